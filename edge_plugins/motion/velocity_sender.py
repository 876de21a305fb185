"""What the camera measured for the autopilot's filter: when it is sent, and by which message."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.journal.records import Record, unit
from edge.telemetry.autopilot import AutopilotConnection
from edge.telemetry.codec import Message
from edge.telemetry.firmware import VISION
from edge_plugins.motion.camera_motion import LEAST_SIDEWAYS_MPS, SLIDES, CameraSpeed

LEAST_AHEAD_MPS = 0.5
"""A filter that were given less would have a scale error of 3 % for certain, and positions would move it less."""
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

    def __init__(
        self, link: AutopilotConnection, heading_error: Callable[[], tuple[float, float] | None] = lambda: None
    ) -> None:
        """heading_error: see `Tracker`."""
        self._link, self._heading_error = link, heading_error
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
            link.send([ENCODERS[link.vehicle.session.firmware.camera_velocity](speed, self._course(speed.stamp_ns))])

    def _course(self, stamp_ns: int) -> tuple[float, float] | None:
        """The vehicle's heading, and one standard deviation: the autopilot's, less its error by keypoint poses.

        None where they have found nothing, or it was of a velocity whose heading is not the autopilot's.
        """
        error, own = self._heading_error(), self._link.history.at(stamp_ns)
        is_by_heading = self._link.vehicle.velocity.aid.is_drifting_camera
        if error is None or own is None or own.heading_deg is None or not is_by_heading:
            return None
        return math.radians(own.heading_deg) + error[0], error[1]

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


def odometry(speed: CameraSpeed, course: tuple[float, float] | None = None) -> Message:
    """ODOMETRY 331 for PX4: a velocity at `stamp_ns`; nothing else, which is NaN.

    It is that of the body, which PX4 turns by its own heading; or by course, in radians clockwise from north with one
    standard deviation, north and east. Its time is CLOCK_MONOTONIC, which the answers to TIMESYNC have as well.
    """
    heading_rad, sigma_rad = course or (0.0, 0.0)
    ahead_mps, right_mps, sin, cos = speed.speed_mps, speed.right_mps, math.sin(heading_rad), math.cos(heading_rad)
    ahead = max(speed.sigma_mps, LEAST_AHEAD_MPS) ** 2
    sideways = speed.right_sigma_mps**2 + (sigma_rad * ahead_mps) ** 2
    first, second = ahead * cos**2 + sideways * sin**2, ahead * sin**2 + sideways * cos**2
    down = max(SLIDES * abs(ahead_mps), LEAST_SIDEWAYS_MPS) ** 2
    variances = [first, *[0.0] * 5, second, *[0.0] * 4, down, *[0.0] * 9]
    return mavlink.MAVLink_odometry_message(
        speed.stamp_ns // 1000,
        mavlink.MAV_FRAME_LOCAL_FRD,
        mavlink.MAV_FRAME_BODY_FRD if course is None else mavlink.MAV_FRAME_LOCAL_NED,
        *[math.nan] * 3,
        [math.nan] * 4,
        ahead_mps * cos - right_mps * sin,
        ahead_mps * sin + right_mps * cos,
        0.0,
        *[math.nan] * 3,
        [math.nan] * 21,
        variances,
        estimator_type=mavlink.MAV_ESTIMATOR_TYPE_VISION,
        quality=100,
    )


def position_delta(speed: CameraSpeed, course: tuple[float, float] | None = None) -> Message:
    """VISION_POSITION_DELTA 11011 for ArduPilot: how far the body moved and turned; its confidence is the sigma.

    Its own heading turns that, whatever the course.
    """
    share = (MOST_ERROR_MPS - speed.sigma_mps) / (MOST_ERROR_MPS - LEAST_ERROR_MPS)
    seconds = DELTA_US / 1e6
    moved, turned = (seconds * speed.speed_mps, seconds * speed.right_mps, 0.0), (0.0, 0.0, seconds * speed.turn_radps)
    confidence = 100 * min(max(share, 0.0), 1.0)
    return mavlink.MAVLink_vision_position_delta_message(speed.stamp_ns // 1000, DELTA_US, turned, moved, confidence)


ENCODERS = {"ODOMETRY": odometry, "VISION_POSITION_DELTA": position_delta}
"""By `Firmware.camera_velocity`."""
