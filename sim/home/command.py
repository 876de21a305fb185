"""`lookback home`: plan the way home along a map's drive, for a ground station."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge.config import RigConfig
from edge.errors import ConfigError
from edge.reference_map import open_map_set
from edge_plugins.home import HomeConfig
from edge_plugins.home.way_home import HomeStart, plan_way_home
from sim.home.files import encoder_of, write_way_home
from sim.output import checked_option

LIMITS = {
    "turning_radius_m": "the vehicle's smallest turning radius",
    "tolerance_m": "by how much waypoints may deviate from the drive",
    "speed_mps": "speed on the way home; 0 is the autopilot's own",
    "altitude_m": "height above the autopilot's home; 0 permits ground vehicles and boats only",
    "max_start_m": "greatest distance of the vehicle from the drive",
    "max_gap_m": "greatest distance between two places of the drive",
    "max_sigma_m": "worst accuracy of the drive's positions, one standard deviation",
    "max_length_m": "greatest length of the way home",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback home`."""
    parser.description = (
        "Reverse a drive of a map from the vehicle to its start, check it, and print what was found."
        " With -o it is written for a ground station, which uploads it."
    )
    parser.add_argument("map", type=Path, metavar="MAP", help="a map, or a folder of maps")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="write it: .waypoints, .plan or .geojson")
    parser.add_argument("--from", dest="start", metavar="LAT,LON", help="where it is (default: end of the drive)")
    parser.add_argument("--drive", type=int, metavar="N", help="number of the drive, from 1 (default: the newest)")
    parser.add_argument("--left-m", type=float, default=0.0, metavar="M", help="how far left of the drive to go home")
    for key, about in LIMITS.items():
        option, default = f"--{key.replace('_', '-')}", getattr(HomeConfig(), key)
        parser.add_argument(option, type=float, metavar="M", help=f"{about} (default {default:g})")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    config = HomeConfig(enabled=True)
    for key in LIMITS:
        if getattr(args, key) is not None:
            config = checked_option(config, f"--{key.replace('_', '-')}", **{key: getattr(args, key)})
    left_m = checked_option(RigConfig(), "--left-m", left_reverse_m=args.left_m).left_reverse_m
    maps = open_map_set(args.map)
    if args.output is not None:
        encoder_of(args.output)  # before the work
    way = plan_way_home(maps, _start(args.start), config, left_m, args.drive)
    print(f"way home  {way}")
    for finding in way.findings:
        print(finding)
    if way.refusals:
        return 1
    if args.output is not None:
        write_way_home(args.output, way, config)
        print(f"written   {args.output}")
    return 0


def _start(text: str | None) -> HomeStart | None:
    """A position from the command line."""
    if text is None:
        return None
    try:
        lat_deg, lon_deg = (float(part) for part in text.split(","))
        if not (abs(lat_deg) <= 90 and abs(lon_deg) <= 180):
            raise ValueError
    except ValueError:
        raise ConfigError(f"--from: {text!r} is not LAT,LON in degrees") from None
    return HomeStart(lat_deg, lon_deg)
