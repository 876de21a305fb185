"""The trial in small: half a kilometer home, two known stretches and a false one; and what its scores mean."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge.errors import ConfigError
from edge.journal.journal import records_of
from edge.journal.records import FixChecked
from edge.reference_map.store import open_map
from sim.evaluation.memoizing_network import MemoizingNetwork
from sim.trial import command
from sim.trial.course import FALSE_BY_M, KNOWN_M, PLANTED_M, World, lay_course, prepare_world
from sim.trial.run import Rules, drive_home
from sim.trial.score import RunScore, TrialScore

LENGTH_M = 560.0


@pytest.fixture(scope="module")
def world(make_once: Callable[..., Path]) -> World:
    return prepare_world(1, make_once("trial", lambda folder: prepare_world(1, folder, LENGTH_M)), LENGTH_M)


def test_a_course_knows_its_stretches_and_lies_about_one(world: World, tmp_path: Path) -> None:
    course = lay_course(world, 5, tmp_path / "map", stretches=2)
    laid, whole = open_map(course.map_path), world.whole_map
    first, end = course.planted
    assert len(laid.header.segments) == 3
    assert len(laid.places) == pytest.approx((2 * KNOWN_M + PLANTED_M) / 2, abs=3)
    assert (first, end) in [(segment.start, segment.end) for segment in laid.header.segments]
    for index in range(len(laid.places)):
        record = laid.places[index]
        (original,) = whole.places[whole.places["row"] == record["row"]]
        off_m = np.hypot(
            (record["lat_deg"] - original["lat_deg"]) * 110_800, (record["lon_deg"] - original["lon_deg"]) * 98_800
        )
        assert off_m == pytest.approx(FALSE_BY_M if first <= index < end else 0.0, abs=3.0)


def test_the_whole_daemon_drives_home(world: World, network: MemoizingNetwork, tmp_path: Path) -> None:
    """In simulated time: right fixes, honest ones, and none of the false place, which is recognized."""
    course = lay_course(world, 5, tmp_path / "map", stretches=2)
    run = drive_home(world, course, 5, network, tmp_path, Rules())
    assert len(run.after_m) >= 5
    assert np.median(run.after_m) <= 4.0
    assert max(run.fix_sigmas) <= 3.0
    assert run.planted_seen
    assert not run.false_fixes
    assert run.withheld["impossibly far"] >= 1
    assert run.answers == {"ACCEPTED": len(run.after_m)}
    checked = [record.moved for record in records_of(tmp_path / "journal.jsonl", FixChecked)]
    assert checked and all(checked)


def test_without_gps_from_boot_the_autopilot_finds_where_it_is(
    world: World, network: MemoizingNetwork, tmp_path: Path
) -> None:
    """Its origin was set some 20 m from where it starts, and the first stretch it recognizes needs a second."""
    course = lay_course(world, 5, tmp_path / "map", stretches=2)
    run = drive_home(world, course, 5, network, tmp_path, Rules(gps_at_start=False))
    assert run.withheld["not confirmed by another place yet"] >= 1
    assert not run.false_fixes
    assert run.after_m
    assert max(run.after_m) <= 10.0


def test_px4_is_told_a_stream(world: World, network: MemoizingNetwork, tmp_path: Path) -> None:
    course = lay_course(world, 6, tmp_path / "map", stretches=2)
    run = drive_home(world, course, 6, network, tmp_path, Rules("px4"))
    assert len(run.after_m) >= 25
    assert np.percentile(run.after_m, 95) <= 10.0
    assert not run.false_fixes


GOOD = RunScore(1, "day", (1.0,), (0.5,), (9.0,), (1.0,), 0, 3, {}, {"ACCEPTED": 1})


@pytest.mark.parametrize(
    ("change", "failure"),
    [
        ({}, None),
        ({"after_m": (4.0,)}, "median"),
        ({"after_m": (1.0,) * 5 + (12.0,) * 2}, "95 %"),
        ({"fix_sigmas": (3.1,)}, "1 fixes more than 3 sigma wrong"),
        ({"false_fixes": 1}, "planted false place"),
        ({"after_m": ()}, "no fix was used"),
    ],
)
def test_what_is_not_good_enough(change: dict[str, object], failure: str | None) -> None:
    failures = TrialScore((replace(GOOD, **change),)).failures  # type: ignore[arg-type]  # fields by name
    assert (failure is None) == (failures == [])
    assert failure is None or failure in failures[0]


def test_the_table_names_every_figure() -> None:
    table = TrialScore((GOOD,)).table()
    assert "autopilot after a fix        median 1.00 m" in table
    assert "recognized in 1 runs, sent 0 times" in table


def test_no_runs_are_refused() -> None:
    parser = argparse.ArgumentParser()
    command.add_command(parser.add_subparsers())
    args = parser.parse_args(["fixes", "--runs", "0"])
    with pytest.raises(ConfigError, match="at least 1"):
        args.run(args)
