"""`lookback map export`: where the drives of a map are, as GeoJSON, GPX, KML or CSV."""

from __future__ import annotations

import argparse
import csv
import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.errors import MapError
from edge.geodesy import POSITION_SOURCES
from edge.reference_map import MapSet, open_map_set
from sim.ground_files import GroundLine, as_geojson, as_gpx, as_kml, write_by_suffix

COLUMNS = ("lat_deg", "lon_deg", "alt_m", "heading_deg", "route_m", "position_sigma_m")
"""Of a place, in a CSV file."""


@dataclass(frozen=True)
class Line:
    """A drive, or a part of it without unknown positions: name, view, first row of the map, and records of PLACE."""

    name: str
    view: str
    recording: str
    first: int
    places: NDArray[np.void]

    @property
    def points(self) -> list[tuple[float, float]]:
        """Latitudes and longitudes."""
        return list(zip(self.places["lat_deg"].tolist(), self.places["lon_deg"].tolist(), strict=True))


def add_arguments(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add it to `lookback map`."""
    export = actions.add_parser("export", help="write where the drives of a map, or of a folder of maps, are")
    export.add_argument("map", type=Path, metavar="MAP", help="a map, or a folder of maps")
    export.add_argument("-o", "--output", type=Path, required=True, metavar="FILE", help=", ".join(WRITERS))
    export.set_defaults(run=_run)


def lines_of(maps: MapSet) -> Iterator[Line]:
    """Those of all drives that are searched."""
    known = ~np.isnan(maps.places["lat_deg"])
    for drive, (start, end) in enumerate(maps.index.segments):
        number = maps.index.map_of(start)
        rows = np.flatnonzero(known[start:end]) + start
        for part in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
            if part.size:
                about = maps.names[number], maps.index.view(drive), maps.index.recording(drive)
                yield Line(*about, int(part[0]) - maps.index.starts[number], maps.places[part])


def _on_ground(lines: Sequence[Line]) -> list[GroundLine]:
    """A line for each drive."""
    return [GroundLine(line.name, line.points, f"{line.view}, {line.recording}") for line in lines]


def _with_properties(lines: Sequence[Line]) -> list[GroundLine]:
    """A line for each drive, and what is known of it."""
    found = []
    for line in lines:
        properties = {
            "map": line.name,
            "view": line.view,
            "recording": line.recording,
            "first_place": line.first,
            "sigma_m": _median(line.places["position_sigma_m"]),
        }
        found.append(GroundLine(line.name, line.points, properties=properties))
    return found


def as_csv(lines: Sequence[Line]) -> str:
    """A row for each place; what is not known is empty."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["map", "place", "view", *COLUMNS, "source", "recording"])
    for line in lines:
        for row, place in enumerate(line.places):
            values = ["" if np.isnan(place[name]) else repr(float(place[name])) for name in COLUMNS]
            about = POSITION_SOURCES[place["position_source"]], line.recording
            table.writerow([line.name, line.first + row, line.view, *values, *about])
    return text.getvalue()


WRITERS: dict[str, Callable[[Sequence[Line]], str]] = {
    ".geojson": lambda lines: as_geojson(_with_properties(lines)),
    ".gpx": lambda lines: as_gpx(_on_ground(lines)),
    ".kml": lambda lines: as_kml(_on_ground(lines)),
    ".csv": as_csv,
}
"""By the suffix of the file."""


def _median(sigma_m: NDArray[np.float32]) -> float | None:
    known = sigma_m[~np.isnan(sigma_m)]
    return round(float(np.median(known)), 3) if known.size else None


def _run(args: argparse.Namespace) -> int:
    lines = list(lines_of(open_map_set(args.map)))
    if not lines:
        raise MapError(f"{args.map}: none of its places has a position")
    write_by_suffix(args.output, {suffix: partial(writer, lines) for suffix, writer in WRITERS.items()})
    print(f"{args.output}: {sum(len(line.places) for line in lines)} places in {len(lines)} lines")
    return 0
