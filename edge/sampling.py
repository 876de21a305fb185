"""Which frames are places: one every so many metres where the distance is known, else one every so many seconds."""

from __future__ import annotations

from edge.config import SamplingConfig

EARLY = 0.02
"""A frame this share of the spacing too early is on time: a feed sampled at 2 m has frames at 1.9999 m."""


class Sampler:
    """Chooses frames of one traverse, in order."""

    def __init__(self, config: SamplingConfig) -> None:
        self._config = config
        self._seen = 0
        self._last: tuple[int, float | None] | None = None
        self._due_m = 0.0

    def take(self, stamp_ns: int, distance_m: float | None) -> bool:
        """Whether the frame of this time, at this distance driven, is a place; the first always is."""
        self._seen += 1
        if self._config.by == "frames":
            return (self._seen - 1) % self._config.spacing_frames == 0
        if self._last is not None and not self._is_due(stamp_ns, distance_m, *self._last):
            return False
        if distance_m is not None:
            # From where the last place should have been, so that the spacing holds on average; anew after a jump.
            self._due_m += self._config.spacing_m
            is_next = self._last is not None and self._last[1] is not None
            if not (is_next and distance_m < self._due_m <= distance_m + self._config.spacing_m):
                self._due_m = distance_m + self._config.spacing_m
        self._last = (stamp_ns, distance_m)
        return True

    def _is_due(self, stamp_ns: int, distance_m: float | None, last_ns: int, last_m: float | None) -> bool:
        if self._config.by == "distance" and distance_m is not None and last_m is not None:
            # A distance that fell was counted anew (the autopilot restarted): that frame starts a new count.
            return distance_m < last_m or distance_m >= self._due_m - EARLY * self._config.spacing_m
        return stamp_ns - last_ns >= self._config.interval_s * 1e9 or stamp_ns < last_ns
