"""[nmea] in the daemon: the vehicle's position each second, and none as soon as nobody knows where it is."""

from __future__ import annotations

import contextlib
import math
import socket
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from edge.descriptor.network import Network
from edge.feed import FeedImages, read_feed
from edge.geodesy import east_north_of
from sim import Pose
from tests.faults.simulated_daemon import DaemonRig, ScriptedFrames
from tests.udp_port import free_port

pynmea2 = pytest.importorskip("pynmea2", reason="the extra import is not installed")
FRAMES, MPS = 60, 10.0


class Stopping(DaemonRig):
    """A vehicle that stops."""

    stops_s = math.inf

    def _pose(self, time_s: float) -> Pose:
        pose = super()._pose(min(time_s, self.stops_s))
        return pose if time_s < self.stops_s else replace(pose, speed_mps=0.0)


class Plotter:
    """A client that keeps whatever sentences came in a turn."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port))
        self._socket.setblocking(False)
        self._rest = b""

    def heard(self) -> list[Any]:
        with contextlib.suppress(BlockingIOError):
            self._rest += self._socket.recv(65536)
        *lines, self._rest = self._rest.split(b"\r\n")
        return [pynmea2.parse(line.decode(), check=True) for line in lines]

    def close(self) -> None:
        self._socket.close()


def test_the_position_follows_the_vehicle_holds_while_it_stands_and_ends(
    make_street: Callable[..., Path], grid: Network, tmp_path: Path
) -> None:
    """Due north at 10 m/s with a place every 2 m; then it stands for longer than `standing_s`."""
    street, port = make_street(range(FRAMES), period_ms=200), free_port(socket.SOCK_STREAM)
    feed = read_feed(street / "feed")
    images, first = FeedImages(feed), feed.rows[0]
    assert first.lat_deg is not None and first.lon_deg is not None
    config = tmp_path / "lookback.toml"
    sections: dict[str, Any] = {
        "descriptor": {"model": "fc6"},
        "map": {"path": str(street / "map")},
        "sequence": {"length": 10},
        "acceptance": {"uniqueness_min": 1.02, "window_m": 10.0},
        "gates": {"risk": 1.0},
        "telemetry": {"journal": ""},
        "page": {"port": 0},
        "nmea": {"port": port, "standing_s": 8.0},
    }
    config.write_text(tomli_w.dumps(sections))
    with ExitStack() as parts:
        bench = Stopping(config, parts, grid, MPS, ScriptedFrames)
        plotter = Plotter(port)
        parts.callback(plotter.close)
        moving, standing = [], []
        for frame in range(FRAMES - 1):
            bench.step(images.read(frame) ^ np.uint8(1), frame)
            moving += [(one, frame) for one in plotter.heard() if one.sentence_type == "GGA"]
        positions = [(one, frame) for one, frame in moving if one.gps_qual == 6]
        assert moving[0][0].gps_qual == 0, "nothing is recognized yet"
        assert len(positions) >= 6
        for one, frame in positions:
            at_m = east_north_of(one.latitude, one.longitude, (first.lat_deg, first.lon_deg))
            assert at_m == pytest.approx((0.0, MPS * 0.2 * frame), abs=4.0)
        bench.stops_s = bench.now_ns / 1e9
        for _ in range(75):  # 15 s
            bench.step(images.read(FRAMES - 1) ^ np.uint8(1), FRAMES)
            standing += [one for one in plotter.heard() if one.sentence_type == "GGA"]
        held = [one.gps_qual == 6 for one in standing]
        assert 7 <= sum(held) <= 9 and held == sorted(held, reverse=True), "for `standing_s`, and no longer"


def test_a_port_that_is_in_use_is_tried_again_and_costs_nothing(
    make_street: Callable[..., Path], grid: Network, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", "edge_plugins.nmea")
    street, config = make_street(range(FRAMES), period_ms=200), tmp_path / "lookback.toml"
    with socket.create_server(("127.0.0.1", 0)) as another, ExitStack() as parts:
        port = another.getsockname()[1]
        sections = {
            "descriptor": {"model": "fc6"},
            "map": {"path": str(street / "map")},
            "telemetry": {"journal": ""},
            "page": {"port": 0},
            "nmea": {"port": port},
        }
        config.write_text(tomli_w.dumps(sections))
        bench = DaemonRig(config, parts, grid, MPS, ScriptedFrames)
        assert f"NMEA: [nmea] 127.0.0.1 port {port}: Address already in use; trying again" in caplog.text
        another.close()
        for _ in range(20):
            bench.step(None, 0)
        plotter = Plotter(port)
        parts.callback(plotter.close)
        for _ in range(6):
            bench.step(None, 0)
        assert [one.sentence_type for one in plotter.heard()][:2] == ["GGA", "RMC"]
        assert f"NMEA: positions on 127.0.0.1, port {port}, on this computer alone" in caplog.text
