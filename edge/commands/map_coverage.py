"""`lookback map coverage`: where a map has been recognized on earlier drives, and where it has not.

A drive is a journal with `journal_frames`, or the output of `replay --all`. The frames that were believed say where the
vehicle was; those between them lie between them, and those before the first and after the last as far away as the
frames are apart.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.config import GatesConfig
from edge.errors import ConfigError, FeedError, MapError
from edge.journal.journal import records_of
from edge.journal.records import FrameUsed
from edge.reference_map import Drives, MapSet, open_map_set

SPARE_M = 1e-6


@dataclass(frozen=True)
class Pass:
    """The frames of one drive over one segment of the map, in order: meters along it, and which are believed."""

    segment: int
    along_m: NDArray[np.float64]
    believed: NDArray[np.bool_]

    def longest_gap(self) -> tuple[float, float]:
        """Where the longest stretch without a believed frame begins and ends along the segment."""
        at = np.concatenate([[0], np.flatnonzero(self.believed), [len(self.along_m) - 1]])
        ends = self.along_m[at]
        longest = int(np.abs(np.diff(ends)).argmax())
        return float(min(ends[longest : longest + 2])), float(max(ends[longest : longest + 2]))


@dataclass(frozen=True)
class Stretch:
    """Meters [from_m, to_m) of a segment. share: of the frames there that are believed, None where none passed.

    drives, believed_in: how many passed, and how many of these had a believed frame there.
    """

    segment: int
    from_m: float
    to_m: float
    share: float | None
    drives: int
    believed_in: int


def passes(frames: Sequence[FrameUsed], maps: MapSet, drives: Drives) -> Iterator[Pass]:
    """The passes of one drive, in order."""
    at = np.cumsum([1 + (frame.missed or 0) for frame in frames])
    known = [index for index, frame in enumerate(frames) if frame.accepted and frame.place is not None]
    places = [_place_index(frames[index], maps) for index in known]
    segments = [drives.drive_of(place) for place in places]
    begin = 0
    for end in range(1, len(known) + 1):
        if end < len(known) and segments[end] == segments[begin]:
            continue
        # Between two segments, half of the frames belong to each.
        first = 0 if begin == 0 else (known[begin - 1] + known[begin] + 1) // 2
        last = len(frames) if end == len(known) else (known[end - 1] + known[end] + 1) // 2
        anchors = np.array(known[begin:end])
        along_m = np.array([drives.along_m(place) for place in places[begin:end]])
        signs = [1.0 if frames[index].direction == "forward" else -1.0 for index in (known[begin], known[end - 1])]
        rows = np.arange(first, last)
        found_m = np.interp(at[rows], at[anchors], along_m)
        found_m -= signs[0] * drives.spacing_m * np.maximum(0, at[anchors[0]] - at[rows])
        found_m += signs[1] * drives.spacing_m * np.maximum(0, at[rows] - at[anchors[-1]])
        low_m, high_m = drives.extent_m(segments[begin])
        inside = (found_m >= low_m - SPARE_M) & (found_m <= high_m + SPARE_M)
        yield Pass(segments[begin], found_m[inside], np.isin(rows, anchors)[inside])
        begin = end


def stretches(drives: Drives, passed: Sequence[Sequence[Pass]], maps: MapSet, length_m: float) -> Iterator[Stretch]:
    """All stretches of all segments; passed: the passes of each drive."""
    for segment in range(len(maps.index.segments)):
        low_m, high_m = drives.extent_m(segment)
        for from_m in np.arange(low_m, max(high_m, low_m + SPARE_M), length_m):
            to_m = min(from_m + length_m, high_m + SPARE_M)
            found = [_believed(one, segment, from_m, to_m) for one in passed]
            found = [believed for believed in found if believed.size]
            share = float(np.concatenate(found).mean()) if found else None
            believed_in = sum(bool(believed.any()) for believed in found)
            yield Stretch(segment, float(from_m), float(to_m), share, len(found), believed_in)


def _believed(one_drive: Sequence[Pass], segment: int, from_m: float, to_m: float) -> NDArray[np.bool_]:
    """Of each frame of a drive in a stretch, whether it is believed."""
    parts = [one for one in one_drive if one.segment == segment]
    inside = [one.believed[(one.along_m >= from_m) & (one.along_m < to_m)] for one in parts]
    return np.concatenate(inside) if inside else np.zeros(0, dtype=bool)


def _place_index(frame: FrameUsed, maps: MapSet) -> int:
    """The number of a frame's place through all maps. MapError where the maps do not have it."""
    name = None if frame.map is msgspec.UNSET else frame.map
    number = maps.names.index(str(name)) if name in maps.names else 0 if name is None and not maps.is_folder else None
    if number is None or frame.place is None or frame.place >= maps.headers[number].places:
        raise MapError(
            f"{maps.path}: it has no place {frame.place} of {name or 'a single map'}; name the map driven on"
        )
    return maps.index.starts[number] + frame.place


