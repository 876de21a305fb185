"""What bounds the autopilot's own position, and where the vehicle is by that alone. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

from edge.geodesy import VehiclePosition, east_north_of, moved
from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import Displacement
from edge.localization.report import Report

BOUND_WRONG = 0.1
"""Probability that what bounded the autopilot last was wrong, where it was not a position of ours: see `integrity`."""


@dataclass(frozen=True)
class Bound:
    """GPS or a position of ours bounded the autopilot's: to one standard deviation, after so many meters driven.

    wrong: probability that it was wrong. by_gps: whether GPS did.
    """

    sigma_m: float
    driven_m: float
    wrong: float
    by_gps: bool


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
        moved_east_m, moved_north_m = now.since(self.displacement)
        if driven_m is None:
            driven_m = math.hypot(moved_east_m, moved_north_m)
        unknown_m = now.unknown_sigma_since(self.displacement)
        sigma_m = math.hypot(self.sigma_m, drift * driven_m, unknown_m)
        return Reckoned(east_m + moved_east_m, north_m + moved_north_m, sigma_m)


class OwnPosition:
    """How far the autopilot's own position may be off, and where GPS had the vehicle last."""

    def __init__(self, drift: float) -> None:
        """drift: of the meters driven, where nothing else is known of the velocity."""
        self._drift = drift
        self.bound: Bound | None = None
        """What bounded it since its boot, None where nothing did."""
        self._has_run_away = False  # since then: nothing measured its velocity for a while
        self.by_gps: Anchor | None = None
        """Where GPS had the vehicle last."""
        self._by_gps_m = 0.0  # driven by then

    def restart(self) -> None:
        """The autopilot has rebooted. What GPS showed of the vehicle holds on, see `Displacement.unknown_m`."""
        self.bound = None

    def bind(self, sigma_m: float, report: Report, wrong: float = BOUND_WRONG, *, by_gps: bool = False) -> None:
        """It is as good as that now. wrong: the probability that what bounds it is."""
        if report.driven_m is not None:
            self.bound, self._has_run_away = Bound(sigma_m, report.driven_m, wrong, by_gps), False

    def watch_aid(self, report: Report) -> None:
        """One whose velocity nothing measures runs away, until it is bound anew."""
        self._has_run_away |= not report.is_aided

    def anchor(self, report: Report) -> None:
        """GPS has the vehicle where the autopilot believes it to be."""
        own, then = report.position, report.displacement
        if own is not None and report.driven_m is not None and report.gps_sigma_m is not None:
            self.by_gps = None if then is None else Anchor(own.lat_deg, own.lon_deg, report.gps_sigma_m, then)
            self._by_gps_m = report.driven_m

    def sigma_m(self, report: Report, velocity_error: float = 0.0, least_m: float = 0.0) -> float | None:
        """One standard deviation, None where nothing bounds it; velocity_error: as a share."""
        if self.bound is None or self._has_run_away or not report.is_aided or report.driven_m is None:
            return None
        driven_m = max(0.0, report.driven_m - self.bound.driven_m)
        return max(math.hypot(self.bound.sigma_m, max(self._drift, velocity_error) * driven_m), least_m)

    def reckoned(self, fix: PlaceFix, displacement: Displacement | None, report: Report) -> Reckoned | None:
        """Where GPS had the vehicle last, moved on by the autopilot's velocity; None where that is not known."""
        if self.by_gps is None or displacement is None or report.driven_m is None or not fix.is_position:
            return None
        drift = max(self._drift, fix.velocity_error)
        return self.by_gps.reckoned(fix, displacement, drift, max(0.0, report.driven_m - self._by_gps_m))
