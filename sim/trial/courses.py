"""The named courses of `lookback sim fixes`: what can go wrong on a drive, each with the rules that it must pass.

A course is a function of a draft: a road of some length, a seeded generator, and what is usual (home at night over a
road that is mapped whole, GPS lost after 9 s, the autopilot steering itself). It changes what its case is about.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from edge.config import GatesConfig
from edge.localization.claims import SAME_DRIVE
from edge.telemetry.codec import Message
from sim.trial import gps_histories
from sim.trial.draft import GPS_S, Draft, Stretch
from sim.trial.rules import (
    arrives,
    back_to_usual,
    called_before_50_m,
    called_soon,
    close,
    first_in_time,
    never_called,
    never_sent,
    no_false_place,
    not_with_gps,
    not_worse,
    on_its_lane,
    resumes,
    sends,
    sources_restored,
    warns,
    within_sigmas,
)
from sim.trial.way import along
from sim.vehicle.driver import Leg
from sim.vehicle.estimator import OdometryErrors
from sim.vehicle.gps import NO_FIX, GpsReport

FALSE_BY_M = 300.0
HOME_LIGHTS = ("day", "dusk", "night", "rain")
FIRST_LINE_M = 120.0
"""A line of 80 m, and a few more frames: before that no place is believed, and its drive not confirmed."""
SET_OFF_M = 40.0
"""From the start of the road: a vehicle that comes home may drive on too far."""
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

Course = Callable[[Draft], None]
COURSES: dict[str, Course] = {}


def course(name: str, *values: object) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Add a course, or one for each value; `name` has the value's place."""

    def add(function: Callable[..., None]) -> Callable[..., None]:
        for value in values:
            COURSES[name.format(value)] = partial(function, value=value)
        if not values:
            COURSES[name] = function
        return function

    return add


def about(name: str) -> str:
    """What a course is about, in a line."""
    function = COURSES[name]
    text = (function.func if isinstance(function, partial) else function).__doc__ or ""
    return " ".join(text.split())


@course("home")
def _home(draft: Draft) -> None:
    """The main task: the autopilot drives home at night without GPS, over a road that is mapped whole."""
    draft.rules = (within_sigmas, no_false_place, not_worse, close, sends, resumes)


@course("take-me-home")
def _take_me_home(draft: Draft) -> None:
    """Out by day, mapped by a rear camera; GPS is lost at the turn; home on that map, in one of four lights."""
    _home_in(draft, str(draft.rng.choice(HOME_LIGHTS)))


@course("take-me-home-{}", *HOME_LIGHTS)
def _home_in(draft: Draft, value: str) -> None:
    """Out by day, mapped by a rear camera; GPS is lost at the turn; home on that map, in this light."""
    draft.home = draft.road(light=value)
    out = along(draft.road(light="day", direction="forward", drive_seed=1), SET_OFF_M, draft.length_m)
    turned = out.turned(180.0, radius_m=draft.home.lane_m)
    way = turned.then(along(draft.home, draft.length_m, 0.0))
    home_m = way.length_m - SET_OFF_M
    draft.drive(way, Leg(out.length_m), Leg(turned.length_m + 5, 2.0), Leg(home_m))
    draft.maps_live = True
    draft.map = [Stretch(SET_OFF_M, draft.length_m)]
    draft.gps_at, draft.gps_until_m = lambda time_s: GpsReport(), out.length_m
    draft.rules = (within_sigmas, no_false_place, not_worse, arrives, on_its_lane, resumes)


@course("one-stretch")
def _one_stretch(draft: Draft) -> None:
    """A: one stretch of 220 m is known, and entered, left and seen from everywhere else."""
    start_m = draft.rng.integers(22) / 21 * (draft.length_m - 220.0)
    draft.map = [Stretch(start_m, start_m + 220.0)]


