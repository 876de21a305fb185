"""Detects unusable images: they show nothing (covered, dark, dazzled), or are frozen; `picture_age`: of unknown age.

Cameras fail this way silently: frames keep coming, with valid timestamps. One whose images are frozen is opened again.

What a camera sees is alike in neighboring rows and columns, and moves when the vehicle does; noise of the sensor is not
alike, a lens that is covered shows a smooth gradient at most, and an old image that is encoded anew does not move. All
three show in the curvature of a thumbnail: second differences along its rows, and along its columns.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.backoff import BackOff
from edge.camera.newest import NewestFrame
from edge.feed import Frame
from edge.geodesy import VehiclePosition

THUMBNAIL, CELL_PX, WIDEST_PX = (32, 24), 8, 640
"""Columns and rows at most. A cell is the mean of its pixels, at least a block of JPEG, whose noise is one; of a wider
image not every pixel is needed."""
CLEAR_GRAY, LEAST_GRAY, STRONG_GRAY = 4.0, 0.5, 15.0
"""Standard deviation, in gray levels, of the curvature that neighbors share: an image shows something from the first
on, nothing below the second. In 1,948 real images it was 5 to 80, and 0.7 to 4 at a contrast of 5 of 100; where nothing
was shown, by noise of 1 to 15 gray levels, up to 2.5. The third is of all curvature: noise of 60 gray levels leaves
13, and of 1,550 rendered images at night, 11 whose rows of windows alternate share nothing and have 20 to 25."""
ALIKE, ALIKE_AGAIN = 0.15, 0.3
"""Between the two, correlation of the curvature of neighbors from which an image shows something; the second, after an
image that shows nothing. At a contrast of 5 of 100 it was 0.16 to 0.86, and by such noise alone up to 0.29."""
DARK_BELOW, DAZZLED_FROM = 32, 224
"""Mean gray level of an image that shows nothing, by which it is dark or dazzled, and covered between."""
SAME, SAME_AFTER_M, SAME_WITHIN_NS = 0.96, 4.0, 1_000_000_000
"""Correlation of the curvature of two images from which they are the same, and meters that the vehicle has driven
between them; after a longer pause the speed does not tell how far that was."""
BLANK_AFTER_NS, FROZEN_AFTER_NS = 500_000_000, 2_000_000_000
REOPEN_FIRST_NS, REOPEN_LAST_NS = 3_000_000_000, 60_000_000_000
COVERED, DARK = "the image is covered", "the image is dark"
DAZZLED, FROZEN = "the image is dazzled", "the image is frozen"


@dataclass(frozen=True)
class PictureFault:
    """Why an image must not be used.

    sure: the fault has lasted long enough to be reported. reopen: the camera should be opened again now.
    """

    what: str
    sure: bool
    reopen: bool = False


class Information(NamedTuple):
    """What an image shows: its mean gray level, the curvature of its thumbnail (n,), and how much of it is no noise.

    alike: correlation of the curvature of neighbors. gray: standard deviation of what they share, in gray levels.
    """

    level: float
    curvature: NDArray[np.float32]
    alike: float
    gray: float

    @classmethod
    def of(cls, image: NDArray[np.uint8]) -> Information:
        """Of an image (H, W, 3) uint8 BGR of any size."""
        height, width = (-(-side // -(-image.shape[1] // WIDEST_PX)) for side in image.shape[:2])
        thinned = cv2.resize(image, (width, height), interpolation=cv2.INTER_NEAREST)
        cells = [max(4, min(most, px // CELL_PX)) for most, px in zip(THUMBNAIL, (width, height), strict=True)]
        gray = cv2.cvtColor(thinned, cv2.COLOR_BGR2GRAY).astype(np.float32)
        small = cv2.resize(gray, cells, interpolation=cv2.INTER_AREA)
        curved = [one[:, 2:] - 2 * one[:, 1:-1] + one[:, :-2] for one in (small, small.T)]
        both = [(float((one[1:] * one[:-1]).mean()), float(np.square(one).mean())) for one in curved]
        alike = max(shared / max(whole, 1e-9) for shared, whole in both)
        deviation = max(0.0, *(shared for shared, _ in both)) ** 0.5
        return cls(float(small.mean()), np.concatenate([one.ravel() for one in curved]), alike, deviation)

    def is_like(self, other: Information) -> bool:
        """Whether both images show the same, seen from the same spot."""
        lengths = float(np.linalg.norm(self.curvature) * np.linalg.norm(other.curvature))
        return float(self.curvature @ other.curvature) >= SAME * lengths


class PictureFaultDetector:
    """Checks every frame; keeps what it needs of those before."""

    def __init__(self, min_speed_mps: float = 0.0) -> None:
        """min_speed_mps: a slower vehicle stands."""
        self._min_speed_mps, self._last = min_speed_mps, np.zeros(0, np.float32)
        self._same_since_ns, self._stamp_ns = 0, 0
        self._blank_since_ns: int | None = None
        self._reopening = BackOff(REOPEN_FIRST_NS, REOPEN_LAST_NS)
        self._before: Information | None = None  # of an image some meters back
        self._driven_m = SAME_AFTER_M  # since that one

    def check(self, image: NDArray[np.uint8], stamp_ns: int, speed_mps: float | None) -> PictureFault | None:
        """Check an image (H, W, 3) uint8; None if it is usable. speed_mps: of the vehicle, None if unknown.

        Identical images mean a frozen camera, because sensors have noise; but not while the vehicle is known to stand,
        because rendered images have none. A single repetition may come from a driver whose camera is slower than
        requested: it has no new information and is not used either.
        """
        seen, stands = Information.of(image), speed_mps is not None and speed_mps < self._min_speed_mps
        is_same = not stands and np.array_equal(seen.curvature, self._last) and stamp_ns >= self._same_since_ns
        blank = self._blank(seen, stamp_ns)
        has_not_moved = blank is None and self._has_not_moved(seen, stamp_ns, 0.0 if stands else speed_mps)
        if not is_same:
            self._last, self._same_since_ns = seen.curvature, stamp_ns
        if not (is_same or has_not_moved):
            self._reopening.reset()
            self._reopening.failed(stamp_ns)
        if blank is not None or not (is_same or has_not_moved):
            return blank
        sure = has_not_moved or stamp_ns - self._same_since_ns >= FROZEN_AFTER_NS
        is_due = sure and self._reopening.is_over(stamp_ns)
        if is_due:
            self._reopening.failed(stamp_ns)
        return PictureFault(FROZEN, sure, reopen=is_due)

    def _blank(self, seen: Information, stamp_ns: int) -> PictureFault | None:
        """Whether an image shows nothing, and why."""
        alike = ALIKE if self._blank_since_ns is None else ALIKE_AGAIN
        if (
            seen.gray >= CLEAR_GRAY
            or float(seen.curvature.std()) >= STRONG_GRAY
            or (seen.gray >= LEAST_GRAY and seen.alike >= alike)
        ):
            self._blank_since_ns = None
            return None
        self._blank_since_ns = stamp_ns if self._blank_since_ns is None else self._blank_since_ns
        what = DARK if seen.level < DARK_BELOW else DAZZLED if seen.level >= DAZZLED_FROM else COVERED
        return PictureFault(what, stamp_ns - self._blank_since_ns >= BLANK_AFTER_NS)

    def _has_not_moved(self, seen: Information, stamp_ns: int, speed_mps: float | None) -> bool:
        """Whether an image shows what one did from which the vehicle has driven on."""
        self._driven_m += (speed_mps or 0.0) * min(max(0, stamp_ns - self._stamp_ns), SAME_WITHIN_NS) / 1e9
        self._stamp_ns = stamp_ns
        if self._driven_m < SAME_AFTER_M:
            return False
        is_like = self._before is not None and seen.is_like(self._before)
        if not is_like:
            self._before, self._driven_m = seen, 0.0
        return is_like


class PictureCheck:
    """Checks the frames of a camera whose driver stamps them, and opens it again where that may help."""

    why_undated = ""
    """What is missing until the age of the pictures is known, "" where it is, or nobody doubts it."""
    stamp_sigma_s = 0.0
    """One standard deviation of a frame's stamp, once that is known."""

    def __init__(self, device: NewestFrame | None, min_speed_mps: float) -> None:
        """device: None for a camera that cannot be opened again. min_speed_mps: a slower vehicle stands."""
        self._device, self._detector = device, PictureFaultDetector(min_speed_mps)
        self.age_ns = 0
        """By how much the pictures are older than they say, as it was known last."""
        self.fault: PictureFault | None = None
        """Of the newest frame."""

    @property
    def why_no_position(self) -> str:
        """Why no position may rest on the pictures, "" if it may."""
        return self.why_undated if self.fault is None else self.fault.what

    def dated(self, frame: Frame, speed_mps: float | None, own: VehiclePosition | None = None) -> Frame:
        """A frame with the stamp of its exposure.

        speed_mps: of the vehicle at the stamp that the frame has. own: its newest position, whose heading shows turns.
        """
        return frame

    def is_usable(self, frame: Frame, speed_mps: float | None) -> bool:
        """Whether a frame may be used; speed_mps: of the vehicle, None if unknown."""
        fault = self.fault = self._detector.check(frame.image, frame.stamp_ns, speed_mps)
        if fault and fault.reopen and self._device is not None:
            self._device.reopen(fault.what)
        return fault is None
