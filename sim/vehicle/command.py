"""`lookback dev sim autopilot`: the simulated autopilot alone, to test a companion computer."""

from __future__ import annotations

import argparse
import math
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.errors import ConfigError, FeedError
from edge.feed import Feed, read_feed
from edge.telemetry import open_link
from edge.telemetry.codec import Message
from sim import Pose
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.firmware import FIRMWARES
from sim.vehicle.position_inputs import east_north_m
from sim.vehicle.pty_link import PtyLink, open_pty

if TYPE_CHECKING:
    from edge.telemetry.link import Link

PRINT_S = 0.1
EAGER_US = 50_000
"""Between heartbeats of an autopilot that follows a recording: the sooner it is heard, the sooner the feed begins."""
STANDS_S = 0.5
"""From the request of its positions, so that some are of the vehicle before it sets off."""
FURTHEST_M = 50_000.0
"""From the simulation's origin: farther away, its flat east and north are meters wrong."""


def add_command(sim_commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `autopilot` to the commands of `lookback dev sim`."""
    parser = sim_commands.add_parser("autopilot", help="run a simulated autopilot on a pseudo-terminal or UDP")
    udp = "send to HOST:PORT, where a daemon listens with udpin: (default: a new pseudo-terminal; its path is printed)"
    parser.add_argument("--udp", metavar="HOST:PORT", help=udp)
    parser.add_argument("--firmware", choices=list(FIRMWARES), default="ardupilot")
    parser.add_argument("--speed", metavar="MPS", type=float, default=0.0, help="speed of a straight drive, default 0")
    parser.add_argument("--heading", metavar="DEG", type=float, default=0.0, help="clockwise from north (default 0)")
    about = "drive as in this simulated recording, once the companion computer has requested positions"
    parser.add_argument("--follow", metavar="FEED", type=Path, help=about)
    parser.add_argument("--no-gps", action="store_true", help="no GPS, odometry only")
    about = "GPS is lost S seconds after the drive began"
    parser.add_argument("--gps-lost-after", metavar="S", type=float, default=math.inf, help=about)
    parser.add_argument("--seconds", metavar="S", type=float, default=math.inf, help="stop after S seconds")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Print received messages as JSON lines on stdout until Ctrl-C; the connection is printed on stderr."""
    start = VehicleStart(math.inf if arguments.follow else time.monotonic())
    if arguments.follow is not None:
        pose_at = recorded_drive(read_feed(arguments.follow), start)
    else:
        pose_at = straight_line(arguments.speed, arguments.heading, start.time_s)
    link = _open(arguments.udp)
    autopilot = SimulatedAutopilot(link, pose_at, firmware=arguments.firmware, gps=not arguments.no_gps)
    if arguments.follow is not None:
        # Over UDP the other end answers what it hears.
        often = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, mavlink.MAVLINK_MSG_ID_HEARTBEAT, EAGER_US
        autopilot.handle(mavlink.MAVLink_command_long_message(1, 1, *often, *[0] * 5))
    stop = threading.Event()
    thread = threading.Thread(target=autopilot.run, args=(stop,))
    thread.start()
    try:
        _print_received(autopilot, thread, arguments, start)
    except KeyboardInterrupt:
        pass
    finally:
        stop.set()
        thread.join()
        link.close()
    return 0


def straight_line(speed_mps: float, heading_deg: float, start_s: float) -> Callable[[float], Pose]:
    """A drive at constant speed that leaves the origin at `start_s`."""
    heading_rad = math.radians(heading_deg)

    def pose_at(time_s: float) -> Pose:
        distance_m = speed_mps * (time_s - start_s)
        east_m, north_m = distance_m * math.sin(heading_rad), distance_m * math.cos(heading_rad)
        return Pose(east_m, north_m, heading_deg, speed_mps, distance_m)

    return pose_at


@dataclass
class VehicleStart:
    """When a recorded drive begins, in seconds of CLOCK_MONOTONIC: the vehicle stands at its first place until then."""

    time_s: float = math.inf

    def hear(self, message: Message, time_s: float) -> None:
        """Set off soon after a companion computer has requested positions: it begins its feed when it hears of that."""
        if message.get_type() != "COMMAND_LONG" or message.command != mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            return
        if message.param1 == mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
            self.time_s = min(self.time_s, time_s + STANDS_S)


def recorded_drive(feed: Feed, start: VehicleStart) -> Callable[[float], Pose]:
    """The drive of a feed, in its own time. FeedError unless its positions are near the simulation's origin."""
    placed = [row for row in feed.rows if row.lat_deg is not None and row.lon_deg is not None]
    at_m = np.array([east_north_m(row.lat_deg or 0.0, row.lon_deg or 0.0) for row in placed]).reshape(-1, 2)
    if len(placed) < 2 or np.abs(at_m).max() > FURTHEST_M:
        raise FeedError(f"--follow: {feed.path}: not a recording of `lookback dev sim drive`, with its positions")
    at_s = np.array([row.stamp_ns - placed[0].stamp_ns for row in placed]) / 1e9
    driven_m = np.r_[0.0, np.hypot(*np.diff(at_m, axis=0).T).cumsum()]
    speed_mps, (east_mps, north_mps) = np.gradient(driven_m, at_s), np.gradient(at_m, at_s, axis=0).T
    heading_rad = np.unwrap(np.arctan2(east_mps, north_mps))

    def pose_at(time_s: float) -> Pose:
        since_s = max(0.0, time_s - start.time_s)
        east_m, north_m, heading, mps, meters = (
            float(np.interp(since_s, at_s, values)) for values in (*at_m.T, heading_rad, speed_mps, driven_m)
        )
        moves = 0.0 < since_s < at_s[-1]
        return Pose(east_m, north_m, math.degrees(heading) % 360.0, mps if moves else 0.0, meters)

    return pose_at


def _open(udp: str | None) -> Link:
    if udp is not None:
        try:
            link = open_link(f"udp:{udp}")
        except ConfigError:
            raise ConfigError(f"--udp: {udp!r} is not HOST:PORT") from None
        print(f"speaking to {udp}", file=sys.stderr)
        return link
    pty: PtyLink = open_pty()
    print(f'connection = "serial:{pty.device}:921600"', file=sys.stderr, flush=True)
    return pty


def _print_received(
    autopilot: SimulatedAutopilot, thread: threading.Thread, arguments: argparse.Namespace, start: VehicleStart
) -> None:
    end_s = time.monotonic() + arguments.seconds
    while thread.is_alive() and time.monotonic() < end_s:
        if time.monotonic() > start.time_s + arguments.gps_lost_after:
            autopilot.gps = False
        batch = autopilot.received[:]
        for received in batch:
            start.hear(received.message, received.time_s)
            line = {"time_s": round(received.time_s, 4), **received.message.to_dict()}
            print(msgspec.json.encode(line).decode(), flush=True)
        del autopilot.received[: len(batch)]  # the thread only appends
        time.sleep(PRINT_S)
