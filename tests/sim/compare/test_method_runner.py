"""The row named Lookback is what `lookback replay` does, frame by frame; and how far ahead its answers lie."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from edge.config import AcceptanceConfig, Config, SamplingConfig
from edge.descriptor.network import Network
from edge.feed import read_feed
from edge.reference_map import MapSet, open_map
from sim.compare.comparison import median_ahead, offset_warnings
from sim.compare.matching import Matches, judge, judged_queries
from sim.compare.method_runner import MethodRunner
from sim.compare.plan import NetworkPlan, Pair, Plan, TraversePlan, load_plan
from sim.compare.run import SHIPPED, Folders, open_runner
from sim.evaluation.recognition import recognize
from sim.maps.command import build_map

LENGTH, TOLERANCE, FRAMES = 10, 5.0, 40


def test_the_evaluation_answers_as_the_recognizer_does(shared: Path, network: Network, tmp_path: Path) -> None:
    feeds = shared / "feeds"
    plan = Plan(
        title="corridor",
        methods=["Lookback"],
        networks={"fc6": NetworkPlan(model="fc6")},
        traverses={name: TraversePlan(feed=f"corridor_{name}", last_row=FRAMES - 1) for name in ("reference", "query")},
        pairs=[Pair("p", "reference", "query", "rows", tolerance=TOLERANCE, length=LENGTH)],
        sampling=SamplingConfig(by="frames"),
    )
    outcome = open_runner(plan, Folders(feeds, feeds, feeds, tmp_path)).run(plan.pairs[0], "Lookback")

    default = Config()
    config = msgspec.structs.replace(
        default,
        sampling=plan.sampling,
        descriptor=msgspec.structs.replace(default.descriptor, region_width=plan.region_width, standing_change=0.0),
        sequence=msgspec.structs.replace(default.sequence, length=LENGTH),
        # The corridor's nominal meter is one frame.
        acceptance=AcceptanceConfig(window_m=2 * TOLERANCE, window_places=round(2 * TOLERANCE)),
    )
    reference, query = (
        replace(feed, rows=feed.rows[:FRAMES])
        for feed in (read_feed(feeds / "corridor_reference"), read_feed(feeds / "corridor_query"))
    )
    build_map([reference], tmp_path / "map", config.descriptor, config.sampling, network=network)
    lines = recognize(MapSet.of(open_map(tmp_path / "map")), query, config, network).used

    assert [line.place if line.place is not None else -1 for line in lines] == outcome.matches.place.tolist()
    assert [line.confidence for line in lines[LENGTH - 1 :]] == outcome.matches.confidence[LENGTH - 1 :].round(
        4
    ).tolist()


def test_right_answers_ahead_of_the_truth_are_told_from_those_behind(tmp_path: Path, write_feed: Any) -> None:
    write_feed("there", [2.0 * step for step in range(20)])
    write_feed("here", [10.0, 12.0, 14.0, 16.0])
    plan = Plan(
        title="ahead",
        methods=["SeqSLAM"],
        networks={"fc6": NetworkPlan(model="fc6")},
        traverses={name: TraversePlan(feed=name) for name in ("there", "here")},
        pairs=[Pair("p", "there", "here", "positions", tolerance=9.0, length=1)],
        sampling=SamplingConfig(by="frames"),
    )
    outcome = open_runner(plan, Folders(tmp_path, tmp_path, tmp_path, tmp_path)).run(plan.pairs[0], "SeqSLAM")
    # The truth is places 5 to 8; answers lie 1, 3 and 4 places on, and one is wrong.
    places = np.array([6, 9, 11, 0])
    for reverse, ahead_m in ((False, 6.0), (True, -6.0)):
        matches = replace(outcome.matches, place=places, reverse=np.full(4, reverse))
        answers = judge(matches, outcome.errors, 9.0, outcome.judged)
        assert abs(median_ahead(replace(outcome, matches=matches, answers=answers)) - ahead_m) < 0.1


def runner_on(tmp_path: Path, pairs: list[Pair], *feeds: str) -> MethodRunner:
    plan = Plan(
        title="street",
        methods=["Raw-fc6"],
        networks={"fc6": NetworkPlan(model="fc6")},
        traverses={name: TraversePlan(feed=name) for name in feeds},
        pairs=pairs,
        sampling=SamplingConfig(by="frames"),
    )
    return open_runner(plan, Folders(tmp_path, tmp_path, tmp_path, tmp_path))


def test_the_offset_is_measured_on_another_drive_and_moves_what_is_right(tmp_path: Path, write_feed: Any) -> None:
    """The rear camera's place shows what the front camera sees 16 m before it."""
    write_feed("rear", [2.0 * step for step in range(80)], view="rear")
    for name, start_m in (("front", 4.0), ("before", 14.0)):
        write_feed(name, [start_m + 2.0 * step for step in range(50)], sees_m=16.0)
    pair = Pair("p", "rear", "front", "positions", tolerance=5.0, length=10)
    runner = runner_on(tmp_path, [pair], "rear", "front", "before")
    plain = runner.run(pair, "Raw-fc6")
    assert not plain.answers.correct.any()
    wide = msgspec.structs.replace(pair, tolerance=20.0)
    cut_off = runner_on(tmp_path, [wide], "rear", "front")
    (warning,) = offset_warnings(cut_off, {("p", "Raw-fc6"): cut_off.run(wide, "Raw-fc6")})
    assert "a median of 16 ahead, where 0 is expected, near the tolerance of 20" in warning
    for changes in ({"ahead": 16.0}, {"calibration": "before"}):
        outcome = runner.run(msgspec.structs.replace(pair, **changes), "Raw-fc6")
        assert abs(outcome.ahead - 16.0) < 0.5 and outcome.answers.correct.mean() > 0.9
        assert abs(median_ahead(outcome) - 16.0) < 0.5
        assert not offset_warnings(runner, {("p", "Raw-fc6"): outcome})


