"""`lookback map learn`: which drives of a road are searched."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge.errors import ConfigError, MapError
from edge.reference_map.learned import LearnedFolder
from edge.reference_map.map_set import name_of
from sim.maps.files import light
from sim.maps.keys import is_signed_with
from sim.maps.learning import LAYERS, STALE_AFTER, Lesson, learn
from sim.maps.picture import write_layers


def add_actions(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add them to `lookback map`."""
    about = "choose which drives of a folder of maps are searched, at most so many of one road"
    learning = actions.add_parser("learn", help=about)
    learning.add_argument("map", type=Path, metavar="FOLDER", help="a folder of maps")
    learning.add_argument("--layers", type=int, default=LAYERS, metavar="N", help=f"drives a road (default {LAYERS})")
    about = f"drives after which a stretch is no longer there (default {STALE_AFTER})"
    learning.add_argument("--stale-after", type=int, default=STALE_AFTER, metavar="N", help=about)
    learning.add_argument("--key", type=Path, metavar="NAME", help="secret key of signed maps that may be retired")
    learning.add_argument("--dry-run", action="store_true", help="print the table, and change nothing")
    learning.add_argument("--picture", type=Path, metavar="FILE", help="draw the layers (SVG, PDF, PNG)")
    learning.add_argument("--undo", action="store_true", help="go back to the drives that were searched before")
    learning.set_defaults(run=_learn)


def _learn(args: argparse.Namespace) -> int:
    folder = LearnedFolder(args.map)
    if args.undo:
        if not args.map.is_dir():
            raise MapError(f"{args.map}: no such folder of maps")
        folder.undo()
        print(f"{args.map}: undone; {len(folder.newest.retired)} drives are retired")
        return 0
    for name in ("layers", "stale_after"):
        if getattr(args, name) < 1:
            raise ConfigError(f"--{name.replace('_', '-')}: {getattr(args, name)} is not 1 or more")
    lesson = learn(
        args.map, args.layers, args.stale_after, lambda path: args.key is not None and is_signed_with(path, args.key)
    )
    print("\n".join(_table(lesson)))
    if args.picture:
        write_layers(args.picture, args.map, lesson)
    if not args.dry_run:
        lesson.keep(folder)
    count, done = len(lesson.choice.searched), "would be" if args.dry_run else "are"
    print(f"{args.map}: {count} of {len(lesson.drives)} drives {done} searched")
    return 0


def _table(lesson: Lesson) -> list[str]:
    width = max(len(drive.path.name) for drive in lesson.drives)
    lines = [f"{'drive':{width}}  view   places  light          frames  stale  state     why"]
    for number, drive in enumerate(lesson.drives):
        why = {**lesson.choice.searched, **lesson.choice.retired}[number]
        state = "searched" if number in lesson.choice.searched else "retired"
        views = "/".join(sorted({segment.view for segment in drive.header.segments}))
        stale = sum(end - start for start, end in lesson.learned.stale.get(drive.header.header_sha256, ()))
        lines.append(
            f"{name_of(drive.path):{width}}  {views:5}  {drive.header.places:6}  {light(drive.path):13}"
            f"  {drive.recognized:6}  {stale:5}  {state:8}  {why}"
        )
    return lines
