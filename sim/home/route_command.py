"""`lookback route`: plan a route along drives of a map, from place to place, for a ground station."""

from __future__ import annotations

import argparse

from edge.errors import ConfigError
from edge.reference_map import open_map_set
from edge_plugins.home.drive_line import drive_lines
from sim.home.command import add_common, print_route


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback route`."""
    parser.description = (
        "Find a way along drives of a map, either way, and from one onto another where they meet; check it, and print"
        " what was found. A place is DRIVE:METERS from the start of a drive, DRIVE:end, or LAT,LON. Without places it"
        " prints the drives."
    )
    add_common(parser)
    parser.add_argument("--from", dest="start", metavar="PLACE", help="where it begins")
    parser.add_argument("--via", action="append", default=[], metavar="PLACE", help="on the way; several in order")
    parser.add_argument("--to", dest="end", metavar="PLACE", help="where it ends")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    places = [args.start, *args.via, args.end]
    if None not in places:
        return print_route(args, "route", places=places)
    if any(places):
        raise ConfigError("a route needs both --from and --to")
    print("\n".join(f"{line.name}: {line.along_m[-1]:.0f} m" for line in drive_lines(open_map_set(args.map))))
    return 0
