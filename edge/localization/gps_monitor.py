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
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

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
GpsState: TypeAlias = GpsVerdictState | Literal["left"]
"""Left: the filter goes on without it, since keypoint poses contradict it; read as "suspect"."""
LEFT: tuple[GpsState, ...] = ("left", "faulty")
MISLED: tuple[GpsState, ...] = ("inconsistent", "faulty")
OF_GPS: tuple[Name, ...] = ("gps dragged", "gps elsewhere")
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


class GpsEvidence(NamedTuple):
    """What a frame shows of GPS.

    gps, of_map: evidence that it is wrong, and that the map is; call: from which on that is declared. tells_gps,
    tells_map: whether it is known which of both is. agreed_m, gap_m: meters of places that were compared with it, and
    since. is_followed: whether it is a measurement of the filter. is_far: from where keypoint poses have the vehicle.
    """

    gps: float
    of_map: float
    call: float
    tells_gps: bool
    tells_map: bool
    agreed_m: float
    gap_m: float
    is_followed: bool
    is_far: bool


class Transition(NamedTuple):
    """From any of some states (none: of all) to another one, where the evidence is such."""

    before: tuple[GpsState, ...]
    holds: Callable[[GpsEvidence], bool]
    after: GpsState


TRANSITIONS = (
    Transition(LEFT, lambda now: now.agreed_m >= 2 * CORRELATION_M, "consistent"),
    Transition(("faulty",), lambda now: True, "faulty"),
    Transition((), lambda now: not now.is_followed and now.is_far, "faulty"),
    Transition((), lambda now: not now.is_followed, "left"),
    Transition((), lambda now: now.gps >= max(now.call, now.of_map + SUSPECT) and now.tells_gps, "faulty"),
    Transition((), lambda now: now.of_map >= max(now.call, now.gps + SUSPECT) and now.tells_map, "map faulty"),
    Transition((), lambda now: max(now.gps, now.of_map) >= now.call, "inconsistent"),
    Transition((), lambda now: max(now.gps, now.of_map) >= SUSPECT, "suspect"),
    Transition((), lambda now: now.agreed_m >= AGREED_M, "consistent"),
    Transition((), lambda now: now.gap_m > LONGEST_GAP_M, "cannot say"),
)
"""The first that holds counts; where none does, the state stays."""


def next_state(state: GpsState, now: GpsEvidence) -> GpsState:
    """By the table."""
    rows = (row for row in TRANSITIONS if state in (row.before or (state,)) and row.holds(now))
    return next((row.after for row in rows), state)


