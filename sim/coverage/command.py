"""`lookback map coverage`: predict where a map will be recognized, and the longest gap."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from edge.config import GatesConfig
from edge.errors import ConfigError, FeedError, MapError
from edge.journal.records import FrameUsed
from edge.reference_map import Drives, MapSet, open_map_set
from edge.telemetry.shadow import ShadowPosition
from sim.coverage import Alias, Conditions, Pass, Rehearsal, Sheet, aliases, passes
from sim.coverage.aliases import SegmentSpan
from sim.coverage.passes import shadow_passes
from sim.coverage.picture import gap_in_words, verdict, write_sheet
from sim.coverage.rehearsal import LIGHTS, WAYS, spell_coverage
from sim.coverage.sheet import KNOWN_M, SOON_M, SheetSpan, spans_of
from sim.ground_files import GroundLine, as_geojson
from sim.journal import records_of
from sim.output import refusing
from sim.shadow.drives import LIGHTS as BY_SUN
from sim.shadow.drives import read_drives
from sim.traverse import config_as_mapped

VIEWS = 5  # pictures on the sheet
MOST_PLACES = 50_000
"""A larger map would take hours, and more memory than this computer may have."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback map coverage`."""
    parser.description = (
        "Predict where a map will be recognized on the next drive: from the map alone, by drives that are rehearsed"
        " over its own descriptors; with journals of earlier drives, by these as well."
    )
    parser.add_argument("map", type=Path, metavar="MAP", help="a map, or a folder of maps")
    about = "of earlier drives: beside GPS, see `lookback shadow`; with journal_frames; or the output of `replay --all`"
    parser.add_argument("journals", nargs="*", type=Path, metavar="JOURNAL", help=about)
    about = "the next drive: home, against the map's direction (default), or the same way again"
    parser.add_argument("--for", dest="way", choices=WAYS, default="home", help=about)
    parser.add_argument("--light", choices=LIGHTS, default="night", help="of the next drive (default %(default)s)")
    parser.add_argument("--view", choices=("front", "rear"), default="front", help="where it looks (default front)")
    parser.add_argument("--rehearsals", type=int, default=8, metavar="N", help="rehearsed drives (8); 0: only journals")
    parser.add_argument("--stretch-m", type=float, default=100.0, metavar="M", help="length of a stretch (default 100)")
    parser.add_argument("--within-m", type=float, default=20.0, metavar="M", help="drift that is accepted (default 20)")
    parser.add_argument("--geojson", type=Path, metavar="FILE", help="write the stretches as GeoJSON, too")
    parser.add_argument("--report", type=Path, metavar="FILE", help="draw them on a page (HTML), too")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    _check(args)
    maps = open_map_set(args.map)
    drives = Drives(maps, maps.headers[0].sampling.spacing_m)
    if not drives.is_metric:
        raise MapError(f"{args.map}: without meters along its drives there are no stretches")
    if args.rehearsals and maps.index.places > MOST_PLACES:
        raise MapError(
            f"{args.map}: {maps.index.places} places are too many to rehearse, at most {MOST_PLACES};"
            " name one of its tiles, see `lookback map split`"
        )
    driven = [one for path in args.journals for one in _driven(path, args, maps, drives)]
    percent = GatesConfig().drift_percent
    spans = spans_of(maps, drives, args.stretch_m)
    sheet = Sheet.of(maps, drives, spans, list(_rehearsed(args, maps)), driven, 100 / percent * args.within_m)
    found = aliases(maps, drives, spans)
    basis = _basis(args, len(driven))
    _print(args, basis, sheet, found, percent)
    for one in _advice(args, maps):
        print(one)
    if args.geojson:
        args.geojson.write_text(_geojson(maps, sheet.stretches, found), encoding="utf-8")
    if args.report:
        lines = [_line(maps, one.span) for one in sheet.stretches]
        way = "home" if args.way == "home" else "the same way again"
        camera = "ahead" if args.view == "front" else "back"
        words = [
            verdict(sheet, f"{way} by {args.light}, with a camera that looks {camera}", args.within_m),
            f"{gap_in_words(sheet.gap, percent).capitalize()}.",
            f"Of {args.map.name}, from {basis}. Beyond the first {KNOWN_M:.0f} m of a drive, all stretches that"
            " nobody drove have one share, since nothing is known of their differences.",
            *_advice(args, maps),
        ]
        write_sheet(args.report, sheet, lines, found, words, f"the map {args.map}", _views(maps))
    return 0


def _views(maps: MapSet) -> list[tuple[str, bytes]]:
    """Pictures along the map, by which a person knows it."""
    rows = np.unique(np.linspace(0, maps.index.places - 1, VIEWS).round().astype(int)).tolist()
    found = ((f"place {row}", maps.thumbnail(row)) for row in rows)
    return [(words, jpeg) for words, jpeg in found if jpeg]


def _advice(args: argparse.Namespace, maps: MapSet) -> list[str]:
    """Whether keypoints are in it; and what helps most, where the map was made by cameras that look the other way."""
    with_keypoints = spell_coverage(maps, Conditions(args.way, args.light, args.view)) if args.rehearsals else []
    views = {one.view for header in maps.headers for one in header.segments}
    camera = "ahead" if args.view == "front" else "back"
    words = f"No drive of a camera that looks {camera} is in this map. Add one: nothing else helps as much."
    return [*with_keypoints, *([] if args.way == "home" or args.view in views else [words])]


