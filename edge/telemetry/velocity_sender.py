"""The camera's velocity for an autopilot's filter: by which message, and whether now. No I/O.

Read in the firmware: ArduPilot fuses a velocity alone only as VISION_POSITION_DELTA, which makes its filter aid itself
as with wheel encoders (`readyToUseBodyOdm` in NavEKF3_core); VISION_SPEED_ESTIMATE and ODOMETRY need a position as
well. PX4 fuses ODOMETRY in the frame of the body, with its own gate (ev_vel_control.cpp). Both take nothing that is
older than 200 ms for a start, and go on alone as soon as nothing comes.
"""

from __future__ import annotations

from collections.abc import Callable

from edge.journal.records import Record, VelocityChanged
from edge.motion import CameraSpeed
from edge.telemetry import encoders
from edge.telemetry.codec import Message
from edge.telemetry.link_protocol import ARDUPILOT, PX4, VISION
from edge.telemetry.vehicle import Vehicle

OLDEST_NS = 500_000_000
"""Of a speed, between its moment and sending: 0.5 m/s at the strongest usual braking of 1 m/s^2."""
SILENT_NS = 1_000_000_000
"""Without a message for so long, nothing measures the velocity: PX4 stops fusing after that time as well."""
MOST_SHARE, LEAST_MPS = 0.2, 0.5
"""One standard deviation, as a share of the speed, or in m/s where that is more: a speed that is less certain is not
sent. By headlights 95 % of the errors are within 5 %."""
MOST_SCALE = 0.05
"""One standard deviation of what all speeds are wrong by alike: GPS of this drive or places must have shown the
camera's height, since a filter cannot average it out."""


class VelocitySender:
    """Sends what the camera measured, unless something speaks against it; nothing is repeated."""

    def __init__(self, vehicle: Vehicle, record: Callable[[Record], object], *, is_on: bool) -> None:
        """is_on: by [motion] use and [telemetry] emit."""
        self._vehicle, self._record, self.is_on = vehicle, record, is_on
        self._sent_ns: int | None = None
        self._why: str | None = None

    def is_silent(self, now_ns: int) -> bool:
        """Whether nothing was sent lately, though the autopilot should have it from here alone."""
        return self.is_on and (self._sent_ns is None or now_ns - self._sent_ns > SILENT_NS)

    def send(self, speed: CameraSpeed, aid: str | None, now_ns: int) -> list[Message]:
        """The message for this firmware. aid: see `velocity_aid`."""
        why = self._refusal(speed, aid, now_ns)
        if why != self._why:
            self._why = why
            self._record(VelocityChanged(is_sent=not why, why=why))
        if why:
            return []
        self._sent_ns = now_ns
        encode = encoders.body_odometry if self._vehicle.autopilot == PX4 else encoders.position_delta
        return [encode(speed)]

    def _refusal(self, speed: CameraSpeed, aid: str | None, now_ns: int) -> str:
        if self._vehicle.autopilot not in (ARDUPILOT, PX4) or self._vehicle.is_doubled:
            return "no autopilot that uses it"
        if aid != VISION:
            return "the autopilot's parameters do not use it"
        if not 0 <= now_ns - speed.stamp_ns <= OLDEST_NS:
            return "too old"
        if speed.sigma_mps > max(MOST_SHARE * abs(speed.speed_mps), LEAST_MPS):
            return "too uncertain"
        return "the camera's height is not known well enough" if speed.scale_share > MOST_SCALE else ""
