"""G: the main task, and the whole of what Lookback is for: the autopilot steers itself home by its own estimate."""

from __future__ import annotations

from dataclasses import replace

from sim.research.trial import course_rules as rule
from sim.research.trial import gps_histories
from sim.research.trial.course import CONFIRMED_M, DOWN_S, CourseDraft, MapStretch, course
from sim.research.trial.courses.gps import follow_history
from sim.research.trial.ways import beside, turned_twice
from sim.trial.draft import SET_OFF_M, home_by, out_and_home
from sim.trial.way import Leg, along
from sim.vehicle.gps import NO_FIX, GpsReport

HOME_LIGHTS = ("day", "dusk", "night", "rain")
REPEAT_LIGHTS = "dusk", "night"
OUTAGES_S, OUTAGE_FROM_S = (5, 12), 30.0
BACKED_M, BACKED_AT = (20, 60), (1 / 3, 2 / 3)
"""By how much, and after which shares of the way out."""

HOME = (*rule.USUAL, rule.arrives, rule.on_its_lane, rule.resumes)


@course("G", "home", rules=(*rule.USUAL, rule.resumes), keypoint_rules=(rule.close, rule.sends))
def _home(draft: CourseDraft) -> None:
    """The main task: the autopilot drives home at night without GPS, over a road that is mapped whole."""


@course("G", "home-fused", keypoint_rules=(rule.close, rule.sends))
def _home_fused(draft: CourseDraft) -> None:
    """The main task with an ArduPilot that fuses keypoint poses (firmware_config/ardupilot_rover_fused.param)."""
    draft.firmware = "ardupilot-fused"


@course("G", "again-dusk")
def _again(draft: CourseDraft) -> None:
    """The same way as the map at dusk, where only the lane says how far across the road the vehicle is."""
    draft.home = draft.road(light="dusk", direction="forward")
    draft.drive(along(draft.home, 0.0, draft.length_m))


@course("G", "repeat-{}", *REPEAT_LIGHTS, rules=(*rule.USUAL, rule.resumes), keypoint_rules=(rule.close, rule.sends))
def _repeat(draft: CourseDraft, value: str) -> None:
    """The same way by a front camera on a front camera's day map, half a meter beside its lane, in this light."""
    draft.home = draft.road(light=value, direction="forward")
    draft.map = [MapStretch(0.0, draft.length_m, left_m=-0.5, camera=("front", "day", 1))]
    draft.drive(along(draft.home, 0.0, draft.length_m))


@course("G", "repeat-beside-{}", 6, 8)
def _repeat_beside(draft: CourseDraft, value: float) -> None:
    """As repeat-dusk, so many meters beside the lane of the map; a person drives."""
    _repeat(draft, "dusk")
    left_m = value * draft.rng.choice((-1.0, 1.0))
    draft.map = [replace(draft.map[0], left_m=0.0)]
    draft.drive(beside(draft.way, lambda m: left_m))
    draft.steers = False


@course("G", "home-{}", "right-3", "right-8", "down-3")
def _home_knocked(draft: CourseDraft, value: str) -> None:
    """The main task at dusk, with a camera that was knocked by so many degrees since the map was made."""
    way, degrees = value.split("-")
    draft.home = draft.road(light="dusk", **{f"camera_{way}_deg": float(degrees)})
    draft.drive(along(draft.home, draft.length_m, 0.0))


@course("G", "home-dusk", rules=(*rule.USUAL, rule.resumes), keypoint_rules=(rule.close, rule.sends))
def _home_at_dusk(draft: CourseDraft) -> None:
    """The main task at dusk."""
    draft.home = draft.road(light="dusk")
    draft.drive(along(draft.home, draft.length_m, 0.0))


@course("G", "take-me-home", rules=HOME)
def _take_me_home(draft: CourseDraft) -> None:
    """Out by day, mapped by a rear camera; GPS is lost at the turn; home on that map, in one of four lights."""
    _home_in(draft, str(draft.rng.choice(HOME_LIGHTS)))


