"""`lookback map export`: where the drives of a map are, by their newest positions, as GeoJSON, GPX, KML or CSV."""

from __future__ import annotations

import argparse
import csv
import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.errors import ConfigError, MapError
from edge.extras import install_command
from edge.geodesy import POSITION_SOURCES
from edge.reference_map import MapSet, open_map_set

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
    is_stale: NDArray[np.bool_]

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
    stale = np.zeros(maps.index.places, dtype=bool)
    for start, end in maps.stale:
        stale[start:end] = True
    known = ~np.isnan(maps.places["lat_deg"])
    for drive, (start, end) in enumerate(maps.index.segments):
        number = maps.index.map_of(start)
        rows = np.flatnonzero(known[start:end]) + start
        for part in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
            if part.size:
                about = maps.names[number], maps.index.view(drive), maps.index.recording(drive)
                yield Line(*about, int(part[0]) - maps.index.starts[number], maps.places[part], stale[part])


def as_geojson(lines: Sequence[Line]) -> str:
    """RFC 7946, longitude first: a line for each drive, one for each stretch that is no longer there."""
    features = []
    for line in lines:
        for first, end, is_stale in _pieces(line.is_stale):
            places = line.places[first:end]
            properties = {
                "map": line.name,
                "view": line.view,
                "recording": line.recording,
                "first_place": line.first + first,
                "is_stale": is_stale,
                "sigma_m": _median(places["position_sigma_m"]),
            }
            points = [(lon, lat) for lat, lon in line.points[first:end]]
            geometry = {"type": "LineString", "coordinates": points if len(points) > 1 else points * 2}
            features.append({"type": "Feature", "geometry": geometry, "properties": properties})
    return msgspec.json.encode({"type": "FeatureCollection", "features": features}).decode()


def as_gpx(lines: Sequence[Line]) -> str:
    """A track for each drive."""
    import gpxpy.gpx

    gpx = gpxpy.gpx.GPX()
    gpx.creator = "lookback"
    for line in lines:
        points = [gpxpy.gpx.GPXTrackPoint(lat_deg, lon_deg) for lat_deg, lon_deg in line.points]
        gpx.tracks.append(gpxpy.gpx.GPXTrack(name=line.name, description=f"{line.view}, {line.recording}"))
        gpx.tracks[-1].segments.append(gpxpy.gpx.GPXTrackSegment(points))
    return str(gpx.to_xml())


def as_kml(lines: Sequence[Line]) -> str:
    """A line for each drive."""
    import simplekml

    kml = simplekml.Kml()
    for line in lines:
        points = [(lon_deg, lat_deg) for lat_deg, lon_deg in line.points]
        kml.newlinestring(name=line.name, description=f"{line.view}, {line.recording}", coords=points)
    return str(kml.kml())


def as_csv(lines: Sequence[Line]) -> str:
    """A row for each place; what is not known is empty."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["map", "place", "view", *COLUMNS, "source", "recording", "is_stale"])
    for line in lines:
        for row, (place, is_stale) in enumerate(zip(line.places, line.is_stale.tolist(), strict=True)):
            values = ["" if np.isnan(place[name]) else repr(float(place[name])) for name in COLUMNS]
            about = POSITION_SOURCES[place["position_source"]], line.recording, int(is_stale)
            table.writerow([line.name, line.first + row, line.view, *values, *about])
    return text.getvalue()


WRITERS: dict[str, Callable[[Sequence[Line]], str]] = {
    ".geojson": as_geojson,
    ".gpx": as_gpx,
    ".kml": as_kml,
    ".csv": as_csv,
}
"""By the suffix of the file."""


def _pieces(is_stale: NDArray[np.bool_]) -> Iterator[tuple[int, int, bool]]:
    borders = [0, *(np.flatnonzero(np.diff(is_stale)) + 1).tolist(), len(is_stale)]
    for first, end in pairwise(borders):
        yield first, end, bool(is_stale[first])


def _median(sigma_m: NDArray[np.float32]) -> float | None:
    known = sigma_m[~np.isnan(sigma_m)]
    return round(float(np.median(known)), 3) if known.size else None


def _run(args: argparse.Namespace) -> int:
    writer = WRITERS.get(args.output.suffix.lower())
    if writer is None:
        raise ConfigError(f"--output: {args.output}: use a name that ends in one of {', '.join(WRITERS)}")
    lines = list(lines_of(open_map_set(args.map)))
    if not lines:
        raise MapError(f"{args.map}: none of its places has a position")
    try:
        args.output.write_text(writer(lines), encoding="utf-8")
    except ModuleNotFoundError as error:
        raise ConfigError(f"{args.output.suffix} needs {error.name}: {install_command('desk')}") from None
    except OSError as error:
        raise ConfigError(f"--output: {args.output}: cannot write it: {error.strerror}") from None
    print(f"{args.output}: {sum(len(line.places) for line in lines)} places in {len(lines)} lines")
    return 0
