"""Which frames are places: one every so many meters where the distance is known, else one every so many seconds."""

from __future__ import annotations

import math

from edge.config import SamplingConfig

EARLY = 0.02
"""A frame this share of the spacing too early is on time: a feed sampled at 2 m has frames at 1.9999 m."""


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
            return distance_m < last_m or distance_m >= self._due_m - EARLY * self._config.spacing_m
        return stamp_ns - last_ns >= self._config.interval_s * 1e9 or stamp_ns < last_ns
