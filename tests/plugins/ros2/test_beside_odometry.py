"""A robot without an autopilot: odometry comes from ROS 2, and its position goes there."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge.camera import Frame
from edge.config import AcceptanceConfig, Config, GatesConfig, MapConfig
from edge.config import SequenceConfig as Sequence
from edge.config import TelemetryConfig as Telemetry
from edge.daemon import Daemon
from edge.descriptor.network import Network
from edge.feed import FeedImages, read_feed
from edge.geodesy import east_north_of
from edge.opened_parts import OpenedParts
from edge_plugins.page import PageConfig
from edge_plugins.ros2 import Ros2Config
from edge_plugins.ros2.participant import Ros2
from tests.faults.simulated_daemon import ScriptedFrames
from tests.plugins.ros2.robot import Robot, RosClock
from tests.udp_port import free_port

FRAMES, MPS = 36, 10.0


def test_a_position_comes_by_odometry_alone(
    make_street: Callable[..., Path], grid: Network, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Due north at 10 m/s: places every 2 m, and odometry ten times a second in a frame that is east and north."""
    street, clock, robot = make_street(range(FRAMES), period_ms=200), RosClock(), Robot(monkeypatch)
    monkeypatch.setattr(Ros2.__init__, "__defaults__", (clock.unix_ns,))  # not that of this computer, which may be busy
    images = FeedImages(feed := read_feed(street / "feed"))
    config = Config(
        map=MapConfig(path=str(street / "map")),
        sequence=Sequence(length=10),
        acceptance=AcceptanceConfig(uniqueness_min=1.02, window_m=10.0, hold_off_s=0.0),
        gates=GatesConfig(risk=1.0, min_interval_s=0.4),
        telemetry=Telemetry(connection=f"udpin:127.0.0.1:{free_port()}", journal=str(tmp_path / "events.jsonl")),
        plugins={
            "ros2": Ros2Config(domain=robot.domain, odometry="odometry", odometry_is_enu=True),
            "page": PageConfig(port=0),
        },
    )
    robot.listen("lookback/fix", "sensor_msgs/NavSatFix")
    robot.listen("diagnostics", "diagnostic_msgs/DiagnosticArray")
    fixes: list[tuple[Any, float]] = []  # each with how far the vehicle had driven
    with ExitStack() as parts:
        frames = ScriptedFrames(clock)
        daemon = Daemon(OpenedParts(config, parts, clock, frames=frames, network=grid))
        for turn in range(2 * FRAMES):
            clock.now_ns += 100_000_000
            robot.send_odometry(clock.unix_ns(), MPS, yaw_rad=math.pi / 2)
            if turn % 2:
                frames.next = Frame(images.read(turn // 2) ^ np.uint8(1), clock.now_ns, turn // 2)
            daemon.turn()
            for fix in robot.heard("lookback/fix"):
                age_s = clock.unix_ns() / 1e9 - fix.header.stamp.sec - fix.header.stamp.nanosec / 1e9
                fixes.append((fix, MPS * (0.1 * (turn - 1) - age_s)))
    origin = feed.rows[0]
    assert origin.lat_deg is not None and origin.lon_deg is not None
    assert len(fixes) >= 5
    for fix, driven_m in fixes:
        at_m = east_north_of(fix.latitude, fix.longitude, (origin.lat_deg, origin.lon_deg))
        assert at_m == pytest.approx((0.0, driven_m), abs=4.0)
    assert robot.heard("diagnostics")[-1].status[0].message.endswith("on the map")
