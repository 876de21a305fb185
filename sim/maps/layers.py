"""`lookback map learn`: which drives of a road are searched, the newest of each view and direction."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge.errors import ConfigError
from edge.reference_map.map_set import name_of
from sim.maps.files import light
from sim.maps.newest import LAYERS, Choice, choose


def add_actions(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add it to `lookback map`."""
    about = "choose which drives of a folder of maps are searched: the newest, at most so many of one road"
    learning = actions.add_parser("learn", help=about)
    learning.add_argument("map", type=Path, metavar="FOLDER", help="a folder of maps")
    learning.add_argument("--layers", type=int, default=LAYERS, metavar="N", help=f"drives a road (default {LAYERS})")
    learning.add_argument("--dry-run", action="store_true", help="print the table, and change nothing")
    learning.set_defaults(run=_learn)


def _learn(args: argparse.Namespace) -> int:
    if args.layers < 1:
        raise ConfigError(f"--layers: {args.layers} is not 1 or more")
    choice = choose(args.map, args.layers)
    print("\n".join(_table(choice)))
    if not args.dry_run:
        choice.mark()
    done = "would be" if args.dry_run else "are"
    print(f"{args.map}: {len(choice.searched)} of {len(choice.drives)} drives {done} searched")
    return 0


def _table(choice: Choice) -> list[str]:
    width = max(len(drive.path.name) for drive in choice.drives)
    lines = [f"{'drive':{width}}  view   places  light          state     why"]
    for number, drive in enumerate(choice.drives):
        state = "searched" if number in choice.searched else "retired"
        why = choice.searched.get(number, "newer ones serve its road")
        views = "/".join(sorted({segment.view for segment in drive.header.segments}))
        lines.append(
            f"{name_of(drive.path):{width}}  {views:5}  {drive.header.places:6}  {light(drive.path):13}"
            f"  {state:8}  {why}"
        )
    return lines
