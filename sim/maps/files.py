"""`lookback map info | verify | split | publish | list | keep | sign | keygen`: maps as they lie on the disk.

Signing is so that a vehicle takes only the maps that its owner has made.
"""

from __future__ import annotations

import argparse
import contextlib
import math
from collections.abc import Callable
from datetime import datetime, timezone
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.errors import FrameError, MapError
from edge.feed import decode_picture
from edge.geodesy import POSITION_SOURCES
from edge.reference_map import ReferenceMap, Route, maps_in, open_map, open_map_set
from edge.reference_map.map_folder import KEEP, is_retired
from edge.reference_map.map_set import MapSet, name_of
from edge.reference_map.place_records import ASSUMED_SIGMA_M
from edge.reference_map.store import HEADER, MapHeader
from edge_plugins.layers.stored import StoredMap, stored_maps
from edge_plugins.mapping.place_log import logs_in, map_of
from sim.maps.agreement import disagreements
from sim.maps.keys import make_key, sign_map
from sim.maps.known_distances import spell_distances
from sim.maps.tiles import publish_map, split_map
from sim.output import refusing

SAMPLED_PICTURES = 16
COURSE = "; headings are the course of its positions"
LIGHTS = ((40.0, "dark"), (80.0, "dim"), (256.0, "bright"))
"""Mean gray level, of 255, below which pictures are called that."""