@course("turn-off")
def _turn_off(draft: Draft) -> None:
    """B: by 90 degrees into a road that is not on the map, in the middle of one that is."""
    middle_m = draft.share(0.5)
    away = along(draft.road(seed=draft.world + 100), draft.length_m, draft.share(0.6))
    way = along(draft.home, draft.length_m, middle_m).turned(draft.rng.choice((-90.0, 90.0)))
    draft.unsent = [(way.length_m, math.inf)]
    draft.drive(way.then(away, moved=True))


@course("u-turn")
def _u_turn(draft: Draft) -> None:
    """B: back the way it came, on the other lane."""
    middle_m = draft.share(0.5)
    way = along(draft.home, draft.length_m, middle_m)
    turned = way.turned(180.0, radius_m=draft.home.lane_m)
    back = turned.then(along(draft.road(direction="forward"), middle_m + 1, draft.length_m))
    draft.drive(back, Leg(way.length_m), Leg(turned.length_m + 5, 2.0), Leg(back.length_m - 2))


@course("reversing-{}", 2, 4)
def _reversing(draft: Draft, value: float) -> None:
    """B: 60 m backwards in the middle of the drive."""
    middle_m = draft.share(0.5)
    draft.drive(draft.way, Leg(middle_m), Leg(middle_m - 60, -value), Leg(draft.way.length_m - 2))


@course("stop")
def _stop(draft: Draft) -> None:
    """B: 45 s at rest, and on."""
    draft.drive(draft.way, Leg(draft.share(0.6), then_wait_s=45.0), Leg(draft.way.length_m - 2))
    draft.rules = (within_sigmas, no_false_place, not_worse, resumes)


@course("ferry")
def _ferry(draft: Draft) -> None:
    """B: carried for 2 km, then on over another road; a person drives, since the autopilot is lost by design."""
    draft.steers = False
    there = along(draft.home, draft.length_m, draft.share(0.6)).carried_on(2000)
    draft.unsent = [(there.length_m - 2000, math.inf)]
    draft.drive(there.then(along(draft.road(seed=draft.world + 100), draft.length_m, draft.share(0.5)), moved=True))


@course("tow")
def _tow(draft: Draft) -> None:
    """B: 100 m along the mapped road with the wheels in the air."""
    draft.steers = False
    draft.drive(draft.way.towed(int(draft.share(0.5)), int(draft.share(0.5) + 100)))


@course("false-{}", 140, 260, 400)
def _false(draft: Draft, value: float) -> None:
    """C: part of the map is 300 m wrong, and GPS fails before it is reached."""
    start_m = draft.share(0.3)
    end_m = min(start_m + value, draft.length_m - 60)
    draft.map = [
        Stretch(0.0, start_m),
        Stretch(start_m, end_m, off_m=draft.side(FALSE_BY_M)),
        Stretch(end_m, draft.length_m),
    ]
    draft.unsent = [(draft.length_m - end_m, draft.length_m - start_m + 240)]
    draft.rules = (within_sigmas, no_false_place, not_worse, resumes)


@course("false-{}-no-gps", 140, 260, 400)
def _false_no_gps(draft: Draft, value: float) -> None:
    """C: the same without GPS from boot: nothing but the wrong stretch is known for the first half of the way."""
    _false(draft, value)
    draft.map = [Stretch(0.0, draft.share(0.15)), draft.map[1]]
    draft.has_gps = False
    draft.rules = (within_sigmas, no_false_place, not_worse)


@course("no-gps")
def _no_gps(draft: Draft) -> None:
    """No GPS from boot, and an origin that was set by hand 6 m off; a person drives, and the map is right.

    For roads of over 700 m.
    """
    draft.has_gps = draft.steers = False
    draft.unsent = [(0.0, SAME_DRIVE * GatesConfig().confirm_m + FIRST_LINE_M)]
    draft.rules = (within_sigmas, no_false_place, not_worse, sends)


