"""What the places say of GPS, whether it is ignored then, and what is left of a report without it. Pure.

An autopilot that steers by a GPS that is dragged across the road leaves the road, and GPS stays on it. Then no place is
believed that could contradict GPS. What is left is that GPS goes on along the mapped drive of the last believed place,
and nothing of that drive is recognized. That alone is no call: a changed road looks the same to the daemon. Where GPS
has gone aside otherwise than the vehicle's own motion as well, two witnesses of three speak against it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from msgspec import structs

from edge.config import Config, RigConfig
from edge.geodesy import east_north_of, moved, moved_left
from edge.localization.anchor import Anchor
from edge.localization.events import GPS_SIGMA_M, Frame, GpsFix, Own
from edge.localization.gps_comparison import Comparison, compare
from edge.localization.gps_referee import DOUBTFUL, GpsReferee, GpsVerdict
from edge.localization.look import HOLDS_M
from edge.localization.own_motion import Departure, GpsTrack
from edge.localization.place_fix import heads_along, map_error_m, position_on_route
from edge.localization.route_estimate import CORRELATION_M
from edge.localization.sighting import Sighting, Sightings
from edge.reference_map import Position, Route
from edge.sequence import PlaceMatch

FIRM = 0.985
"""Confidence of a firm recognition: known after CORRELATION_M of it, until as much was less firm or unseen.
At 0.979, two of five simulated drives in snow that were hardly recognized were warned of."""
UNSEEN_M = 80.0
"""What is not recognized before that is said; down to half of it where the last places made GPS doubtful. With honest
GPS it is said in none of 35 drives home by night, and in 9 of 91 in the map's direction at dusk, in rain and snow."""
BESIDE_SIGMAS = 2.0
"""Beside the lane, of the road, the map and GPS: as far GPS is on the drive."""
MOST_PLACES = 2
"""A frame says something of so many places at most: what was driven without frames says nothing."""


