"""Detects unusable images: blank (lens covered, no exposure), frozen (the same image again and again), and too old.

Cameras fail this way silently: frames keep coming, with valid timestamps. One whose images are frozen is opened again.
Images behind the buffer of a network stream are older than they say. Pictures and the vehicle start, stop and turn
together, so the age is seen at a start, at a stop and in bends (`turns`); nothing is known of it before.
"""

from __future__ import annotations

import math
import zlib
from collections import deque
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.backoff import BackOff
from edge.camera.newest import NewestFrame
from edge.camera.turns import Turns
from edge.feed import Frame

BLANK_DEVIATION = 2.0
"""Standard deviation in gray levels, of the channel with the largest. The minimum in the recorded feeds is 56."""
BLANK_AFTER_NS = 500_000_000
FROZEN_AFTER_NS = 2_000_000_000
REOPEN_FIRST_NS = 3_000_000_000
REOPEN_LAST_NS = 60_000_000_000
STEP_PX = 4
BLANK = "the image is blank; is the lens covered, or the exposure wrong?"
FROZEN = "the image is frozen"
UNDATED = "how old its pictures are is not known; a start, stop or turn shows it"
TOO_OLD = "its pictures seem {:.0f} s old; one more start, stop or turn shows it"
BLOCK_PX = 8
"""Pictures are compared by the means of such squares, in which a sensor's noise of 5 gray levels is one of 0.6."""
BEFORE_NS, LEAST_NS, AFTER_NS = 1_500_000_000, 4_000_000_000, 10_000_000_000
"""How long the vehicle must have stood before a start, or moved before a stop; and how long after it pictures are
compared, at least and at most: older ones than that are not noticed."""
LASTS_NS = 1_000_000_000
"""A start or stop that lasts less is none: by its speed, a vehicle that creeps starts and stops."""
HOLE_NS = 1_000_000_000
"""A longer hole in the pictures hides when they, or the vehicle, started or stopped: those of a stream, 3 s old, seemed
1.3 to 1.8 s old, which counts as in time, and positions 12 to 22 m off were sent."""
CONTRAST = 3.0
"""Times by which pictures must change more while the vehicle moves than while it stands."""
OLD_NS = 2_000_000_000
"""Pictures that are older are noticed: a slow start shows up to a second late, and frames have holes. By their turns,
those in time seemed up to 1.1 s old on simulated drives."""
ALIKE_NS = 1_500_000_000
"""Two ages that differ by no more are one: a slow start shows late, and a slow stop early."""
LEAST_CHANGE = 0.1
"""Gray levels, far below the noise of any sensor; rendered pictures have none."""


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
        self._checksum: int | None = None
        self._same_since_ns = 0
        self._blank_since_ns: int | None = None
        self._reopening = BackOff(REOPEN_FIRST_NS, REOPEN_LAST_NS)

    def check(self, image: NDArray[np.uint8], stamp_ns: int, moves: bool | None) -> PictureFault | None:
        """Check an image (H, W, 3) uint8; None if it is usable. moves: whether the vehicle drives, None if unknown.

        Identical bytes mean a frozen camera, because sensors have noise; but not while the vehicle is known to stand,
        because rendered images have none. A single repetition may come from a driver whose camera is slower than
        requested: it has no new information and is not used either.
        """
        thinned = image[::STEP_PX, ::STEP_PX]
        checksum = zlib.crc32(thinned.tobytes())
        is_same = checksum == self._checksum and stamp_ns >= self._same_since_ns and moves is not False
        if not is_same:
            self._checksum, self._same_since_ns = checksum, stamp_ns
            self._reopening.reset()
            self._reopening.failed(stamp_ns)
        # By channel, because a buffer of zeros in YUV is uniformly green.
        is_blank = float(thinned.std(axis=(0, 1)).max()) < BLANK_DEVIATION
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


@dataclass(frozen=True)
class Age:
    """Of the pictures: nanoseconds, 0 where they are in time; is_certain: whether two observations say so."""

    age_ns: int = 0
    is_certain: bool = True


