"""Points and lines on the ground as GeoJSON, GPX and KML, and the file whose suffix says which."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from itertools import zip_longest
from pathlib import Path
from typing import Any

import msgspec

from edge.errors import ConfigError
from sim.output import needing, writing


@dataclass(frozen=True)
class GroundLine:
    """points: latitudes and longitudes. about: for people. times: of the points, or none. properties: in GeoJSON."""

    name: str
    points: Sequence[tuple[float, float]]
    about: str = ""
    times: Sequence[datetime] = ()
    properties: Mapping[str, Any] = field(default_factory=dict)


def as_geojson(lines: Sequence[GroundLine], points: Sequence[GroundLine] = ()) -> str:
    """RFC 7946, longitude first. points: lines of one point, which are shown as that."""
    features = [_feature("Point", one, _coordinates(one)[0]) for one in points]
    # A line has two points.
    features += [_feature("LineString", one, (_coordinates(one) * 2)[: max(2, len(one.points))]) for one in lines]
    return msgspec.json.encode({"type": "FeatureCollection", "features": features}).decode()


def as_gpx(lines: Sequence[GroundLine], points: Sequence[GroundLine] = ()) -> str:
    """A waypoint for each point, and a track for each line."""
    import gpxpy.gpx

    gpx = gpxpy.gpx.GPX()
    gpx.creator = "lookback"
    for one in points:
        (lat_deg, lon_deg), time = one.points[0], next(iter(one.times), None)
        gpx.waypoints.append(gpxpy.gpx.GPXWaypoint(lat_deg, lon_deg, time=time, name=one.name, description=one.about))
    for one in lines:
        timed = zip_longest(one.points, one.times)
        track = [gpxpy.gpx.GPXTrackPoint(at[0], at[1], time=time) for at, time in timed]
        gpx.tracks.append(gpxpy.gpx.GPXTrack(name=one.name, description=one.about or None))
        gpx.tracks[-1].segments.append(gpxpy.gpx.GPXTrackSegment(track))
    return str(gpx.to_xml())


def as_kml(lines: Sequence[GroundLine], points: Sequence[GroundLine] = ()) -> str:
    """A placemark for each point and each line."""
    import simplekml

    kml = simplekml.Kml()
    for one in points:
        placemark = kml.newpoint(name=one.name, description=one.about, coords=_coordinates(one))
        placemark.timestamp.when = next((time.isoformat() for time in one.times), None)
    for one in lines:
        kml.newlinestring(name=one.name, description=one.about, coords=_coordinates(one))
    return str(kml.kml())


def write_by_suffix(output: Path, writers: Mapping[str, Callable[[], str]]) -> None:
    """Write the text that the suffix of a file asks for; ConfigError. writers: by suffix."""
    writer = writers.get(output.suffix.lower())
    if writer is None:
        raise ConfigError(f"--output: {output}: use a name that ends in one of {', '.join(writers)}")
    with needing(f"{output.suffix}", "desk"):
        text = writer()
    with writing(output) as stream:
        stream.write(text)


def _coordinates(one: GroundLine) -> list[tuple[float, float]]:
    return [(lon_deg, lat_deg) for lat_deg, lon_deg in one.points]


def _feature(kind: str, one: GroundLine, coordinates: object) -> dict[str, object]:
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": one.properties}
