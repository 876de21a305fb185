"""`keypoints.bin`: the keypoints of each place, and how far away they are; memory-mapped.

A place has as many records of KEYPOINT as the header's key says, the best first; where its picture shows fewer, the
rest are zeros, whose descriptors no other is like.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.config import Lens
from edge.errors import MapError, reason
from edge.toml_file import Line

KEYPOINT = np.dtype(
    [
        ("descriptor", "i1", 64),
        ("xy", "<u2", 2),  # 1 / STEPS of a pixel
        ("direction", "<f2", 2),  # x / z and y / z in the frame of the place's camera
        ("inverse", "<f2"),  # 1 / z in 1/m and its sigma; NaN where the distance is not known
        ("sigma", "<f2"),
    ]
)
"""76 bytes."""
STEPS = 32
MOST_PIXELS = (1 << 16) // STEPS


class KeypointsKey(Lens, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """What made the keypoints of a map: the network, how many of each place, and the pictures they are in.

    The lens is that of those pictures: `xy` is as it shows them, directions are without what it bends. focal_sigma: of
    the logarithm of the focal length; not 0 where the field of view was taken as a usual one.
    """

    network: Line
    sha256: Line
    most: Annotated[int, msgspec.Meta(ge=1, le=10_000)]
    width: Annotated[int, msgspec.Meta(ge=1, le=MOST_PIXELS)]
    height: Annotated[int, msgspec.Meta(ge=1, le=MOST_PIXELS)]
    fov_deg: Annotated[float, msgspec.Meta(ge=30, le=120)]
    focal_sigma: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.0

    @property
    def place_bytes(self) -> int:
        """Bytes of a place."""
        return self.most * KEYPOINT.itemsize


def mapped(file: Path, key: KeypointsKey, places: int, *, writable: bool = False) -> NDArray[np.void]:
    """Records (N, K) of KEYPOINT, of which nothing is read yet. MapError if the file cannot be mapped."""
    try:
        return np.memmap(file, KEYPOINT, mode="r+" if writable else "r", shape=(places, key.most))
    except (OSError, ValueError) as error:
        raise MapError(f"{file}: cannot map it: {reason(error)}") from None
