"""Detects unusable images: blank (lens covered, no exposure), frozen (the same image again and again), of unknown age.

Cameras fail this way silently: frames keep coming, with valid timestamps. One whose images are frozen is opened again.
Images behind the buffer of a network stream are older than they say; `picture_age` shows by how much.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.backoff import BackOff
from edge.camera.newest import NewestFrame
from edge.feed import Frame
from edge.geodesy import VehiclePosition

BLANK_DEVIATION = 2.0
"""Standard deviation in gray levels, of the channel with the largest. The minimum in the recorded feeds is 56."""
BLANK_AFTER_NS = 500_000_000
FROZEN_AFTER_NS = 2_000_000_000
REOPEN_FIRST_NS = 3_000_000_000
REOPEN_LAST_NS = 60_000_000_000
STEP_PX = 4
"""One pixel of a square of so many is checked, by OpenCV: slices of NumPy take 10 to 15 times as long."""
BLANK = "the image is blank; is the lens covered, or the exposure wrong?"
FROZEN = "the image is frozen"


@dataclass(frozen=True)
class PictureFault:
    """Why an image must not be used.

    sure: the fault has lasted long enough to be reported. reopen: the camera should be opened again now.
    """

    what: str
    sure: bool
    reopen: bool = False


class FrozenPictureDetector:
    """Checks every frame; keeps what it needs of the last one."""

    def __init__(self) -> None:
        self._thinned = b""
        self._same_since_ns = 0
        self._blank_since_ns: int | None = None
        self._reopening = BackOff(REOPEN_FIRST_NS, REOPEN_LAST_NS)

    def check(self, image: NDArray[np.uint8], stamp_ns: int, moves: bool | None) -> PictureFault | None:
        """Check an image (H, W, 3) uint8; None if it is usable. moves: whether the vehicle drives, None if unknown.

        Identical bytes mean a frozen camera, because sensors have noise; but not while the vehicle is known to stand,
        because rendered images have none. A single repetition may come from a driver whose camera is slower than
        requested: it has no new information and is not used either.
        """
        height, width = (-(-side // STEP_PX) for side in image.shape[:2])
        thinned = cv2.resize(image, (width, height), interpolation=cv2.INTER_NEAREST)
        pixels = thinned.tobytes()
        is_same = pixels == self._thinned and stamp_ns >= self._same_since_ns and moves is not False
        if not is_same:
            self._thinned, self._same_since_ns = pixels, stamp_ns
            self._reopening.reset()
            self._reopening.failed(stamp_ns)
        # By channel, because a buffer of zeros in YUV is uniformly green.
        is_blank = float(cv2.meanStdDev(thinned)[1].max()) < BLANK_DEVIATION
        if not is_blank:
            self._blank_since_ns = None
        elif self._blank_since_ns is None:
            self._blank_since_ns = stamp_ns
        if self._blank_since_ns is not None:
            return PictureFault(BLANK, stamp_ns - self._blank_since_ns >= BLANK_AFTER_NS)
        if not is_same:
            return None
        sure = stamp_ns - self._same_since_ns >= FROZEN_AFTER_NS
        return PictureFault(FROZEN, sure, reopen=sure and self._is_due(stamp_ns))

    def _is_due(self, stamp_ns: int) -> bool:
        """Whether to open a frozen camera again now; the delays grow while that does not help."""
        if not self._reopening.is_over(stamp_ns):
            return False
        self._reopening.failed(stamp_ns)
        return True


class PictureCheck:
    """Checks the frames of a camera whose driver stamps them, and opens it again where that may help."""

    why_undated = ""
    """What is missing until the age of the pictures is known, "" where it is, or nobody doubts it."""
    stamp_sigma_s = 0.0
    """One standard deviation of a frame's stamp, once that is known."""

    def __init__(self, device: NewestFrame | None, min_speed_mps: float) -> None:
        """device: None for a camera that cannot be opened again. min_speed_mps: a slower vehicle stands."""
        self._device, self._min_speed_mps = device, min_speed_mps
        self._detector = FrozenPictureDetector()
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
        fault = self.fault = self._detector.check(frame.image, frame.stamp_ns, self._moves(speed_mps))
        if fault and fault.reopen and self._device is not None:
            self._device.reopen(fault.what)
        return fault is None

    def _moves(self, speed_mps: float | None) -> bool | None:
        return None if speed_mps is None else speed_mps >= self._min_speed_mps