class PictureAge:
    """Compares starts, stops and turns of the pictures with those of the vehicle."""

    def __init__(self) -> None:
        self._turns = Turns()
        self._means: NDArray[np.float32] | None = None
        self._changes: deque[tuple[int, float]] = deque()
        """Of the pictures since BEFORE_NS + AFTER_NS ago: stamp, and logarithm of the gray levels of the change."""
        self._newest: tuple[bool | None, int, bool] = None, 0, False
        self._moves: bool | None = None
        self._since_ns = 0
        """What the vehicle does, once that lasts, and since when; the newest may not last. Last of the newest: whether
        it began while pictures were missing, so that nobody knows when."""
        self._is_judged = True
        self._ages_ns: deque[int] = deque(maxlen=2)
        self.age = Age()

    @property
    def is_known(self) -> bool:
        """Whether a start, a stop or turns have shown it."""
        return bool(self._ages_ns)

    def add(
        self,
        image: NDArray[np.uint8],
        stamp_ns: int,
        moves: bool | None,
        heading: tuple[int, float] | None = None,
    ) -> None:
        """A picture (H, W, 3) of a moment; moves: whether the vehicle did then, None if unknown. heading: see Turns."""
        height, width = (max(1, size // BLOCK_PX) for size in image.shape[:2])
        green = np.asarray(cv2.extractChannel(image, 1), np.uint8)
        by_turns_ns = self._turns.add(green, stamp_ns, heading)
        if by_turns_ns is not None:
            self._observe(by_turns_ns)
        green = green[: height * BLOCK_PX, : width * BLOCK_PX].astype(np.float32)
        # Each picture passes here, used or not: this takes a quarter of the time of NumPy's mean.
        means = np.asarray(cv2.resize(green, (width, height), interpolation=cv2.INTER_AREA), np.float32)
        before, self._means = self._means, means
        if before is not None and before.shape == means.shape:
            change = max(LEAST_CHANGE, float(np.abs(means - before).mean()))
            self._changes.append((stamp_ns, math.log(change)))
        while self._changes and stamp_ns - self._changes[0][0] > BEFORE_NS + AFTER_NS:
            self._changes.popleft()
        if moves is not self._newest[0]:
            is_hidden = len(self._changes) < 2 or stamp_ns - self._changes[-2][0] > HOLE_NS
            self._newest = moves, stamp_ns, is_hidden
        is_new = moves is not self._moves and stamp_ns - self._newest[1] >= LASTS_NS
        lasted_ns = (self._newest[1] if is_new else stamp_ns) - self._since_ns
        if not self._is_judged and (lasted_ns >= AFTER_NS or (is_new and lasted_ns >= LEAST_NS)):
            self._judge()
        if is_new:
            is_unknown = self._moves is None or moves is None
            self._moves, self._since_ns, is_hidden = self._newest
            self._is_judged = is_unknown or is_hidden or lasted_ns < BEFORE_NS

    def _judge(self) -> None:
        """Find the moment at which the pictures started or stopped as the vehicle did."""
        self._is_judged = True
        stamps_ns, changes = np.array([one for one in self._changes if one[0] > self._since_ns - BEFORE_NS]).T
        is_before = stamps_ns <= self._since_ns
        is_last = stamps_ns > self._since_ns + (stamps_ns[-1] - self._since_ns) * 2 / 3
        if not is_before.any():
            return
        earlier, later = float(np.median(changes[is_before])), float(np.median(changes[is_last]))
        if (later - earlier if self._moves else earlier - later) < math.log(CONTRAST):
            return
        is_as_later = np.abs(changes - later) < np.abs(changes - earlier)
        # The moment after which most of the pictures change as they do later, and before which they do not.
        wrong = np.cumsum(is_as_later) + np.cumsum(~is_as_later[::-1])[::-1] - ~is_as_later
        last = int(wrong.argmin())
        hole_ns = stamps_ns[last + 1] - stamps_ns[last] if last + 1 < len(stamps_ns) else 0
        if hole_ns <= HOLE_NS:
            self._observe(int(stamps_ns[last] - self._since_ns))

    def _observe(self, age_ns: int) -> None:
        """By a start, a stop, or turns."""
        self._ages_ns.append(age_ns if age_ns >= OLD_NS else 0)
        first_ns, newest_ns = self._ages_ns[0], self._ages_ns[-1]
        if self.age.age_ns and self.age.is_certain and abs(age_ns - self.age.age_ns) <= ALIKE_NS:
            return  # a stamp that is better by a tenth of a second is not worth beginning anew
        if not any(self._ages_ns):
            self.age = Age()
            return
        is_certain = all(self._ages_ns) and len(self._ages_ns) == 2 and abs(first_ns - newest_ns) <= ALIKE_NS
        self.age = Age((first_ns + newest_ns) // 2 if is_certain else newest_ns, is_certain)


class PictureCheck:
    """Checks the frames of a camera, and opens it again where that may help."""

    def __init__(self, device: NewestFrame | None, min_speed_mps: float, *, may_be_old: bool = False) -> None:
        """device: None for a camera that cannot be opened again. min_speed_mps: a slower vehicle stands.

        may_be_old: whether nothing but the pictures themselves says how old they are, as those of a network stream.
        """
        self._device, self._min_speed_mps, self._may_be_old = device, min_speed_mps, may_be_old
        self._detector = FrozenPictureDetector()
        self._age, self._opened = PictureAge(), 0
        self.age_ns = 0
        """By how much the pictures are older than they say, where that is certain."""
        self.fault: PictureFault | None = None
        """Of the newest frame."""

    @property
    def why_no_position(self) -> str:
        """Why no position may rest on the pictures, "" if it may."""
        return self.why_undated if self.fault is None else self.fault.what

    @property
    def why_undated(self) -> str:
        """What is missing until the age of the pictures is known, "" where it is, or nobody doubts it."""
        return UNDATED if self._may_be_old and not self._age.is_known else ""

    def dated(self, frame: Frame, speed_mps: float | None, heading: tuple[int, float] | None = None) -> Frame:
        """A frame with the stamp of its exposure; speed_mps: of the vehicle at the stamp that it has.

        heading: stamp and degrees of the newest heading of the vehicle.
        """
        opened = 0 if self._device is None else self._device.health.reopened
        if opened != self._opened:  # what lies between is another buffer
            self._age, self._opened = PictureAge(), opened
        self._age.add(frame.image, frame.stamp_ns, self._moves(speed_mps), heading)
        age = self._age.age
        self.age_ns = age.age_ns if age.is_certain else 0
        return replace(frame, stamp_ns=frame.stamp_ns - self.age_ns)

    def _moves(self, speed_mps: float | None) -> bool | None:
        return None if speed_mps is None else speed_mps >= self._min_speed_mps

    def is_usable(self, frame: Frame, speed_mps: float | None) -> bool:
        """Whether a frame may be used; speed_mps: of the vehicle, None if unknown."""
        fault = self._detector.check(frame.image, frame.stamp_ns, self._moves(speed_mps))
        if fault and fault.reopen and self._device is not None:
            self._device.reopen(fault.what)
        age = self._age.age
        if fault is None and not age.is_certain:
            fault = PictureFault(TOO_OLD.format(age.age_ns / 1e9), sure=True)
        self.fault = fault
        return fault is None
