"""The daemon's state, and why, decided by pure functions; `monitor` follows and publishes it.

The journal, systemd's STATUS=, the heartbeat's system_status, the pilot's status text, the page and doctor show one
`Health`. Its reason says why no position comes, wherever none does:

    starting     no image has been used yet
    warming up   fewer frames than a sequence needs, or a large map is still being searched
    on the map   the newest match is accepted
    off the map  it is rejected
    degraded     something is missing that may come back
    failed       the program ends: an error that it cannot recover from

A vehicle that stands keeps the state in which it stopped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias, cast

from pymavlink.dialects.v20 import ardupilotmega as mavlink

Able: TypeAlias = Literal["starting", "warming up", "on the map", "off the map"]
HealthState: TypeAlias = Literal["starting", "warming up", "on the map", "off the map", "degraded", "failed"]

MAV_STATES: dict[HealthState, int] = {
    "starting": mavlink.MAV_STATE_BOOT,
    "warming up": mavlink.MAV_STATE_CALIBRATING,
    "on the map": mavlink.MAV_STATE_ACTIVE,
    "off the map": mavlink.MAV_STATE_STANDBY,
    "degraded": mavlink.MAV_STATE_CRITICAL,
    "failed": mavlink.MAV_STATE_EMERGENCY,
}
LINK_GRACE_S = 5.0
"""Autopilots send every second; a link that has just been opened is not yet silent."""
SLOW_FRAME_S = 1.0
"""The result of a slower frame is about a place that the vehicle has left."""
OFF_STEPS_M = (20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000)
"""Meters without a recognized place at which the reason changes: each change is a line for the pilot."""
HOLE_STEPS_M = (40, *OFF_STEPS_M[2:])
"""The same without a keypoint pose: 6 m beside the lane 22 m are usual (docs/tables/keypoints.md), 40 m are not."""


@dataclass(frozen=True)
class Health:
    """The state, its reason ("" if there is none), and the state of recognition behind it.

    no_pose_m: see `HealthInputs`.
    """

    state: HealthState
    why: str = ""
    able: Able = "starting"
    no_pose_m: float | None = None

    def __str__(self) -> str:
        return f"{self.state}: {self.why}" if self.why else self.state

    def unable(self, undated: str) -> str:
        """Why nothing is recognized at this moment, "" while it is; undated: why it is not known when pictures were."""
        return undated if self.able == "on the map" else self.able

    @property
    def mav_state(self) -> int:
        """MAV_STATE for the heartbeat."""
        return MAV_STATES[self.state]


@dataclass(frozen=True)
class HealthInputs:
    """States that the stages report.

    recognizer: its state, as in `recognition.recognizer`. frames_used: since the start, or since the last blindness.
    camera: opening | running | lost | ended, with the reason. picture: the image's fault, "" if none. link: closed |
    waiting | up, with the reason and for how long it has not been up. journal: why it cannot be written. frame_s: how
    long the last frame took. gps: what is wrong with it by the places, "" if nothing is. withheld: why no position is
    sent, "" while one is. driven_m: by the odometer, None if unknown. off_m: of that since a place was recognized.
    no_pose_m: of that since the newest keypoint pose, None without one; right_m: of its drive of the map it was then.
    lens: what is wrong with the camera, which still sees something.
    """

    recognizer: str = "warming up"
    frames_used: int = 0
    camera: str = "running"
    camera_why: str = ""
    picture: str = ""
    link: str = "up"
    link_why: str = ""
    link_down_s: float = 0.0
    journal: str = ""
    frame_s: float = 0.0
    gps: str = ""
    withheld: str = ""
    driven_m: float | None = None
    off_m: float | None = None
    no_pose_m: float | None = None
    right_m: float = 0.0
    lens: str = ""

    @property
    def blind(self) -> str:
        """Why no place can be recognized now; "" if one can."""
        if self.camera == "lost":
            return f"camera: {self.camera_why}"
        return f"camera: {self.picture}" if self.picture else ""


NOT_YET = {
    "starting": "no picture has been used yet",
    "warming up": "more frames are needed",
    "searching": "the whole map is searched",
}
"""Why no place can be recognized yet."""
STARTING = Health("starting", NOT_YET["starting"])


def derive(signs: HealthInputs, before: Health = STARTING) -> Health:
    """The state now; `before` is the last one, which a standing vehicle keeps."""
    able = _able(replace(signs, frames_used=0) if signs.blind else signs, before)
    journal = f"journal: {signs.journal}" if signs.journal else ""
    slow = f"slow: a frame took over {SLOW_FRAME_S:g} s" if signs.frame_s > SLOW_FRAME_S else ""
    troubles = [one for one in (signs.gps, _link_trouble(signs), journal, slow) if one]
    if signs.blind:
        return Health("degraded", "; ".join([f"not recognized: {signs.blind}", *troubles]), able)
    why = "; ".join(filter(None, (_why_no_position(signs, able), _hole(signs), signs.lens)))
    if troubles:
        return Health("degraded", "; ".join([*troubles, str(Health(able, why))]), able)
    return Health(able, why, able)


def _why_no_position(signs: HealthInputs, able: Able) -> str:
    """In a sentence for people; "" while positions are sent."""
    if able == "on the map":
        return f"no position: {signs.withheld}" if signs.withheld else ""
    if able != "off the map":
        return NOT_YET["searching" if signs.recognizer == "searching" else able]
    passed_m = _passed_m(OFF_STEPS_M, signs.off_m)
    return f"not recognized for {passed_m} m" if passed_m else "not recognized"


def _hole(signs: HealthInputs) -> str:
    """For how long there was no keypoint pose, and where the vehicle was before, for people."""
    passed_m, side = _passed_m(HOLE_STEPS_M, signs.no_pose_m), "left" if signs.right_m < 0 else "right"
    return f"no pose for {passed_m} m, before {abs(signs.right_m):.1f} m {side} of the map's lane" if passed_m else ""


def _passed_m(steps_m: Sequence[int], driven_m: float | None) -> int:
    """The last of some steps that was passed, 0 before the first."""
    return max((step_m for step_m in steps_m if driven_m is not None and driven_m >= step_m), default=0)


def _able(signs: HealthInputs, before: Health) -> Able:
    if signs.frames_used == 0:  # none yet, or since the camera was blind
        return "starting" if before.able == "starting" else "warming up"
    if signs.recognizer == "standing":
        return before.able if before.able != "starting" else "warming up"
    return "warming up" if signs.recognizer == "searching" else cast("Able", signs.recognizer)


def _link_trouble(signs: HealthInputs) -> str:
    if signs.link == "closed":
        return f"link: {signs.link_why}" if signs.link_why else ""
    is_silent = signs.link != "up" and signs.link_down_s > LINK_GRACE_S
    return "link: no autopilot heard" if is_silent else ""