@course("shifted-40")
def _shifted(draft: Draft) -> None:
    """C: the whole map is 40 m wrong."""
    draft.map = [Stretch(0.0, draft.length_m, off_m=draft.side(40.0))]
    draft.rules = (within_sigmas, not_worse)


@course("two-drives-40")
def _two_drives(draft: Draft) -> None:
    """C: two drives over the road disagree by 40 m, and nobody says which of them is right."""
    draft.map = [Stretch(0.0, draft.length_m), Stretch(0.0, draft.length_m, left_m=1.0, off_m=draft.side(40.0))]
    draft.rules = (within_sigmas, not_worse)


@course("two-laps")
def _two_laps(draft: Draft) -> None:
    """C: laps of 120 m whose places are 300 m wrong, without GPS from boot: a lap must not confirm another."""
    start_m = draft.length_m / 2
    lap = along(draft.home, start_m + 119, start_m).bent()
    draft.drive(lap.then(lap).then(lap).then(lap))
    draft.map = [Stretch(start_m, start_m + 119, on_way=True, off_m=draft.side(FALSE_BY_M))]
    draft.has_gps, draft.steers = False, False
    draft.rules = (within_sigmas, no_false_place)


@course("gps-{}", *GPS_WORKS)
def _gps_works(draft: Draft, value: str) -> None:
    """D: GPS works (RTK, PPP, the second receiver, a lost request for its messages), so no position may be sent."""
    draft.gps_at = lambda time_s: GPS_WORKS[value]
    draft.loses = lambda time_s, message, outgoing: value == "lost-request" and not outgoing and _requests(message, 24)
    draft.rules = (never_sent,)


@course("gps-500-m")
def _gps_500_m(draft: Draft) -> None:
    """D: a 3-D fix that is 500 m accurate, by its own word: GPS must count as lost."""
    draft.gps_at = lambda time_s: GpsReport(accuracy_m=1.0 if time_s < GPS_S else 500.0)
    draft.rules = (within_sigmas, no_false_place, not_worse, sends)


@course("gps-flicker")
def _gps_flicker(draft: Draft) -> None:
    """D: GPS comes and goes every 4 s."""
    draft.gps_at = lambda time_s: GpsReport() if time_s < GPS_S or time_s % 8 < 4 else NO_FIX


@course("gps-one-message")
def _gps_one_message(draft: Draft) -> None:
    """D: a single good report in the middle of an outage."""
    at_s = draft.share(0.5) / 8.0
    draft.gps_at = lambda time_s: GpsReport() if time_s < GPS_S or at_s <= time_s < at_s + 0.2 else NO_FIX
    draft.rules = (within_sigmas, no_false_place, not_worse, resumes)


@course("gps-drag-{}", 0.5, 5)
def _gps_drag(draft: Draft, value: float) -> None:
    """D: a spoofed GPS moves away, so many meters a second, for 40 s, and then is jammed."""

    def report(time_s: float) -> GpsReport:
        off_m = value * min(max(0.0, time_s - GPS_S), 40.0)
        return GpsReport(east_off_m=off_m) if time_s < GPS_S + 40.0 else NO_FIX

    draft.gps_at = report
    draft.steers = False
    draft.unsent = [(0.0, (GPS_S + 40.0) * 8.0)]
    draft.rules = (within_sigmas, no_false_place, not_worse)


@course("gps-{}", "multipath", "rtk-2-cm")
def _gps_honest(draft: Draft, value: str) -> None:
    """D: an honest GPS, with bursts of multipath and outages or with RTK, must not be called wrong."""
    _follow_history(draft, gps_histories.multipath if value == "multipath" else gps_histories.rtk)
    draft.rules = (never_called,)


@course("gps-spoofed-{}", *SPOOFS)
def _gps_spoofed(draft: Draft, value: str) -> None:
    """D: GPS is spoofed while a person drives; the places contradict it, and positions are used in its place."""
    start_s = draft.share(0.55) / 8.0
    _follow_history(draft, SPOOFS[value](start_s))
    draft.doubted_gps = "send" if value in BY_SCRIPT else "switch"
    draft.rules = (called_before_50_m if "drag" in value else called_soon, back_to_usual)


