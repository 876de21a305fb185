"""What bounded a position last, and where the vehicle is by that alone. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

from edge.geodesy import VehiclePosition, east_north_of, moved
from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import Displacement


@dataclass(frozen=True)
class Bound:
    """GPS or a position of ours bounded the autopilot's: to one standard deviation, after so many meters driven.

    wrong: probability that it was wrong. by_gps: whether GPS did.
    """

    sigma_m: float
    driven_m: float
    wrong: float
    by_gps: bool

    def sigma_at(self, driven_m: float | None, drift: float, reported_m: float | None = None) -> float | None:
        """One standard deviation now: with what was driven since, or as the autopilot says if that is more."""
        if driven_m is None:
            return None
        ours_m = math.hypot(self.sigma_m, drift * max(0.0, driven_m - self.driven_m))
        return ours_m if reported_m is None else max(ours_m, reported_m)


@dataclass(frozen=True)
class Reckoned:
    """Where the vehicle is by an anchor: meters east and north of a fix, and one standard deviation."""

    east_m: float
    north_m: float
    sigma_m: float

    @property
    def distance_m(self) -> float:
        """From the fix."""
        return math.hypot(self.east_m, self.north_m)

    def position(self, fix: PlaceFix) -> VehiclePosition:
        """At the moment of the fix that it is relative to; standing, since it is of that moment alone."""
        assert fix.lat_deg is not None and fix.lon_deg is not None
        lat_deg, lon_deg = moved(fix.lat_deg, fix.lon_deg, self.east_m, self.north_m)
        return VehiclePosition(fix.stamp_ns, lat_deg, lon_deg, 0.0, None, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Anchor:
    """Where the vehicle was, by GPS or by an observation, to one standard deviation, at a displacement."""

    lat_deg: float
    lon_deg: float
    sigma_m: float
    displacement: Displacement

    def reckoned(self, fix: PlaceFix, now: Displacement, drift: float, driven_m: float | None = None) -> Reckoned:
        """Relative to a fix with a position, at a displacement; drift: of the meters driven, those in between if None.

        What may have been driven while the velocity was unknown is in the standard deviation.
        """
        assert fix.lat_deg is not None and fix.lon_deg is not None
        east_m, north_m = east_north_of(self.lat_deg, self.lon_deg, (fix.lat_deg, fix.lon_deg))
        moved_east_m, moved_north_m = now.east_m - self.displacement.east_m, now.north_m - self.displacement.north_m
        if driven_m is None:
            driven_m = math.hypot(moved_east_m, moved_north_m)
        unknown_m = now.unknown_sigma_since(self.displacement)
        sigma_m = math.hypot(self.sigma_m, drift * driven_m, unknown_m)
        return Reckoned(east_m + moved_east_m, north_m + moved_north_m, sigma_m)
