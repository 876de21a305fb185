"""The keypoints of the map of this drive, found and placed by a thread of its own: no turn of the daemon waits for it.

Once the drive has gone on by REACH_M, the distances of a place's points are known, and it is written.
"""

from __future__ import annotations

import logging
import signal
from bisect import bisect_right
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cached_property
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from edge.config import Lens
from edge.keypoints import Keypoints
from edge.keypoints.drive_points import points_of_drive
from edge.keypoints.lens import LensCheck
from edge.keypoints.mount import Mount, mount_of_drive
from edge.keypoints.network import KeypointNetwork
from edge.keypoints.points import REACH_M
from edge.reference_map.keypoint_file import KeypointsKey
from edge.reference_map.keypoint_records import camera_of, points_of, put_points, record_of
from edge_plugins.mapping.builder import Place
from edge_plugins.mapping.keypoint_rows import NO_KEYPOINTS, is_of_shape, keypoints_key
from edge_plugins.mapping.place_log import PlaceLog
from edge_plugins.mapping.place_log_records import LogHeader

MOST_PICTURES = 4
"""That wait for their keypoints, of up to 6 MB each; a place whose picture comes meanwhile has none."""
log = logging.getLogger(__name__)


class _Row(NamedTuple):
    """A place of the present drive."""

    row: int
    route_m: float
    heading_rad: float
    keypoints: Keypoints