@course("G", "take-me-home-{}", *HOME_LIGHTS, rules=HOME)
def _home_in(draft: CourseDraft, value: str) -> None:
    """Out by day, mapped by a rear camera; GPS is lost at the turn; home on that map, in this light."""
    out_and_home(draft, value)
    draft.maps_live = True
    draft.map = [MapStretch(SET_OFF_M, draft.length_m)]
    draft.gps_at = lambda time_s: GpsReport()


@course("G", "take-me-home-outage-{}", *OUTAGES_S, rules=HOME)
def _home_after_outage(draft: CourseDraft, value: float) -> None:
    """The same at night, where GPS was lost for so many seconds on the way out, as below a bridge."""
    _home_in(draft, "night")
    draft.gps_at = lambda time_s: NO_FIX if OUTAGE_FROM_S <= time_s < OUTAGE_FROM_S + value else GpsReport()


@course("G", "take-me-home-silence-4", rules=HOME)
def _home_after_silence(draft: CourseDraft) -> None:
    """The same at night, where the autopilot sent nothing but heartbeats for 4 s on the way out."""
    _home_in(draft, "night")
    draft.silence_s = OUTAGE_FROM_S, OUTAGE_FROM_S + 4.0


@course("G", "take-me-home-killed", rules=HOME)
def _home_after_kill(draft: CourseDraft) -> None:
    """The same at night, where the daemon died on the way out, and was back 6 to 10 s later."""
    _home_in(draft, "night")
    draft.killed_s, draft.down_s = OUTAGE_FROM_S, draft.rng.uniform(*DOWN_S)


@course("G", "take-me-home-unseen-8", rules=HOME)
def _home_after_unseen(draft: CourseDraft) -> None:
    """The same at night, where the camera that maps gave no frame for 8 s, as while it is opened again."""
    _home_in(draft, "night")
    draft.unseen_s = OUTAGE_FROM_S, OUTAGE_FROM_S + 8.0


@course("G", "take-me-home-backed-{}", *BACKED_M, rules=HOME)
def _home_after_backing(draft: CourseDraft, value: float) -> None:
    """The same at night, where the vehicle backed twice by so many meters on the way out."""
    _home_in(draft, "night")
    out_m = draft.legs[0].to_m
    for at_m in (share * out_m for share in reversed(BACKED_AT)):
        draft.legs = [Leg(at_m), Leg(at_m - value, -2.0), *draft.legs]


@course("G", "take-me-home-turned-twice", rules=HOME)
def _home_after_turns(draft: CourseDraft) -> None:
    """The same at night, where the way out led 200 m back in its middle, and out again: 200 m are mapped twice."""
    _home_in(draft, "night")
    out, turns = turned_twice(draft, SET_OFF_M)
    home_by(draft, out, turns)


@course("G", "take-me-home-switched-off", least_m=1200.0, rules=(*rule.USUAL, rule.sends))
def _home_after_switched_off(draft: CourseDraft) -> None:
    """The same at night, where computer and autopilot were off at the turn and GPS is gone after; a person drives."""
    _home_in(draft, "night")
    out, *home = draft.legs
    draft.legs = [replace(out, then_wait_s=30.0), *home]
    off_s = out.to_m / 8.0 + 10.0
    draft.killed_s, draft.down_s, draft.restarted_s = off_s, DOWN_S[1], off_s + DOWN_S[0]
    draft.gps_at = lambda time_s: GpsReport() if time_s < off_s else NO_FIX
    draft.origin_off_m, draft.steers = (0.0, 0.0), False
    draft.unsent = [(0.0, out.to_m + CONFIRMED_M)]


@course("G", "take-me-home-multipath", rules=(*rule.USUAL, rule.resumes))
def _home_after_multipath(draft: CourseDraft) -> None:
    """The same at night, where GPS was 10 m off or gone for seconds now and then on the way out, as in a town."""
    _home_in(draft, "night")
    follow_history(draft, gps_histories.multipath)


@course("G", "person", rules=(*rule.USUAL, rule.sends, rule.resumes))
def _person(draft: CourseDraft) -> None:
    """A person keeps to the lane, whatever the autopilot believes."""
    draft.steers = False
