"""Where a method says that the query was, for other programs: TUM (evo), GeoJSON and GPX, beside the true drive."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from sim.datasets.export import WRITERS, TrackPoint

if TYPE_CHECKING:
    from sim.evaluation.method_runner import Outcome


def write_trajectories(folder: Path, slug: str, outcome: Outcome) -> None:
    """Write SLUG_{truth,answers}.{tum,geojson,gpx}; nothing for pairs whose truth is not in positions."""
    if outcome.pair.truth != "positions":
        return
    truth = _driven(outcome)
    for name, points in (("truth", truth), ("answers", _answered(outcome))):
        for suffix in (".tum", ".geojson", ".gpx"):
            path = folder / f"{slug}_{name}{suffix}"
            path.write_text(WRITERS[suffix](points, path.stem, truth[0]), encoding="utf-8")


def _driven(outcome: Outcome) -> list[TrackPoint]:
    return [
        TrackPoint(row.stamp_ns, row.lat_deg, row.lon_deg, row.heading_deg)
        for row in outcome.query.feed_rows()
        if row.lat_deg is not None and row.lon_deg is not None
    ]


def _answered(outcome: Outcome) -> list[TrackPoint]:
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
        fields = {"place": place, "uniqueness": uniqueness, "error": error}
        found.append(TrackPoint(rows[query].stamp_ns, there.lat_deg, there.lon_deg, heading, fields, is_event=True))
    return found
