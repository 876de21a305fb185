"""What the camera measured for the autopilot's filter: when it is sent, and by which message."""

from __future__ import annotations

import math
from typing import Annotated

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.journal.records import Record, unit
from edge.telemetry.autopilot import AutopilotConnection
from edge.telemetry.codec import Message
from edge.telemetry.firmware import VISION
from edge_plugins.motion.camera_motion import CameraSpeed

SLIDES, LEAST_SIDEWAYS_MPS = 0.03, 0.2
"""Sideways and up or down a vehicle moves by 2 degrees of its speed, and as much where it stands as its body rocks."""
DELTA_US = 100_000  # ArduPilot divides by it again
LEAST_ERROR_MPS, MOST_ERROR_MPS = 0.1, 0.9  # EK3_VIS_VERR_MIN and _MAX as shipped, which a confidence of 100 and 0 mean


OLDEST_NS = 500_000_000
"""Of a speed, between its moment and sending: 0.5 m/s at the strongest usual braking of 1 m/s^2."""
MOST_SHARE, LEAST_MPS = 0.2, 0.5
"""One standard deviation, as a share of the speed, or in m/s where that is more: a speed that is less certain is not
sent. By headlights 95 % of the errors are within 5 %."""
MOST_SCALE = 0.05
"""One standard deviation of what all speeds are wrong by alike: GPS of this drive or places must have shown the
camera's height, since a filter cannot average it out."""


class VelocityChanged(Record, frozen=True, tag="velocity"):
    """The camera's velocity is sent to the autopilot from now on, or is not any more; with [motion] use = "send"."""

    is_sent: Annotated[bool, unit("", "whether it is; nothing is sent either while `motion` has no speed")]
    why: Annotated[str, unit("", 'why not, "" while it is')] = ""


class VelocitySender:
    """Sends on one link, and records when it begins and why it ends."""

    def __init__(self, link: AutopilotConnection) -> None:
        self._link = link
        self._why: str | None = None

    def send(self, speed: CameraSpeed) -> None:
        """Send it as this firmware takes it; nothing where something speaks against it."""
        link, now_ns = self._link, self._link.clock_ns()
        if link.state != "up" or not link.velocity_aid.sends:
            return
        why = self._refusal(speed, now_ns)
        if why != self._why:
            self._why = why
            link.record(VelocityChanged(is_sent=not why, why=why))
        if not why:
            link.velocity_aid.sent_ns = now_ns
            link.send([ENCODERS[link.vehicle.session.firmware.camera_velocity](speed)])

    def _refusal(self, speed: CameraSpeed, now_ns: int) -> str:
        vehicle = self._link.vehicle
        if not vehicle.session.firmware.camera_velocity or vehicle.is_doubled:
            return "no autopilot that uses it"
        if self._link.velocity_aid.without_gps != VISION:
            return "the autopilot's parameters do not use it"
        if not 0 <= now_ns - speed.stamp_ns <= OLDEST_NS:
            return "too old"
        if speed.sigma_mps > max(MOST_SHARE * abs(speed.speed_mps), LEAST_MPS):
            return "too uncertain"
        if speed.scale_share > MOST_SCALE:
            return "the camera's height is not known well enough"
        # A filter that nothing has aided since is off by more than it allows a velocity to be.
        is_aided = self._link.velocity_aid.sent_ns is not None or vehicle.session.gps.state(now_ns) == "healthy"
        return "" if is_aided else "GPS was lost before the camera's height was known"


def body_odometry(speed: CameraSpeed) -> Message:
    """ODOMETRY 331 for PX4: a velocity in the frame of the body at `stamp_ns`; nothing else, which is NaN.

    Its time is CLOCK_MONOTONIC, which the answers to TIMESYNC have as well.
    """
    sideways = max(SLIDES * abs(speed.speed_mps), LEAST_SIDEWAYS_MPS) ** 2
    variances = [speed.sigma_mps**2, *[0.0] * 5, sideways, *[0.0] * 4, sideways, *[0.0] * 9]
    return mavlink.MAVLink_odometry_message(
        speed.stamp_ns // 1000,
        mavlink.MAV_FRAME_LOCAL_FRD,
        mavlink.MAV_FRAME_BODY_FRD,
        *[math.nan] * 3,
        [math.nan] * 4,
        speed.speed_mps,
        0.0,
        0.0,
        *[math.nan] * 3,
        [math.nan] * 21,
        variances,
        estimator_type=mavlink.MAV_ESTIMATOR_TYPE_VISION,
        quality=100,
    )


def position_delta(speed: CameraSpeed) -> Message:
    """VISION_POSITION_DELTA 11011 for ArduPilot: how far the body moved and turned; its confidence is the sigma."""
    share = (MOST_ERROR_MPS - speed.sigma_mps) / (MOST_ERROR_MPS - LEAST_ERROR_MPS)
    seconds = DELTA_US / 1e6
    moved, turned = (seconds * speed.speed_mps, 0.0, 0.0), (0.0, 0.0, seconds * speed.turn_radps)
    confidence = 100 * min(max(share, 0.0), 1.0)
    return mavlink.MAVLink_vision_position_delta_message(speed.stamp_ns // 1000, DELTA_US, turned, moved, confidence)


ENCODERS = {"ODOMETRY": body_odometry, "VISION_POSITION_DELTA": position_delta}
"""By `Firmware.camera_velocity`."""
