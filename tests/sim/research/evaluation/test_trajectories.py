"""Tracks as other programs read them."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from edge.config import SamplingConfig
from edge.geodesy import east_north
from sim.datasets.export import TrackPoint, as_gpx, as_tum
from sim.research.evaluation.matching import judge
from sim.research.evaluation.plan import NetworkPlan, Pair, Plan, TraversePlan
from sim.research.evaluation.run import Folders, open_runner
from sim.research.evaluation.scores import scores
from sim.research.evaluation.trajectories import write_trajectories

NORTH_M = 110_574.0  # a degree of latitude at the equator
ORIGIN = TrackPoint(1_700_000_000_123_456_789, 0.0, 0.0, 90.0)
THERE = TrackPoint(1_700_000_001_000_000_000, 100 / NORTH_M, 0.0, 0.0)


def test_tum_has_meters_from_the_origin_and_yaw_as_quaternion() -> None:
    rows = [[float(value) for value in line.split()] for line in as_tum([ORIGIN, THERE], "", ORIGIN).splitlines()]
    assert all(len(row) == 8 for row in rows)
    assert rows[0][1:] == [0, 0, 0, 0, 0, 0, 1]  # looks east
    assert abs(rows[1][2] - 100) < 0.1 and abs(rows[1][1]) < 1e-6
    assert abs(2 * math.atan2(rows[1][6], rows[1][7]) - math.pi / 2) < 1e-6  # looks north
    assert as_tum([ORIGIN], "", ORIGIN).startswith("1700000000.123456789 ")  # no nanosecond is lost


def test_tum_without_headings_is_whole() -> None:
    assert as_tum([TrackPoint(0, 0.0, 0.0, None)], "", ORIGIN).split()[-4:] == ["0", "0", "0.000000000", "1.000000000"]


def test_a_name_is_escaped() -> None:
    assert "<name>dusk &amp; night</name>" in as_gpx([ORIGIN, THERE], "dusk & night", ORIGIN)


def test_the_files_for_the_evaluator_of_nsavp_give_the_scores_of_the_report(tmp_path: Path, write_feed: Any) -> None:
    """Scored as its class PlaceRecognitionEvaluator documents: queries without a candidate are missed."""
    write_feed("there", [2.0 * step for step in range(80)])
    write_feed("home", [130.0 - 2 * step for step in range(60)], sees_m=6.0, light=0.5)
    for name in ("there", "home"):
        header = tmp_path / name / "feed.toml"
        header.write_text(header.read_text().replace('source = ""', "") + f'source = "NSAVP R0_{name}_mono_left"\n')
    pair = Pair("p", "there", "home", "positions", tolerance=5.0, length=10, ahead=-6.0)
    plan = Plan(
        title="t",
        methods=["SeqSLAM/causal"],
        traverses={name: TraversePlan(feed=name) for name in ("there", "home")},
        pairs=[pair],
        sampling=SamplingConfig(by="frames"),
        networks={"shipped": NetworkPlan()},
    )
    outcome = open_runner(plan, Folders(tmp_path, tmp_path, tmp_path, tmp_path)).run(pair, "SeqSLAM/causal")
    places = np.where(np.arange(60) % 7 == 6, 3, outcome.matches.place)  # some are wrong
    matches = replace(outcome.matches, place=places)
    outcome = replace(outcome, matches=matches, answers=judge(matches, outcome.errors, pair.tolerance, outcome.judged))
    write_trajectories(tmp_path, "p", outcome)
    folder = tmp_path / "p_nsavp"
    stamps_s = [np.loadtxt(folder / f"timestamps_{name}.txt") for name in ("query", "reference")]
    assert [len(stamps) for stamps in stamps_s] == [60, 80] and stamps_s[0][3] == 1.5
    found = json.loads((folder / "match_candidates.json").read_text())
    assert sorted(found) == ["distances", "query_ids", "reference_ids"]

    at = [np.interp(stamps, stamps, place) for stamps, place in zip(stamps_s, _north_m(outcome), strict=True)]
    right = np.abs(at[0][found["query_ids"]] - at[1][found["reference_ids"]]) <= pair.tolerance
    best_first = np.argsort(found["distances"])
    hits = right[best_first].cumsum()
    possible = sum(np.abs(at[1] - place).min() <= pair.tolerance for place in at[0][9:])
    whole = hits == np.arange(1, len(hits) + 1)
    assert 0.02 < scores(outcome.answers).recall_at_100 == hits[whole].max() / possible < 0.9


def _north_m(outcome: Any) -> list[Any]:
    tables = [[(row.lat_deg, row.lon_deg) for row in one.feed_rows()] for one in (outcome.query, outcome.reference)]
    return [
        east_north(np.array(table, float)[:, 0], np.array(table, float)[:, 1], (0.0, 0.0))[:, 1] for table in tables
    ]
