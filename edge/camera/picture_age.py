"""How old the pictures of a network stream are: what its camera shows turns when the vehicle turns.

What lies in the middle of a picture is far, and moves by turns much more than by driving on; its shift from picture to
picture (phase correlation) and the autopilot's heading are compared at each lag. Nothing is known before a bend. A
camera whose driver stamps its pictures needs none of this.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from dataclasses import dataclass, replace
from itertools import takewhile

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from edge.camera.newest import NewestFrame
from edge.camera.picture_check import PictureCheck
from edge.feed import Frame
from edge.geodesy import VehiclePosition

UNDATED = "how old its pictures are is not known; a bend shows it"
log = logging.getLogger(__name__)
MIDDLE_PX = 40, 30
"""To which the middle half of a picture is reduced, width and height. On 18 simulated drives (six roads; day, night and
rain) its shift over a second correlates with the turn by 0.82 to 0.97; that of the whole picture by 0.56 to 0.85."""
HANNING = np.asarray(cv2.createHanningWindow(MIDDLE_PX, cv2.CV_32F), np.float32)
STEP_NS, COMPARED, LAGS = 250_000_000, 80, 32
"""What is compared: the turns in steps of so long, so many of the newest pictures (20 s), with those of the vehicle up
to so many steps (8 s) earlier."""
LEAST_RADPS = 0.01
"""Standard deviation of the vehicle's turns, below which a road counts as straight. In the bends of those roads it was
0.03 to 0.12."""
CLEAR = 0.2
"""Response of the phase correlation (1 at most) below which a shift says nothing, as after a hole in the pictures."""
TURNS_ALIKE, CLEARER, LAGS_APART = 0.7, 2.0, 6
"""Least correlation, by what factor the variance that it leaves must be less than at any other lag, and how many steps
further another one is. Pictures of those drives that were 0, 3 and 6 s old, and those of three drives of the trial,
showed their age in 77 % of the stretches, each within 0.5 s. Pictures of another road showed one in 0.2 % of 2,890
stretches, and never one of a second or more; with a factor of 1.5 and 15 s it was 3.4 and 1.3 %."""
AGAIN = 4
"""Steps until turns that do not show it are asked again."""
SIGMA_NS = 150_000_000
"""One standard deviation of an age. On drives of the trial with pictures 0 and 1 s late, ages were off by 0.10 s (rms;
0.28 at most, n = 25). What delays the headings delays all of them, so many are not better than one."""
AGREE_NS = round(3 * math.sqrt(2) * SIGMA_NS)
"""That two ages may be apart and still agree: three standard deviations, as everywhere."""
PLAUSIBLE_NS = 1_000_000_000
"""Up to which a first age is believed at once; a greater one, and each that contradicts those before, once it is seen
twice. The ages that 13 recorded drives showed of such pictures were 0 to 0.56 s, but for those 2.8 s."""
KEPT_AGES = 6
"""The newest observations of the age that are kept."""
CHANGED_NS = 250_000_000
"""Stamps are corrected anew where the age is found to be so far from what they were corrected by: nothing that was
recognized before counts then. Less is in the standard deviation of positions."""


@dataclass(frozen=True)
class Age:
    """By how much pictures are older than they say: nanoseconds, and one standard deviation of it."""

    age_ns: int
    sigma_ns: int


class PictureAge:
    """By how much the pictures of one stream are older than they say, by turns of the newest COMPARED + LAGS steps."""

    def __init__(self) -> None:
        self._middle: NDArray[np.float32] | None = None
        self._shift = 0.0
        self._shifted: deque[tuple[int, float]] = deque()
        self._headings: deque[tuple[int, float]] = deque()
        self._due_ns = 0
        self._seen: deque[int] = deque(maxlen=KEPT_AGES)
        self.age: Age | None = None
        """None until turns have shown it."""

    def add(self, image: NDArray[np.uint8], stamp_ns: int, heading: tuple[int, float] | None) -> None:
        """A picture (H, W, 3) of a moment. heading: stamp and degrees of the vehicle's newest one."""
        green = np.asarray(cv2.extractChannel(image, 1), np.uint8)
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
        oldest_ns = stamp_ns - STEP_NS * (COMPARED + LAGS)
        for series in (self._shifted, self._headings):
            while len(series) > 1 and series[1][0] <= oldest_ns:
                series.popleft()
        known = all(series and series[0][0] <= oldest_ns for series in (self._shifted, self._headings))
        if stamp_ns >= self._due_ns and known:
            age_ns = self._age_ns(stamp_ns)
            self._due_ns = stamp_ns + STEP_NS * (COMPARED if age_ns is not None else AGAIN)
            if age_ns is not None:
                self._observe(age_ns)

    def _age_ns(self, now_ns: int) -> int | None:
        """By the newest turns, None where these do not show it. Asked again, other turns answer."""
        grid_ns = now_ns - STEP_NS * np.arange(COMPARED + LAGS, -1, -1)
        stamps_ns, shifts = np.array(self._shifted).T
        headed_ns, headings_deg = np.array(self._headings).T
        pictures = np.diff(np.interp(grid_ns, stamps_ns, shifts))[-COMPARED:]
        turns_rad = np.diff(np.interp(grid_ns, headed_ns, np.unwrap(np.radians(headings_deg))))
        # The last window is that of the newest turns: a lag of 0.
        vehicle = sliding_window_view(turns_rad, COMPARED)[::-1]
        pictures = pictures - pictures.mean()
        vehicle = vehicle - vehicle.mean(axis=1, keepdims=True)
        size = np.linalg.norm(vehicle, axis=1)
        alike = vehicle @ pictures / np.maximum(size * np.linalg.norm(pictures), 1e-9)
        best = int(alike.argmax())
        others = np.abs(np.arange(LAGS + 1) - best) >= LAGS_APART
        left, left_else = 1 - alike[best] ** 2, 1 - max(0.0, float(alike[others].max())) ** 2
        is_turning = size[best] >= LEAST_RADPS * STEP_NS / 1e9 * np.sqrt(COMPARED)
        if not is_turning or alike[best] < TURNS_ALIKE or left_else < CLEARER * left or best == LAGS:
            return None
        if best == 0:
            return 0
        before, at, after = (float(one) for one in alike[best - 1 : best + 2])
        curve = before - 2 * at + after
        return round(STEP_NS * (best + ((before - after) / (2 * curve) if curve else 0.0)))

    def _observe(self, age_ns: int) -> None:
        """What the newest observations agree on is the age; one alone changes none that is known."""
        self._seen.append(age_ns)
        alike = list(takewhile(lambda other: abs(other - age_ns) <= AGREE_NS, reversed(self._seen)))
        if len(alike) < 2 and (self.age is not None or age_ns > PLAUSIBLE_NS):
            return
        mean_ns, used_ns = sum(alike) / len(alike), 0 if self.age is None else self.age.age_ns
        # A stamp that is better by a little is not worth beginning anew.
        if abs(mean_ns - used_ns) > CHANGED_NS:
            used_ns = round(mean_ns)
        self.age = Age(used_ns, round(math.hypot(SIGMA_NS, mean_ns - used_ns)))


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
        self._age.add(frame.image, frame.stamp_ns, heading)
        age = self._age.age
        if age is not None and age.age_ns != self.age_ns:
            self.age_ns = age.age_ns
            log.warning("pictures are %.1f s older than they say; their stamps are corrected", self.age_ns / 1e9)
        return replace(frame, stamp_ns=frame.stamp_ns - self.age_ns)
