"""Pictures that show nothing: a blank one (lens covered, no exposure) and a frozen one (the same again and again).

Cameras fail that way without a word: frames go on coming, with good stamps.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.backoff import BackOff

BLANK_DEVIATION = 2.0
"""Grey levels, of the channel that varies most. The flattest picture of the recorded feeds has 56."""
BLANK_AFTER_NS = 500_000_000
FROZEN_AFTER_NS = 2_000_000_000
REOPEN_FIRST_NS = 3_000_000_000
REOPEN_LAST_NS = 60_000_000_000
STEP_PX = 4
BLANK = "the picture is blank; is the lens covered, or the exposure wrong?"
FROZEN = "the picture is frozen"


@dataclass(frozen=True)
class PictureFault:
    """What is wrong with a picture that must not be used.

    sure: it has been so for long enough to be told. reopen: opening the camera again is worth a try now.
    """

    what: str
    sure: bool
    reopen: bool = False


class FrozenPictureDetector:
    """Looks at every frame that is taken."""

    def __init__(self) -> None:
        self._checksum: int | None = None
        self._same_since_ns = 0
        self._blank_since_ns: int | None = None
        self._reopening = BackOff(REOPEN_FIRST_NS, REOPEN_LAST_NS)

    def check(self, image: NDArray[np.uint8], stamp_ns: int, moves: bool | None) -> PictureFault | None:
        """What is wrong with a picture (H, W, 3) uint8; moves: whether the vehicle drives, None where nobody tells.

        The same bytes again are a frozen camera, since sensors have noise; but not while the vehicle is known to stand,
        because rendered pictures have none. One such picture may be a driver's, of a camera that is slower than asked
        for: it says nothing new either, and is not used.
        """
        thinned = image[::STEP_PX, ::STEP_PX]
        checksum = zlib.crc32(thinned.tobytes())
        is_same = checksum == self._checksum and stamp_ns >= self._same_since_ns and moves is not False
        if not is_same:
            self._checksum, self._same_since_ns = checksum, stamp_ns
            self._reopening.reset()
            self._reopening.failed(stamp_ns)
        # By channel, since a buffer of zeros in YUV is a plain green.
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
        """Whether to open a frozen camera again now; the pauses grow while that does not help."""
        if not self._reopening.is_over(stamp_ns):
            return False
        self._reopening.failed(stamp_ns)
        return True
