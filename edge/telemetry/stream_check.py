"""Whether a stream of positions is used, which no message answers: by PX4's parameters, and by where it then is."""

from __future__ import annotations

from pymavlink.dialects.v20 import common as mavlink

from edge.telemetry.acknowledgements import MOVED_NS
from edge.telemetry.vehicle import Vehicle

CONTROL, ID = "EKF2_AGP0_CTRL", "EKF2_AGP0_ID"
FUSES_POSITION = 1
"""Bit of `CONTROL`."""
PARAMETERS = {mavlink.MAV_AUTOPILOT_PX4: (CONTROL, ID)}
"""What the autopilot is asked, by MAV_AUTOPILOT."""
STREAM_NS = 10_000_000_000
"""How long an autopilot that is far from the positions of a stream may take to come nearer."""
FAR_SIGMAS = 2.0
"""Standard deviations of a position beyond which the autopilot's own should come nearer to it."""


def unused_because(vehicle: Vehicle, message: str, sensor_id: int) -> str:
    """Why this autopilot will use no position that comes in that message; "" where nothing is known against it."""
    if message != "global_position_sensor" or vehicle.autopilot != mavlink.MAV_AUTOPILOT_PX4:
        return ""
    control, own_id = (vehicle.parameters.get(name) for name in (CONTROL, ID))
    if control is not None and not round(control) & FUSES_POSITION:
        return f"{CONTROL} is {control:.0f}"
    if own_id is not None and round(own_id) != sensor_id:
        return f"{ID} is {own_id:.0f}"
    return ""


class StreamCheck:
    """Whether the autopilot's position comes nearer to those that are sent, once it is far from them."""

    def __init__(self, vehicle: Vehicle, sensor_id: int) -> None:
        """sensor_id: which PX4 must be set to use."""
        self._vehicle, self._sensor_id = vehicle, sensor_id
        self.new_session()

    def new_session(self) -> None:
        """The autopilot may be another one."""
        self._began_ns = self._last_ns = 0
        self._first_m = 0.0
        self._is_checked = self._was_far = False
        self._unused = ""

    def newly_unused(self, message: str) -> str:
        """Why this autopilot uses no position that comes in that message; "" where that is not known, or said."""
        before, self._unused = self._unused, unused_because(self._vehicle, message, self._sensor_id)
        return self._unused if self._unused != before else ""

    def add(self, distance_m: float, sigma_m: float, now_ns: int) -> bool | None:
        """Whether it came nearer, once for each stream; None before and after, and while it is near.

        distance_m: from the autopilot's own position to the one that is sent now. Nearer is half of the distance that
        it was when this began, or within the standard deviation.
        """
        if now_ns - self._last_ns > MOVED_NS:
            self._is_checked = False
            self._begin(distance_m, sigma_m, now_ns)
        self._last_ns = now_ns
        if self._is_checked or now_ns - self._began_ns < STREAM_NS:
            return None
        if not self._was_far:
            self._begin(distance_m, sigma_m, now_ns)
            return None
        self._is_checked = True
        return distance_m <= max(sigma_m, self._first_m / 2)

    def _begin(self, distance_m: float, sigma_m: float, now_ns: int) -> None:
        self._began_ns, self._first_m, self._was_far = now_ns, distance_m, distance_m > FAR_SIGMAS * sigma_m
