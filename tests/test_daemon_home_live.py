"""The way home along the map that is being made on the way out: GPS is lost, and the pilot asks for it."""

from __future__ import annotations

from contextlib import ExitStack, closing
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import CameraConfig, Config, DescriptorConfig, MapConfig, SamplingConfig, TelemetryConfig
from edge.daemon import Daemon
from edge.opened_parts import OpenedParts
from edge_plugins.home import HomeConfig
from edge_plugins.home.home_requests import HomeAnswered
from edge_plugins.page import PageConfig
from sim import geodetic
from sim.journal import records_of
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.pty_link import open_pty
from tests.plugins.mapping.test_mapping_plugin import SPACING_M, STEP_NS, Camera, ToldNetwork, Trip, mapping_to


def test_the_way_out_is_the_way_home(tmp_path: Path) -> None:
    network = ToldNetwork.load()
    assert isinstance(network, ToldNetwork)
    world, mapping = Trip(network, home=False), mapping_to(tmp_path / "maps", second_camera=True)
    with ExitStack() as parts:
        link = parts.enter_context(closing(open_pty()))
        config = Config(
            camera=CameraConfig(kind="sim"),
            descriptor=DescriptorConfig(keep_statistics_min=0.0),
            sampling=SamplingConfig(spacing_m=SPACING_M),
            map=MapConfig(path=mapping.folder),
            plugins={"mapping": mapping, "page": PageConfig(port=0), "home": HomeConfig(enabled=True)},
            telemetry=TelemetryConfig(
                connection=f"serial:{link.device}:921600", journal=str(tmp_path / "events.jsonl")
            ),
        )
        autopilot = SimulatedAutopilot(link, world.pose, world.clock_ns, gps_fails_s=world.now_ns / 1e9 + 28)
        frames = Camera(world, ahead=True), Camera(world, ahead=False)
        opened = OpenedParts(config, parts, world.clock_ns, frames=frames[0], mapping_frames=frames[1], network=network)
        daemon = Daemon(opened)

        def run(seconds: float) -> None:
            for _ in range(round(seconds * 1e9 / STEP_NS)):
                world.now_ns += STEP_NS
                for _ in range(4):
                    autopilot.step()
                    daemon.turn()

        run(29.0)  # 260 m out, and GPS has failed
        autopilot.send(mavlink.MAVLink_command_long_message(1, 191, mavlink.MAV_CMD_USER_5, 0, 1, 5665, 0, 0, 0, 0, 0))
        run(2.0)
    (answer,) = records_of(tmp_path / "events.jsonl", HomeAnswered)
    assert answer.verified, answer.text
    first, *_, last = autopilot.mission.waypoints_deg
    assert last == pytest.approx(geodetic(0.0, 0.0), abs=3e-5)
    assert first == pytest.approx(geodetic(250.0, 0.0), abs=1e-4), "GPS was lost there, and mapping ended"
