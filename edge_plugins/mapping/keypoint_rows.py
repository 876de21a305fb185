"""The keypoints of a map that is being made: place after place to the disk, then the distances of all of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from msgspec.structs import asdict
from numpy.typing import NDArray

from edge.config import PINHOLE, Lens
from edge.descriptor.model_file import read_model_file, resolve_model
from edge.errors import MapError
from edge.keypoints import Keypoints
from edge.keypoints.drive_points import points_of_drive
from edge.keypoints.mount import Mount, mount_of_drive
from edge.keypoints.network import NETWORK
from edge.reference_map.keypoint_file import MOST_PIXELS, KeypointsKey, mapped
from edge.reference_map.keypoint_records import camera_of, keypoints_of, points_of, put_points, record_of
from edge.reference_map.store import Segment

MOST_OF_PLACE = 300
"""Keypoints of a place: 22.8 kB. Home at night, 57 of 60 frames of one road had a pose by 200, and all by 300 and 400,
whose errors were alike."""
ASPECT_PX = 1.0
"""By which the height of a picture may differ from that of another size's of the same shape."""


NO_KEYPOINTS = Keypoints(np.empty((0, 2), np.float32), np.empty(0, np.float32), np.empty((0, 64), np.int8), (1, 1))
KeyOf = Callable[[int, int], KeypointsKey]
"""The key of a map by the height and width of its first picture."""


ASSUMED_DEG, ASSUMED_SIGMA_DEG = 75.0, 10.0
"""Where nobody says the field of view: phones have 65, a GoPro in Linear 86, webcams 60 to 78."""
ASSUMED_FOCAL_SIGMA = math.radians(ASSUMED_SIGMA_DEG) / math.sin(math.radians(ASSUMED_DEG))
ASSUMED = f"not known, and taken as {ASSUMED_DEG:g} ± {ASSUMED_SIGMA_DEG:g} degrees"


def keypoints_key(
    height: int, width: int, fov_deg: float, lens: Lens = PINHOLE, focal_sigma: float = 0.0
) -> KeypointsKey:
    """Of a new map of pictures of this size and horizontal field of view, by the network that ships. ModelError."""
    made = read_model_file(resolve_model(Path(NETWORK))).info
    shrunk = min(1.0, MOST_PIXELS / max(height, width))
    size = round(width * shrunk), round(height * shrunk)
    return KeypointsKey(NETWORK, made.sha256, MOST_OF_PLACE, *size, float(fov_deg), focal_sigma, **asdict(lens))


def is_of_shape(key: KeypointsKey, height: int, width: int) -> bool:
    """Whether a picture has the shape of a map's pictures, of whatever size."""
    return abs(height * key.width / width - key.height) <= ASPECT_PX


class KeypointRows:
    """Writes `keypoints.bin`."""

    def __init__(self, file: Path, key_of: KeyOf) -> None:
        """OSError."""
        self._path, self._key_of = file, key_of
        self._key: KeypointsKey | None = None
        self._file = file.open("wb")
        self._count = 0
        self._mounts: dict[int, Mount | None] = {}  # of places that are not leveled yet; None: nor are distances known

    def add(self, *found: Keypoints) -> None:
        """Of the next places. MapError for a picture of another shape."""
        for keypoints in found:
            height, width = keypoints.size
            key = self._key = self._key or self._key_of(height, width)
            if not is_of_shape(key, height, width):
                raise MapError(
                    f"pictures of {width} x {height} and of {key.width} x {key.height} pixels: a map with keypoints has"
                    " those of one shape; build two maps, or use --no-keypoints"
                )
            self._mounts[self._count] = None
            self._write(record_of(keypoints, key))

    def add_record(self, record: NDArray[np.void], key: KeypointsKey, mount: Mount | None = None) -> None:
        """Of the next place, as another map of this key has them; mount: by this place, as live mapping has them."""
        if mount is not None:
            self._mounts[self._count] = mount
        self._key = self._key or key
        self._write(record)

    def _write(self, record: NDArray[np.void]) -> None:
        self._file.write(record.tobytes())
        self._count += 1

    def finish(self, places: NDArray[np.void], segments: Iterable[Segment]) -> KeypointsKey:
        """Compute the distances of new places by all rows of their drives, and level them. places: (N,) of PLACE."""
        self.close()
        assert self._key is not None  # a map has places
        key = self._key
        records = mapped(self._path, key, self._count, writable=True)
        for segment in segments:
            drive = records[segment.start : segment.end]
            own = places[segment.start : segment.end]
            heading, faces_back = np.radians(own["heading_deg"]), segment.view == "rear"
            mounts = {
                row - segment.start: self._mounts[row]
                for row in range(segment.start, segment.end)
                if row in self._mounts
            }
            rows = [row for row, mount in mounts.items() if mount is None]

            def read(row: int, drive: NDArray[np.void] = drive) -> Keypoints:
                return keypoints_of(drive[row], key)

            of_drive = mount_of_drive(mount for mount in mounts.values() if mount is not None)
            where, is_course = (own["route_m"], heading), segment.heading_is_course
            found = points_of_drive(
                read, *where, camera_of(key), rows, faces_back=faces_back, mount=of_drive, is_course=is_course
            )
            for row, (points, mount) in zip(rows, found, strict=True):
                put_points(drive[row], points)
                mounts[row] = mount
            of_drive = mount_of_drive(mount for mount in mounts.values() if mount is not None)
            for row in mounts:
                put_points(drive[row], points_of(drive[row]).turned(of_drive.rotation.T))
        records.flush()  # type: ignore[attr-defined]
        return key

    def close(self) -> None:
        """Close the file; more than once is harmless."""
        self._file.close()