def test_lines_run_as_the_query_is_known_to_pass_the_reference(tmp_path: Path, write_feed: Any) -> None:
    write_feed("out", [2.0 * step for step in range(40)])
    write_feed("home", [2.0 * step for step in range(39, -1, -1)], view="rear")  # it sees what the other saw
    pair = Pair("p", "out", "home", "positions", tolerance=5.0, length=10)
    runner = runner_on(tmp_path, [pair], "out", "home")
    for method in ("Raw-fc6", "Lookback/uniqueness"):
        assert runner.run(pair, method).answers.correct.mean() > 0.8
        for directions, correct in (("reverse", True), ("forward", False)):
            outcome = runner.run(msgspec.structs.replace(pair, directions=directions), method)
            assert outcome.matches.reverse[outcome.judged].all() == correct
            assert (outcome.answers.correct.mean() > 0.8) == correct


@pytest.mark.long  # methods on recordings: what fails there alone is a figure
def test_real_streets_front_against_rear(shared: Path, tmp_path: Path) -> None:
    plan = load_plan(SHIPPED / "real_front_rear.toml")
    plan = msgspec.structs.replace(plan, networks={"fc6": NetworkPlan(model="fc6")})
    feeds = shared / "feeds/street_front_rear"
    outcome = open_runner(plan, Folders(feeds, feeds, feeds, tmp_path)).run(plan.pairs[0], "Raw-fc6")
    assert len(outcome.query.drives()) == 6
    assert len(outcome.judged) == len(outcome.query.rows) - 6 * 9
    assert outcome.answers.correct.mean() > 0.4  # a guess is right in 0.05