class GpsJudge:
    """GPS against the places of one map. GPS that was called wrong counts as wrong until it agrees again."""

    def __init__(self, config: Config) -> None:
        gates = config.gates
        self._acts = gates.doubted_gps != "report"
        self._referee = GpsReferee(gates.gps_false_call, gates.gps_missed, gates.drift_percent / 100)
        self._sightings: Sightings | None = None
        self._since_look_m = math.inf
        self._unseen_road: UnseenRoad | None = None
        self._track, self._departed = GpsTrack(gates.drift_percent / 100), Departure()
        self._is_unseen = False
        self._error_m: tuple[float, float] | None = None  # east, north: what the autopilot has followed
        self.is_wrong = False
        """Whether GPS was called wrong, and has not agreed since."""
        self.published = GpsVerdict()
        """What the places say of GPS, "wrong" until it agrees again."""

    def use_maps(self, sightings: Sightings) -> None:
        """Compare with the places of other maps; what is known of GPS stays."""
        self._sightings, self._unseen_road = sightings, UnseenRoad(sightings.route, sightings.rig)

    def reset(self) -> None:
        """No frame from before counts. What is known of GPS stays."""
        self._track.clear()
        if self._unseen_road is not None:
            self._unseen_road.reset()

    def update(
        self, frame: Frame, looked: Sighting | None, own: Own, anchor: Anchor | None, undated_m: float = 0.0
    ) -> bool:
        """Compare GPS with the place of a frame at which the vehicle moved; True where it speaks against GPS by that.

        looked: what its picture says. anchor: where GPS had the vehicle last, by the autopilot's filter. undated_m: see
        `Sighting`.
        """
        assert self._sightings is not None and self._unseen_road is not None
        # What GPS has helped to believe does not vouch for it.
        match, gps = frame.match.alone if frame.match else None, frame.gps
        if own.gps_sigma_m is None and anchor is not None:
            self._referee.keep_until_lost(anchor)
        comparison = None
        if match is not None:
            comparison = compare(match, looked, gps, self._sightings, undated_m)
            comparison = self._unless_held(comparison, frame.missed)
        if comparison is not None:
            heading_deg = None if own.position is None else own.position.heading_deg
            heads = heading_deg is None or heads_along(comparison.heading_rad, math.radians(heading_deg))
            known = replace(comparison, motion=frame.without_gps, stamp_s=frame.stamp_ns / 1e9)
            comparison = known if heads else None
        before = self._referee.verdict.state
        verdict = self._referee.update(comparison, frame.missed)
        if (
            gps is not None
            and frame.without_gps is not None
            and (comparison is None or comparison.look_sigma_m is None)
        ):
            self._referee.go_on(gps, frame.without_gps, frame.stamp_ns / 1e9)
        self._track.add(gps, frame.without_gps)
        doubt = (verdict.doubt or 0.0) if verdict.state == "doubtful" else 0.0
        self._unseen_road.update(match, _where(gps, own, frame), doubt)
        self._use_departure(self._unseen_road)
        return self._referee.verdict.state in ("disagrees", "wrong") and before not in ("disagrees", "wrong")

    def _unless_held(self, comparison: Comparison | None, missed: int) -> Comparison | None:
        """What a line says soon after a look is nothing new."""
        if comparison is None:
            return None
        self._since_look_m += (1 + missed) * comparison.spacing_m
        if comparison.look_sigma_m is not None:
            self._since_look_m = 0.0
        return comparison if self._since_look_m == 0 or self._since_look_m > HOLDS_M else None

    def _use_departure(self, road: UnseenRoad) -> None:
        """Not recognized where GPS has the vehicle: has GPS gone there as the vehicle has?"""
        is_open = road.unseen_m >= UNSEEN_M / 4 and self._referee.verdict.state != "wrong"
        self._departed = max(self._departed, self._track.departure()) if is_open else Departure()
        evidence, east_m, north_m = self._departed
        self._is_unseen = road.is_unseen(evidence / DOUBTFUL)
        if self._is_unseen and evidence >= DOUBTFUL:
            self._referee.call(east_m, north_m)

    @property
    def verdict(self) -> GpsVerdict:
        """By the frames so far."""
        verdict = self._referee.verdict
        is_unseen = self._is_unseen and verdict.state != "wrong"
        return GpsVerdict("not recognized", doubt=verdict.doubt) if is_unseen else verdict

    @property
    def is_doubted(self) -> bool:
        """Whether places speak against GPS now."""
        return self._referee.verdict.state in ("doubtful", "disagrees", "wrong")

    @property
    def unsettled_m(self) -> float | None:
        """See `GpsReferee`."""
        return self._referee.unsettled_m

    @property
    def is_ignored(self) -> bool:
        """Whether positions are published as if GPS were lost."""
        return self.is_wrong and self._acts

    def use_verdict(self, *, follows_gps: bool) -> None:
        """Go by the newest verdict from now on; it stays "wrong" until GPS agrees again.

        follows_gps: whether the autopilot's own position still rests on GPS.
        """
        verdict = self.verdict
        self.is_wrong = verdict.state == "wrong" or (self.is_wrong and verdict.state != "agrees")
        if not self.is_wrong:
            self._error_m, self.published = None, verdict
            return
        if follows_gps and verdict.east_m is not None and verdict.north_m is not None:
            self._error_m = verdict.east_m, verdict.north_m
        self.published = replace(verdict, state="wrong", doubt=1.0)

    def bound(self) -> None:
        """The autopilot is where a position has put it: the error of GPS is no longer in it."""
        self._error_m = None

    def believed(self, own: Own) -> Own:
        """What the autopilot reports, without a GPS that is ignored, and without the error of GPS that it followed."""
        if self.is_ignored:
            own = structs.replace(own, gps="not healthy", gps_sigma_m=None)
        position = own.position
        if position is None or self._error_m is None:
            return own
        lat_deg, lon_deg = moved(position.lat_deg, position.lon_deg, -self._error_m[0], -self._error_m[1])
        return structs.replace(own, position=replace(position, lat_deg=lat_deg, lon_deg=lon_deg))


