"""A vehicle that drives along a small map whose every position is known: two drives of 2 m a place, due north."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from edge.config import Config, RigConfig, SequenceConfig, TrackingConfig
from edge.localization import Displacement, PlaceFix
from edge.localization.route_filter import RouteFilter
from edge.sequence import Parallax, PlaceMatch

S = 1_000_000_000
LENGTH, SPACING_M, FRAME_NS = 20, 2.0, S // 5
LAT_DEG, METRE_DEG = -27.0, 1 / 110_773  # of a meridian there


def settings(rig: RigConfig, **tracking: Any) -> Config:
    return Config(rig=rig, tracking=TrackingConfig(**tracking), sequence=SequenceConfig(length=LENGTH))


def match(place: int, direction: Any = "forward", **changes: Any) -> PlaceMatch:
    fields: dict[str, Any] = {
        "place_index": place,
        "place": place,
        "direction": direction,
        "order": "swapped",
        "slope": 1.0,
        "distance": 0.5,
        "uniqueness": 1.2,
        "sharpness": 0.2,
        "accepted": True,
    }
    return PlaceMatch(**{**fields, **changes})


class Drive:
    """A vehicle that sees what it should: one frame each 2 m, a fifth of a second apart."""

    def __init__(self, one: RouteFilter, start_place: int, direction: Any = "forward", undated_m: float = 0.0) -> None:
        self.filter, self.direction, self.undated_m = one, direction, undated_m
        self.sign = 1 if direction == "forward" else -1
        self.place, self.frames, self.stamp_ns = start_place, 0, 100 * S
        self.drift = 0.0  # see `Displacement`
        self.scale, self.east_m = 1.0, 0.0  # what the odometer reads of a meter; how far it has the vehicle to the side

    def displacement(self, further_m: float = 0.0, leg: int = 1) -> Displacement:
        north_m = self.sign * (self.scale * self.frames * SPACING_M + further_m)
        return Displacement(leg, self.east_m, north_m, self.drift)

    def go(self, frames: int, sees: Callable[[int], PlaceMatch | None] | None = None, missed: int = 0) -> None:
        for _ in range(frames):
            self.frames += 1
            self.stamp_ns += FRAME_NS
            self.place += self.sign
            seen = sees(self.place) if sees else match(self.place, self.direction)
            self.filter.update(seen, self.stamp_ns, self.displacement(), missed, undated_m=self.undated_m)

    def north_m(self, tracked: PlaceFix | None) -> float:
        assert tracked is not None and tracked.lat_deg is not None
        return (tracked.lat_deg - LAT_DEG) / METRE_DEG


def warm(
    one: RouteFilter, place: int = 60, direction: Any = "forward", frames: int = 30, undated_m: float = 0.0
) -> Drive:
    drive = Drive(one, place, direction, undated_m)
    drive.go(LENGTH, lambda _: None)
    drive.go(frames)
    return drive


def beside_m(fix: PlaceFix | None) -> float:
    """Meters to the left of the map's drive, for a vehicle that drives north."""
    assert fix is not None and fix.lon_deg is not None
    return (153.0 - fix.lon_deg) * 99_255


def regions(beyond_m: float, left_m: float) -> Parallax:
    """Lines that are clearly so far beyond that of both regions, of a vehicle so far to the left of the map's drive."""
    steps_m = SPACING_M * np.arange(-20, 21)
    away_m = [steps_m - beyond_m - side * 2.4 * left_m for side in (-0.5, 0.5)]
    rows = [np.tile(1 - 0.3 / (1 + (one / 4) ** 2), (LENGTH, 1)) for one in away_m]
    return Parallax(np.arange(LENGTH), np.array(rows))
