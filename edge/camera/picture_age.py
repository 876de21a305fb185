"""How old the pictures of a network stream are: a vehicle and what its camera shows start, stop and turn together.

Starts and stops: pictures change from one to the next while the vehicle moves. Turns: what lies in the middle of a
picture is far, and moves by turns much more than by driving on; its shift from picture to picture (phase correlation)
and the autopilot's heading are compared at each lag. Nothing is known before one of them. A camera whose driver stamps
its pictures needs none of this: pictures of recorded drives, 0.13 s old at most, seemed 2.3, 2.8 and 5.4 s old.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import NamedTuple

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from edge.camera.newest import NewestFrame
from edge.camera.picture_check import PictureCheck
from edge.feed import Frame
from edge.geodesy import VehiclePosition

UNDATED = "how old its pictures are is not known; a start, stop or turn shows it"
log = logging.getLogger(__name__)
MIDDLE_PX = 40, 30
"""To which the middle half of a picture is reduced, width and height. On 18 simulated drives (six roads; day, night and
rain) its shift over a second correlates with the turn by 0.82 to 0.97; that of the whole picture by 0.56 to 0.85."""
HANNING = np.asarray(cv2.createHanningWindow(MIDDLE_PX, cv2.CV_32F), np.float32)
STEP_NS, WINDOW, LAGS = 250_000_000, 80, 32
"""What is compared: the turns in steps of so long, so many of the newest pictures (20 s), with those of the vehicle up
to so many steps (8 s) earlier."""
LEAST_RADPS = 0.01
"""Standard deviation of the vehicle's turns, below which a road counts as straight. In the bends of those roads it was
0.03 to 0.12."""
CLEAR = 0.2
"""Response of the phase correlation (1 at most) below which a shift says nothing, as after a hole in the pictures."""
ALIKE, CLEARER, APART = 0.7, 2.0, 6
"""Least correlation, by what factor the variance that it leaves must be less than at any other lag, and how many steps
further another one is. Pictures of those drives that were 0, 3 and 6 s old, and those of three drives of the trial,
showed their age in 77 % of the stretches, each within 0.5 s. Pictures of another road showed one in 0.2 % of 2,890
stretches, and never one of a second or more; with a factor of 1.5 and 15 s it was 3.4 and 1.3 %."""
AGAIN = 4
"""Steps until turns that do not show it are asked again."""
TURNS_SIGMA_NS, MOVES_SIGMA_NS = 150_000_000, 500_000_000
"""One standard deviation of an age by turns, and by a start or a stop. On drives of the trial with pictures 0 and 1 s
late, ages by turns were off by 0.10 s (rms; 0.28 at most, n = 25), by starts by 0.2 (n = 50), by stops by up to 0.6."""
AGREE_SIGMAS = 3.0
"""Standard deviations that two ages may be apart and still agree, as everywhere."""
BLOCK_PX = 8
"""Pictures are compared by the means of such squares, in which a sensor's noise of 5 gray levels is one of 0.6."""
BEFORE_NS, LEAST_NS, AFTER_NS = 1_500_000_000, 4_000_000_000, 10_000_000_000
"""How long the vehicle must have stood before a start, or moved before a stop; and how long after it pictures are
compared, at least and at most: older ones than that are not noticed."""
LASTS_NS = 1_000_000_000
"""A start or stop that lasts less is none: by its speed, a vehicle that creeps starts and stops."""
HOLE_NS = 1_000_000_000
"""A longer hole in the pictures hides when they, or the vehicle, started or stopped: those of a stream, 3 s old, seemed
1.3 to 1.8 s old, and positions 12 to 22 m off were sent."""
CONTRAST = 3.0
"""Times by which pictures must change more while the vehicle moves than while it stands: they begin or cease to where
they change by its root more than while it stands. Half way to how they change later was up to 5.4 s late, where a
recorded drive began in an open place at 1 m/s2."""
MIXED = 0.35
"""Share of the pictures up to a start or stop that may change as they do after it. A vehicle that crept while it waited
showed half of them so, and pictures that were 3 s old seemed to be in time.
"""
PLAUSIBLE_NS = 1_000_000_000
"""Up to which a first age is believed at once; a greater one, and each that contradicts those before, once it is seen
twice. The ages that 13 recorded drives showed of such pictures were 0 to 0.56 s, but for those 2.8 s."""
KEPT = 6
"""The newest observations of the age that are kept."""
CHANGED_NS = 250_000_000
"""Stamps are corrected anew where the age is found to be so far from what they were corrected by: nothing that was
recognized before counts then. Less is in the standard deviation of positions."""
LEAST_CHANGE = 0.1
"""Gray levels, far below the noise of any sensor; rendered pictures have none."""


