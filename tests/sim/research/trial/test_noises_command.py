"""`lookback dev noises` on a drive whose errors are known."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from edge.commands.parser import build_parser
from edge.errors import FeedError
from edge.geodesy import moved
from sim.research.trial.noises_command import Noises, compare, table
from sim.research.trial.recorded_drive import RecordedDrive
from sim.vehicle.position_inputs import east_north_m
from sim.world.scenario import Scenario
from tests.golden.harness import HERE
from tests.localization.route_bench import OPPOSITE_M, Bench
from tests.localization.route_course import HOME, Course


def truth_of(bench: Bench) -> RecordedDrive:
    """A drive as it was recorded, of which nothing but the truth matters here."""
    stamps_ns = list(bench.truths)
    points = np.array([east_north_m(*moved(*HOME, *true_m.tolist())) for true_m in bench.truths.values()])
    heading_deg = np.degrees(np.unwrap(np.arctan2(*np.gradient(points, axis=0).T)))
    columns = np.array(stamps_ns) / 1e9, *points.T, heading_deg
    truth = dict(zip(("mono_s", "east_m", "north_m", "heading_deg"), columns, strict=True))
    scenarios = [(-math.inf, Scenario(light="dusk"))]
    return RecordedDrive("one", "map", bench.config, scenarios, points, truth, truth, [], [], [], [], 0.04)


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Noises:
    bench, noises = Bench(Course(scale=0.03, heading_deg=2.0), 3, tmp_path_factory.mktemp("noises")), Noises()
    bench.run()
    compare(bench.config, bench.events, truth_of(bench), noises)
    return noises


def test_what_a_velocity_is_wrong_by_is_found(found: Noises) -> None:
    heading, scale = found["ArduPilot: heading of the velocity, degrees"], found["ArduPilot: scale of the velocity, %"]
    assert np.mean(heading, axis=0)[0] == pytest.approx(-2.0, abs=0.2)
    assert np.mean(scale, axis=0)[0] == pytest.approx(3.0, abs=0.8)


def test_lines_are_as_far_off_as_they_were_drawn(found: Noises) -> None:
    """One drive of 1,200 m is 24 correlation lengths of their errors."""
    off_m, sigmas_m, _ = np.array(found["sequence matches along-track, dusk, again, m"]).T
    assert math.sqrt(np.mean(np.square(off_m))) == pytest.approx(OPPOSITE_M, rel=0.4)
    assert 0.5 < math.sqrt(np.mean(np.square(off_m / sigmas_m))) < 1.6


def test_a_row_says_how_long_errors_stay() -> None:
    rng = np.random.default_rng(1)
    at_m = (2.0 * np.arange(500)).tolist()
    noisy = [{"noise": [*zip(rng.normal(0, 2, 500), [1.0] * 500, at_m, strict=True)]} for _ in range(4)]
    stays = [{"bias": [(side, 1.0, one_m) for one_m in at_m]} for side in (-3.0, 3.0)]
    rows = {row.split(" | ")[0]: row.split(" | ")[2:] for row in table([*noisy, *stays]).splitlines()[2:]}
    measured, rms, of_drive, alike, ratio = rows["| noise"]
    assert measured == "2000" and float(rms) == float(ratio[:-2]) == pytest.approx(2.0, abs=0.1)
    assert float(of_drive) < 0.2 and abs(float(alike)) < 0.1
    assert rows["| bias"] == ["1000", "3.00", "3.00", "1.00", "3.00 |"]


def test_without_lists_it_says_what_makes_them(tmp_path: Path) -> None:
    words = ["dev", "noises", str(tmp_path), str(HERE / "drives")]
    parsed = build_parser(words).parse_args(words)
    with pytest.raises(FeedError, match="`lookback dev flights FOLDER -o"):
        parsed.run(parsed)