@pytest.mark.long
def test_with_an_odometer_a_third_of_real_streets_is_accepted_and_nothing_wrong(shared: Path, tmp_path: Path) -> None:
    """Also on the map of all others, where no place is right; docs/back-to-back.md has the figures."""
    plan = load_plan(SHIPPED / "real_front_rear_odometer.toml")
    plan = msgspec.structs.replace(plan, networks={"grid": NetworkPlan(model="grid")})
    (pair,), rear, front = plan.pairs, plan.traverses["rear"].feeds, plan.traverses["front"].feeds
    others = {f"without {one}": TraversePlan(feeds=tuple(rear[:at] + rear[at + 1 :])) for at, one in enumerate(rear)}
    alone = {one: TraversePlan(feeds=(one,)) for one in front}
    plan = msgspec.structs.replace(plan, traverses={**plan.traverses, **others, **alone})
    feeds = shared / "feeds/street_front_rear"
    runner = open_runner(plan, Folders(feeds, feeds, feeds, tmp_path))
    answers, least = runner.run(pair, "Lookback").answers, AcceptanceConfig().confidence_from
    accepted = np.nan_to_num(answers.confidence) >= least
    assert (accepted.mean(), answers.correct.mean()) == (pytest.approx(0.34, abs=0.04), pytest.approx(0.88, abs=0.04))
    assert answers.correct[accepted].all()
    for scene, other in zip(front, others, strict=True):
        reference, query = runner.traverse(other), runner.traverse(scene)
        length = runner.sequence_length(pair)
        found = runner.match(pair, runner.method("Lookback"), reference, query, length)
        assert (np.nan_to_num(found.confidence) < least).all()


def test_a_traverse_that_ends_earlier_is_not_described_again(tmp_path: Path, write_feed: Any) -> None:
    write_feed("there", [2.0 * step for step in range(12)])
    traverses = {"whole": TraversePlan(feed="there"), "part": TraversePlan(feed="there", last_row=6)}
    plan = Plan(
        "t", ["Raw-fc6"], traverses, [Pair("p", "part", "whole", length=2)], sampling=SamplingConfig(by="frames")
    )
    runner = open_runner(plan, Folders(tmp_path, tmp_path, tmp_path, tmp_path))
    whole, part = (runner.traverse(name) for name in ("whole", "part"))
    raw = runner.descriptions.raw(whole, "grid", "left-right")
    again = runner.descriptions.raw(part, "grid", "left-right")
    assert np.array_equal(again, raw[:7])
    took_ms = [runner.descriptions.frame_ms(one, "grid", "left-right") for one in (whole, part)]
    assert took_ms[0] == took_ms[1]


def test_a_query_of_unknown_position_is_not_judged_and_one_off_the_map_is() -> None:
    errors = np.array([[0.0, 9.0], [np.nan, np.nan], [9.0, 0.0], [99.0, np.inf], [1.0, 8.0]])
    assert judged_queries(errors, length=1).tolist() == [0, 2, 3, 4]
    assert judged_queries(errors, length=3).tolist() == [2, 3, 4]
    place = np.array([0, 0, 1, 0, -1])
    matches = Matches(place, np.ones(5), np.zeros(5, np.bool_), np.zeros((5, 2), np.float32))
    answers = judge(matches, errors, 2.0, np.array([0, 2, 3, 4]))
    assert answers.has_truth.tolist() == [True, True, False, True]
    assert answers.correct.tolist() == [True, True, False, False]


def test_the_ten_best_places_are_put_in_the_order_of_their_inliers(shared: Path, tmp_path: Path) -> None:
    """In a corridor, where a place is known within one frame: 25 of 40 by keypoints, 17 by descriptors."""
    feeds, methods = shared / "feeds", ["NSD-single", "Keypoints"]
    plan = Plan(
        title="corridor",
        methods=methods,
        traverses={name: TraversePlan(feed=f"corridor_{name}", last_row=39) for name in ("reference", "query")},
        pairs=[Pair("p", "reference", "query", "rows", tolerance=1.0, length=1)],
        sampling=SamplingConfig(by="frames"),
    )
    runner = open_runner(plan, Folders(feeds, feeds, feeds, tmp_path))
    alone, by_inliers = (runner.run(plan.pairs[0], method) for method in methods)
    np.testing.assert_array_equal(np.sort(by_inliers.matches.ranked), np.sort(alone.matches.ranked))
    right = [int((outcome.error_of_best() <= 1.0).sum()) for outcome in (alone, by_inliers)]
    assert right[1] > right[0] + 5
    assert (by_inliers.matches.confidence == by_inliers.matches.confidence.round()).all()
    assert by_inliers.frame_ms > alone.frame_ms