class GpsMonitor:
    """Fault detection of GPS against the places of one map. A faulty GPS stays so until it is consistent again."""

    def __init__(self, gates: GatesConfig) -> None:
        self._doubted_gps = gates.doubted_gps
        self._call = math.log((1 - gates.gps_missed) / gates.gps_false_call)
        self._unseen_road: UnseenRoad | None = None
        self._state: GpsState = "cannot say"
        self._agreed_m, self._gap_m = (
            0.0,
            0.0,
        )  # of places that were compared; once it is left, of those where it is near
        self._has_agreed, self._is_suspected = False, False
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

        own: as it is believed. driven_m: since the frame before. is_compared: whether its place was compared with what
        is known.
        """
        assert self._unseen_road is not None
        bank, match = tracker.bank, frame.match.alone if frame.match else None
        gps, of_map = bank.evidence(*OF_GPS), bank.evidence("map elsewhere")
        self._unseen_road.update(match, _where(frame.gps, own, frame), gps / self._call if gps >= SUSPECT else 0.0)
        is_unseen = self._unseen_road.is_unseen(gps / SUSPECT)
        before, off_m, likelier = self.verdict, tracker.gps_off_m, max(OF_GPS, key=bank.evidence)
        self._count(tracker, driven_m, is_compared=is_compared and off_m is not None)
        is_far = off_m is not None and float(np.hypot(*off_m)) > NEAR_SIGMAS * GPS_SIGMA_M
        # Own motion in which GPS has no part says which is wrong; or GPS departs by far from a drive of the map that
        # moved as its vehicle did.
        knows = self._has_agreed and frame.without_gps is not None
        departs = self._has_agreed and tracker.is_checked and likelier == "gps dragged"
        departs = departs and (tracker.has_pose or tracker.gps_off(likelier) >= DEPARTS_M)
        of_gps, is_far = max(gps, self._call) if is_unseen and gps >= SUSPECT else gps, is_far and tracker.has_pose
        told, meters = (of_gps, of_map, self._call, knows or departs, knows), (self._agreed_m, self._gap_m)
        now = GpsEvidence(*told, *meters, tracker.follows_gps, is_far)
        was, self._state = self._state, next_state(self._state, now)
        if self._state == "consistent":
            self._has_agreed, tracker.follows_gps = True, True
        elif self._state == "faulty" and tracker.follows_gps:
            tracker.call_gps(likelier)
            off_m = tracker.gps_off_m
        if self._state in LEFT and self._state != was:
            self._agreed_m = 0.0
        if off_m is not None and self._state in ("inconsistent", "map faulty"):
            off_m = tracker.gps_from_places_m
        elif off_m is None and before.off_m is not None:
            self._has_agreed = True  # GPS was right until then, unless something else says otherwise
        has_poses = tracker.may_leave_gps and tracker.pose().place is not None
        self._is_suspected = self.is_doubted and (self._is_suspected or has_poses)
        state: GpsState = "cannot say" if off_m is None else "not recognized" if is_unseen else self._state
        state = "faulty" if self._state == "faulty" else state
        doubt = {"cannot say": None, "faulty": 1.0}.get(state, min(1.0, max(gps, of_map) / self._call))
        last_m = before.off_m if state == "faulty" else None
        where_m = last_m if off_m is None else (float(off_m[0]), float(off_m[1]))
        self.verdict = GpsVerdict("suspect" if state == "left" else state, where_m, doubt)
        return state in MISLED and before.state not in MISLED

    def _count(self, tracker: Tracker, driven_m: float, *, is_compared: bool) -> None:
        """Meters of places that were compared with GPS, and since the last one."""
        self._gap_m = 0.0 if is_compared else self._gap_m + driven_m
        if is_compared:
            self._agreed_m += driven_m
        if self._gap_m > LONGEST_GAP_M or (is_compared and self._state in LEFT and not tracker.gps_is_near):
            self._agreed_m = 0.0

    @property
    def is_doubted(self) -> bool:
        """Whether places speak against GPS now."""
        return self._state in ("suspect", "inconsistent", *LEFT)

    @property
    def is_ignored(self) -> bool:
        """Whether positions are published as if GPS were lost."""
        return self._is_suspected or (self._state == "faulty" and self._doubted_gps != "report")

    @property
    def is_wrong(self) -> bool:
        """Whether where GPS has the vehicle says nothing of where it is, whatever is done about that.

        With `doubted_gps` "switch" a suspicion is enough, where the autopilot could go by keypoint poses instead: it
        costs nothing if it is false. By a spoofing drift of 1 m/s, vehicles that steer themselves were 40 to 64 m
        beside their lane on four roads where GPS had to be faulty first, and 3.0 to 4.7 m at most on three where it is
        left (flown on ArduPilot 4.6.3).
        """
        return self._state == "faulty" or self._is_suspected

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
        self._firm_m, self._ahead_m, self._beside_m, self._doubt = 0.0, 0.0, 0.0, 0.0
        self.unseen_m = 0.0  # that GPS went on along the drive without any of it being recognized

    def is_unseen(self, doubt: float) -> bool:
        """Whether the vehicle is not recognized where GPS has it. doubt: by its own motion, see `GpsVerdict`."""
        return self.unseen_m >= UNSEEN_M * (1 - min(max(self._doubt, doubt), 1.0) / 2)

    def update(self, match: PlaceMatch | None, gps: Sequence[GpsFix], doubt: float = 0.0) -> None:
        """The answer to one more frame.

        gps: at the exposure, by the receiver and by the autopilot's filter, whose position is on the lane while it
        steers by it, and lags a receiver that is spoofed. doubt: see `GpsVerdict`; 0 where GPS is not suspect.
        """
        if match is None:
            self.reset()  # a sequence begins anew, and cannot be recognized yet
        elif match.accepted:
            self._see(match, doubt)
        elif self._last is not None and gps:
            self._follow(self._last, gps)

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

    def _follow(self, last: PlaceMatch, gps: Sequence[GpsFix]) -> None:
        sign, rig = (1 if last.direction == "forward" else -1), self._rig
        seen_m, behind_m = sign * self._ahead_m, sign * rig.ahead_m(last.direction, last.order)
        here = position_on_route(self._route, last.place_index, seen_m - behind_m, last.direction)
        is_mapped = self._route.reaches(last.place_index, self._route.route_m(last.place_index) + seen_m)
        if here is None or here.heading_deg is None or not is_mapped:
            self.reset()
            return
        offsets_m = [along_and_left_m(one, here, rig.left_m(last.direction)) for one in gps]
        ahead_m, left_m = min(offsets_m, key=lambda off_m: abs(off_m[1]))
        if abs(left_m) > NEAR_SIGMAS * math.hypot(rig.sigma_cross_track_m, map_error_m(here), gps[0].sigma_m):
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
