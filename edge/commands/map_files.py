"""`lookback map info | verify | split`: maps as they lie on the disk, one or a folder of them."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from edge.errors import MapError
from edge.map_agreement import disagreements
from edge.reference_map import ReferenceMap, open_map, open_map_set
from edge.reference_map.place_records import spell_accuracy
from edge.reference_map.store import MapHeader
from edge.reference_map.tiles import split_map


def add_actions(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add them to `lookback map`."""
    info = actions.add_parser("info", help="print the properties of a map, or of the maps of a folder")
    info.add_argument("map", type=Path, metavar="MAP", help="a map, or a folder of maps")
    info.set_defaults(run=_info)

    verify = actions.add_parser(
        "verify", help="check every byte of a map or a folder of maps, and whether its drives agree about the road"
    )
    verify.add_argument("map", type=Path, metavar="MAP", help="a map, or a folder of maps")
    verify.set_defaults(run=_verify)

    split = actions.add_parser("split", help="cut a large map into tiles")
    split.add_argument("map", type=Path, metavar="MAP", help="the map's folder")
    split.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="folder for the tiles")
    split.add_argument("--places", type=int, required=True, metavar="N", help="places per tile (at most N + 63)")
    split.set_defaults(run=_split)


def _info(args: argparse.Namespace) -> int:
    maps = open_map_set(args.map)
    if not maps.is_folder:
        _tell_of_map(open_map(args.map))
        return 0
    print(f"maps      {maps}, in {args.map}")
    print(f"accuracy  {spell_accuracy(maps.places)}")
    for name, header in zip(maps.names, maps.headers, strict=True):
        print(f"map       {name}: {header.places} places, {_size_mb(header):.1f} MB, {_spell_bounds(header)}")
    for excluded in maps.excluded:
        print(f"excluded  {excluded.why}")
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
    print(
        f"regions   {header.regions.kind}, width {header.regions.width:g}, normalization {header.regions.normalization}"
    )
    if header.dimensions < header.model.dimensions:
        print(f"reduced   to {header.dimensions} of {header.model.dimensions} dimensions per region")
    print(f"sampling  {sampling[header.sampling.by]}")
    print(f"places    {header.places}, {int(np.isfinite(places['lat_deg']).sum())} of them with a position")
    print(f"accuracy  {spell_accuracy(places)}")
    print(f"bounds    {_spell_bounds(header)}")
    if header.tile is not None:
        print(f"tile      of the map {header.tile.map_sha256[:12]}, from its place {header.tile.start} on")
    for segment in header.segments:
        print(f"segment   {segment.start} to {segment.end - 1}: {segment.source}, {segment.view} view")
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
        print(f"{args.map}: {one}; one of the two drives is wrong, so both count as that uncertain")
    return 1 if found else 0


def _split(args: argparse.Namespace) -> int:
    headers = split_map(open_map(args.map, every_file=True), args.output, args.places)
    print(f"{args.output}: {len(headers)} tiles of {min(header.places for header in headers)} places or more")
    return 0
