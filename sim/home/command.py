"""`lookback home`: plan the way home along a map's drive, for a ground station."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from edge.config import RigConfig
from edge.errors import ConfigError
from edge.reference_map import open_map_set
from edge_plugins.home import HomeConfig
from edge_plugins.home.route import RouteStart, plan_route
from edge_plugins.home.route_search import degrees_of
from sim.home.files import encoder_of, write_route
from sim.output import checked_option

LIMITS = {
    "turning_radius_m": "the vehicle's smallest turning radius",
    "tolerance_m": "by how much waypoints may deviate from the drive",
    "speed_mps": "speed on the way; 0 is the autopilot's own",
    "altitude_m": "height above the autopilot's home; 0 permits ground vehicles and boats only",
    "max_start_m": "greatest distance of the vehicle from the drive",
    "max_gap_m": "greatest distance between two places of the drive",
    "max_sigma_m": "worst accuracy of the drive's positions, one standard deviation",
    "max_length_m": "greatest length of the way",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback home`."""
    parser.description = (
        "Reverse a drive of a map from the vehicle to its start, check it, and print what was found."
        " With -o it is written for a ground station, which uploads it."
    )
    add_common(parser)
    parser.add_argument("--from", dest="start", metavar="LAT,LON", help="where it is (default: end of the drive)")
    parser.add_argument("--drive", type=int, metavar="N", help="number of the drive, from 1 (default: the newest)")
    parser.set_defaults(run=_run)


def add_common(parser: argparse.ArgumentParser) -> None:
    """What a way needs, wherever it leads."""
    parser.add_argument("map", type=Path, metavar="MAP", help="a map, or a folder of maps")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="write it: .waypoints, .plan or .geojson")
    parser.add_argument("--left-m", type=float, default=0.0, metavar="M", help="how far left of each drive to drive")
    for key, about in LIMITS.items():
        option, default = f"--{key.replace('_', '-')}", getattr(HomeConfig(), key)
        parser.add_argument(option, type=float, metavar="M", help=f"{about} (default {default:g})")


def _run(args: argparse.Namespace) -> int:
    start = None
    if args.start is not None:
        try:
            start = RouteStart(*degrees_of(args.start))
        except ValueError:
            raise ConfigError(f"--from: {args.start!r} is not LAT,LON in degrees") from None
    return print_route(args, "way home", start=start, drive=args.drive)


def print_route(args: argparse.Namespace, name: str, *, start: RouteStart | None = None, **way_of: Any) -> int:
    """Plan it, print what was found, and write it where it may be driven; the exit status."""
    config = HomeConfig(enabled=True)
    for key in LIMITS:
        if getattr(args, key) is not None:
            config = checked_option(config, f"--{key.replace('_', '-')}", **{key: getattr(args, key)})
    rig = checked_option(RigConfig(), "--left-m", left_forward_m=args.left_m, left_reverse_m=args.left_m)
    maps = open_map_set(args.map)
    if args.output is not None:
        encoder_of(args.output)  # before the work
    way = plan_route(maps, start, config, rig, **way_of)
    print(f"{name:<9} {way}", *way.findings, sep="\n")
    if way.refusals:
        return 1
    if args.output is not None:
        write_route(args.output, way, config, name)
        print(f"written   {args.output}")
    return 0
