"""How large a vehicle's wheels are, by its drives beside GPS: `lookback calibrate wheels CONFIG`, on the vehicle."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing

from msgspec.structs import replace
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import TelemetryConfig
from edge.errors import LookbackError
from edge.localization import ScaleFactor, learned
from edge.telemetry.autopilot import AutopilotConnection
from edge.telemetry.vehicle import Vehicle
from edge.telemetry.wheel_store import WHEEL_RADIUS, drives_of, in_percent
from edge_plugins.doctor.autopilot import ground_station, poll_until

WAIT_S = 8.0
WHEELS = {"WENC_TYPE": WHEEL_RADIUS, "WENC2_TYPE": "WENC2_RADIUS"}
"""ArduPilot's parameters: whether it has a wheel, and that wheel's radius."""
SAME_M = 1e-6
"""Between a radius that was sent and the one that came back, as float32."""


def calibrate_wheels(config: TelemetryConfig, *, uploads: bool, is_sure: bool) -> None:
    """Print what each drive shows and which radii follow, and set these where asked to. LookbackError."""
    with closing(ground_station(config)) as link:
        present_m, scale = _present_radii(link), _print_drives(config.journal, link.vehicle)
    if abs(scale.mean) <= scale.sigma:
        print("the wheels are right within one standard deviation: nothing is to be set")
        return
    radii_m = {name: round(radius_m * (1 + scale.mean), 5) for name, radius_m in present_m.items()}
    for name, radius_m in radii_m.items():
        print(f"{name} is {present_m[name]:.5f}, and should be {radius_m:.5f}")
    if not uploads:
        print("--upload sets this on the autopilot")
    elif is_sure or _is_agreed():
        # By another link to the same vehicle: what came in while a person thought is not of now.
        with closing(ground_station(replace(config, system_id=link.vehicle.target_id))) as link:
            _upload(link, radii_m)


def _present_radii(link: AutopilotConnection) -> dict[str, float]:
    """Of the wheels that the autopilot has, by parameter."""
    names = {*WHEELS, *WHEELS.values()}

    def is_known() -> bool:
        link.requests.parameters.add(names)
        return names <= link.vehicle.session.parameters.keys() or link.vehicle.session.firmware.gps_switch == "fusion"

    poll_until(link, is_known, WAIT_S)
    session, values = link.vehicle.session, link.vehicle.session.parameters
    if not link.vehicle.connected:
        why = link.why_closed or f"no heartbeat in {WAIT_S:g} s"
        raise LookbackError(f"{link.config.connection}: {why}; stop the service first, see also `lookback doctor`")
    if session.firmware.gps_switch == "fusion":
        raise LookbackError("PX4 has no radius to set: its filter uses no wheel encoders. Correct who sends ODOMETRY")
    radii_m = {radius: values.get(radius, 0.0) for kind, radius in WHEELS.items() if values.get(kind)}
    if WHEEL_RADIUS not in radii_m or min(radii_m.values()) <= 0:
        raise LookbackError("the autopilot has no wheel encoders: WENC_TYPE or WENC_RADIUS is 0, or was not answered")
    return radii_m


def _print_drives(journal: str, vehicle: Vehicle) -> ScaleFactor:
    """What they show together; LookbackError where that is nothing."""
    drives = drives_of(journal, vehicle)
    print("by how much the wheels measure too little, with one standard deviation:")
    for number, one in enumerate(drives, start=1):
        print(f"  drive {number:2}: {in_percent(ScaleFactor(*one))}")
    scale = learned(drives)
    if scale is None:
        raise LookbackError("two drives that agree are needed: of 100 m beside GPS, each a run of `lookback run`")
    print(f"  together: {in_percent(scale._replace(varies=0.0))}, by those since the last that disagrees")
    return scale


def _is_agreed() -> bool:
    try:
        return input("Set this on the autopilot? [y/N] ").strip().lower() in ("y", "yes")
    except EOFError:
        raise LookbackError("nothing was set: --upload needs a yes at the terminal, or --yes") from None


def _upload(link: AutopilotConnection, radii_m: Mapping[str, float]) -> None:
    """Set each radius and read it back, of a vehicle whose heartbeats say that it is disarmed."""
    vehicle, before = link.vehicle, ""
    poll_until(link, lambda: vehicle.is_armed is not None, WAIT_S)
    for name, radius_m in radii_m.items():
        values = vehicle.session.parameters
        values.pop(name, None)
        if vehicle.is_armed is False:
            to = vehicle.target_id, mavlink.MAV_COMP_ID_AUTOPILOT1, name.encode()
            link.send([mavlink.MAVLink_param_set_message(*to, radius_m, mavlink.MAV_PARAM_TYPE_REAL32)])
            link.requests.parameters.add({name})
            poll_until(link, lambda: name in values, WAIT_S)  # noqa: B023  # it is over within the turn
        if abs(values.get(name, 0.0) - radius_m) > SAME_M:
            why = (
                "the autopilot has not taken it" if vehicle.is_armed is False else "the vehicle is armed, or not heard"
            )
            by_hand = f"; set it to {radius_m:.5f} by hand, since {before} is set" if before else ""
            raise LookbackError(f"{name} was not set: {why}{by_hand}")
        print(f"{name} = {radius_m:.5f}: set, and read back")
        before = name
    print("what the drives have shown counts for this from now on")
