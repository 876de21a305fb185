"""Which frames are places: one every so many meters where the distance is known, else one every so many seconds.

And how far the vehicle drives from one to the next, in places of the map (`Steps`), since that has its own spacing.
"""

from __future__ import annotations

import math
import statistics
from collections import deque

from edge.config import SamplingConfig

EARLY = 0.02
"""A frame this share of the spacing too early is on time: a feed sampled at 2 m has frames at 1.9999 m."""
AS_MAPPED = 0.05
"""Share by which the spacing of the frames may differ from the map's and count as the same: the slopes that are
searched around a known distance differ from it by as much."""
ON_TIME = 0.25
"""Share of the spacing between a frame and where it was due that counts as none: frames of the map are as late. At 30
frames a second and 10 m/s it is a sixth of 2 m."""
BACK_M = 1.0
"""By so much a distance may fall and be the same count: a frame was exposed before one whose distance was extrapolated
while braking. On one recorded drive such a fall of 0.36 m at its turn ended the map of the way out."""
GAP_FRAMES = 20
"""Usual steps; a longer one is no step but a gap, unless the next one is as long."""
KEPT_STEPS = 40
"""Frames of which the median is the usual step: as many as the default sequence has."""


class Sampler:
    """Chooses frames of one traverse, in order."""

    def __init__(self, config: SamplingConfig) -> None:
        self.missed = 0
        """Places passed before the frame chosen last without a frame of their own, because none came there in time."""
        self._config = config
        self._frames = 0
        self._last: tuple[int, float | None] | None = None
        self._due_m = 0.0

    def is_place(self, stamp_ns: int, distance_m: float | None) -> bool:
        """Whether the frame of this time, at this distance driven, is a place; the first always is."""
        self._frames += 1
        if self._config.by == "frames":
            return (self._frames - 1) % self._config.spacing_frames == 0
        if self._last is not None and not self._is_due(stamp_ns, distance_m, *self._last):
            return False
        if self._config.by == "distance" and distance_m is not None:
            self._count(distance_m)
        self._last = (stamp_ns, distance_m)
        return True

    def _count(self, distance_m: float) -> None:
        """Set the next place from where this one should have been, so that the spacing holds on average."""
        spacing_m = self._config.spacing_m
        last_m = self._last[1] if self._last is not None else None
        if last_m is None or distance_m < last_m:
            self.missed, self._due_m = 0, distance_m + spacing_m
        else:
            self.missed = max(0, math.floor((distance_m - self._due_m) / spacing_m + EARLY))
            self._due_m += (self.missed + 1) * spacing_m

    def _is_due(self, stamp_ns: int, distance_m: float | None, last_ns: int, last_m: float | None) -> bool:
        if self._config.by == "distance" and distance_m is not None and last_m is not None:
            # A distance that fell was reset (the autopilot restarted): that frame starts a new count.
            return distance_m < last_m - BACK_M or distance_m >= self._due_m - EARLY * self._config.spacing_m
        return stamp_ns - last_ns >= self._config.interval_s * 1e9 or stamp_ns < last_ns


def spell_spacing(sampling: SamplingConfig, map_spacing_m: float | None) -> str:
    """How far frames and places are apart, in words for people; map_spacing_m: None where the map does not know it."""
    frames = {
        "distance": f"a frame every {sampling.spacing_m:g} m",
        "time": f"a frame every {sampling.interval_s:g} s",
        "frames": f"one of {sampling.spacing_frames} frames" if sampling.spacing_frames > 1 else "every frame",
    }[sampling.by]
    places = f"every {map_spacing_m:.3g} m" if map_spacing_m else "at distances that it does not know"
    return f"{frames}, and the map has a place {places}"


class Steps:
    """Steps from frame to frame, in places of a map: by the odometer where it is known, else as usual."""

    def __init__(self, sampling: SamplingConfig) -> None:
        self._by, self._spacing_m = sampling.by, sampling.spacing_m
        self._begun_m = 0.0
        self._last: float | None = None  # driven until the last frame, in spacings
        self._kept: deque[float] = deque(maxlen=KEPT_STEPS)
        self._is_gap = False  # whether the newest step is one

    def next(self, odometer_m: float | None, missed: int, map_spacing_m: float) -> float:
        """The step to a frame; odometer_m: at the frame, None where not known. missed: frames like it before it."""
        before = self._last
        now = self._last = None if odometer_m is None else self._driven(odometer_m)
        if now is None or before is None or now <= before:
            return (1 + missed) * self.usual(map_spacing_m)
        was_gap, self._is_gap = self._is_gap, now - before > GAP_FRAMES * self._median()
        if was_gap or not self._is_gap:
            self._kept.append(now - before)
        return (now - before) * self._places(map_spacing_m)

    def usual(self, map_spacing_m: float) -> float:
        """The usual step; one place where no distance was measured."""
        return self._median() * self._places(map_spacing_m) if self._kept else 1.0

    def _median(self) -> float:
        return statistics.median(self._kept) if self._kept else 1.0

    def _places(self, map_spacing_m: float) -> float:
        """Places in a spacing of the frames; one where both are nearly the same."""
        is_alike = abs(self._spacing_m - map_spacing_m) <= AS_MAPPED * map_spacing_m
        return 1.0 if is_alike else self._spacing_m / map_spacing_m

    def _driven(self, odometer_m: float) -> float:
        """Spacings driven until a frame; until where it was due if it was sampled by distance and is near there."""
        if self._last is None or odometer_m < self._begun_m + (self._last - ON_TIME) * self._spacing_m:
            self._begun_m = odometer_m
            self._last = None
        driven = (odometer_m - self._begun_m) / self._spacing_m
        is_due = self._by == "distance" and abs(driven - round(driven)) <= ON_TIME
        return float(round(driven)) if is_due else driven