def _follow_history(draft: Draft, history: gps_histories.History) -> None:
    """GPS as a history says, for a vehicle at 8 m/s; a person drives."""
    time_s = np.arange(0.0, draft.way.length_m / 4.0, 0.1)
    true_m = np.array([draft.way.at(min(8.0 * t, draft.way.length_m - 1.0))[:2] for t in time_s])
    offsets_m = history(time_s, true_m, draft.rng)

    def report(at_s: float) -> GpsReport:
        east_m, north_m = offsets_m[int(np.clip(at_s / 0.1, 0, len(offsets_m) - 1))]
        return NO_FIX if np.isnan(east_m) else GpsReport(east_off_m=float(east_m), north_off_m=float(north_m))

    draft.gps_at, draft.steers = report, False


@course("lost-acknowledgements")
def _lost_acknowledgements(draft: Draft) -> None:
    """E: every second answer of the autopilot is lost."""
    draft.loses = lambda time_s, message, outgoing: (
        outgoing and message.get_type() == "COMMAND_ACK" and int(time_s) % 2 == 0
    )
    draft.rules = (within_sigmas, no_false_place, not_worse, sends)


@course("lost-source-set")
def _lost_source_set(draft: Draft) -> None:
    """E: the command that selects the second set of sources is lost until 31 s after GPS; GPS comes back later."""
    draft.emit = "vision_position"
    draft.loses = lambda time_s, message, outgoing: not outgoing and time_s < 40.0 and _is_command(message, 42007)
    draft.rules = (within_sigmas, no_false_place, sources_restored)
    draft.gps_at = lambda time_s: NO_FIX if GPS_S <= time_s < draft.share(0.8) / 8.0 else GpsReport()


@course("silence-{}", 6, 60)
def _silence(draft: Draft, value: float) -> None:
    """E: nothing but heartbeats from the autopilot for some seconds."""
    draft.silence_s = (draft.share(0.4) / 8.0, draft.share(0.4) / 8.0 + value)
    draft.unsent = [(draft.share(0.3), draft.share(0.4) + value * 10.4 + 80)]
    draft.rules = (within_sigmas, no_false_place, not_worse, resumes)


@course("daemon-killed")
def _daemon_killed(draft: Draft) -> None:
    """E: the daemon dies in the middle of the drive, without a word, and is started again."""
    draft.killed_s = draft.share(0.5) / 8.0
    draft.rules = (within_sigmas, no_false_place, not_worse, resumes)
    draft.unsent = [(draft.share(0.35), draft.share(0.65) + 40)]


@course("autopilot-restarted")
def _autopilot_restarted(draft: Draft) -> None:
    """E: the autopilot restarts while the vehicle is driven on."""
    draft.restarted_s = draft.share(0.5) / 8.0
    draft.steers = False


@course("gps-returns")
def _gps_returns(draft: Draft) -> None:
    """E: GPS comes back while positions go unanswered: none may be sent again then."""
    back_s = draft.share(0.6) / 8.0
    draft.gps_at = lambda time_s: GpsReport() if not GPS_S <= time_s < back_s else NO_FIX
    draft.loses = lambda time_s, message, outgoing: outgoing and message.get_type() == "COMMAND_ACK"
    draft.rules = (within_sigmas, no_false_place, not_with_gps)


@course("odometer{:+d}", -15, -3, 3, 12)
def _odometer(draft: Draft, value: int) -> None:
    """F: the wheels measure so many percent too much."""
    draft.errors = replace(draft.errors, scale=1.0 + value / 100.0)


@course("heading-3")
def _heading(draft: Draft) -> None:
    """F: dead reckoning goes 3 degrees to the side all the time."""
    draft.errors = replace(draft.errors, heading_deg=3.0 * np.sign(draft.errors.heading_deg))


