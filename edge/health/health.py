"""What state the daemon is in, and why. Pure, and the only place that decides it.

The journal, systemd's STATUS=, the heartbeat's system_status and the pilot's lines all come from one `Health`:

    starting     no picture has been used yet
    warming up   fewer pictures than a sequence needs, or a large map is still being gone through
    on the map   the newest match is believed
    off the map  it is not
    degraded     something is missing that can come back by itself, and what; "blind" where no place can be recognised
    failed       the program ends: what was found cannot be recovered from inside

A vehicle that stands keeps the state in which it stopped.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, cast

from pymavlink.dialects.v20 import common as mavlink

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
"""Autopilots say something every second; a link that has just been opened is not yet silent."""
SLOW_FRAME_S = 1.0
"""A frame that took longer tells of a place that the vehicle has left."""


@dataclass(frozen=True)
class Health:
    """The state, why it is so ("" where there is nothing to say), and what the recogniser is able to do in it."""

    state: HealthState
    why: str = ""
    able: Able = "starting"

    def __str__(self) -> str:
        return f"{self.state}: {self.why}" if self.why else self.state

    @property
    def mav_state(self) -> int:
        """MAV_STATE for the heartbeat."""
        return MAV_STATES[self.state]


@dataclass(frozen=True)
class HealthInputs:
    """What the stages say of themselves.

    recognizer: its state, as in `edge.recognizer`. frames_used: since the start, or since the last blindness.
    camera: running | lost | ended, with the reason. picture: what is wrong with it. link: closed | waiting | up, with
    the reason and since when it is not up. journal: why it cannot be written. frame_s: what the last frame took.
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

    @property
    def blind(self) -> str:
        """Why no place can be recognised now; "" when one can."""
        if self.camera == "lost":
            return f"camera: {self.camera_why}"
        return f"camera: {self.picture}" if self.picture else ""


STARTING = Health("starting")


def derive(signs: HealthInputs, before: Health = STARTING) -> Health:
    """The state now; `before` is the one told last, which a standing vehicle keeps."""
    able = _able(signs, before)
    troubles = [trouble for trouble in (_link_trouble(signs), _journal_trouble(signs), _slow(signs)) if trouble]
    if signs.blind:
        return Health("degraded", "; ".join([f"blind, {signs.blind}", *troubles]), "starting")
    if troubles:
        return Health("degraded", "; ".join([*troubles, able]), able)
    return Health(able, "", able)


def _able(signs: HealthInputs, before: Health) -> Able:
    if signs.frames_used == 0:
        return "starting"
    if signs.recognizer == "standing":
        return before.able if before.able != "starting" else "warming up"
    return "warming up" if signs.recognizer == "searching" else cast("Able", signs.recognizer)


def _link_trouble(signs: HealthInputs) -> str:
    if signs.link == "up":
        return ""
    if signs.link == "closed":
        return f"link: {signs.link_why}" if signs.link_why else ""
    return "link: no autopilot heard" if signs.link_down_s > LINK_GRACE_S else ""


def _journal_trouble(signs: HealthInputs) -> str:
    return f"journal: {signs.journal}" if signs.journal else ""


def _slow(signs: HealthInputs) -> str:
    return f"slow: a frame took over {SLOW_FRAME_S:g} s" if signs.frame_s > SLOW_FRAME_S else ""
