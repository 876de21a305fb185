"""Where a method says that the query was, for other programs.

TUM (evo), GeoJSON and GPX beside the true drive; and for sequences of NSAVP the files that its evaluator reads, as
https://github.com/umautobots/nsavp_tools specifies them (documentation/place_recognition.md):

    python3 place_recognition/evaluation.py timestamps_query.txt timestamps_reference.txt R0_RA0_applanix.h5
        R0_FA0_applanix.h5 R0_RA0_M0_measured_extrinsics.yaml R0_FA0_M0_measured_extrinsics.yaml mono_left mono_left
        match_candidates.json
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from sim.datasets.export import WRITERS, TrackPoint

if TYPE_CHECKING:
    from sim.research.evaluation.method_runner import Outcome


def write_trajectories(folder: Path, slug: str, outcome: Outcome) -> None:
    """Write SLUG_{truth,answers}.{tum,geojson,gpx}; nothing for pairs whose truth is not in positions.

    Of NSAVP, a folder SLUG_nsavp as well.
    """
    if outcome.pair.truth != "positions":
        return
    if all(one.feed.header.source.startswith("NSAVP ") for one in (outcome.reference, outcome.query)):
        write_candidates(folder / f"{slug}_nsavp", outcome)
    truth = _driven(outcome)
    for name, points in (("truth", truth), ("answers", _answered(outcome))):
        for suffix in (".tum", ".geojson", ".gpx"):
            path = folder / f"{slug}_{name}{suffix}"
            path.write_text(WRITERS[suffix](points, path.stem, truth[0]), encoding="utf-8")


def write_candidates(folder: Path, outcome: Outcome) -> None:
    """Write timestamps_query.txt and timestamps_reference.txt (seconds, TAI), and match_candidates.json.

    A match is at the place that lies the rig's offset behind it. Of `distances` the evaluator only uses the order.
    """
    folder.mkdir(exist_ok=True)
    for name, one in (("query", outcome.query), ("reference", outcome.reference)):
        stamps = [f"{row.stamp_ns // 10**9}.{row.stamp_ns % 10**9:09d}\n" for row in one.feed_rows()]
        (folder / f"timestamps_{name}.txt").write_text("".join(stamps), encoding="utf-8")
    places = outcome.places_of_vehicle()
    answered = outcome.judged[places[outcome.judged] >= 0]
    candidates = {
        "query_ids": answered.tolist(),
        "reference_ids": places[answered].tolist(),
        "distances": (-outcome.matches.confidence[answered]).tolist(),
    }
    (folder / "match_candidates.json").write_bytes(msgspec.json.encode(candidates))


def _driven(outcome: Outcome) -> list[TrackPoint]:
    return [
        TrackPoint(row.stamp_ns, row.lat_deg, row.lon_deg, row.heading_deg)
        for row in outcome.query.feed_rows()
        if row.lat_deg is not None and row.lon_deg is not None
    ]


def _answered(outcome: Outcome) -> list[TrackPoint]:
    """Position of the place behind the matched one by the rig's offset, for every frame that has an answer."""
    rows, places = outcome.query.feed_rows(), outcome.reference.feed_rows()
    errors, of_vehicle = outcome.error_of_best(), outcome.places_of_vehicle()
    found = []
    for query in outcome.judged.tolist():
        place = int(of_vehicle[query])
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
