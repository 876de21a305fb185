"""Position aiding, by GPS or a fix that was sent: where the vehicle is by the last one and its motion since. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from edge.geodesy import Origin, east_north_of, moved
from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import Odometry
from edge.localization.events import BOUND_WRONG, AutopilotState, ExternalPosition, Fix
from edge.sequence import DeadReckoningPosition

SETTLED_NS = 10_000_000_000
"""After GPS is used again, nothing is left of a position of ours."""
CALLED_SIGMA_M = 10.0
"""Of where GPS had the vehicle less its error, when GPS is declared faulty."""


@dataclass(frozen=True)
class DeadReckoningOffset:
    """The vehicle by a datum and dead reckoning: meters east and north of a fix, and one standard deviation.

    wrong, is_gps: see `OdometryDatum`.
    """

    east_m: float
    north_m: float
    sigma_m: float
    wrong: float = BOUND_WRONG
    is_gps: bool = False

    @property
    def distance_m(self) -> float:
        """From the fix."""
        return math.hypot(self.east_m, self.north_m)


@dataclass(frozen=True)
class OdometryDatum:
    """The datum of odometry: where the vehicle was by GPS, a fix or an observation, to one standard deviation.

    driven_m: in all by then, None where only the displacement since counts. wrong: probability that it was elsewhere.
    is_gps: whether GPS says so.
    """

    lat_deg: float
    lon_deg: float
    sigma_m: float
    displacement: Odometry
    driven_m: float | None = None
    wrong: float = BOUND_WRONG
    is_gps: bool = False

    def sigma_at(self, now: Odometry, drift: float, driven_m: float | None = None) -> float:
        """One standard deviation at a displacement, with what may have been driven while the velocity was unknown.

        drift: of the meters driven since. driven_m: in all by now.
        """
        since_m = math.hypot(*now.since(self.displacement))
        if driven_m is not None and self.driven_m is not None:
            since_m = max(0.0, driven_m - self.driven_m)
        return math.hypot(self.sigma_m, drift * since_m, now.unknown_sigma_since(self.displacement))

    def reckoned(self, at: Origin, now: Odometry, drift: float, driven_m: float | None = None) -> DeadReckoningOffset:
        """Relative to a latitude and longitude; see `sigma_at`."""
        east_m, north_m = east_north_of(self.lat_deg, self.lon_deg, at)
        moved_m, sigma_m = now.since(self.displacement), self.sigma_at(now, drift, driven_m)
        return DeadReckoningOffset(east_m + moved_m[0], north_m + moved_m[1], sigma_m, self.wrong, self.is_gps)


class PositionAiding:
    """Where the vehicle was by the last aiding, and by GPS alone; where it is follows from its motion since.

    So what the autopilot makes of a fix need not be known, and the error of its own position is no model: that is as
    uncertain as where the vehicle is known to be, and is further off by as far as it is from there.
    """

    def __init__(self, drift: float) -> None:
        """drift: of the meters driven, where nothing else is known of the velocity."""
        self.drift = drift
        """By what is known of it now, of the meters driven."""
        self.is_bounded = False
        """Whether GPS or a fix has aided the autopilot since its boot."""
        self.rests_on_fixes = False
        """Whether a fix that was sent may have moved the autopilot's own position since GPS aided it last."""
        self._last: OdometryDatum | None = None
        self._without_places: OdometryDatum | None = None  # in which no place has a part
        self._sent_ns: int | None = None

    def restart(self) -> None:
        """The autopilot has rebooted. What is known of the vehicle holds on, see `Odometry.unknown_m`."""
        self.is_bounded, self._sent_ns = False, None

    def use_gps(self, t_ns: int, own: AutopilotState, *, is_doubted: bool) -> None:
        """GPS has the vehicle where the autopilot believes to be. is_doubted: whether places speak against GPS."""
        position, sigma_m = own.position, own.gps_sigma_m
        if self._sent_ns is None or t_ns - self._sent_ns > SETTLED_NS:
            self.rests_on_fixes = False
        if position is None or sigma_m is None or own.motion is None:
            return
        where = position.lat_deg, position.lon_deg, sigma_m
        self._last, self.is_bounded = OdometryDatum(*where, own.motion, own.driven_m, is_gps=True), True
        if not (self.rests_on_fixes or is_doubted):
            self._without_places = self._last

    def doubt_gps(self) -> None:
        """Places speak against where GPS had the vehicle, or the vehicle was carried since."""
        self._without_places = None

    def call_gps(self, off_m: tuple[float, float] | None) -> None:
        """GPS was declared faulty, so many meters east and north of the vehicle; None where that is not known."""
        self._without_places = None
        if self._last is not None and self._last.is_gps:
            at = self._last.lat_deg, self._last.lon_deg
            lat_deg, lon_deg = at if off_m is None else moved(*at, -off_m[0], -off_m[1])
            known = replace(self._last, lat_deg=lat_deg, lon_deg=lon_deg, sigma_m=CALLED_SIGMA_M, is_gps=False)
            self._last = None if off_m is None else known

    def use_fix(self, t_ns: int, fix: Fix | None, own: AutopilotState) -> None:
        """A fix was sent; None: one that nobody knows."""
        self.rests_on_fixes = True
        if fix is None:
            return
        self._sent_ns = t_ns
        if fix.motion is None or fix.place.lat_deg is None or fix.place.lon_deg is None:
            return
        sigma_m = max(fix.place.sigma_along_m, fix.place.sigma_cross_track_m)
        where = fix.place.lat_deg, fix.place.lon_deg, sigma_m
        self._last = OdometryDatum(*where, fix.motion, own.driven_m, fix.bound_wrong)
        self.is_bounded = True

    def use_external(self, stated: ExternalPosition, own: AutopilotState) -> None:
        """The operator says where the vehicle is; as probably wrong as GPS, and nothing of it is in the autopilot."""
        if own.motion is not None:
            where = stated.lat_deg, stated.lon_deg, stated.sigma_m
            self._last = OdometryDatum(*where, own.motion, own.driven_m)

    def dead_reckoning_position(self, motion: Odometry | None, own: AutopilotState) -> DeadReckoningPosition | None:
        """Where GPS and the vehicle's motion since have it at a displacement, without any place of the map."""
        if self._without_places is None or motion is None or own.driven_m is None or not own.is_aided:
            return None
        where = moved(
            self._without_places.lat_deg, self._without_places.lon_deg, *motion.since(self._without_places.displacement)
        )
        return DeadReckoningPosition(*where, self._without_places.sigma_at(motion, self.drift, own.driven_m))

    def innovation(
        self, fix: PlaceFix, motion: Odometry | None, own: AutopilotState, *, without_places: bool = False
    ) -> DeadReckoningOffset | None:
        """The innovation of a fix: the vehicle by the last aiding, relative to it; None where that is not known.

        without_places: by GPS alone, as where nothing aids the velocity: a fix that was sent may come back as that.
        """
        datum = self._last if own.is_aided and not without_places else self._without_places
        if datum is None or motion is None or own.driven_m is None or not fix.is_position:
            return None
        assert fix.lat_deg is not None and fix.lon_deg is not None
        return datum.reckoned((fix.lat_deg, fix.lon_deg), motion, self.drift, own.driven_m)

    def own_sigma_m(self, own: AutopilotState) -> float | None:
        """One standard deviation of the autopilot's own position; None where nothing has aided it, or it runs away."""
        position, motion = own.position, own.motion
        if self._last is None or not (self.is_bounded and own.is_aided) or own.driven_m is None:
            return None
        if position is None or motion is None:
            return None
        off = self._last.reckoned((position.lat_deg, position.lon_deg), motion, self.drift, own.driven_m)
        return max(math.hypot(off.sigma_m, off.distance_m), own.accuracy_m or 0.0)
