"""`lookback export`: what a journal or a replay tells of places, for maps, GPS tools, Google Earth and evo."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import msgspec

from edge.errors import ConfigError, FeedError
from edge.journal.journal import read_journal
from sim.evaluation.trajectories import Fix, tum

EVENT, SEEN = "place", "frame"


@dataclass(frozen=True)
class Told:
    """One record with a position: an event, or a frame whose match was believed; `fields` is all that it says.

    time_s: Unix time where the record has it, else the stamp of its frame in seconds.
    """

    kind: str
    time_s: float
    lat_deg: float
    lon_deg: float
    heading_deg: float | None
    fields: dict[str, Any]

    @property
    def name(self) -> str:
        """What a map shows beside the point."""
        return f"place {self.fields['place']}"


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `lookback export` to the command line; an entry point of `lookback.commands`."""
    parser = commands.add_parser("export", help="events and runs as GeoJSON, GPX, KML or TUM")
    parser.add_argument("journal", type=Path, metavar="JOURNAL", help="a journal, or lines that replay wrote")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE", help=", ".join(WRITERS))
    parser.add_argument("--events-only", action="store_true", help="leave out the track of believed frames")
    parser.set_defaults(run=_run)


def read_told(path: Path) -> list[Told]:
    """The events and believed frames of a journal or of replay's lines, in order, as far as they have a position."""
    try:
        records = [_told(record) for record in read_journal(path)]
    except OSError as error:
        raise FeedError(f"{path}: cannot read it: {error.strerror}") from None
    return [told for told in records if told is not None]


def _told(record: dict[str, Any]) -> Told | None:
    # Replay's lines have no name; those that went out are events.
    kind = record.get("event", EVENT if record.get("emitted") else SEEN)
    if kind not in (EVENT, SEEN) or record.get("lat_deg") is None or not record.get("accepted", True):
        return None
    time_s = record.get("unix_s", record["stamp_ns"] / 1e9)
    return Told(kind, time_s, record["lat_deg"], record["lon_deg"], record.get("heading_deg"), record)


def as_geojson(told: Sequence[Told], name: str) -> str:
    """RFC 7946, longitude first: a point an event with all its fields, and a line through all."""
    features: list[dict[str, Any]] = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [one.lon_deg, one.lat_deg]},
            "properties": {"name": one.name, "time": _utc(one).isoformat(), **one.fields},
        }
        for one in told
        if one.kind == EVENT
    ]
    if len(told) > 1:
        line = [[one.lon_deg, one.lat_deg] for one in told]
        properties = {"name": name}
        features.append(
            {"type": "Feature", "geometry": {"type": "LineString", "coordinates": line}, "properties": properties}
        )
    return msgspec.json.encode({"type": "FeatureCollection", "features": features}).decode()


def as_gpx(told: Sequence[Told], name: str) -> str:
    """A waypoint an event, and a track of all."""
    import gpxpy.gpx

    gpx = gpxpy.gpx.GPX()
    gpx.creator = "lookback"
    segment = gpxpy.gpx.GPXTrackSegment()
    for one in told:
        at: dict[str, Any] = {"latitude": one.lat_deg, "longitude": one.lon_deg, "time": _utc(one)}
        segment.points.append(gpxpy.gpx.GPXTrackPoint(**at))
        if one.kind == EVENT:
            gpx.waypoints.append(gpxpy.gpx.GPXWaypoint(**at, name=one.name, description=_described(one)))
    gpx.tracks.append(gpxpy.gpx.GPXTrack(name=name))
    gpx.tracks[0].segments.append(segment)
    return str(gpx.to_xml())


def as_kml(told: Sequence[Told], name: str) -> str:
    """A placemark an event, and a line through all."""
    import simplekml

    kml = simplekml.Kml(name=name)
    for one in told:
        if one.kind == EVENT:
            point = kml.newpoint(name=one.name, description=_described(one), coords=[(one.lon_deg, one.lat_deg)])
            point.timestamp.when = _utc(one).isoformat()
    kml.newlinestring(name=name, coords=[(one.lon_deg, one.lat_deg) for one in told])
    return str(kml.kml())


def as_tum(told: Sequence[Told], name: str) -> str:
    """`stamp x y z qx qy qz qw` a line, metres from the first; what evo reads."""
    fixes = [Fix(round(one.time_s * 1e9), one.lat_deg, one.lon_deg, one.heading_deg) for one in told]
    return tum(fixes, fixes[0])


WRITERS: dict[str, Callable[[Sequence[Told], str], str]] = {
    ".geojson": as_geojson,
    ".gpx": as_gpx,
    ".kml": as_kml,
    ".tum": as_tum,
}


def _described(one: Told) -> str:
    fields = one.fields
    words = [fields.get("category") or "", fields.get("direction") or "", f"uniqueness {fields.get('uniqueness')}"]
    return ", ".join(word for word in words if word)


def _utc(one: Told) -> datetime:
    return datetime.fromtimestamp(one.time_s, tz=timezone.utc)


def _run(args: argparse.Namespace) -> int:
    writer = WRITERS.get(args.output.suffix.lower())
    if writer is None:
        raise ConfigError(f"--output: {args.output}: a name that ends in one of {', '.join(WRITERS)}")
    told = [one for one in read_told(args.journal) if one.kind == EVENT or not args.events_only]
    if not told:
        raise FeedError(f"{args.journal}: no place with a position in it; a map without positions gives none")
    try:
        text = writer(told, args.journal.stem)
    except ModuleNotFoundError as error:
        raise ConfigError(f"{args.output.suffix} needs {error.name}: pip install 'lookback[desk]'") from None
    try:
        args.output.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"--output: {args.output}: cannot write it: {error.strerror}") from None
    events = sum(one.kind == EVENT for one in told)
    print(f"{args.output}: {events} events, {len(told) - events} further frames")
    return 0
