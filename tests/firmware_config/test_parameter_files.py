"""Every parameter that we tell people to load exists in the firmware, and takes the value that we give it.

The lists beside this file are parts of what the firmware's makers publish; each names where it is from.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_args, get_type_hints

import msgspec
import pytest
from pymavlink.mavparm import MAVParmDict

from edge.config import Config, TelemetryConfig
from edge.telemetry.firmware import GPS_SET, SET_WITHOUT_GPS

FILES = Path(__file__).parents[2] / "firmware_config"
ARDUPILOT = sorted(FILES.glob("*.param"))
PX4 = sorted(FILES.glob("*.params"))
SOURCES = ("POSXY", "VELXY", "VELZ", "POSZ", "YAW")
BAUD = int(TelemetryConfig().connection.rpartition(":")[2])


class Listed(msgspec.Struct, forbid_unknown_fields=True):
    """What a firmware says of a parameter: nothing, or one of values, range (null is no limit) and bits."""

    type: int | None = None  # MAV_PARAM_TYPE: 6 int32, 9 float
    values: list[float] | None = None
    range: tuple[float | None, float | None] | None = None
    bits: list[int] | None = None

    def takes(self, value: float) -> bool:
        if self.values is not None:
            return value in self.values
        if self.range is not None:
            low, high = self.range
            return (low is None or value >= low) and (high is None or value <= high)
        if self.bits is not None:
            return value >= 0 and value == int(value) and not int(value) & ~sum(1 << bit for bit in self.bits)
        return True


class Listing(msgspec.Struct, forbid_unknown_fields=True):
    source: list[str]
    parameters: dict[str, Listed]


def listing_of(file: Path) -> Listing:
    """The list of the firmware that a file is for, whose name its own begins with."""
    lists = [one for one in Path(__file__).parent.glob("*.json") if file.stem.startswith(one.stem)]
    (listed,) = lists or [Path(__file__).with_name("ardupilot_rover.json")]
    return msgspec.json.decode(listed.read_bytes(), type=Listing)


def rows(file: Path) -> list[tuple[str, float, int | None]]:
    """Name, value and, for PX4, type of each line that is not a comment; asserts the form of every line."""
    found: list[tuple[str, float, int | None]] = []
    for line in file.read_text().splitlines():
        if not line or line.startswith("#"):
            continue
        if file in PX4:
            match = re.fullmatch(r"1\t1\t([A-Z][A-Z0-9_]{1,15})\t(-?[0-9.]+)\t([69])", line)
        else:
            match = re.fullmatch(r"([A-Z][A-Z0-9_]{1,15}) (-?[0-9.]+)()", line)
        assert match is not None, f"{file.name}: {line!r}"
        found.append((match[1], float(match[2]), int(match[3]) if match[3] else None))
    return found


def by_name(file: Path) -> dict[str, float]:
    return {name: value for name, value, _ in rows(file)}


all_files = pytest.mark.parametrize("file", ARDUPILOT + PX4, ids=lambda path: path.name)


@all_files
def test_parameters_exist_and_take_their_values(file: Path) -> None:
    known = listing_of(file).parameters
    assert len(by_name(file)) == len(rows(file)), f"{file.name}: a parameter twice"
    for name, value, kind in rows(file):
        assert name in known, f"{file.name}: no parameter {name}"
        assert known[name].takes(value), f"{file.name}: {name} does not take {value:g}"
        assert kind == known[name].type, f"{file.name}: {name} is of another type"


@all_files
def test_each_line_says_why(file: Path) -> None:
    """A comment stands above each parameter, or above the pair that it belongs to."""
    lines = file.read_text().splitlines()
    for number, line in enumerate(lines):
        if line and not line.startswith("#"):
            above = lines[number - 1] if lines[number - 1].startswith("#") else lines[number - 2]
            above = above if above.startswith("#") else lines[number - 3]
            assert above.startswith("# "), f"{file.name}: nothing above {line!r} says why"


@pytest.mark.parametrize("file", ARDUPILOT, ids=lambda path: path.name)
def test_mavproxys_loader_reads_the_same(file: Path) -> None:
    loaded = MAVParmDict()
    assert loaded.load(str(file))
    assert dict(loaded) == by_name(file)


def test_baud_rates_are_the_configs() -> None:
    for file in ARDUPILOT:
        assert by_name(file)["SERIAL2_BAUD"] == BAUD // 1000
    assert by_name(FILES / "px4.params")["SER_TEL2_BAUD"] == BAUD


@all_files
def test_the_config_knows_the_way_that_the_file_is_for(file: Path) -> None:
    (emit,) = re.findall(r'emit = "(\w+)"', file.read_text())
    assert emit in get_args(get_type_hints(TelemetryConfig)["emit"])


def test_the_sensors_id_is_the_configs() -> None:
    assert by_name(FILES / "px4_global_position_sensor.params")["EKF2_AGP0_ID"] == TelemetryConfig().sensor_id


def test_no_gps_set_ups_have_a_speed_and_no_position_source() -> None:
    """Without a speed source, ArduPilot takes fixes for some seconds after GPS is lost, and never again."""
    for file, velocity in (("ardupilot_rover.param", 7), ("ardupilot_copter.param", 5)):
        parameters = by_name(FILES / file)
        assert parameters["EK3_SRC1_POSXY"] == 0
        assert parameters["EK3_SRC1_VELXY"] == velocity
    rover = by_name(FILES / "ardupilot_rover.param")
    assert rover["WENC_POS_Y"] != 0 and rover["WENC2_POS_Y"] != 0
    assert rover["AHRS_OPTIONS"] == 3


@pytest.mark.parametrize(("kind", "velocity"), [("rover", 7), ("copter", 5), ("plane", 0)])
def test_the_set_that_lookback_selects_has_poses_and_nothing_of_gps(kind: str, velocity: int) -> None:
    """And beside them the speed of the first set, but for GPS; set 2 is the one that is selected."""
    values = by_name(FILES / f"ardupilot_{kind}_fused.param")
    first, second = ([values[f"EK3_SRC{number}_{of}"] for of in SOURCES] for number in (GPS_SET, SET_WITHOUT_GPS))
    assert second == [6, velocity, 0, 1, 1]
    assert (first[0], first[1]) == (3, velocity or 3)
    assert values["VISO_TYPE"] == 1


def test_px4_does_not_trust_an_external_velocity_too_much() -> None:
    parameters = by_name(FILES / "px4_velocity_aid.params")
    assert (parameters["EKF2_EV_CTRL"], parameters["EKF2_EVV_NOISE"]) == (4, 0.5)
    assert by_name(FILES / "px4_camera_velocity.params") == {**parameters, "EKF2_EVV_NOISE": 0.1}


def test_readme_names_every_file_and_no_unknown_one() -> None:
    named = set(re.findall(r"`(\w+\.params?)`", (FILES / "README.md").read_text()))
    assert named == {path.name for path in ARDUPILOT + PX4}


@pytest.mark.parametrize(
    "connection", re.findall(r"(?:serial|udp|udpin):[\w./:-]+:\d+", (FILES / "README.md").read_text())
)
def test_readme_connections_are_understood(connection: str) -> None:
    from edge.telemetry.link import parse_connection

    assert str(parse_connection(connection)) == connection
    assert Config(telemetry=TelemetryConfig(connection=connection)).telemetry.connection == connection
