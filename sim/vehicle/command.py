"""`lookback dev sim autopilot`: the simulated autopilot alone, to test a companion computer."""

from __future__ import annotations

import argparse
import math
import sys
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import msgspec

from edge.errors import ConfigError
from edge.telemetry import open_link
from sim import Pose
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.firmware import FIRMWARES
from sim.vehicle.pty_link import PtyLink, open_pty

if TYPE_CHECKING:
    from edge.telemetry.link import Link

PRINT_S = 0.1


def add_command(sim_commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `autopilot` to the commands of `lookback dev sim`."""
    parser = sim_commands.add_parser("autopilot", help="run a simulated autopilot on a pseudo-terminal or UDP")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--pty", action="store_true", help="on a new pseudo-terminal; its path is printed (default)")
    where.add_argument("--udp", metavar="HOST:PORT", help="send to HOST:PORT, where a daemon listens with udpin:")
    parser.add_argument("--firmware", choices=list(FIRMWARES), default="ardupilot")
    parser.add_argument("--speed", metavar="MPS", type=float, default=0.0, help="speed of a straight drive, default 0")
    parser.add_argument("--heading", metavar="DEG", type=float, default=0.0, help="clockwise from north (default 0)")
    parser.add_argument("--no-gps", action="store_true", help="no GPS, odometry only")
    parser.add_argument("--no-origin", action="store_true", help="no origin at boot: until it is set, or GPS has a fix")
    parser.add_argument(
        "--drift", metavar="PERCENT", type=float, default=0.0, help="error of odometry in %% of the distance"
    )
    parser.add_argument("--seconds", metavar="S", type=float, default=math.inf, help="stop after S seconds")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Print received messages as JSON lines on stdout until Ctrl-C; the connection is printed on stderr."""
    link = _open(arguments.udp)
    autopilot = SimulatedAutopilot(
        link,
        straight_line(arguments.speed, arguments.heading, time.monotonic()),
        firmware=arguments.firmware,
        gps=not arguments.no_gps,
        has_origin=not arguments.no_origin,
        drift_percent=arguments.drift,
    )
    stop = threading.Event()
    thread = threading.Thread(target=autopilot.run, args=(stop,))
    thread.start()
    try:
        _print_received(autopilot, thread, arguments.seconds)
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


def _print_received(autopilot: SimulatedAutopilot, thread: threading.Thread, seconds: float) -> None:
    end_s = time.monotonic() + seconds
    while thread.is_alive() and time.monotonic() < end_s:
        batch = autopilot.received[:]
        for received in batch:
            line = {"time_s": round(received.time_s, 4), **received.message.to_dict()}
            print(msgspec.json.encode(line).decode(), flush=True)
        del autopilot.received[: len(batch)]  # the thread only appends
        time.sleep(PRINT_S)
