"""How old pictures are, from turns: a vehicle that turns by its heading shifts what is far ahead in its pictures.

What lies in the middle of a picture is far, and moves by turns much more than by driving on. The shift of the middle
from picture to picture (phase correlation), and the autopilot's heading, are compared at each lag.
"""

from __future__ import annotations

from collections import deque

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

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