class Seen(NamedTuple):
    """How old pictures were by a start, a stop, or turns: nanoseconds, and one standard deviation."""

    age_ns: float
    sigma_ns: float

    def agrees(self, other: Seen) -> bool:
        """Whether both may be right."""
        return abs(self.age_ns - other.age_ns) <= AGREE_SIGMAS * math.hypot(self.sigma_ns, other.sigma_ns)


@dataclass(frozen=True)
class Age:
    """By how much pictures are older than they say: nanoseconds, and one standard deviation of it."""

    age_ns: int
    sigma_ns: int


class _Doing(NamedTuple):
    """Whether the vehicle moves, None if unknown; since when; and whether it began while pictures were missing."""

    moves: bool | None
    since_ns: int
    is_hidden: bool


class Starts:
    """Starts and stops of the pictures and of the vehicle."""

    def __init__(self) -> None:
        self._means: NDArray[np.float32] | None = None
        self._changes: deque[tuple[int, float]] = deque()
        """Of the pictures since BEFORE_NS + AFTER_NS ago: stamp, and logarithm of the gray levels of the change."""
        self._newest = self._lasting = _Doing(None, 0, is_hidden=False)
        """What the vehicle does, which may not last, and what it does once that lasts."""
        self._is_judged = True

    def add(self, green: NDArray[np.uint8], stamp_ns: int, moves: bool | None) -> int | None:
        """By how much pictures are older than they say, in ns, by a start or a stop; None where none shows it.

        green: a picture (H, W) of a moment. moves: whether the vehicle did then, None if unknown.
        """
        height, width = (max(1, size // BLOCK_PX) for size in green.shape)
        blocks = green[: height * BLOCK_PX, : width * BLOCK_PX].astype(np.float32)
        # Each picture passes here, used or not: this takes a quarter of the time of NumPy's mean.
        means = np.asarray(cv2.resize(blocks, (width, height), interpolation=cv2.INTER_AREA), np.float32)
        before, self._means = self._means, means
        if before is not None and before.shape == means.shape:
            change = max(LEAST_CHANGE, float(np.abs(means - before).mean()))
            self._changes.append((stamp_ns, math.log(change)))
        while self._changes and stamp_ns - self._changes[0][0] > BEFORE_NS + AFTER_NS:
            self._changes.popleft()
        if moves is not self._newest.moves:
            is_hidden = len(self._changes) < 2 or stamp_ns - self._changes[-2][0] > HOLE_NS
            self._newest = _Doing(moves, stamp_ns, is_hidden)
        before_that, newest, age_ns = self._lasting, self._newest, None
        is_new = moves is not before_that.moves and stamp_ns - newest.since_ns >= LASTS_NS
        lasted_ns = (newest.since_ns if is_new else stamp_ns) - before_that.since_ns
        if not self._is_judged and (lasted_ns >= AFTER_NS or (is_new and lasted_ns >= LEAST_NS)):
            self._is_judged, age_ns = True, self._age_ns()
        if is_new:
            is_unknown = before_that.moves is None or moves is None
            self._lasting, self._is_judged = newest, is_unknown or newest.is_hidden or lasted_ns < BEFORE_NS
        return age_ns

    def _age_ns(self) -> int | None:
        """How much later than the vehicle the pictures started or stopped, None where they do not show it."""
        moves, since_ns, _ = self._lasting
        stamps_ns, changes = np.array([one for one in self._changes if one[0] > since_ns - BEFORE_NS]).T
        is_before = stamps_ns <= since_ns
        is_last = stamps_ns > since_ns + (stamps_ns[-1] - since_ns) * 2 / 3
        if not is_before.any():
            return None
        earlier, later = float(np.median(changes[is_before])), float(np.median(changes[is_last]))
        if (later - earlier if moves else earlier - later) < math.log(CONTRAST):
            return None
        # A vehicle that sets off at 1 m/s2 shows it for a third of a second before it counts as moving.
        still = float(np.quantile(changes[is_before if moves else is_last], 0.25))
        is_as_later = (changes > still + math.log(CONTRAST) / 2) == moves
        if is_as_later[is_before].mean() > MIXED:
            return None
        # The moment after which most of the pictures change as they do later, and before which they do not.
        wrong = np.cumsum(is_as_later) + np.cumsum(~is_as_later[::-1])[::-1] - ~is_as_later
        last = int(wrong.argmin())
        hole_ns = stamps_ns[last + 1] - stamps_ns[last] if last + 1 < len(stamps_ns) else 0
        # A slow start may show early, but no picture is younger than its arrival.
        return None if hole_ns > HOLE_NS else max(0, int(stamps_ns[last] - since_ns))


class Turns:
    """The turns of the pictures and of the vehicle, of the newest WINDOW + LAGS steps."""

    def __init__(self) -> None:
        self._middle: NDArray[np.float32] | None = None
        self._shift = 0.0
        self._shifted: deque[tuple[int, float]] = deque()
        self._headings: deque[tuple[int, float]] = deque()
        self._due_ns = 0

    def add(self, green: NDArray[np.uint8], stamp_ns: int, heading: tuple[int, float] | None) -> int | None:
        """By how much pictures are older than they say, in ns, by the newest turns; None where these do not show it.

        green: a picture (H, W) of a moment. heading: stamp and degrees of the vehicle's newest one. Asked again, other
        turns answer.
        """
        height, width = green.shape
        part = green[height // 4 : height - height // 4, width // 4 : width - width // 4]
        middle = np.asarray(cv2.resize(part, MIDDLE_PX, interpolation=cv2.INTER_AREA), np.float32)
        if self._middle is not None:
            (right_px, _), response = cv2.phaseCorrelate(self._middle, middle, HANNING)
            self._shift -= right_px if response >= CLEAR else 0.0
        self._middle = middle
        self._shifted.append((stamp_ns, self._shift))
        if heading is not None and (not self._headings or heading[0] > self._headings[-1][0]):
            self._headings.append(heading)
        oldest_ns = stamp_ns - STEP_NS * (WINDOW + LAGS)
        for series in (self._shifted, self._headings):
            while len(series) > 1 and series[1][0] <= oldest_ns:
                series.popleft()
        known = all(series and series[0][0] <= oldest_ns for series in (self._shifted, self._headings))
        if stamp_ns < self._due_ns or not known:
            return None
        age_ns = self._age_ns(stamp_ns)
        self._due_ns = stamp_ns + STEP_NS * (WINDOW if age_ns is not None else AGAIN)
        return age_ns

    def _age_ns(self, now_ns: int) -> int | None:
        grid_ns = now_ns - STEP_NS * np.arange(WINDOW + LAGS, -1, -1)
        stamps_ns, shifts = np.array(self._shifted).T
        headed_ns, headings_deg = np.array(self._headings).T
        pictures = np.diff(np.interp(grid_ns, stamps_ns, shifts))[-WINDOW:]
        turns_rad = np.diff(np.interp(grid_ns, headed_ns, np.unwrap(np.radians(headings_deg))))
        # The last window is that of the newest turns: a lag of 0.
        vehicle = sliding_window_view(turns_rad, WINDOW)[::-1]
        pictures = pictures - pictures.mean()
        vehicle = vehicle - vehicle.mean(axis=1, keepdims=True)
        size = np.linalg.norm(vehicle, axis=1)
        alike = vehicle @ pictures / np.maximum(size * np.linalg.norm(pictures), 1e-9)
        best = int(alike.argmax())
        others = np.abs(np.arange(LAGS + 1) - best) >= APART
        left, left_else = 1 - alike[best] ** 2, 1 - max(0.0, float(alike[others].max())) ** 2
        is_turning = size[best] >= LEAST_RADPS * STEP_NS / 1e9 * np.sqrt(WINDOW)
        if not is_turning or alike[best] < ALIKE or left_else < CLEARER * left or best == LAGS:
            return None
        if best == 0:
            return 0
        before, at, after = (float(one) for one in alike[best - 1 : best + 2])
        curve = before - 2 * at + after
        return round(STEP_NS * (best + ((before - after) / (2 * curve) if curve else 0.0)))


class PictureAge:
    """By how much the pictures of one stream are older than they say, by all that has shown it."""

    def __init__(self) -> None:
        self._turns, self._starts = Turns(), Starts()
        self._seen: deque[Seen] = deque(maxlen=KEPT)
        self.age: Age | None = None
        """None until a start, a stop or turns have shown it."""

    def add(
        self,
        image: NDArray[np.uint8],
        stamp_ns: int,
        moves: bool | None,
        heading: tuple[int, float] | None = None,
    ) -> None:
        """A picture (H, W, 3) of a moment; moves, heading: see `Starts` and `Turns`."""
        green = np.asarray(cv2.extractChannel(image, 1), np.uint8)
        for age_ns, sigma_ns in (
            (self._turns.add(green, stamp_ns, heading), TURNS_SIGMA_NS),
            (self._starts.add(green, stamp_ns, moves), MOVES_SIGMA_NS),
        ):
            if age_ns is not None:
                self._observe(Seen(age_ns, sigma_ns))

    def _observe(self, seen: Seen) -> None:
        """What the newest observations agree on is the age; one alone changes none that is known."""
        self._seen.append(seen)
        alike = list(takewhile(seen.agrees, reversed(self._seen)))
        if len(alike) < 2 and (self.age is not None or seen.age_ns > PLAUSIBLE_NS):
            return
        weights = [one.sigma_ns**-2 for one in alike]
        age_ns = float(np.average([one.age_ns for one in alike], weights=weights))
        sigma_ns = min(one.sigma_ns for one in alike)  # what delays the headings delays all of them
        used_ns = 0 if self.age is None else self.age.age_ns
        # A stamp that is better by a little is not worth beginning anew.
        if abs(age_ns - used_ns) > CHANGED_NS:
            used_ns = round(age_ns)
        self.age = Age(used_ns, round(math.hypot(sigma_ns, age_ns - used_ns)))


class StreamCheck(PictureCheck):
    """Checks the frames of a network stream, of which nothing but the pictures themselves says how old they are."""

    def __init__(self, device: NewestFrame | None, min_speed_mps: float) -> None:
        super().__init__(device, min_speed_mps)
        self._age, self._opened = PictureAge(), 0

    @property
    def why_undated(self) -> str:  # type: ignore[override]
        """See `PictureCheck`."""
        return UNDATED if self._age.age is None else ""

    @property
    def stamp_sigma_s(self) -> float:  # type: ignore[override]
        """See `PictureCheck`."""
        return 0.0 if self._age.age is None else self._age.age.sigma_ns / 1e9

    def dated(self, frame: Frame, speed_mps: float | None, own: VehiclePosition | None = None) -> Frame:
        """See `PictureCheck`; a change of the age is logged."""
        opened = 0 if self._device is None else self._device.health.reopened
        if opened != self._opened:  # what lies between is another buffer
            self._age, self._opened, self.age_ns = PictureAge(), opened, 0
        heading = None if own is None or own.heading_deg is None else (own.stamp_ns, own.heading_deg)
        self._age.add(frame.image, frame.stamp_ns, self._moves(speed_mps), heading)
        age = self._age.age
        if age is not None and age.age_ns != self.age_ns:
            self.age_ns = age.age_ns
            log.warning("pictures are %.1f s older than they say; their stamps are corrected", self.age_ns / 1e9)
        return replace(frame, stamp_ns=frame.stamp_ns - self.age_ns)
