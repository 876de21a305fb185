"""Where a method says that the query was, for other programs: TUM (evo), GeoJSON and GPX, beside the true drive.

TUM lines are `stamp_s x y z qx qy qz qw`, metres east, north and up of the first true position, and yaw as quaternion;
where a feed knows no heading, the quaternion is that of looking east.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import escape

import msgspec
import numpy as np

from edge.feed import FeedRow
from edge.reference_map.route import east_north

if TYPE_CHECKING:
    from sim.evaluation.bench import Outcome


@dataclass(frozen=True)
class Fix:
    """A position at the time of a query frame; uniqueness and error_m are of an answer, None of the true drive."""

    stamp_ns: int
    lat_deg: float
    lon_deg: float
    heading_deg: float | None
    uniqueness: float | None = None
    error_m: float | None = None


def write_trajectories(folder: Path, slug: str, outcome: Outcome) -> list[Path]:
    """Write SLUG_{truth,answers}.{tum,geojson,gpx}; nothing for pairs whose truth is not in positions."""
    if outcome.pair.truth != "positions":
        return []
    written = []
    truth, answers = _driven(outcome.query.feed_rows()), _answered(outcome)
    for name, fixes in (("truth", truth), ("answers", answers)):
        spelled = {"tum": tum(fixes, truth[0]), "geojson": geojson(fixes), "gpx": gpx(fixes, f"{slug} {name}")}
        for suffix, text in spelled.items():
            written.append(folder / f"{slug}_{name}.{suffix}")
            written[-1].write_text(text, encoding="utf-8")
    return written


def tum(fixes: Sequence[Fix], origin: Fix) -> str:
    """Lines of the TUM format, metres from `origin`."""
    places = [origin, *fixes]
    metres = east_north(np.array([fix.lat_deg for fix in places]), np.array([fix.lon_deg for fix in places]))[1:]
    lines = []
    for fix, (east_m, north_m) in zip(fixes, metres.tolist(), strict=True):
        # Headings turn clockwise from north, yaw against the clock from east.
        yaw = math.radians(90 - fix.heading_deg) if fix.heading_deg is not None else 0.0
        stamp = f"{fix.stamp_ns // 10**9}.{fix.stamp_ns % 10**9:09d}"
        lines.append(f"{stamp} {east_m:.3f} {north_m:.3f} 0 0 0 {math.sin(yaw / 2):.9f} {math.cos(yaw / 2):.9f}\n")
    return "".join(lines)


def geojson(fixes: Sequence[Fix]) -> str:
    """A point a frame (RFC 7946: longitude first), with what is known of it."""
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [fix.lon_deg, fix.lat_deg]},
            "properties": {"stamp_ns": fix.stamp_ns, "uniqueness": fix.uniqueness, "error_m": fix.error_m},
        }
        for fix in fixes
    ]
    return msgspec.json.encode({"type": "FeatureCollection", "features": features}).decode()


def gpx(fixes: Sequence[Fix], name: str) -> str:
    """One track of GPX 1.1."""
    points = "".join(
        f'<trkpt lat="{fix.lat_deg:.8f}" lon="{fix.lon_deg:.8f}"><time>{_utc(fix.stamp_ns)}</time></trkpt>\n'
        for fix in fixes
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<gpx version="1.1" creator="lookback" xmlns="http://www.topografix.com/GPX/1/1">\n'
        f"<trk><name>{escape(name)}</name><trkseg>\n{points}</trkseg></trk>\n</gpx>\n"
    )


def _utc(stamp_ns: int) -> str:
    return datetime.fromtimestamp(stamp_ns / 1e9, tz=timezone.utc).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def _driven(rows: Sequence[FeedRow]) -> list[Fix]:
    return [
        Fix(row.stamp_ns, row.lat_deg, row.lon_deg, row.heading_deg)
        for row in rows
        if row.lat_deg is not None and row.lon_deg is not None
    ]


def _answered(outcome: Outcome) -> list[Fix]:
    """The matched place's position for every frame that has an answer."""
    rows, places = outcome.query.feed_rows(), outcome.reference.feed_rows()
    errors = outcome.error_of_best()
    found = []
    for query in outcome.judged.tolist():
        place = int(outcome.matches.place[query])
        there = places[place]
        if place < 0 or there.lat_deg is None or there.lon_deg is None:
            continue
        heading = there.heading_deg
        if heading is not None and outcome.matches.reverse[query]:
            heading = (heading + 180) % 360
        uniqueness, error = float(outcome.matches.confidence[query]), float(errors[query])
        found.append(Fix(rows[query].stamp_ns, there.lat_deg, there.lon_deg, heading, uniqueness, error))
    return found