def _check(args: argparse.Namespace) -> None:
    if not args.stretch_m >= 1:
        raise ConfigError(f"--stretch-m: {args.stretch_m:g} is not at least 1")
    if not args.within_m > 0:
        raise ConfigError(f"--within-m: {args.within_m:g} is not above 0")
    if not 0 <= args.rehearsals <= 1000:
        raise ConfigError(f"--rehearsals: {args.rehearsals} is not 0 to 1000")
    if not args.rehearsals and not args.journals:
        raise ConfigError("--rehearsals 0 leaves nothing to predict from: name journals of earlier drives")


def _rehearsed(args: argparse.Namespace, maps: MapSet) -> Iterator[list[Pass]]:
    rehearsal = Rehearsal(maps, config_as_mapped(maps.headers[0]), Conditions(args.way, args.light, args.view))
    for seed in tqdm(range(args.rehearsals), desc="rehearsing", unit=" drives", disable=None):
        yield rehearsal.drive(seed)


def _driven(path: Path, args: argparse.Namespace, maps: MapSet, drives: Drives) -> list[list[Pass]]:
    """The drives of a journal: those beside GPS that went this way in this light, else the one of all its frames."""
    with refusing(FeedError, f"{path}: cannot read it"):
        frames = list(records_of(path, FrameUsed))
        is_beside_gps = not frames and any(records_of(path, ShadowPosition))
    if is_beside_gps:
        light = BY_SUN.index(args.light) if args.light in BY_SUN else None
        beside = (one for one in read_drives([path]) if one.is_judge)
        lit = (one if light is None else one.where(one.light == light) for one in beside)
        return [found for one in lit if (found := list(shadow_passes(one, maps, drives, args.way)))]
    if not frames:
        raise FeedError(
            f"{path}: no frames in it; drive beside GPS, set [telemetry] journal_frames = true, or use `replay --all`"
        )
    return [list(passes(frames, maps, drives))]


def _print(args: argparse.Namespace, basis: str, sheet: Sheet, found: Sequence[Alias], percent: float) -> None:
    print(f"{args.map}: {basis}")
    resembles = {one.stretch: one.other for one in found}
    for one in sheet.stretches:
        print(f"{_name(one.span)}: {_expected(one)}{_drives(one)}{_alias(resembles.get(one.span))}")
    print(gap_in_words(sheet.gap, percent))
    print(f"drift always within {args.within_m:g} m: {100 * sheet.completed:.0f} % of the drives")


def _basis(args: argparse.Namespace, driven: int) -> str:
    drives = "drive" if args.rehearsals == 1 else "drives"
    basis = [f"{args.rehearsals} rehearsed {drives} {args.way} by {args.light}"] if args.rehearsals else []
    return " and ".join([*basis, *([f"{driven} earlier ones"] if args.journals else [])])


def _name(span: SegmentSpan) -> str:
    return f"drive {span.segment + 1}, {span.from_m:5.0f} to {span.to_m:5.0f} m"


def _expected(one: SheetSpan) -> str:
    if one.share is None or one.soon is None:
        return "not driven"
    mean = " (mean of all so far from the start)" if one.is_mean else ""
    return f"{100 * one.share:3.0f} % of the frames; within {SOON_M:.0f} m {100 * one.soon:3.0f} %{mean}"


def _drives(one: SheetSpan) -> str:
    return f"; accepted on {one.believed_in} of {one.drives} earlier drives" if one.drives else ""


def _alias(other: SegmentSpan | None) -> str:
    return f"; resembles {_name(other)}" if other else ""


def _properties(one: SheetSpan, other: SegmentSpan | None) -> dict[str, Any]:
    share, soon = (None if value is None else round(value, 3) for value in (one.share, one.soon))
    drives = {"drives": one.drives, "believed_in": one.believed_in}
    found = {"share": share, "soon": soon, "is_mean": one.is_mean, **drives}
    return {**_where(one.span), **found, "alias": None if other is None else _where(other)}


def _where(one: SegmentSpan) -> dict[str, Any]:
    """Drives of the map are counted from 1, as people read them."""
    return {"drive": one.segment + 1, "from_m": one.from_m, "to_m": one.to_m}


def _geojson(maps: MapSet, stretches: Sequence[SheetSpan], found: Sequence[Alias]) -> str:
    resembles = {one.stretch: one.other for one in found}
    lines = []
    for one in stretches:
        points = [(lat_deg, lon_deg) for lon_deg, lat_deg in _line(maps, one.span)]
        lines.append(GroundLine("", points, properties=_properties(one, resembles.get(one.span))))
    return as_geojson([line for line in lines if len(line.points) > 1])


def _line(maps: MapSet, span: SegmentSpan) -> list[list[float]]:
    """Longitude and latitude of its places."""
    places = maps.places[slice(*maps.index.segment(span.segment))]
    here = (places["route_m"] >= span.from_m) & (places["route_m"] <= span.to_m) & ~np.isnan(places["lat_deg"])
    line: list[list[float]] = np.column_stack([places["lon_deg"][here], places["lat_deg"][here]]).tolist()
    return line
