"""Fault detection of GPS by the places: its verdict, and the state without a GPS that is ignored. Pure.

GPS is faulty once a hypothesis of it (`hypotheses`) is likelier than that all is right, by Wald's boundary, and
likelier than that the map is elsewhere. It is consistent again where it has been where the vehicle is for two
correlation lengths.

Spoofing that drifts cross-track steers an autopilot off the road, while GPS stays on it. Then no place is believed that
could contradict GPS. What is left: GPS goes on along the mapped drive of the last believed place, and nothing of that
drive is recognized. That alone declares no fault: a changed road is not recognized either. Where GPS moved otherwise
than the vehicle as well, two witnesses of three speak against it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from msgspec import structs

from edge.config import GatesConfig, RigConfig
from edge.geodesy import along_and_across, east_north_of, moved_left
from edge.localization.events import GPS_SIGMA_M, AutopilotState, GpsFix, ImageProcessed
from edge.localization.filter import CORRELATION_M
from edge.localization.hypotheses import Name
from edge.localization.odometer_calibration import NEAR_SIGMAS
from edge.localization.place_fix import map_error_m, position_on_route
from edge.localization.tracker import Tracker
from edge.reference_map import Position, Route
from edge.sequence import PlaceMatch

GpsVerdictState: TypeAlias = Literal[
    "cannot say", "consistent", "suspect", "inconsistent", "faulty", "map faulty", "not recognized"
]
SUSPECT = 3.0
"""Evidence (20 to 1) from which GPS is suspect, and from which own motion speaks for one of two witnesses."""
AGREED_M = 30.0
"""Of places that were compared with GPS, without evidence against it, from which on they agree."""
LONGEST_GAP_M = 240.0
"""Without a place or without GPS, after which nothing is known of it."""
DEPARTS_M = 25.0
"""How far GPS is off a recording that keeps its shape before it is faulty by that alone, without keypoint poses: these
measure the cross-track position of a vehicle on a road that leads away."""
COMPASS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
FIRM = 0.985
"""Confidence of a firm recognition: known after CORRELATION_M of it, until as much was less firm or unseen.
At 0.979, two of five simulated drives in snow that were hardly recognized were warned of."""
UNSEEN_M = 80.0
"""What is not recognized before that is said; down to half of it where the last places made GPS suspect. With honest
GPS it is said in none of 35 drives home by night, and in 9 of 91 in the map's direction at dusk, in rain and snow."""
MOST_PLACES = 2
"""A frame says something of so many places at most: what was driven without frames says nothing."""


@dataclass(frozen=True)
class GpsVerdict:
    """What the places say of GPS now.

    off_m: GPS less places by the newest matches, east and north; None where there are none. doubt: evidence that GPS is
    faulty, as a share of what it takes to declare it so: 0 to 1, None where nothing is known.
    """

    state: GpsVerdictState = "cannot say"
    off_m: tuple[float, float] | None = None
    doubt: float | None = None

    @property
    def distance_m(self) -> float | None:
        """Length of the offset."""
        return None if self.off_m is None else math.hypot(*self.off_m)

    @property
    def where(self) -> str:
        """The offset in words, "" where it is not known."""
        if self.off_m is None:
            return ""
        point = COMPASS[round(math.degrees(math.atan2(*self.off_m)) / 45) % 8]
        return f"{math.hypot(*self.off_m):.0f} m off to the {point}"


