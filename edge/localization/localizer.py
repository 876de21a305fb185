"""What follows from a match: where the vehicle is, and whether GPS agrees with the place. Pure: no link, no clock.

A match says how far along the map's drive the vehicle is; across it, only that the vehicle is on the road, in its lane.
Neither uses GPS or the autopilot's velocity, which a spoofed GPS would carry along. So GPS is compared with the newest
place of the line, although its middle is known better: the middle would have to be moved on by that velocity.
"""

from __future__ import annotations

import math
from dataclasses import replace

from edge.config import Config, RigConfig
from edge.geodesy import VehiclePosition, moved_left
from edge.journal.records import FrameUsed, PlaceFix
from edge.localization.dead_reckoning import Displacement, ReportedMotion
from edge.localization.gps_referee import Comparison, GpsFix, GpsReferee, GpsVerdict
from edge.localization.place_fix import (
    EVEN_SHARPNESS,
    frame_used,
    line_middle,
    map_error_m,
    match_position,
    untracked_fix,
)
from edge.localization.route_filter import RouteFilter
from edge.localization.unseen_road import UnseenRoad, along_and_left_m
from edge.localization.velocity_error import VelocityError
from edge.reference_map import MapSet, Route
from edge.sequence import PlaceMatch

MOST_ASIDE_RAD = math.radians(60)
"""Between the vehicle's heading and that of a place with which GPS is compared. Where a mapped drive turned round and
the vehicle went on, places of the way back were believed for 40 m, and an honest GPS was called 37 m wrong."""


class Localizer:
    """Follows the vehicle along the drives of some maps, one answer of the recognizer after another."""

    def __init__(self, maps: MapSet, config: Config) -> None:
        self._config = config
        self._route = Route(maps)
        self._filter = RouteFilter(self._route, config)
        self._referee = GpsReferee(
            config.gates.gps_false_call, config.gates.gps_missed, config.gates.drift_percent / 100
        )
        self._unseen_road = UnseenRoad(self._route, config.rig)
        self._velocity_error = VelocityError(config.sequence.length)
        self.newest: PlaceMatch | None = None
        """The newest believed match."""

    def grow(self, maps: MapSet) -> None:
        """Follow the vehicle along maps that have further places after those of the last ones."""
        self._route.grow(maps)

    def reset(self) -> None:
        """Begin anew: no position is published that rests on frames from before. What is known of GPS stays."""
        self._filter.reset()
        self._velocity_error.clear()
        self._unseen_road.reset()
        self.newest = None

    def update(
        self, match: PlaceMatch | None, stamp_ns: int, displacement: Displacement | None, missed: int = 0
    ) -> None:
        """Use the answer to one frame; see `RouteFilter.update`."""
        self._filter.update(match, stamp_ns, displacement, missed)
        if match is not None and match.accepted:
            self.newest = match

    def follow_velocity(self, stamp_ns: int, motion: ReportedMotion) -> VelocityError:
        """Go on to a frame, used or not: what the autopilot's velocity is wrong by, while nothing measures it."""
        error = self._velocity_error
        if motion.is_measured:
            error.begin()
        error.predict(stamp_ns, motion.heading_rad, motion.velocity_mps, motion.pulled_m)
        return error

    def correct_velocity(
        self, match: PlaceMatch | None, stamp_ns: int, motion: ReportedMotion, *, stands: bool
    ) -> VelocityError:
        """The same after the answer to a used frame; stands: whether it shows what the last one did."""
        error = self._velocity_error
        if stands:
            error.use_halt(stamp_ns, motion.velocity_mps)
        else:
            error.add_frame(stamp_ns)
            if not motion.is_measured:
                self._use_line(match)
        return error

    def _use_line(self, match: PlaceMatch | None) -> None:
        if match is None or not match.accepted or match.sharpness < EVEN_SHARPNESS:
            return
        line = line_middle(match, self._route, self._config.sequence.length)
        if line is not None:
            sign = 1 if match.direction == "forward" else -1
            self._velocity_error.use_line((line.segment, sign), sign * line.along_m, line.length_m)

    def judge_gps(
        self,
        match: PlaceMatch | None,
        gps: GpsFix | None,
        displacement: Displacement | None = None,
        heading_deg: float | None = None,
        missed: int = 0,
    ) -> GpsVerdict:
        """Compare GPS with the place of a frame at which the vehicle moved; gps, displacement: at its exposure.

        heading_deg: of the vehicle, None where it is not known.
        """
        comparison = None
        if match is not None:
            comparison = compare(match, gps, self._route, self._config.rig, self._config.sequence.length)
            if comparison is not None:
                heads = heading_deg is None or _heads_along(comparison.heading_rad, math.radians(heading_deg))
                comparison = replace(comparison, displacement=displacement) if heads else None
        was_wrong = self._referee.verdict.state == "wrong"
        verdict = self._referee.update(comparison, missed)
        if verdict.state == "wrong" and not was_wrong:
            self._filter.reject_gps()
        is_unseen = self._unseen_road.update(match, gps)
        return GpsVerdict("not recognized", doubt=verdict.doubt) if is_unseen else verdict

    def bind(self, position: VehiclePosition, gps_sigma_m: float) -> None:
        """GPS bounds the autopilot's position, and so that of the vehicle, while nothing speaks against GPS."""
        if self._referee.verdict.state not in ("doubtful", "wrong"):
            self._filter.bind(position, gps_sigma_m)

    def position_at_exposure(self) -> PlaceFix | None:
        """The position at the exposure of the last match that agreed; None while the vehicle is lost."""
        return self._filter.at_exposure()

    def position(self, stamp_ns: int, displacement: Displacement | None) -> PlaceFix | None:
        """The position at another moment, by the autopilot's velocity since; None while that is not known."""
        return self._filter.at(stamp_ns, displacement)

    def place_fix(self, match: PlaceMatch, stamp_ns: int) -> PlaceFix:
        """An event: with the position of the vehicle if it is followed, else with the place's own."""
        fix = self._filter.at_exposure()
        if fix is None or fix.stamp_ns != stamp_ns:
            fix = untracked_fix(match, stamp_ns, self._route, self._config.rig)
        return fix

    def frame_used(self, frame: int, stamp_ns: int, match: PlaceMatch | None, missed: int = 0) -> FrameUsed:
        """The record of a frame and of its match. missed: places passed without a frame before it."""
        return frame_used(frame, stamp_ns, match, self._route, self._config.rig, missed)


