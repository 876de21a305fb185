"""D: GPS that works, comes and goes, is inaccurate, or is spoofed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.telemetry.codec import Message
from sim.research.trial import course_rules as rule
from sim.research.trial import gps_histories
from sim.research.trial.course import GPS_S, CourseDraft, MapStretch, course, is_command
from sim.research.trial.ways import turned_twice
from sim.trial.way import Leg
from sim.vehicle.gps import NO_FIX, GpsReport

GPS_WORKS = {
    "rtk": GpsReport(fix_type=mavlink.GPS_FIX_TYPE_RTK_FIXED, accuracy_m=0.02),
    "ppp": GpsReport(fix_type=mavlink.GPS_FIX_TYPE_PPP, accuracy_m=0.02),
    "second-only": GpsReport(second=True),
    "lost-request": GpsReport(),
}
SPOOFS: dict[str, Callable[[float], gps_histories.History]] = {
    **{
        f"drag-{rate:g}-{way}": partial(gps_histories.drag, rate, way)
        for rate in gps_histories.DRAG_MPS
        for way in ("along", "left")
    },
    "jump": partial(gps_histories.jump, 60.0),
    "replay": partial(gps_histories.replay, 30.0),
    "jammed": lambda start_s: gps_histories.jammed(8.0, gps_histories.jump(60.0, start_s), start_s),
}
BY_SCRIPT = ("jump", "drag-1-along")


@course("D", "gps-{}", *GPS_WORKS, rules=(rule.never_sent,))
def _gps_works(draft: CourseDraft, value: str) -> None:
    """GPS works (RTK, PPP, the second receiver, a lost request for its messages), so no position may be sent."""
    draft.gps_at = lambda time_s: GPS_WORKS[value]
    draft.loses = lambda time_s, message, outgoing: value == "lost-request" and not outgoing and _requests_gps(message)


@course("D", "gps-500-m", rules=(*rule.USUAL, rule.sends))
def _gps_500_m(draft: CourseDraft) -> None:
    """A 3-D fix that is 500 m accurate, by its own word: GPS must count as lost."""
    draft.gps_at = lambda time_s: GpsReport(accuracy_m=1.0 if time_s < GPS_S else 500.0)


@course("D", "gps-flicker")
def _gps_flicker(draft: CourseDraft) -> None:
    """GPS comes and goes every 4 s."""
    draft.gps_at = lambda time_s: GpsReport() if time_s < GPS_S or time_s % 8 < 4 else NO_FIX


@course("D", "gps-one-message", rules=(*rule.USUAL, rule.resumes))
def _gps_one_message(draft: CourseDraft) -> None:
    """A single good report in the middle of an outage."""
    at_s = draft.share(0.5) / 8.0
    draft.gps_at = lambda time_s: GpsReport() if time_s < GPS_S or at_s <= time_s < at_s + 0.2 else NO_FIX


@course("D", "gps-drag-{}", 0.5, 5)
def _gps_drag(draft: CourseDraft, value: float) -> None:
    """A spoofed GPS moves away, so many meters a second, for 40 s, and then is jammed."""

    def report(time_s: float) -> GpsReport:
        off_m = value * min(max(0.0, time_s - GPS_S), 40.0)
        return GpsReport(east_off_m=off_m) if time_s < GPS_S + 40.0 else NO_FIX

    draft.gps_at = report
    draft.steers = False
    draft.unsent = [(0.0, (GPS_S + 40.0) * 8.0)]


@course("D", "gps-back-150", rules=(*rule.HONEST, rule.called_soon))
def _gps_back(draft: CourseDraft) -> None:
    """GPS comes back 150 m wrong; a person drives."""
    back_s, (east_m, north_m) = draft.share(0.5) / 8.0, draft.side(150.0)
    wrong = GpsReport(east_off_m=east_m, north_off_m=north_m)
    draft.gps_at = lambda time_s: GpsReport() if time_s < GPS_S else NO_FIX if time_s < back_s else wrong
    draft.steers, draft.doubted_gps = False, "switch"


@course("D", "gps-wrong-after-gap-{}", 60, 150, least_m=1000.0, rules=(*rule.HONEST, rule.called_on_map))
def _gps_wrong_after_gap(draft: CourseDraft, value: float) -> None:
    """GPS is consistent with the map for 400 m; in a gap of the map of 250 m it begins to be wrong. A person drives."""
    _wrong_in_gap(draft, 250.0, value)
    draft.doubted_gps = "switch"


@course("D", "gps-30-m-off-after-{}", "gap", "far-gap", "gap-unaided", least_m=1600.0)
def _gps_off_after_gap(draft: CourseDraft, value: str) -> None:
    """GPS is consistent with the map for 400 m; in a gap of the map of 250 m or 800 m it begins to be 30 m off, also
    where nothing but GPS measures the velocity. A person drives, who must read of it soon."""
    gap_m = 800.0 if value == "far-gap" else 250.0
    draft.rules = (*rule.HONEST, rule.told_after(400.0 + gap_m, _wrong_in_gap(draft, gap_m, 30.0)))
    if value == "gap-unaided":
        draft.errors = replace(draft.errors, source="none")


def _wrong_in_gap(draft: CourseDraft, gap_m: float, off_m: float) -> float:
    """A gap of the map after 400 m, in the middle of which GPS begins to be so far to the side: at that second."""
    agreed_m = draft.length_m - 400.0
    draft.map = [MapStretch(0.0, agreed_m - gap_m), MapStretch(agreed_m, draft.length_m)]
    from_s, (east_m, north_m) = (400.0 + gap_m / 2) / 8.0, draft.side(off_m)
    wrong = GpsReport(east_off_m=east_m, north_off_m=north_m)
    draft.gps_at = lambda time_s: GpsReport() if time_s < from_s else wrong
    draft.steers = False
    return from_s


@course("D", "gps-turned-twice", rules=(rule.never_called, rule.never_sent))
def _gps_turned_twice(draft: CourseDraft) -> None:
    """Half of the way out by day, 200 m back, and out again, mapped on the way; an honest GPS must not be called."""
    way, turns = turned_twice(draft, 0.0)
    draft.drive(way, *turns, Leg(way.length_m - 2))
    draft.maps_live, draft.steers = True, False
    draft.map = []
    draft.gps_at = lambda time_s: GpsReport()


@course("D", "gps-{}", "multipath", "rtk-2-cm", rules=(rule.never_called,))
def _gps_honest(draft: CourseDraft, value: str) -> None:
    """An honest GPS, with bursts of multipath and outages or with RTK, must not be declared faulty."""
    follow_history(draft, gps_histories.multipath if value == "multipath" else gps_histories.rtk)
    draft.steers = False


@course("D", "gps-spoofed-{}", *SPOOFS)
def _gps_spoofed(draft: CourseDraft, value: str) -> None:
    """GPS is spoofed while a person drives; the places contradict it, and positions are used in its place."""
    start_s = draft.share(0.55) / 8.0
    follow_history(draft, SPOOFS[value](start_s))
    draft.steers, draft.doubted_gps = False, "send" if value in BY_SCRIPT else "switch"
    draft.rules = (rule.called_before_50_m if "drag" in value else rule.called_soon, rule.back_to_usual)


@course("D", "gps-steered-aside", rules=(rule.never_sent, rule.warned_before_50_m))
def _gps_steered_aside(draft: CourseDraft) -> None:
    """A spoofed GPS drifts to the left of the road at 1 m/s; the autopilot steers by it, and leaves the road."""
    start_s = draft.share(0.35) / 8.0

    def report(time_s: float) -> GpsReport:
        heading_rad, off_m = draft.way.at(8.0 * time_s)[2], max(0.0, time_s - start_s)
        return GpsReport(east_off_m=-off_m * np.cos(heading_rad), north_off_m=off_m * np.sin(heading_rad))

    draft.gps_at = report


def follow_history(draft: CourseDraft, history: gps_histories.History) -> None:
    """GPS as a history says, for a vehicle at 8 m/s."""
    time_s = np.arange(0.0, draft.way.length_m / 4.0, 0.1)
    true_m = np.array([draft.way.at(min(8.0 * t, draft.way.length_m - 1.0))[:2] for t in time_s])
    offsets_m = history(time_s, true_m, draft.rng)

    def report(at_s: float) -> GpsReport:
        east_m, north_m = offsets_m[int(min(max(at_s / 0.1, 0.0), len(offsets_m) - 1))]
        return NO_FIX if np.isnan(east_m) else GpsReport(east_off_m=float(east_m), north_off_m=float(north_m))

    draft.gps_at = report


def _requests_gps(message: Message) -> bool:
    asks = is_command(message, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL)
    return asks and int(message.param1) == mavlink.MAVLINK_MSG_ID_GPS_RAW_INT