def add_actions(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add them to `lookback map`."""

    def add(
        name: str, run: Callable[[argparse.Namespace], int], about: str, what: str = "a map, or a folder of maps"
    ) -> argparse.ArgumentParser:
        parser: argparse.ArgumentParser = actions.add_parser(name, help=about)
        parser.add_argument("map", type=Path, metavar="MAP", help=what)
        parser.set_defaults(run=run)
        return parser

    add("info", _info, "print the properties of a map, or of the maps of a folder")
    agree = "check every byte of a map or a folder of maps, and whether its drives agree about the road"
    add("verify", _verify, agree)
    split = add("split", _split, "cut a large map into tiles", "the map's folder")
    split.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="folder for the tiles")
    split.add_argument("--places", type=int, required=True, metavar="N", help="places per tile (at most N + 63)")
    add("list", _list, "list the maps of a folder, and which may be deleted", "a folder of maps")
    publish = add(
        "publish", _publish, "copy a map to give away, without the pictures of its places", "the map's folder"
    )
    publish.add_argument("-o", "--output", type=Path, required=True, metavar="MAP", help="folder of the new map")
    publish.add_argument("--pictures", action="store_true", help="with the small pictures of its places")
    keep = add("keep", _keep, "mark a map so that live mapping never deletes it", "the map's folder")
    keep.add_argument("--undo", action="store_true", help="remove the mark")
    sign = add("sign", _sign, "check every byte of a map, or of each map of a folder, and sign it")
    sign.add_argument("--key", type=Path, required=True, metavar="NAME", help="the secret key that `map keygen` made")
    keygen = actions.add_parser("keygen", help="make a key pair to sign maps with: NAME and NAME.pub")
    keygen.add_argument("key", type=Path, metavar="NAME", help="file for the secret key")
    keygen.set_defaults(run=_keygen)


def _info(args: argparse.Namespace) -> int:
    maps = open_map_set(args.map)
    if not maps.is_folder:
        _tell_of_map(open_map(args.map))
        return 0
    print(f"maps      {maps}, in {args.map}")
    print(f"accuracy  {_accuracy(maps.places)}")
    for name, header in zip(maps.names, maps.headers, strict=True):
        print(f"map       {name}: {header.places} places, {_size_mb(header):.1f} MB, {_spell_bounds(header)}")
    for excluded in maps.excluded:
        print(f"excluded  {excluded.why}")
    for path in filter(is_retired, maps_in(args.map)):
        print(f"retired   {name_of(path)}: not searched; see `map learn`")
    return 0


def _tell_of_map(reference_map: ReferenceMap) -> None:
    header, places = reference_map.header, reference_map.places
    sampling = {
        "distance": f"every {header.sampling.spacing_m:g} m, else every {header.sampling.interval_s:g} s",
        "time": f"every {header.sampling.interval_s:g} s",
        "frames": f"every {header.sampling.spacing_frames}. frame",
    }
    print(f"map       {reference_map.path}, format version {header.version}, written by lookback {header.lookback}")
    print(f"model     {header.model.name}, tap {header.model.tap}, sha256 {header.model.sha256}")
    print(f"provider  {header.model.provider}")
    print(f"regions   {header.regions.kind}, width {header.regions.width:g}")
    if header.dimensions < header.model.dimensions:
        print(f"reduced   to {header.dimensions} of {header.model.dimensions} dimensions per region")
    print(f"sampling  {sampling[header.sampling.by]}")
    print(f"places    {header.places}, {int(np.isfinite(places['lat_deg']).sum())} of them with a position")
    print(f"accuracy  {_accuracy(places)}")
    print(f"bounds    {_spell_bounds(header)}")
    key = header.keypoints_key
    if key is not None:
        of = f"{key.most} a place ({key.place_bytes / 1e3:.1f} kB), {key.network}, {key.sha256[:12]}"
        print(f"keypoints {of}, of {key.width} x {key.height} pixels and {key.fov_deg:g} degrees")
        for line in spell_distances(reference_map):
            print(f"          {line}")
    if header.tile is not None:
        print(f"tile      of the map {header.tile.map_sha256[:12]}, from its place {header.tile.start} on")
    route = Route(MapSet.of(reference_map))
    for segment in header.segments:
        of = f"{segment.source}, {segment.view} view{COURSE if segment.heading_is_course else ''}"
        crept_m = math.sqrt(route.drive(segment.start).crept_at(math.inf))
        of += f"; its GPS moved by some {crept_m:.0f} m otherwise than the vehicle" if crept_m >= 1 else ""
        print(f"segment   {segment.start} to {segment.end - 1}: {of}")
    print(
        f"size      {_size_mb(header):.1f} MB, {header.files['descriptors.i8'].bytes / 1e6:.1f} MB of it for matching"
    )


def _size_mb(header: MapHeader) -> float:
    return sum(key.bytes for key in header.files.values()) / 1e6


def _spell_bounds(header: MapHeader) -> str:
    bounds = header.bounds
    if bounds is None:
        return "no positions"
    return f"{bounds.south:.5f} to {bounds.north:.5f} north, {bounds.west:.5f} to {bounds.east:.5f} east"


def _verify(args: argparse.Namespace) -> int:
    maps = open_map_set(args.map, every_file=True)
    for excluded in maps.excluded:
        print(excluded.why)
    if maps.excluded:
        names = ", ".join(excluded.name for excluded in maps.excluded)
        raise MapError(f"{args.map}: {len(maps.excluded)} of its maps would be excluded: {names}")
    count = sum(len(header.files) for header in maps.headers)
    print(f"{args.map}: valid; all {count} checksums match")
    found = disagreements(maps)
    for one in found:
        print(f"{args.map}: {one}; one of the two drives is wrong: delete it, or build the map without it")
    return 1 if found else 0


def _split(args: argparse.Namespace) -> int:
    headers = split_map(open_map(args.map, every_file=True), args.output, args.places)
    print(f"{args.output}: {len(headers)} tiles of {min(header.places for header in headers)} places or more")
    return 0


def _publish(args: argparse.Namespace) -> int:
    header = publish_map(open_map(args.map, every_file=True), args.output, pictures=args.pictures)
    kept = "with" if args.pictures else "without"
    print(f"{args.output}: {header.places} places, {kept} pictures; sign it with `lookback map sign`")
    return 0


def _keygen(args: argparse.Namespace) -> int:
    public = make_key(args.key)
    print(
        f"{args.key}: keep this file secret; copy {public} to the vehicle and set"
        f' [map] require_signature_by = "{public.name}"'
    )
    return 0


def _sign(args: argparse.Namespace) -> int:
    maps = open_map_set(args.map)
    if maps.excluded:
        raise MapError(maps.excluded[0].why)
    for one in maps.maps:
        sign_map(one.path, args.key)
    print(f"{args.map}: signed")
    return 0


def _list(args: argparse.Namespace) -> int:
    maps = stored_maps(args.map)
    width = max((len(one.path.name) for one in maps), default=0)
    for one in maps:
        print(f"{name_of(one.path):{width}}  {_spell(one)}")
    for file in logs_in(args.map):
        print(f"{name_of(map_of(file))}: being mapped, or to be completed at the next start of `lookback run`")
    total_mb = sum(one.size_bytes for one in maps) / 1e6
    print(f"{args.map}: {len(maps)} map{'s' * (len(maps) != 1)}, {total_mb:.1f} MB")
    return 0


def _spell(one: StoredMap) -> str:
    made = datetime.fromtimestamp(one.made_unix_s, tz=timezone.utc).strftime("%Y-%m-%d %H:%M UTC")
    is_kept = one.is_kept or one.is_signed
    stays = "kept" if is_kept else "may be deleted" if one.is_from_drive else "not from live mapping"
    stays += ", retired" if one.is_retired else ""
    return f"{made}  {one.header.places:6} places  {one.size_bytes / 1e6:8.1f} MB  {light(one.path)}  {stays}"


def light(path: Path) -> str:
    """How bright the pictures of a map are, by some of them."""
    levels = []
    try:
        reference_map = open_map(path)
        for place in np.linspace(0, len(reference_map.places) - 1, SAMPLED_PICTURES).astype(int):
            thumbnail = reference_map.thumbnail(int(place))
            with contextlib.suppress(FrameError):
                levels.append(float(decode_picture("", thumbnail, cv2.IMREAD_GRAYSCALE).mean()))
    except (MapError, OSError):
        return "damaged"
    level = float(np.median(levels)) if levels else float("nan")
    return next((name for limit, name in LIGHTS if level < limit), "light unknown")


def _keep(args: argparse.Namespace) -> int:
    if not (args.map / HEADER).is_file():
        raise MapError(f"{args.map}: not a map; name the folder of one")
    with refusing(MapError, f"{args.map}: cannot mark it"):
        if args.undo:
            (args.map / KEEP).unlink(missing_ok=True)
        else:
            (args.map / KEEP).touch()
    print(f"{args.map}: {'may be deleted' if args.undo else 'kept'}")
    return 0


def _accuracy(places: NDArray[np.void]) -> str:
    """For people: how accurate the known positions are, what measured them, and what is assumed."""
    known = places[~np.isnan(places["lat_deg"])]
    if not known.size:
        return "no positions"
    given = known["position_sigma_m"][~np.isnan(known["position_sigma_m"])]
    counts = np.bincount(known["position_source"], minlength=len(POSITION_SOURCES))
    sources = ", ".join(name for name, count in zip(POSITION_SOURCES, counts, strict=True) if count)
    parts = [f"{np.median(given):.1f} m median, {given.max():.1f} m at worst"] if given.size else []
    if given.size < known.size:
        parts.append(f"not recorded for {known.size - given.size} places, {ASSUMED_SIGMA_M:g} m is assumed")
    return f"{'; '.join(parts)} (source: {sources})"
