"""H: PX4 with and without a velocity of its own, and streams of positions."""

from __future__ import annotations

from dataclasses import replace

from sim.research.trial import course_rules as rule
from sim.research.trial.course import COURSES, GPS_S, CourseDraft, course
from sim.research.trial.courses.gps import follow_history
from sim.research.trial.gps_histories import drag
from sim.vehicle.estimator import OdometryErrors
from sim.vehicle.gps import NO_FIX, GpsReport

WANDER_MPS = 0.4
"""Of a velocity that nothing measures, ahead within a second, besides its growth and what positions do to it: 0.24 to
0.35 on three recorded flights of PX4, 0.1 of its rover."""


def _run_away(draft: CourseDraft) -> None:
    acceleration_mps2, seed = draft.rng.uniform(0.1, 0.2), int(draft.rng.integers(2**31))
    draft.errors = OdometryErrors("none", acceleration_mps2=acceleration_mps2, wander_mps=WANDER_MPS, seed=seed)


@course("H", "px4-no-velocity-aid", rules=(rule.never_sent,))
def _px4_no_aid(draft: CourseDraft) -> None:
    """Nothing measures PX4's velocity, which runs away: where the vehicle is between two places, nobody knows."""
    draft.firmware, draft.steers, draft.motion = "px4", False, "off"
    _run_away(draft)


ROVER_WANDER_MPS = 0.1
"""The same of PX4's rover, whose attitude is right while a velocity is fused."""
PX4_TURNS_DEG, ARDUPILOT_TURNS_DEG, TURNS_WITHIN_M = 2.3, 1.2, 100.0
"""Of the heading's error without GPS, see `HeadingWander`. On two recorded drives of PX4 by the camera's speed, 1.4 km,
it was 1.6 degrees off (median), 5.1 at most, 2.3 rms, and its autocorrelation 0.92, 0.76, 0.40 and 0.0 after 50, 100,
200 and 300 m; rms 1.95 on all ten of PX4. ArduPilot's, on twelve drives, was 1.0 off, 3.0 at most, 1.2 rms."""


def _turn(draft: CourseDraft, turns_deg: float) -> None:
    draft.errors = replace(draft.errors, gyro_dps=0.0, turns_deg=turns_deg, turns_within_m=TURNS_WITHIN_M)


SEEN_S = 25.0
"""With GPS, in which about 200 m are driven: enough to learn the camera's height."""


EARLY_S = 3.0  # in which hardly 7 m are driven
GAP_FROM_S, GAP_S = 50.0, 4.5


@course("J", "px4-camera{}", "", "-43003", "-stop", "-turn-off", "-false-260", "-unused", "-gap")
def _px4_camera(draft: CourseDraft, value: str) -> None:
    """The camera measures the speed of a vehicle whose PX4 runs away; our positions must not follow that. gap: no
    picture comes for 4.5 s."""
    if value.lstrip("-") in COURSES:
        COURSES[value.lstrip("-")].lay(draft)
    draft.firmware, draft.steers = "px4-without-agp" if value == "-unused" else "px4", False
    draft.motion = "odometer"
    draft.emit = "external_position" if value not in ("", "-unused") else "auto"
    _run_away(draft)
    draft.gps_at = lambda time_s: GpsReport() if time_s < SEEN_S else NO_FIX
    draft.rules = rule.USUAL
    if value == "-gap":
        draft.unseen_s = GAP_FROM_S, GAP_FROM_S + GAP_S


@course("J", "px4-camera-sent{}", "", "-steers", "-stop", "-turn-off", "-early", "-gap")
def _px4_camera_sent(draft: CourseDraft, value: str) -> None:
    """As px4-camera, and PX4 fuses the velocity that the camera measures; steers: it steers itself home; early: GPS is
    lost at once, and by an earlier drive the camera is higher by a tenth than it is."""
    COURSES["px4-camera" + value.replace("-steers", "").replace("-early", "")].lay(draft)
    draft.errors = replace(draft.errors, source="camera", wander_mps=ROVER_WANDER_MPS)
    _turn(draft, PX4_TURNS_DEG)
    draft.emit, draft.motion = "auto", "send"
    if value == "-steers":
        draft.steers, draft.rules = True, (*rule.USUAL, rule.resumes, rule.on_its_lane)
    elif value == "-early":
        draft.gps_at = lambda time_s: GpsReport() if time_s < EARLY_S else NO_FIX
        draft.height = 1.1


@course("J", "px4-gps-dragged", least_m=1500.0)
def _px4_gps_dragged(draft: CourseDraft) -> None:
    """As px4-camera-sent, with GPS throughout: spoofed to the left at 1 m/s for a while, and PX4 is to leave it,
    to use positions meanwhile, and to have it back."""
    COURSES["px4-camera-sent"].lay(draft)
    follow_history(draft, drag(1.0, "left", draft.share(0.35) / 8.0))
    spoofed, right_s = draft.gps_at, draft.share(0.8) / 8.0
    draft.gps_at = lambda time_s: spoofed(time_s) if time_s < right_s else GpsReport()
    draft.doubted_gps, draft.rules = (
        "switch",
        (*rule.HONEST, rule.called_before_50_m, rule.back_to_usual, rule.sources_restored),
    )


@course("J", "rover-camera-sent{}", "", "-scale-10", "-slips", "-gap")
def _rover_camera_sent(draft: CourseDraft, value: str) -> None:
    """ArduPilot Rover without wheel encoders steers itself home by the camera's velocity and our positions; scale-10:
    its camera is lower by a tenth than on an earlier drive, slips: from the middle of the way on, gap: as
    px4-camera-gap."""
    COURSES["px4-camera-sent-gap" if value == "-gap" else "px4-camera-sent"].lay(draft)
    draft.firmware, draft.steers = "ardupilot", True
    _turn(draft, ARDUPILOT_TURNS_DEG)
    if value == "-scale-10":
        draft.gps_at = lambda time_s: GpsReport() if time_s < GPS_S else NO_FIX
        draft.height = 1.1
    elif value == "-slips":
        slips_m = 0.5 * draft.length_m
        draft.shown_m = lambda route_m: route_m * (1.1 if route_m < slips_m else 1.0)


@course("H", "px4-aided{}", "", "-1.17", rules=(*rule.USUAL, rule.close, rule.sends))
def _px4_aided(draft: CourseDraft, value: str) -> None:
    """PX4 with a velocity sensor whose scale is 3 % wrong; 1.17 is reset by each position."""
    draft.firmware = f"px4{value}"
    draft.errors = OdometryErrors("velocity sensor", 1.0 + 0.03 * draft.rng.choice((-1.0, 1.0)))


@course("H", "stream-unused", rules=(*rule.HONEST, rule.warns))
def _stream_unused(draft: CourseDraft) -> None:
    """PX4 whose parameters for positions are missing: a warning must say that nobody uses them."""
    draft.firmware = "px4-without-agp"
    draft.errors = OdometryErrors("velocity sensor", 1.03)


@course("H", "px4-failsafe", rules=(*rule.HONEST, rule.first_in_time))
def _px4_failsafe(draft: CourseDraft) -> None:
    """PX4 gives up 6 s after the loss of GPS; on a mapped road the first position must come before."""
    draft.firmware, draft.steers = "px4", False
    draft.errors = OdometryErrors("velocity sensor", 1.03)
    lost_s = draft.share(0.7) / 8.0
    draft.gps_at = lambda time_s: GpsReport() if time_s < lost_s else NO_FIX