class UnseenRoad:
    """Follows GPS along the drive of the last believed place, while no place is believed."""

    def __init__(self, route: Route, rig: RigConfig) -> None:
        self._route, self._rig = route, rig
        self.reset()

    def reset(self) -> None:
        """Nothing is known of where the vehicle was recognized last."""
        self._last: PlaceMatch | None = None
        self._firm_m = self._ahead_m = self._beside_m = self._doubt = 0.0
        self.unseen_m = 0.0  # that GPS went on along the drive without any of it being recognized

    def is_unseen(self, doubt: float) -> bool:
        """Whether the vehicle is not recognized where GPS has it. doubt: by its own motion, see `GpsVerdict`."""
        return self.unseen_m >= UNSEEN_M * (1 - min(max(self._doubt, doubt), 1.0) / 2)

    def update(self, match: PlaceMatch | None, by_gps: Sequence[GpsFix], doubt: float = 0.0) -> None:
        """The answer to one more frame.

        by_gps: at the exposure, by the receiver and by the autopilot's filter, whose position is on the lane while it
        steers by it, and lags a receiver that is dragged off. doubt: see `GpsVerdict`; 0 where GPS is not doubtful.
        """
        if match is None:
            self.reset()  # a sequence begins anew, and cannot be recognized yet
        elif match.accepted:
            self._see(match, doubt)
        elif self._last is not None and by_gps:
            self._follow(self._last, by_gps)

    def _see(self, match: PlaceMatch, doubt: float) -> None:
        spacing_m = self._route.drive(match.place_index).spacing_m
        if match.confidence >= FIRM:
            self._firm_m = min(CORRELATION_M, max(0.0, self._firm_m + spacing_m - self.unseen_m))
            self.unseen_m = 0.0
        else:
            # A vehicle that leaves the road is recognized there now and then, but not firmly.
            if not doubt:
                self._firm_m = max(0.0, self._firm_m - spacing_m)
            self.unseen_m = max(0.0, self.unseen_m - spacing_m)
        is_firm = self._firm_m >= CORRELATION_M or (self._last is not None and self._firm_m > 0)
        self._last, self._ahead_m, self._doubt = (match if is_firm else None), 0.0, doubt

    def _follow(self, last: PlaceMatch, by_gps: Sequence[GpsFix]) -> None:
        sign, rig = (1 if last.direction == "forward" else -1), self._rig
        seen_m, behind_m = sign * self._ahead_m, sign * rig.ahead_m(last.direction, last.order)
        here = position_on_route(self._route, last.place_index, seen_m - behind_m, last.direction)
        is_mapped = self._route.reaches(last.place_index, self._route.route_m(last.place_index) + seen_m)
        if here is None or here.heading_deg is None or not is_mapped:
            self.reset()
            return
        offsets_m = [along_and_left_m(one, here, rig.left_m(last.direction)) for one in by_gps]
        ahead_m, left_m = min(offsets_m, key=lambda off_m: abs(off_m[1]))
        if abs(left_m) > BESIDE_SIGMAS * math.hypot(rig.sigma_across_m, map_error_m(here), by_gps[0].sigma_m):
            # For long, it has turned off; a filter that catches up with a dragged receiver is back soon.
            self._beside_m += self._route.drive(last.place_index).spacing_m
            if self._beside_m > UNSEEN_M:
                self.reset()
            return
        self._beside_m = 0.0
        most_m = MOST_PLACES * self._route.drive(last.place_index).spacing_m
        self._ahead_m += ahead_m
        self.unseen_m += max(-most_m, min(ahead_m, most_m))


def _where(gps: GpsFix | None, own: Own, frame: Frame) -> list[GpsFix]:
    """Where GPS has the vehicle at the exposure of a frame: by the receiver, and by the filter that may use it.

    Also while the filter is away from a receiver that is dragged off faster than it follows.
    """
    position, found = own.position, [] if gps is None else [gps]
    if position is not None and own.gps != "not healthy":
        apart_s = (frame.stamp_ns - position.stamp_ns) / 1e9
        at = moved(position.lat_deg, position.lon_deg, position.east_mps * apart_s, position.north_mps * apart_s)
        found.append(GpsFix(*at, GPS_SIGMA_M))
    return found


def along_and_left_m(gps: GpsFix, place: Position, lane_m: float) -> tuple[float, float]:
    """How far GPS is ahead of a place, and to the left of the lane that is `lane_m` to the left of it."""
    heading_deg = place.heading_deg or 0.0
    lane = moved_left(place.lat_deg, place.lon_deg, heading_deg, lane_m)
    east_m, north_m = east_north_of(gps.lat_deg, gps.lon_deg, lane)
    sin, cos = math.sin(math.radians(heading_deg)), math.cos(math.radians(heading_deg))
    return east_m * sin + north_m * cos, north_m * sin - east_m * cos
