"""What `lookback doctor` says of the autopilot: heard or not, what it reports, and the parameters that matter."""

from __future__ import annotations

from collections.abc import Iterator

from edge.commands.diagnostic import Diagnostic, bad, good, note
from edge.config import TelemetryConfig
from edge.errors import LookbackError
from edge.telemetry.autopilot_probe import PX4, WANTED, AutopilotProbe, Wanted, probe_autopilot
from edge.telemetry.position_messages import NAMES, suitable_message

SERIAL = (
    "check the wires, the baud rate, and that the port speaks MAVLink 2 (ArduPilot: SERIALn_PROTOCOL 2); with signing,"
    " both ends need the same key"
)
NETWORK = (
    "check that something sends MAVLink 2 there (a mavlink-router, or MAVProxy with --out), that its system is running,"
    " and that no firewall is between; with signing, both ends need the same key"
)
RIGHTS = "see firmware_config/README.md for wiring and rights"


def check_autopilot(config: TelemetryConfig, seconds: float) -> Iterator[Diagnostic]:
    """Listen to the autopilot for up to `seconds` and judge what it says."""

    def names(autopilot: int | None, version: tuple[int, int] | None) -> list[str]:
        return [wanted.name for wanted in wanted_of(config, autopilot, version)]

    try:
        found = probe_autopilot(config, names, seconds)
    except LookbackError as error:
        yield bad("autopilot", str(error), "correct [telemetry]")
        return
    if found.why_closed and not found.connected:
        yield bad("autopilot", found.why_closed, RIGHTS)
    elif not found.connected:
        heard = f"{config.connection}: no heartbeat in {seconds:g} s"
        yield bad("autopilot", heard, SERIAL if config.connection.startswith("serial:") else NETWORK)
    else:
        yield from _judge(config, found)


def wanted_of(config: TelemetryConfig, autopilot: int | None, version: tuple[int, int] | None) -> list[Wanted]:
    """The parameters that the configured way of telling positions needs on that firmware."""
    way = config.emit
    if way == "auto":
        suitable, _ = suitable_message(autopilot, version)
        way = suitable.name if suitable else "report"  # type: ignore[assignment]
    wanted = [one for one in WANTED if (one.autopilot, one.way) == (autopilot, way)]
    if autopilot == PX4 and way == "global_position_sensor":
        why = "it must be the id that [telemetry] sensor_id gives"
        wanted.append(Wanted(PX4, way, "EKF2_AGP0_ID", why, values=(config.sensor_id,)))
    return wanted


def _judge(config: TelemetryConfig, found: AutopilotProbe) -> Iterator[Diagnostic]:
    name = NAMES.get(found.autopilot or 0, f"autopilot {found.autopilot}")
    version = "{}.{}".format(*found.version) if found.version else "(version not told)"
    yield good("autopilot", f"{config.connection}: {name} {version}, system {found.system_id}")
    if config.emit == "auto":
        suitable, why = suitable_message(found.autopilot, found.version)
        yield (good if suitable else note)(
            "autopilot", f"emit = auto: {suitable.name if suitable else 'report'}, {why}"
        )
    if not found.speed_known:
        yield note(
            "autopilot", "it reports no speed", "frames will be taken by time, which a map by distance fits badly"
        )
    if not found.position_known:
        yield note("autopilot", "it reports no position", "give it GPS or an origin; recordings will have no positions")
    if not found.gps_healthy:
        yield note("autopilot", "it has no GPS fix", "a drive to calibrate or to make a map of needs one")
    for wanted in wanted_of(config, found.autopilot, found.version):
        value = found.parameters.get(wanted.name)
        if value is None:
            yield note("parameter", f"{wanted.name}: no answer", "this firmware may not have it; see firmware_config/")
        elif wanted.holds(value):
            yield good("parameter", f"{wanted.name} = {value:g}")
        else:
            yield bad("parameter", f"{wanted.name} = {value:g}: {wanted.why}", wanted.remedy)
