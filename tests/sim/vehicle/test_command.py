"""`lookback dev sim autopilot` as a user has it: over UDP and on a pseudo-terminal."""

from __future__ import annotations

import argparse
import json
import select
import threading
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.errors import ConfigError, FeedError
from edge.feed import Feed, FeedHeader, FeedRow
from edge.telemetry import open_link
from edge.telemetry.codec import MavlinkCodec
from sim import geodetic
from sim.vehicle.command import VehicleStart, add_command, recorded_drive
from tests.udp_port import free_port


def parse(*arguments: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_command(parser.add_subparsers())
    return parser.parse_args(["autopilot", *arguments])


def test_over_udp_it_speaks_first_and_prints_what_it_hears(capsys: pytest.CaptureFixture[str]) -> None:
    address = f"127.0.0.1:{free_port()}"
    link = open_link(f"udpin:{address}")
    arguments = parse("--udp", address, "--speed", "3", "--seconds", "1.0")
    thread = threading.Thread(target=arguments.run, args=(arguments,))
    thread.start()
    assert select.select([link], [], [], 5.0)[0]
    codec = MavlinkCodec(1, 191)
    assert codec.decode(link.receive())[0].get_type() == "HEARTBEAT"
    link.send(codec.encode(mavlink.MAVLink_statustext_message(6, b"hello", 0, 0)))
    thread.join()
    link.close()
    output = capsys.readouterr()
    (line,) = output.out.splitlines()
    printed = json.loads(line)
    assert (printed["mavpackettype"], printed["text"]) == ("STATUSTEXT", "hello")
    assert output.err == f"speaking to {address}\n"


def test_on_a_pseudo_terminal_it_says_which_connection_to_configure(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = parse("--seconds", "0")
    assert arguments.run(arguments) == 0
    assert capsys.readouterr().err.startswith('connection = "serial:/dev/pts/')


def test_a_malformed_address_names_the_option() -> None:
    arguments = parse("--udp", "localhost")
    with pytest.raises(ConfigError, match="--udp: 'localhost' is not HOST:PORT"):
        arguments.run(arguments)


def test_a_recorded_drive_begins_when_the_companion_computer_is_heard() -> None:
    """East at 5 m/s for 4 s, with a picture each second."""
    places = [geodetic(5.0 * second, 20.0) for second in range(5)]
    rows = tuple(FeedRow("", second * 10**9, lat, lon) for second, (lat, lon) in enumerate(places))
    feed, start = Feed(Path("drive"), FeedHeader("drive", "front", 4, 3), rows), VehicleStart()
    pose_at = recorded_drive(feed, start)
    assert (pose_at(1000.0).east_m, pose_at(1000.0).speed_mps) == pytest.approx((0.0, 0.0), abs=1e-3)
    start.time_s = 1001.0
    pose = pose_at(1002.5)
    found = pose.east_m, pose.north_m, pose.heading_deg, pose.speed_mps, pose.distance_m
    assert found == pytest.approx((7.5, 20.0, 90.0, 5.0, 7.5), abs=1e-3)
    assert (pose_at(1009.0).east_m, pose_at(1009.0).speed_mps) == pytest.approx((20.0, 0.0), abs=1e-3)


def test_a_drive_elsewhere_cannot_be_followed() -> None:
    for rows in ((FeedRow("", 0), FeedRow("", 1)), (FeedRow("", 0, 51.0, -1.0), FeedRow("", 1, 51.0, -1.001))):
        with pytest.raises(FeedError, match=r"--follow: drive: not a recording of `lookback dev sim drive`"):
            recorded_drive(Feed(Path("drive"), FeedHeader("drive", "front", 4, 3), rows), VehicleStart())
