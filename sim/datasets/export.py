"""`lookback export`: write the recognized places of a journal or a replay as GeoJSON, GPX, KML or TUM."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from edge.errors import FeedError
from edge.geodesy import east_north
from edge.journal.records import FrameUsed, PlaceFix
from sim.ground_files import GroundLine, as_geojson, as_gpx, as_kml, write_by_suffix
from sim.journal import JournalLine, read_journal
from sim.output import refusing


@dataclass(frozen=True)
class TrackPoint:
    """One position of a track.

    stamp_ns: Unix time where it is known, else the stamp of the frame. fields: what else is known of the point.
    is_event: shown as a point of its own and not only as part of the track.
    """

    stamp_ns: int
    lat_deg: float
    lon_deg: float
    heading_deg: float | None
    fields: Mapping[str, Any] = field(default_factory=dict)
    is_event: bool = False

    @property
    def time(self) -> datetime:
        """The stamp as UTC."""
        return datetime.fromtimestamp(self.stamp_ns / 1e9, tz=timezone.utc)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback export`."""
    parser.add_argument("journal", type=Path, metavar="JOURNAL", help="a journal, or the output of replay")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE", help=", ".join(WRITERS))
    parser.add_argument("--events-only", action="store_true", help="without the track of accepted frames")
    parser.set_defaults(run=_run)


def read_track(path: Path) -> list[TrackPoint]:
    """The events and accepted frames of a journal or of replay's output, in order, where they have a position."""
    with refusing(FeedError, f"{path}: cannot read it"):
        points = [_point(line) for line in read_journal(path)]
    return [point for point in points if point is not None]


def _point(line: JournalLine) -> TrackPoint | None:
    record, is_replay = line.record, line.unix_s is None
    if not isinstance(record, PlaceFix | FrameUsed) or record.lat_deg is None or record.lon_deg is None:
        return None
    if isinstance(record, FrameUsed) and not record.accepted:
        return None
    # A journal has a record of its own for an event, replay has only the frame.
    is_event = isinstance(record, PlaceFix) or (is_replay and record.emitted)
    stamp_ns = record.stamp_ns if line.unix_s is None else round(line.unix_s * 1e9)
    fields = {"unix_s": line.unix_s, **msgspec.to_builtins(record)}
    return TrackPoint(stamp_ns, record.lat_deg, record.lon_deg, record.heading_deg, fields, is_event)


def _event(one: TrackPoint) -> GroundLine:
    """A point, with all its fields."""
    name, time = f"place {one.fields['place']}", one.time
    about = ", ".join(filter(None, (one.fields.get("direction"), f"uniqueness {one.fields['uniqueness']}")))
    fields = {"name": name, "time": time.isoformat(), **one.fields}
    return GroundLine(name, [(one.lat_deg, one.lon_deg)], about, [time], fields)


def _events(points: Sequence[TrackPoint]) -> list[GroundLine]:
    return [_event(one) for one in points if one.is_event]


def _track(points: Sequence[TrackPoint], name: str) -> list[GroundLine]:
    """A line through all points."""
    degrees = [(one.lat_deg, one.lon_deg) for one in points]
    return [GroundLine(name, degrees, times=[one.time for one in points], properties={"name": name})]


def as_tum(points: Sequence[TrackPoint]) -> str:
    """Lines `stamp_s x y z qx qy qz qw`, as evo reads them: meters east, north, up of the first point; yaw in those.

    Where no heading is known, the quaternion is that of looking east.
    """
    degrees = np.array([(one.lat_deg, one.lon_deg) for one in (points[0], *points)])
    lines = []
    for one, (east_m, north_m) in zip(points, east_north(*degrees.T)[1:].tolist(), strict=True):
        # Headings turn clockwise from north, yaw counterclockwise from east.
        yaw_rad = math.radians(90 - one.heading_deg) if one.heading_deg is not None else 0.0
        stamp = f"{one.stamp_ns // 10**9}.{one.stamp_ns % 10**9:09d}"
        half_rad = yaw_rad / 2
        lines.append(f"{stamp} {east_m:.3f} {north_m:.3f} 0 0 0 {math.sin(half_rad):.9f} {math.cos(half_rad):.9f}\n")
    return "".join(lines)


WRITERS: dict[str, Callable[[Sequence[TrackPoint], str], str]] = {
    ".geojson": lambda points, name: as_geojson(_track(points, name) if len(points) > 1 else [], _events(points)),
    ".gpx": lambda points, name: as_gpx(_track(points, name), _events(points)),
    ".kml": lambda points, name: as_kml(_track(points, name), _events(points)),
    ".tum": lambda points, name: as_tum(points),
}
"""By the suffix of the file: points and a name to its text."""


def _run(args: argparse.Namespace) -> int:
    points = [one for one in read_track(args.journal) if one.is_event or not args.events_only]
    if not points:
        raise FeedError(f"{args.journal}: no place with a position in it; a map without positions gives none")
    writers = {suffix: partial(writer, points, args.journal.stem) for suffix, writer in WRITERS.items()}
    write_by_suffix(args.output, writers)
    events = sum(one.is_event for one in points)
    print(f"{args.output}: {events} events, {len(points) - events} further frames")
    return 0
