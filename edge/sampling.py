"""Which frames are places: one every so many metres where the distance is known, else one every so many seconds."""

from __future__ import annotations

from edge.config import SamplingConfig


class Sampler:
    """Chooses frames of one traverse, in order."""

    def __init__(self, config: SamplingConfig) -> None:
        self._config = config
        self._seen = 0
        self._last: tuple[int, float | None] | None = None

    def take(self, stamp_ns: int, distance_m: float | None) -> bool:
        """Whether the frame of this time, at this distance driven, is a place; the first always is."""
        self._seen += 1
        if self._config.by == "frames":
            return (self._seen - 1) % self._config.spacing_frames == 0
        if self._last is not None and not self._due(stamp_ns, distance_m, *self._last):
            return False
        self._last = (stamp_ns, distance_m)
        return True

    def _due(self, stamp_ns: int, distance_m: float | None, last_ns: int, last_m: float | None) -> bool:
        if self._config.by == "distance" and distance_m is not None and last_m is not None:
            # A distance that fell was counted anew (the autopilot restarted): that frame starts a new count.
            return distance_m < last_m or distance_m - last_m >= self._config.spacing_m
        return stamp_ns - last_ns >= self._config.interval_s * 1e9 or stamp_ns < last_ns