def _heads_along(road_rad: float, heading_rad: float) -> bool:
    """Whether a vehicle heads along the road of a place: a match may go on through a turn of the map's drive."""
    return math.cos(road_rad - heading_rad) >= math.cos(MOST_ASIDE_RAD)


def compare(match: PlaceMatch, gps: GpsFix | None, route: Route, rig: RigConfig, length: int) -> Comparison | None:
    """GPS less place at the newest frame of a match; None where it is not believed, or its line may be pushed.

    length: frames in a sequence.
    """
    if not match.accepted or line_middle(match, route, length) is None:
        return None
    place = match_position(match, route, rig)
    if place is None or place.heading_deg is None:
        return None
    drive, lane_m = route.drive(match.place_index), rig.left_m(match.direction)
    lat_deg, lon_deg = moved_left(place.lat_deg, place.lon_deg, place.heading_deg, lane_m)
    heading_rad = math.radians(place.heading_deg)
    match_m, map_m, gps_m = rig.sigma_m(match.direction, match.order), map_error_m(place), gps.sigma_m if gps else 0.0
    off_along_m = off_left_m = None
    if gps is not None:
        off_along_m, off_left_m = along_and_left_m(gps, place, lane_m)
    return Comparison(
        recording=drive.recording,
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        spacing_m=drive.spacing_m,
        heading_rad=heading_rad,
        off_along_m=off_along_m,
        off_left_m=off_left_m,
        along_sigma_m=math.hypot(match_m, map_m, gps_m),
        left_sigma_m=math.hypot(rig.sigma_across_m, map_m, gps_m),
        match_sigma_m=match_m,
    )
