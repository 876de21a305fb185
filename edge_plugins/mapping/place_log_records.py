"""What the file of a map that is being made holds: how its places were made, each place, and its keypoints."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

import edge
from edge.config import SamplingConfig
from edge.keypoints import Keypoints
from edge.keypoints.mount import Mount
from edge.reference_map import ModelKey, RegionsKey
from edge.reference_map.keypoint_file import KEYPOINT, KeypointsKey
from edge_plugins.mapping.builder import Place

View = Literal["front", "rear"]


class LogHeader(msgspec.Struct, frozen=True):
    """How the places were made; a map is made of places that were made alike. keypoints: None where they have none."""

    model: ModelKey
    regions: RegionsKey
    sampling: SamplingConfig
    lookback: str = edge.__version__
    keypoints: KeypointsKey | None = None


class PlacePassed(msgspec.Struct, frozen=True):
    """A place, and its raw descriptor (R, D) as little-endian float16.

    drive: the number of its drive, whose places were passed one after another. view: of the camera. unix_s: when it was
    handed over. is_vouched: whether all of its drive moved as what GPS has no part in, see `OwnMotion`.
    """

    place: Place
    raw: bytes
    drive: int
    view: View
    unix_s: float
    is_vouched: bool = False


class PointsMade(msgspec.Struct, frozen=True):
    """The keypoints of a place, written once the drive has gone on, so that their distances are known.

    points: records of KEYPOINT, in the frame of the camera as it is mounted. radians: how it is mounted by this place.
    information: of these, (2, 2) row by row.
    """

    points: bytes
    radians: tuple[float, float]
    information: tuple[float, float, float, float]

    @property
    def mount(self) -> Mount:
        """How the camera is mounted by this place."""
        return Mount(np.array(self.radians), np.reshape(self.information, (2, 2)))

    @property
    def record(self) -> NDArray[np.void]:
        """The records (K,)."""
        return np.frombuffer(self.points, KEYPOINT)

    @classmethod
    def of(cls, record: NDArray[np.void], mount: Mount) -> PointsMade:
        """Of the records (K,) of a place."""
        a, b, c, d = mount.information.ravel().tolist()
        return cls(record.tobytes(), tuple(mount.radians.tolist()), (a, b, c, d))


@dataclass(frozen=True)
class MappedPlace:
    """A place, its raw descriptor (R, D), and its keypoints once they are found, None for a place without."""

    raw: NDArray[np.float32]
    place: Place
    keypoints: Future[Keypoints] | None = None
