"""Tracks that phones, receivers, watches and web maps write: the positions of a drive, each with its time.

.gpx      the points of its tracks (https://www.topografix.com/GPX/1/1)
.fit      the records of a watch or a bicycle computer (https://developer.garmin.com/fit)
.nmea     the RMC sentences of a receiver, with the altitude of its GGA (NMEA 0183)
.geojson  a LineString with `coordTimes` or `times`, as of togeojson, or Points with `time` (RFC 7946)
.kml      gx:Track, pairs of `when` and `gx:coord` (https://developers.google.com/kml/documentation/kmlreference)
.srt      the subtitles of a DJI drone, which have its position
.csv      a line for each position; its columns are those of `pictures_csv`
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Iterator
from datetime import datetime
from itertools import chain
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from edge.errors import FeedError
from sim.datasets.pictures_csv import positions_in
from sim.datasets.tables import parse_time_ns
from sim.datasets.track import TrackFix
from sim.output import needing

KNOT_MPS = 1852 / 3600
SEMICIRCLE_DEG = 180 / 2**31
SRT_BEGINS = re.compile(r"(\d+):(\d\d):(\d\d)[,.](\d{3})\s*-->")
SRT_NAMED = re.compile(r"\b(latitude|longitude|abs_alt)\s*:\s*(-?[\d.]+)")
SRT_PAIR = re.compile(r"GPS\s*\(\s*(-?[\d.]+)\s*,\s*(-?[\d.]+)")


def _gpx_fixes(file: Path, data: bytes) -> Iterator[TrackFix]:
    with needing(f"{file}:", "import", FeedError):
        import gpxpy
        from gpxpy.gpx import GPXException

    try:
        points = [point for point, *_ in gpxpy.parse(data.decode("utf-8-sig")).walk()]
    except (GPXException, UnicodeDecodeError, ValueError) as error:
        raise FeedError(f"{file}: not a whole GPX file: {' '.join(str(error).split())}") from None
    if any(point.time is None for point in points):
        raise FeedError(f"{file}: a point of its track has no time; export the recorded track, not a planned route")
    for point in points:
        alt_m, course_deg, speed_mps = map(_known, (point.elevation, point.course, point.speed))
        at = point.latitude, point.longitude, alt_m, course_deg, speed_mps
        yield TrackFix(_moment_ns(point.time), *at, source="gps")


def _fit_fixes(file: Path, data: bytes) -> Iterator[TrackFix]:
    with needing(f"{file}:", "import", FeedError):
        import fitdecode

    try:
        with fitdecode.FitReader(data) as reader:
            for frame in reader:
                if frame.frame_type != fitdecode.FIT_FRAME_DATA or frame.name != "record":
                    continue
                values = {field.name: field.value for field in frame.fields}
                if values.get("position_lat") is None or values.get("position_long") is None:
                    continue
                lat_deg, lon_deg = (values[name] * SEMICIRCLE_DEG for name in ("position_lat", "position_long"))
                alt_m, speed_mps = (
                    _known(values.get(f"enhanced_{name}", values.get(name))) for name in ("altitude", "speed")
                )
                stamp_ns = _moment_ns(values["timestamp"])
                yield TrackFix(stamp_ns, lat_deg, lon_deg, alt_m, speed_mps=speed_mps, source="gps")
    except (fitdecode.FitError, KeyError, TypeError) as error:
        raise FeedError(f"{file}: not a whole FIT file: {' '.join(str(error).split())}") from None


def _nmea_fixes(file: Path, data: bytes) -> Iterator[TrackFix]:
    with needing(f"{file}:", "import", FeedError):
        import pynmea2

    alt_m = math.nan
    for line in data.decode("ascii", errors="replace").splitlines():
        start = line.find("$")  # loggers put times of their own before it
        if start < 0:
            continue
        try:
            said = pynmea2.parse(line[start:].strip(), check=True)
            if said.sentence_type == "GGA":
                alt_m = _known(said.altitude)
            elif said.sentence_type == "RMC" and said.status == "A":
                lat_deg, lon_deg = float(said.latitude), float(said.longitude)
                speed_mps = _known(said.spd_over_grnd) * KNOT_MPS
                course = _known(said.true_course)
                yield TrackFix(_moment_ns(said.datetime), lat_deg, lon_deg, alt_m, course, speed_mps, source="gps")
        except (pynmea2.ParseError, TypeError, ValueError):
            continue  # cut or garbled on its way, as its checksum says


def _geojson_fixes(file: Path, data: bytes) -> Iterator[TrackFix]:
    try:
        found = json.loads(data)
        for feature in found["features"] if found["type"] == "FeatureCollection" else [found]:
            points, kind = feature["geometry"]["coordinates"], feature["geometry"]["type"]
            said = feature.get("properties") or {}
            times = said.get("coordTimes") or said.get("coordinateProperties", {}).get("times") or said.get("times")
            if kind == "Point":
                points, times = [points], [said.get("time") or said.get("timestamp")]
            elif kind == "MultiLineString":
                points, times = list(chain(*points)), list(chain(*(times or ())))
            if not times or None in times or len(times) != len(points):
                raise FeedError(f"{file}: a {kind} without a time for each point (coordTimes, or time of a Point)")
            for (lon_deg, lat_deg, *alt_m), time in zip(points, times, strict=True):
                yield _at(parse_time_ns(str(time), f"{file}: time"), lat_deg, lon_deg, alt_m)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise FeedError(f"{file}: not a GeoJSON track: {type(error).__name__}: {error}") from None


def _kml_fixes(file: Path, data: bytes) -> Iterator[TrackFix]:
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        raise FeedError(f"{file}: not a whole KML file: {error}") from None
    tracks = list(root.iter("{http://www.google.com/kml/ext/2.2}Track"))
    if not tracks:
        raise FeedError(f"{file}: no gx:Track in it, so its points have no times; export the track as GPX")
    for track in tracks:
        times = [one.text or "" for one in track if one.tag.endswith("}when")]
        coords = [(one.text or "").split() for one in track if one.tag.endswith("}coord")]
        if len(times) != len(coords):
            raise FeedError(f"{file}: {len(times)} times for {len(coords)} points of a gx:Track")
        for time, coord in zip(times, coords, strict=True):
            try:
                lon_deg, lat_deg, *alt_m = map(float, coord)
            except ValueError:
                raise FeedError(f"{file}: a gx:coord of {' '.join(coord)!r} is no longitude and latitude") from None
            yield _at(parse_time_ns(time.strip(), f"{file}: when"), lat_deg, lon_deg, alt_m)


def _at(stamp_ns: int, lat_deg: float, lon_deg: float, alt_m: list[float]) -> TrackFix:
    return TrackFix(stamp_ns, lat_deg, lon_deg, alt_m[0] if alt_m else math.nan, source="gps")


def _moment_ns(moment: datetime) -> int:
    return round(moment.timestamp() * 1e6) * 1000


def _known(value: Any) -> float:
    return math.nan if value is None or value == "" else float(value)


def _srt_fixes(file: Path, data: bytes) -> Iterator[TrackFix]:
    """By the times of the subtitles, which are those of the video."""
    for cue in re.split(r"\r?\n\s*\r?\n", data.decode("utf-8-sig", "replace").replace("longt", "long")):
        begun, named, pair = SRT_BEGINS.search(cue), dict(SRT_NAMED.findall(cue)), SRT_PAIR.search(cue)
        lon_deg, lat_deg = pair.groups() if pair else (named.get("longitude"), named.get("latitude"))
        if begun is None or lon_deg is None or lat_deg is None or not (float(lat_deg) or float(lon_deg)):
            continue  # before it has a fix it says 0, 0
        hours, minutes, seconds, part = map(int, begun.groups())
        stamp_ns = (3600 * hours + 60 * minutes + seconds) * 10**9 + part * 10**6
        at = float(lat_deg), float(lon_deg), float(named.get("abs_alt", "nan")), math.nan, math.nan
        yield TrackFix(stamp_ns, *at, source="gps")


TRACKS: dict[str, Callable[[Path, bytes], Iterable[TrackFix]]] = {
    ".gpx": _gpx_fixes,
    ".fit": _fit_fixes,
    ".nmea": _nmea_fixes,
    ".geojson": _geojson_fixes,
    ".kml": _kml_fixes,
    ".srt": _srt_fixes,
    ".csv": lambda file, _: positions_in(file),
}
"""By the suffix; of several beside a video the first is used, as loggers write the same track more than once."""