class LiveKeypoints:
    """Those of each place, which are added in their order by one thread."""

    def __init__(self, fov_deg: float | None, lens: Lens, focal_sigma: float = 0.0, *, faces_back: bool) -> None:
        """fov_deg: horizontal, of the pictures; None: there are none. focal_sigma: one standard deviation of the focal
        length, as a share. faces_back: the camera that maps. ModelError.
        """
        self._made = None if fov_deg is None else keypoints_key(1, 1, fov_deg, lens, focal_sigma)
        self._faces_back = faces_back
        self._thread = ThreadPoolExecutor(1, "keypoints", _block_signals)
        self._pictures: list[Future[Keypoints]] = []
        self._size = 1, 1  # of the newest, height and width
        self._log: PlaceLog | None = None
        self._is_closed = self._has_warned = False
        # What follows is the thread's own, but for what `__getitem__` reads of _drives.
        self._drives: list[tuple[int, Mount]] = []  # with which place each begins, and its camera
        self._rows: list[_Row] = []  # of the present drive, as far as they are needed
        self._placed = 0  # of these, whose distances are known
        self._lens = LensCheck()

    def is_alike(self, key: KeypointsKey | None) -> bool:
        """Whether a map with keypoints of this key, None for one without, can go on."""
        return self._made == (None if key is None else replace(key, width=1, height=1))

    def header_of(self, header: LogHeader) -> LogHeader:
        """The header of a new file, whose first picture is the newest one."""
        made = self._made
        if made is None:
            return header
        return replace(header, keypoints=keypoints_key(*self._size, made.fov_deg, made.alone, made.focal_sigma))

    def write_to(self, file: PlaceLog) -> None:
        """Write to a file, going on with its last drive if there is one."""
        self._log, found = file, file.file
        self._drives = [(first, found.mounts.get(first) or mount_of_drive(())) for first, _ in found.drives]

    def find(self, image: NDArray[np.uint8]) -> Future[Keypoints] | None:
        """Those of a picture (H, W, 3) uint8 BGR, which must not change; None where the computer is too slow."""
        self._size = image.shape[0], image.shape[1]
        self._pictures = [one for one in self._pictures if not one.done()]
        made = self._made
        if made is None or self._is_closed:
            return None
        if len(self._pictures) >= MOST_PICTURES:
            self._warn("the computer is too slow for those of all places")
            return None
        self._pictures.append(self._thread.submit(self._find, image, made.most))
        return self._pictures[-1]

    def _find(self, image: NDArray[np.uint8], most: int) -> Keypoints:
        self._lens.add(image)
        return self._lens.without_fixed(self._network.extract(image, most))

    def begin_drive(self, row: int) -> None:
        """The places from a row on are of another drive."""
        if not self._is_closed:
            self._thread.submit(self._begin_drive, row)

    def add(self, place: Place, found: Future[Keypoints] | None) -> None:
        """A place of the present drive, which was handed to the file."""
        if found is not None and not self._is_closed:
            self._thread.submit(self._add, place, found)

    def __getitem__(self, row: int) -> NDArray[np.void]:
        """The records (K,) of KEYPOINT of a place, in the frame of a camera that faces level along the road.

        Without keypoints where they are not known yet.
        """
        assert self._log is not None and self._log.file.header.keypoints is not None
        made, drives = self._log.points(row), self._drives
        if made is None:
            return record_of(NO_KEYPOINTS, self._log.file.header.keypoints)
        record = made.record.copy()
        _, mount = drives[bisect_right(drives, row, key=lambda one: one[0]) - 1]
        put_points(record, points_of(record).turned(mount.rotation.T))
        return record

    def wait(self) -> None:
        """Until all is done that was handed over so far."""
        if self._made is not None:
            self._thread.submit(lambda: None).result()

    def end(self, then: Callable[[], object]) -> None:
        """Place the last points by what there is, and call `then`; once."""
        if not self._is_closed:
            self._is_closed = True
            self._thread.submit(self._place_up_to, np.inf)
            self._thread.submit(then)

    def close(self) -> None:
        """Wait for that; more than once is harmless."""
        self._thread.shutdown()

    @cached_property
    def _network(self) -> KeypointNetwork:
        return KeypointNetwork()

    def _begin_drive(self, row: int) -> None:
        self._place_up_to(np.inf)
        self._rows, self._placed = [], 0
        self._drives = [*self._drives, (row, mount_of_drive(()))]

    def _add(self, place: Place, found: Future[Keypoints]) -> None:
        if error := found.exception():
            self._warn(f"a place has none: {error}")
            return
        keypoints = found.result()
        if self._key is not None and is_of_shape(self._key, *keypoints.size):
            self._rows.append(_Row(place.row, place.route_m, np.radians(place.heading_deg), keypoints))
            self._place_up_to(place.route_m - REACH_M)

    def _place_up_to(self, route_m: float) -> None:
        while self._placed < len(self._rows) and self._rows[self._placed].route_m <= route_m:
            try:
                self._place(self._placed)
            except (ArithmeticError, ValueError) as error:  # as NumPy's LinAlgError
                self._warn(f"the distances of a place's are not known: {error}")
            self._placed += 1
        if self._placed < len(self._rows):
            first_m = self._rows[self._placed].route_m - REACH_M
            passed = sum(one.route_m < first_m for one in self._rows[: self._placed])
            self._rows, self._placed = self._rows[passed:], self._placed - passed

    def _place(self, at: int) -> None:
        key, (first, mount) = self._key, self._drives[-1]
        assert key is not None and self._log is not None
        rows, route_m, heading_rad, keypoints = zip(*self._rows, strict=True)
        where = np.array(route_m), np.array(heading_rad), camera_of(key)
        found = points_of_drive(keypoints.__getitem__, *where, [at], faces_back=self._faces_back, mount=mount)
        ((points, of_row),) = found
        self._drives = [*self._drives[:-1], (first, mount_of_drive([of_row], mount))]
        record = record_of(keypoints[at], key)
        put_points(record, points)
        self._log.add_points(rows[at], record, of_row)

    @property
    def _key(self) -> KeypointsKey | None:
        return None if self._log is None else self._log.file.header.keypoints

    def _warn(self, why: str) -> None:
        if not self._has_warned:
            self._has_warned = True
            log.warning("keypoints of the map of this drive: %s", why)


def _block_signals() -> None:
    signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