def add_action(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add it to `lookback map`."""
    coverage = actions.add_parser("coverage", help="print where earlier drives recognized the map, and their gaps")
    coverage.add_argument("map", type=Path, metavar="MAP", help="a map, or a folder of maps")
    coverage.add_argument(
        "journals", nargs="+", type=Path, metavar="JOURNAL", help="journals with journal_frames, or of `replay --all`"
    )
    coverage.add_argument(
        "--stretch-m", type=float, default=100.0, metavar="M", help="length of a stretch (default %(default)g)"
    )
    coverage.add_argument(
        "--within-m", type=float, default=20.0, metavar="M", help="drift that is still good enough (default 20)"
    )
    coverage.add_argument("--geojson", type=Path, metavar="FILE", help="write the stretches as GeoJSON, too")
    coverage.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    if not args.stretch_m >= 1:
        raise ConfigError(f"--stretch-m: {args.stretch_m:g} is not at least 1")
    maps = open_map_set(args.map)
    drives = Drives(maps, maps.headers[0].sampling.spacing_m)
    if not drives.is_metric:
        raise MapError(f"{args.map}: without meters along its drives there are no stretches")
    passed = [list(passes(_frames(path), maps, drives)) for path in args.journals]
    found = list(stretches(drives, passed, maps, args.stretch_m))
    for one in found:
        share = "not driven" if one.share is None else f"{one.share:4.0%} of frames, {one.believed_in} of {one.drives}"
        print(f"drive {one.segment}, {one.from_m:5.0f} to {one.to_m:5.0f} m: {share}")
    _print_gaps(args.journals, passed, args.within_m)
    if args.geojson:
        args.geojson.write_bytes(msgspec.json.encode(_geojson(maps, found)))
    return 0


def _frames(path: Path) -> list[FrameUsed]:
    try:
        frames = list(records_of(path, FrameUsed))
    except OSError as error:
        raise FeedError(f"{path}: cannot read it: {error.strerror}") from None
    if not frames:
        raise FeedError(f"{path}: no frames in it; set [telemetry] journal_frames = true, or use `replay --all`")
    return frames


def _print_gaps(journals: Sequence[Path], passed: Sequence[Sequence[Pass]], within_m: float) -> None:
    percent, completed = GatesConfig().drift_percent, 0
    for path, one_drive in zip(journals, passed, strict=True):
        gaps = [(one.segment, *one.longest_gap()) for one in one_drive if one.along_m.size]
        if not gaps:
            print(f"{path}: nothing is believed on this map")
            continue
        segment, from_m, to_m = max(gaps, key=lambda gap: gap[2] - gap[1])
        drift_m = percent / 100 * (to_m - from_m)
        completed += drift_m <= within_m
        print(
            f"{path}: longest gap {to_m - from_m:.0f} m, drive {segment} from {from_m:.0f} to {to_m:.0f} m;"
            f" {drift_m:.0f} m of drift at {percent:g} %"
        )
    print(f"drift always within {within_m:g} m: {completed} of {len(journals)} drives")


def _geojson(maps: MapSet, found: Sequence[Stretch]) -> dict[str, object]:
    features = []
    for one in found:
        places = maps.places[slice(*maps.index.segment(one.segment))]
        here = (places["route_m"] >= one.from_m) & (places["route_m"] <= one.to_m) & ~np.isnan(places["lat_deg"])
        line = np.column_stack([places["lon_deg"][here], places["lat_deg"][here]]).tolist()
        if len(line) > 1:
            geometry = {"type": "LineString", "coordinates": line}
            properties = {field: getattr(one, field) for field in Stretch.__dataclass_fields__}
            features.append({"type": "Feature", "geometry": geometry, "properties": properties})
    return {"type": "FeatureCollection", "features": features}