class GpsMonitor:
    """Fault detection of GPS against the places of one map. A faulty GPS stays so until it is consistent again."""

    def __init__(self, gates: GatesConfig) -> None:
        self._acts, self._switches = gates.doubted_gps != "report", gates.doubted_gps == "switch"
        self._call = math.log((1 - gates.gps_missed) / gates.gps_false_call)
        self._unseen_road: UnseenRoad | None = None
        self._state: GpsVerdictState = "cannot say"
        self._compared_m = self._agreed_m = self._gap_m = 0.0
        self._has_agreed = self._is_suspected = False
        self.verdict = GpsVerdict()
        """What the places say of GPS by the frames so far, "faulty" until it is consistent again."""

    def use_maps(self, route: Route, rig: RigConfig) -> None:
        """Compare with the places of other maps; what is known of GPS stays."""
        self._unseen_road = UnseenRoad(route, rig)

    def reset(self) -> None:
        """No frame from before counts. What is known of GPS stays."""
        if self._unseen_road is not None:
            self._unseen_road.reset()

    def update(
        self, frame: ImageProcessed, tracker: Tracker, own: AutopilotState, driven_m: float, *, is_compared: bool
    ) -> bool:
        """Judge GPS by a frame that the tracker has used; True where places speak against it by that.

        driven_m: since the frame before. is_compared: whether its place was compared with what is known.
        """
        assert self._unseen_road is not None
        bank, match = tracker.bank, frame.match.alone if frame.match else None
        gps, of_map = bank.evidence("gps dragged", "gps elsewhere"), bank.evidence("map elsewhere")
        doubt = min(1.0, max(gps, of_map) / self._call)
        self._unseen_road.update(match, _where(frame.gps, own, frame), gps / self._call if gps >= SUSPECT else 0.0)
        is_unseen = self._unseen_road.is_unseen(gps / SUSPECT)
        before, off_m = self.verdict, tracker.gps_off_m
        self._count(driven_m, is_compared=is_compared and off_m is not None)
        if not tracker.follows_gps:
            is_far = off_m is not None and float(np.hypot(*off_m)) > NEAR_SIGMAS * GPS_SIGMA_M and tracker.has_pose
            if off_m is not None and self._agrees_again(tracker, driven_m, is_compared=is_compared):
                self._state = "consistent"
                tracker.follows_gps = True
            elif self._state != "faulty":
                self._state, self._agreed_m = ("faulty" if is_far else "suspect"), self._agreed_m * (not is_far)
        elif max(gps, of_map) >= self._call or (is_unseen and gps >= SUSPECT):
            self._state = self._faulty_one(frame, tracker, self._call if is_unseen else gps, of_map)
            if self._state == "faulty":
                names: tuple[Name, ...] = ("gps dragged", "gps elsewhere")
                tracker.call_gps(max(names, key=bank.evidence))
                self._agreed_m = 0.0
                off_m = tracker.gps_off_m
        elif max(gps, of_map) >= SUSPECT:
            self._state = "suspect"
        elif self._compared_m >= AGREED_M:
            self._state, self._has_agreed = "consistent", True
        elif self._gap_m > LONGEST_GAP_M:
            self._state = "cannot say"
        if off_m is not None and self._state in ("inconsistent", "map faulty"):
            off_m = tracker.gps_from_places_m
        elif off_m is None and before.off_m is not None:
            self._has_agreed = True  # GPS was right until then, unless something else says otherwise
        state: GpsVerdictState = "not recognized" if is_unseen and self._state != "faulty" else self._state
        if off_m is None and state != "faulty":
            state = "cannot say"
        known = None if state == "cannot say" else 1.0 if state == "faulty" else doubt
        last_m = before.off_m if state == "faulty" else None
        self.verdict = GpsVerdict(state, last_m if off_m is None else (float(off_m[0]), float(off_m[1])), known)
        return state in ("inconsistent", "faulty") and before.state not in ("inconsistent", "faulty")

    def _faulty_one(self, frame: ImageProcessed, tracker: Tracker, gps: float, of_map: float) -> GpsVerdictState:
        """GPS, or the map, if they have agreed before, and own motion in which GPS has no part tells them apart.

        Without that, GPS that departs by far from a drive of the map that moved as its vehicle did.
        """
        is_far = tracker.has_pose or tracker.gps_off("gps dragged") >= DEPARTS_M
        drifts = tracker.bank.evidence("gps dragged") > tracker.bank.evidence("gps elsewhere")
        departs = is_far and drifts and tracker.is_checked
        is_known = frame.without_gps is not None
        if self._has_agreed and gps >= self._call and gps - of_map >= SUSPECT and (is_known or departs):
            return "faulty"
        return "map faulty" if self._has_agreed and of_map - gps >= SUSPECT and is_known else "inconsistent"

    def _count(self, driven_m: float, *, is_compared: bool) -> None:
        """Meters of places that were compared with GPS, and since the last one."""
        self._gap_m = 0.0 if is_compared else self._gap_m + driven_m
        self._compared_m = self._compared_m + driven_m if is_compared else self._compared_m
        if self._gap_m > LONGEST_GAP_M:
            self._compared_m = 0.0

    def _agrees_again(self, tracker: Tracker, driven_m: float, *, is_compared: bool) -> bool:
        if is_compared:
            self._agreed_m = self._agreed_m + driven_m if tracker.gps_is_near else 0.0
        return self._agreed_m >= 2 * CORRELATION_M

    @property
    def is_doubted(self) -> bool:
        """Whether places speak against GPS now."""
        return self._state in ("suspect", "inconsistent", "faulty")

    @property
    def is_ignored(self) -> bool:
        """Whether positions are published as if GPS were lost."""
        return (self._state == "faulty" and self._acts) or self._is_suspected

    @property
    def is_wrong(self) -> bool:
        """Whether where GPS has the vehicle says nothing of where it is, whatever is done about that."""
        return self._state == "faulty" or self._is_suspected

    def suspect(self, *, has_poses: bool) -> None:
        """Go by a suspicion from now on, where the autopilot could go by keypoint poses instead.

        It costs nothing if it is false. By a spoofing drift of 1 m/s, vehicles that steer themselves were 40 to 64 m
        beside their lane on four roads where GPS had to be faulty first, and 3.0 to 4.7 m at most on three where it is
        left (flown on ArduPilot 4.6.3).
        """
        self._is_suspected = self._switches and self.is_doubted and (self._is_suspected or has_poses)

    def believed(self, own: AutopilotState) -> AutopilotState:
        """What the autopilot reports, without a GPS that is ignored."""
        return structs.replace(own, gps="not healthy", gps_sigma_m=None) if self.is_ignored else own


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
        steers by it, and lags a receiver that is spoofed. doubt: see `GpsVerdict`; 0 where GPS is not suspect.
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
        if abs(left_m) > NEAR_SIGMAS * math.hypot(rig.sigma_cross_track_m, map_error_m(here), by_gps[0].sigma_m):
            # For long, it has turned off; a filter that catches up with a spoofed receiver is back soon.
            self._beside_m += self._route.drive(last.place_index).spacing_m
            if self._beside_m > UNSEEN_M:
                self.reset()
            return
        self._beside_m = 0.0
        most_m = MOST_PLACES * self._route.drive(last.place_index).spacing_m
        self._ahead_m += ahead_m
        self.unseen_m += max(-most_m, min(ahead_m, most_m))


def _where(gps: GpsFix | None, own: AutopilotState, frame: ImageProcessed) -> list[GpsFix]:
    """Where GPS has the vehicle at the exposure of a frame: by the receiver, and by the filter that may use it.

    Also while the filter is away from a receiver whose spoofing drift is faster than it follows.
    """
    position, found = own.position, [] if gps is None else [gps]
    if position is not None and own.gps != "not healthy":
        found.append(GpsFix(*position.at(frame.stamp_ns), GPS_SIGMA_M))
    return found


def along_and_left_m(gps: GpsFix, place: Position, lane_m: float) -> tuple[float, float]:
    """How far GPS is ahead of a place, and to the left of the lane that is `lane_m` to the left of it."""
    heading_deg = place.heading_deg or 0.0
    lane = moved_left(place.lat_deg, place.lon_deg, heading_deg, lane_m)
    ahead_m, right_m = along_and_across(east_north_of(gps.lat_deg, gps.lon_deg, lane), heading_deg)
    return ahead_m, -right_m