@course("irregular-map")
def _irregular(draft: Draft) -> None:
    """F: places every 1 to 5 m."""
    draft.map = [replace(draft.map[0], spacing_m=(1.0, 5.0))]
    draft.rules = (within_sigmas, no_false_place, not_worse, sends)


@course("no-headings")
def _no_headings(draft: Draft) -> None:
    """F: a map whose places have no heading."""
    draft.map = [replace(draft.map[0], headings=False)]
    draft.rules = (within_sigmas, no_false_place, not_worse, sends)


@course("antimeridian")
def _antimeridian(draft: Draft) -> None:
    """F: the road crosses 180 degrees."""
    middle_lon_deg = np.degrees(draft.way.at(draft.way.length_m / 2)[0] / (6378137.0 * math.cos(math.radians(27.4772))))
    draft.lon_shift_deg = float(180.0 - 153.0283 - middle_lon_deg)
    draft.rules = (within_sigmas, no_false_place, not_worse, sends)


@course("clock-wrap")
def _clock_wrap(draft: Draft) -> None:
    """F: the autopilot's clock in milliseconds wraps in the middle of the drive, 49.7 days after boot."""
    draft.booted_before_s = 2**32 / 1e3 - draft.share(0.6) / 8.0
    draft.rules = (within_sigmas, no_false_place, not_worse, resumes)


@course("person")
def _person(draft: Draft) -> None:
    """A person keeps to the lane, whatever the autopilot believes."""
    draft.steers = False
    draft.rules = (within_sigmas, no_false_place, not_worse, sends, resumes)


@course("px4-no-velocity-aid{}", "", "-43003")
def _px4_no_aid(draft: Draft, value: str) -> None:
    """H: nothing measures PX4's velocity, which runs away; our positions must not follow it."""
    draft.firmware, draft.steers = "px4", False
    draft.emit = "external_position" if value else "auto"
    draft.errors = OdometryErrors("none", acceleration_mps2=draft.rng.uniform(0.1, 0.2))
    draft.rules = (within_sigmas, no_false_place, not_worse)


@course("px4-aided{}", "", "-43003")
def _px4_aided(draft: Draft, value: str) -> None:
    """H: PX4 with a velocity sensor whose scale is 3 % wrong."""
    draft.firmware = "px4"
    draft.emit = "external_position" if value else "auto"
    draft.errors = OdometryErrors("velocity sensor", 1.0 + 0.03 * draft.rng.choice((-1.0, 1.0)))
    draft.rules = (within_sigmas, no_false_place, not_worse, sends)


@course("vision")
def _vision(draft: Draft) -> None:
    """ArduPilot with VISION_POSITION_ESTIMATE, whose stream turns the filter's heading."""
    draft.emit = "vision_position"


@course("stream-unused")
def _stream_unused(draft: Draft) -> None:
    """H: PX4 whose parameters for positions are missing: the pilot must be told that nobody uses them."""
    draft.firmware = "px4-without-agp"
    draft.errors = OdometryErrors("velocity sensor", 1.03)
    draft.rules = (within_sigmas, no_false_place, warns)


@course("px4-failsafe")
def _px4_failsafe(draft: Draft) -> None:
    """H: PX4 gives up 6 s after the loss of GPS; on a mapped road the first position must come before."""
    draft.firmware, draft.steers = "px4", False
    draft.errors = OdometryErrors("velocity sensor", 1.03)
    lost_s = draft.share(0.7) / 8.0
    draft.gps_at = lambda time_s: GpsReport() if time_s < lost_s else NO_FIX
    draft.rules = (within_sigmas, no_false_place, first_in_time)


def _is_command(message: Message, command: int) -> bool:
    return bool(getattr(message, "command", None) == command)


def _requests(message: Message, message_id: int) -> bool:
    return _is_command(message, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL) and int(message.param1) == message_id
