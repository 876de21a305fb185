"""What measures the vehicle's velocity when GPS is gone, by the autopilot's parameters.

Without such an aid an estimator loses its position within seconds, and a position that we send comes back as its
velocity: the two agree with each other and not with the truth. The estimator's flags do not show it, since they return
while our position is fused.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import common as mavlink

from edge.telemetry.vehicle import Vehicle

ARDUPILOT, PX4 = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mavlink.MAV_AUTOPILOT_PX4
PARAMETERS: dict[int, tuple[str, ...]] = {
    ARDUPILOT: ("EK3_SRC1_VELXY", "EK3_SRC2_VELXY", "WENC_TYPE", "FLOW_TYPE"),
    PX4: ("EKF2_EV_CTRL", "EKF2_OF_CTRL", "EKF2_OF0_CTRL"),
}
ON_WINGS = {mavlink.MAV_TYPE_FIXED_WING, *range(mavlink.MAV_TYPE_VTOL_DUOROTOR, mavlink.MAV_TYPE_VTOL_RESERVED5 + 1)}
AIRSPEED, WHEELS, FLOW, VISION, BEACONS = "airspeed and wind", "wheel encoders", "optical flow", "vision", "beacons"
NO_AID = "none"
EV_VELOCITY = 1 << 2  # of EKF2_EV_CTRL


def velocity_aid(vehicle: Vehicle, source_set: int) -> str | None:
    """The aid, or `NO_AID`; None where it is not known. source_set: of ArduPilot's sets, that without GPS."""
    if vehicle.kind in ON_WINGS:
        return AIRSPEED
    if vehicle.autopilot == ARDUPILOT:
        return _ardupilot(vehicle, source_set)
    return _px4(vehicle) if vehicle.autopilot == PX4 else None


def _ardupilot(vehicle: Vehicle, source_set: int) -> str | None:
    source = vehicle.parameters.get(f"EK3_SRC{source_set}_VELXY")
    if source is None:
        return None
    sensors = {5: ("FLOW_TYPE", FLOW), 7: ("WENC_TYPE", WHEELS)}
    if round(source) not in sensors:
        return {4: BEACONS, 6: VISION}.get(round(source), NO_AID)
    parameter, aid = sensors[round(source)]
    kind = vehicle.parameters.get(parameter)
    return None if kind is None else aid if kind else NO_AID


def _px4(vehicle: Vehicle) -> str | None:
    """Flow is enabled by default, with or without a sensor, so that it has to be heard."""
    vision = vehicle.parameters.get("EKF2_EV_CTRL")
    if vision is None:
        return None
    if round(vision) & EV_VELOCITY:
        return VISION
    if vehicle.heard_ns(mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW_RAD) is None:
        return NO_AID
    controls = [vehicle.parameters.get(name) for name in ("EKF2_OF_CTRL", "EKF2_OF0_CTRL")]
    return FLOW if any(controls) else None if controls == [None, None] else NO_AID
