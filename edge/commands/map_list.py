"""`lookback map list | keep`: the maps of a folder, when and in what light they were made, and how often recognized."""

from __future__ import annotations

import argparse
from datetime import datetime, timezone
from pathlib import Path

import cv2
import numpy as np

from edge.errors import MapError
from edge.mapping.completion import logs_in, map_of
from edge.mapping.quota import KEEP_FILE, StoredMap, stored_maps
from edge.reference_map import open_map
from edge.reference_map.store import HEADER

SAMPLED_PICTURES = 16
LIGHTS = ((40.0, "dark"), (80.0, "dim"), (256.0, "bright"))
"""Mean gray level, of 255, below which a map's pictures are called that."""


def add_actions(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add them to `lookback map`."""
    listing = actions.add_parser("list", help="list the maps of a folder, and how often each was recognized")
    listing.add_argument("folder", type=Path, metavar="FOLDER", help="a folder of maps")
    listing.set_defaults(run=_list)

    keep = actions.add_parser("keep", help="mark a map so that live mapping never deletes it")
    keep.add_argument("map", type=Path, metavar="MAP", help="the map's folder")
    keep.add_argument("--undo", action="store_true", help="remove the mark")
    keep.set_defaults(run=_keep)


def _list(args: argparse.Namespace) -> int:
    maps = stored_maps(args.folder)
    width = max((len(one.path.name) for one in maps), default=0)
    for one in maps:
        print(f"{one.path.name:{width}}  {_spell(one)}")
    for file in logs_in(args.folder):
        print(f"{map_of(file).name}: being mapped, or to be completed at the next start of `lookback run`")
    total_mb = sum(one.size_bytes for one in maps) / 1e6
    print(f"{args.folder}: {len(maps)} map{'s' * (len(maps) != 1)}, {total_mb:.1f} MB")
    return 0


def _spell(one: StoredMap) -> str:
    made = datetime.fromtimestamp(one.made_unix_s, tz=timezone.utc).strftime("%Y-%m-%d %H:%M UTC")
    used = f"recognized {one.used.recognized} times" if one.used.recognized else "not recognized yet"
    stays = "kept" if one.is_kept else "may be deleted" if one.is_from_drive else "not from live mapping"
    return f"{made}  {one.header.places:6} places  {one.size_bytes / 1e6:8.1f} MB  {_light(one.path)}  {used}  {stays}"


def _light(path: Path) -> str:
    """How bright the pictures of a map are, by some of them."""
    levels = []
    try:
        reference_map = open_map(path)
        for place in np.linspace(0, len(reference_map.places) - 1, SAMPLED_PICTURES).astype(int):
            data = np.frombuffer(reference_map.thumbnail(int(place)), np.uint8)
            picture = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if data.size else None
            levels += [] if picture is None else [float(picture.mean())]
    except (MapError, OSError):
        return "damaged"
    level = float(np.median(levels)) if levels else float("nan")
    return next((name for limit, name in LIGHTS if level < limit), "light unknown")


def _keep(args: argparse.Namespace) -> int:
    if not (args.map / HEADER).is_file():
        raise MapError(f"{args.map}: not a map; name the folder of one")
    try:
        if args.undo:
            (args.map / KEEP_FILE).unlink(missing_ok=True)
        else:
            (args.map / KEEP_FILE).touch()
    except OSError as error:
        raise MapError(f"{args.map}: cannot mark it: {error.strerror}") from None
    print(f"{args.map}: {'may be deleted' if args.undo else 'kept'}")
    return 0
