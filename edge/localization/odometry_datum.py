"""Where the vehicle was at a displacement, and where it is by that. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

from edge.geodesy import east_north_of
from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import Odometry


@dataclass(frozen=True)
class DeadReckoningOffset:
    """The vehicle by a datum and dead reckoning: meters east and north of a fix, and one standard deviation."""

    east_m: float
    north_m: float
    sigma_m: float

    @property
    def distance_m(self) -> float:
        """From the fix."""
        return math.hypot(self.east_m, self.north_m)


@dataclass(frozen=True)
class OdometryDatum:
    """The datum of odometry: where the vehicle was by GPS or an observation, to one standard deviation.

    driven_m: in all by then, None where only the displacement since counts.
    """

    lat_deg: float
    lon_deg: float
    sigma_m: float
    displacement: Odometry
    driven_m: float | None = None

    def sigma_at(self, now: Odometry, drift: float, driven_m: float | None = None) -> float:
        """One standard deviation at a displacement, with what may have been driven while the velocity was unknown.

        drift: of the meters driven since. driven_m: in all by now.
        """
        since_m = math.hypot(*now.since(self.displacement))
        if driven_m is not None and self.driven_m is not None:
            since_m = max(0.0, driven_m - self.driven_m)
        return math.hypot(self.sigma_m, drift * since_m, now.unknown_sigma_since(self.displacement))

    def reckoned(
        self, fix: PlaceFix, now: Odometry, drift: float, driven_m: float | None = None
    ) -> DeadReckoningOffset:
        """Relative to a fix with a position; see `sigma_at`."""
        assert fix.lat_deg is not None and fix.lon_deg is not None
        east_m, north_m = east_north_of(self.lat_deg, self.lon_deg, (fix.lat_deg, fix.lon_deg))
        moved_m, sigma_m = now.since(self.displacement), self.sigma_at(now, drift, driven_m)
        return DeadReckoningOffset(east_m + moved_m[0], north_m + moved_m[1], sigma_m)
