"""The files of a way home, read by programs that are not ours: pymavlink's loader and MAVSDK's importer."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.errors import ConfigError
from edge.reference_map import open_map_set
from edge_plugins.home import HomeConfig
from edge_plugins.home.route import RoutePlan, plan_route
from sim.home.files import write_route
from tests.plugins.home.test_way_home import arc, joined, straight
from tests.udp_port import free_port


@pytest.fixture
def way(map_along: Callable[..., Path]) -> RoutePlan:
    drive = joined(straight(60.0), arc(30.0, 90), straight(60.0, -90.0))
    return plan_route(open_map_set(map_along(drive)), None, HomeConfig())


@pytest.mark.parametrize("config", [HomeConfig(), HomeConfig(speed_mps=3.5, altitude_m=12.0)])
def test_waypoints_are_read_by_pymavlinks_loader(way: RoutePlan, tmp_path: Path, config: HomeConfig) -> None:
    from pymavlink.mavwp import MAVWPLoader

    path = tmp_path / "home.waypoints"
    write_route(path, way, config, "way home")
    loader = MAVWPLoader()
    assert loader.load(str(path)) == loader.count()
    items = [loader.wp(number) for number in range(loader.count())]
    speeds = [item.param2 for item in items if item.command == mavlink.MAV_CMD_DO_CHANGE_SPEED]
    assert speeds == ([config.speed_mps] if config.speed_mps else [])
    points = [item for item in items[1:] if item.command == mavlink.MAV_CMD_NAV_WAYPOINT]
    assert [(item.x, item.y) for item in points] == [
        pytest.approx(position, abs=1e-7) for position in way.positions_deg
    ]
    assert {item.z for item in points} == {config.altitude_m}
    assert {item.frame for item in points} == {mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT}


@pytest.fixture(scope="module")
def importer() -> Iterator[Callable[[str], list[Any]]]:
    """MAVSDK's reader of plans, which needs a system; a heartbeat of ours is one."""
    pytest.importorskip("mavsdk")
    import socket
    import time

    import mavsdk
    from mavsdk.plugins.mission_raw.mission_raw import MissionRaw

    from edge.telemetry.codec import MavlinkCodec

    port = free_port()
    judge = mavsdk.Mavsdk(mavsdk.Configuration.create_manual(245, 190, True))
    assert judge.add_any_connection(f"udpin://127.0.0.1:{port}") == mavsdk.ConnectionResult.SUCCESS
    codec, deadline_s = MavlinkCodec(1, 1), time.monotonic() + 60
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours:
        while not judge.get_systems():
            assert time.monotonic() < deadline_s
            ours.sendto(codec.encode(mavlink.MAVLink_heartbeat_message(10, 3, 0, 0, 4, 3)), ("127.0.0.1", port))
            ours.settimeout(0.05)
            try:
                ours.recv(1024)
            except TimeoutError:
                continue
        raw = MissionRaw(judge.get_systems()[0])
        yield lambda path: raw.import_qgroundcontrol_mission(path).mission_items
        raw.destroy()
    judge.destroy()


@pytest.mark.parametrize("config", [HomeConfig(), HomeConfig(speed_mps=3.5)])
def test_the_plan_is_read_by_mavsdk(
    way: RoutePlan, tmp_path: Path, config: HomeConfig, importer: Callable[[str], list[Any]]
) -> None:
    path = tmp_path / "home.plan"
    write_route(path, way, config, "way home")
    home, *items = importer(str(path))  # for ArduPilot, item 0 is the home position
    points = [item for item in items if item.command == mavlink.MAV_CMD_NAV_WAYPOINT]
    found_e7 = np.array([(item.x, item.y) for item in points])
    assert found_e7 == pytest.approx(np.array(way.positions_deg) * 1e7, abs=1)
    assert (home.x, home.y) == (points[-1].x, points[-1].y)
    assert [item.param2 for item in items if item.command == 178] == ([3.5] if config.speed_mps else [])


def test_geojson_has_the_line_its_waypoints_and_the_findings(way: RoutePlan, tmp_path: Path) -> None:
    path = tmp_path / "home.geojson"
    write_route(path, way, HomeConfig(), "way home")
    collection = json.loads(path.read_text())
    *points, line = collection["features"]
    assert line["geometry"]["type"] == "LineString"
    assert np.array(line["geometry"]["coordinates"])[:, ::-1] == pytest.approx(np.array(way.positions_deg))
    assert [point["geometry"]["coordinates"] for point in points] == line["geometry"]["coordinates"]
    assert line["properties"]["findings"] == [str(finding) for finding in way.findings]
    assert points[-1]["properties"]["along_m"] == pytest.approx(way.length_m, abs=0.1)


def test_another_suffix_or_folder_is_one_clear_error(way: RoutePlan, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"home\.kml: not a name that ends in \.waypoints, \.plan, \.geojson"):
        write_route(tmp_path / "home.kml", way, HomeConfig(), "way home")
    with pytest.raises(ConfigError, match=r"cannot write it: No such file"):
        write_route(tmp_path / "none/home.plan", way, HomeConfig(), "way home")
