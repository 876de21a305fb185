"""The courses in small, and the parts that judge them."""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge.config import FIRST_NETWORK
from edge.descriptor.network import Network
from edge.errors import ConfigError
from sim.research.trial import course_rules
from sim.research.trial import fixes_command as command
from sim.research.trial.course import Course, CourseDraft, drafted
from sim.research.trial.course_drive import drive
from sim.research.trial.course_rules import HONEST, CourseRun, Failure, Rule, failures
from sim.research.trial.courses import CASES, COURSES, courses_of
from sim.research.trial.courses.maps import on_keypoints
from sim.research.trial.table import (
    ENOUGH_RUNS,
    TABLES,
    CourseScore,
    in_short,
    line,
    put_between,
    shown,
)
from sim.research.trial.ways import joined, placed
from sim.trial.records import FixErrors, TruthTrack
from sim.trial.run import JOURNAL, map_scenario
from sim.trial.views import RoadLibrary
from sim.trial.way import Driver, Leg, along
from sim.vehicle.estimator import Estimator, FilterNoise, OdometryErrors
from sim.world.scenario import Scenario

LENGTH_M, SHORT_M, WORLD = 500.0, 300.0, 21
"""Of a road; the shorter one where keypoints are found in each picture."""
CELL_M = 2
"""Views as far apart as the map's places are: most drives see no others than the map's camera and the first one."""
SMALL = (
    "home",
    "reversing-4",
    "tow",
    "two-laps",
    "gps-multipath",
    "gps-spoofed-jump",
    "gps-spoofed-drag-2-left",
    "wheels-spin",
    "gps-steered-aside",
    "daemon-killed",
    "px4-failsafe",
    "px4-no-velocity-aid",
)
"""Courses driven by `make check`, the first by `make test`; `make smoke` drives take-me-home-night, `make soak` all.

Of "one-stretch", "turn-off" and "false-260" test_route_bench has the same cases without pictures.
"""


@pytest.fixture(scope="module")
def library(make_once: Callable[..., Path]) -> Iterator[RoadLibrary]:
    """The road as the map's camera and a vehicle on its lane see it is rendered once, for all workers."""
    found = RoadLibrary(Network.load(Path(FIRST_NETWORK)), make_once("views", _render_lanes), CELL_M)
    yield found
    found.close()


def _render_lanes(folder: Path) -> None:
    found = RoadLibrary(Network.load(Path(FIRST_NETWORK)), folder, CELL_M)
    home = drafted(COURSES["home"], 1, LENGTH_M, WORLD).home
    for route_m in range(0, int(LENGTH_M) + 1, CELL_M):
        found[home].raw(route_m)
        found[map_scenario(home)].raw(route_m)
    found.save()
    found.close()


def _marked(name: str) -> Any:
    return pytest.param(name, marks=[] if name == SMALL[0] else [pytest.mark.long])


@pytest.mark.parametrize("name", [_marked(name) for name in SMALL])
def test_a_course_is_passed(name: str, library: RoadLibrary, tmp_path: Path) -> None:
    run = drive(COURSES[name], 1, LENGTH_M, WORLD, tmp_path, library)
    assert not run.failures, line(name, run)


@pytest.mark.long
def test_old_pictures_of_a_vehicle_that_never_stops_send_no_wrong_position(
    library: RoadLibrary, tmp_path: Path
) -> None:
    """Where an age of less than two seconds counts as in time, positions are up to 19 m and 8 sigma off.

    An age of over a second must have been seen twice; where it was not, none is sent.
    """
    run = drive(COURSES["pictures-1.5"], 1, LENGTH_M, WORLD, tmp_path, library)
    assert not failures(run, HONEST), line("pictures-1.5", run)
    assert len(run.sent.time_s) <= 10


def test_every_course_says_what_it_is_about_and_can_be_laid() -> None:
    assert {name for case in CASES for name in courses_of(case)} == set(COURSES)
    for one in COURSES.values():
        assert one.about
        for seed in (1, 2):
            draft = drafted(one, seed, LENGTH_M, WORLD)
            assert draft.way.length_m > 300
            assert draft.legs[-1].to_m < draft.way.length_m


def straight(count: int = 600) -> TruthTrack:
    time_s = np.arange(0.0, count) * 0.1
    zeros = np.zeros(count)
    return TruthTrack(time_s, time_s * 8.0, zeros, zeros + 5.0, time_s < 9.0)


def run_of(error_m: float = 2.0, sigma_m: float = 3.0, **changes: object) -> CourseRun:
    """Positions each second from the tenth on."""
    sent_s = np.arange(10.0, 60.0)
    sent = FixErrors(sent_s, np.full(50, error_m), np.full(50, sigma_m))
    track = straight()
    run = CourseRun(1, WORLD, track, track, sent, expected=track.time_s >= 9.0, after_m=np.full(50, error_m))
    return replace(run, **changes)  # type: ignore[arg-type]  # fields by name


CALLED = ((30.0, 4, "Lookback: GPS faulty: 45 m off to the E"),)
"""After 240 m."""
WARNED = ((30.0, 4, "Lookback: not recognized where GPS says we are"),)
SPOOFED = replace(straight(), error_m=np.where(straight().time_s < 20.0, 2.0, 45.0))
"""45 m wrong from 160 m on."""
NOTHING = FixErrors(np.array([]), np.array([]), np.array([]))
BELIEVED = np.array([(5.0, 90.0), (9.0, 3.0), (30.0, 2.0)])
"""A place that is 90 m off, and right ones after 72 and 240 m."""


def with_levels(along_m: float, cross_track_m: float) -> CourseRun:
    """One position that is 1 m off along the way and 8 m across it, with these levels."""
    off_m = np.array([[1.0, -8.0]])
    sent = FixErrors(np.array([10.0]), np.hypot(*off_m.T), np.array([3.0]), off_m)
    return run_of(sent=sent, levels=np.array([[10.01, along_m, cross_track_m]]))


@pytest.mark.parametrize(
    ("rule", "run", "found"),
    [
        (course_rules.within_sigmas, run_of(), ""),
        (course_rules.within_sigmas, run_of(error_m=13.0), "4.3 sigma"),
        (course_rules.no_false_place, run_of(error_m=41.0), "50 false, up to 41 m"),
        (course_rules.within_protection_level, with_levels(2.0, 9.0), ""),
        (course_rules.within_protection_level, with_levels(12.0, 7.0), "1 positions"),
        (course_rules.not_worse, run_of(), ""),
        (
            course_rules.not_worse,
            run_of(track=replace(straight(), error_m=np.full(600, 7.0))),
            "error 7.0 m, alone 5.0 m",
        ),
        (
            course_rules.not_worse,
            run_of(track=replace(straight(), cross_track_m=np.full(600, -2.0))),
            "cross-track 2.0 m, alone 0.0",
        ),
        (course_rules.close, run_of(error_m=3.5), "median after 3.5 m"),
        (course_rules.close, run_of(after_m=np.array([])), "median after 5.0 m"),
        (course_rules.close, run_of(track=replace(straight(), error_m=np.ones(600)), after_m=np.array([])), ""),
        (course_rules.sends, run_of(), ""),
        (course_rules.sends, run_of(sent=NOTHING), "share sent 0.00"),
        (course_rules.resumes, run_of(), ""),
        (course_rules.resumes, run_of(sent=NOTHING), "none for 350 m at 42"),
        (course_rules.resumes, run_of(sent=FixErrors(*np.array([[10.0], [1.0], [3.0]]))), "none for 200 m at 28"),
        (course_rules.arrives, run_of(), ""),
        (course_rules.arrives, run_of(track=replace(straight(), end_off_m=12.0)), "12 m off"),
        (course_rules.on_its_lane, run_of(), ""),
        (
            course_rules.on_its_lane,
            run_of(track=replace(straight(), cross_track_m=np.full(600, -6.0))),
            "cross-track 6.0 m",
        ),
        (course_rules.never_sent, run_of(), "50 sent"),
        (course_rules.not_with_gps, run_of(), ""),
        (course_rules.not_with_gps, run_of(track=replace(straight(), gps=straight().time_s > 40)), "17 sent with GPS"),
        (course_rules.sources_restored, run_of(source_set=2), "ends on source set 2"),
        (course_rules.warns, run_of(), "no warning"),
        (course_rules.warns, run_of(texts=((20.0, 4, "positions are not used"),)), ""),
        (course_rules.called_before_50_m, run_of(), ""),
        (course_rules.called_before_50_m, run_of(track=SPOOFED, texts=CALLED), ""),
        (
            course_rules.called_before_50_m,
            run_of(track=replace(straight(), error_m=np.full(600, 60.0))),
            "60 m before a call",
        ),
        (course_rules.called_soon, run_of(), ""),
        (course_rules.called_soon, run_of(track=SPOOFED, texts=CALLED), ""),
        (course_rules.called_soon, run_of(track=SPOOFED), "not called for 3"),
        (course_rules.never_called, run_of(), ""),
        (course_rules.never_called, run_of(texts=CALLED), "called at 30 s"),
        (course_rules.never_called, run_of(texts=WARNED), "warned at 30 s"),
        (course_rules.warned_before_50_m, run_of(texts=WARNED), ""),
        (course_rules.warned_before_50_m, run_of(texts=CALLED), ""),
        (course_rules.warned_before_50_m, run_of(), "no warning"),
        (
            course_rules.warned_before_50_m,
            run_of(track=replace(straight(), error_m=np.full(600, 60.0)), texts=WARNED),
            "60 m",
        ),
        (course_rules.back_to_usual, run_of(track=SPOOFED), ""),
        (course_rules.back_to_usual, run_of(texts=CALLED), ""),
        (course_rules.back_to_usual, run_of(track=SPOOFED, texts=CALLED), "error 45 m after the call"),
        (course_rules.first_in_time, run_of(), ""),
        (course_rules.first_in_time, run_of(sent=NOTHING), "first after inf s"),
        (course_rules.never_wrong, run_of(known=BELIEVED), "1 places wrong, up to 90 m"),
        (course_rules.never_wrong, run_of(known=BELIEVED[1:]), ""),
        (course_rules.known_at_rest, run_of(known=BELIEVED), "accepted after 72 m"),
        (course_rules.known_at_rest, run_of(known=BELIEVED, set_down_m=71.6), ""),
        (course_rules.known_again, run_of(known=BELIEVED), ""),
        (course_rules.known_again, run_of(known=BELIEVED[:1]), "accepted after nan m"),
        (course_rules.known_again, run_of(known=BELIEVED, set_down_m=100.0), "accepted after 140 m"),
    ],
)
def test_what_a_rule_finds(rule: Rule, run: CourseRun, found: str) -> None:
    assert rule(run).startswith(found)
    assert bool(rule(run)) == bool(found)


def test_the_table_counts_failures_and_judges_all_drives_together() -> None:
    failed = run_of(error_m=10.0)
    failed = replace(failed, failures=failures(failed, (course_rules.close, course_rules.within_sigmas)))
    score = CourseScore("home", (run_of(), failed))
    assert score.failures == ["close (1)", "500 in 1,000 beyond 3 sigma", "rms 2.40 sigma"]
    row = shown([score]).splitlines()[2]
    assert row.startswith("| home | 1 of 2 | 100 | 6.0 / 10.0 / 10.0 m | 2.4 / 3.3 | 5.0 m, 5.0 m |")
    assert "close: median after 10.0 m" in line("home", failed)


def test_an_autopilot_that_is_wrong_leaves_the_lane_by_what_it_is_wrong() -> None:
    """It steers by its belief: 5 m east of the truth takes it 5 m west of a road that leads north."""
    way = placed(along(Scenario(seed=WORLD, length_m=LENGTH_M), 0.0, 400.0), 0.0, 0.0, 0.0)
    straight_on = replace(way, east_m=0 * way.east_m, north_m=np.arange(401.0), heading_rad=0 * way.heading_rad)
    driver = Driver(straight_on, [Leg(380.0)], np.random.default_rng(1))
    driver.belief = belief = Estimator(driver.pose, 0.0, OdometryErrors(), FilterNoise())
    for time_s in itertools.count(0.02, 0.02):
        belief.update(driver.pose, time_s, (driver.pose.east_m + 5.0, driver.pose.north_m))
        driver.step(0.02)
        if driver.ended:
            break
    assert driver.pose.east_m == pytest.approx(-5.0, abs=0.1)
    assert driver.left_m == pytest.approx(5.0, abs=0.1)


def test_reversing_stops_and_goes_on() -> None:
    way = along(Scenario(seed=WORLD, length_m=LENGTH_M), 0.0, 400.0)
    driver = Driver(way, [Leg(100.0), Leg(60.0, -4.0, then_wait_s=5.0), Leg(150.0)], np.random.default_rng(1))
    seen = []
    while not driver.ended:
        driver.step(0.02)
        seen.append((driver.along_m, driver.pose.speed_mps))
    along_m, speed_mps = np.array(seen).T
    assert along_m.max() == pytest.approx(150.0, abs=1.0)
    assert speed_mps.min() < -2.0
    assert driver.pose.distance_m == pytest.approx(100 + 40 + 90, abs=3.0)


def test_a_turned_way_is_continuous_and_its_view_turns_with_it() -> None:
    home = Scenario(seed=WORLD, length_m=LENGTH_M, direction="reverse")
    away = Scenario(seed=WORLD + 1, length_m=LENGTH_M, direction="reverse")
    before = along(home, 520.0, 260.0)
    way = joined(before.turned(90.0), along(away, 400.0, 300.0))
    steps_m = np.hypot(np.diff(way.east_m), np.diff(way.north_m))
    assert steps_m.max() < 1.6
    assert np.degrees(way.heading_rad[-101] - before.heading_rad[-1]) == pytest.approx(90.0, abs=1.0)
    assert way.turn_deg.max() == pytest.approx(90.0)
    assert [way.roads[index].seed for index in way.road[[0, -1]]] == [WORLD, WORLD + 1]
    assert way.project(*way.at(100.0, -3.0)[:2], near_m=95.0) == pytest.approx((100.0, -3.0), abs=0.3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--runs", "0"], "at least 1"),
        (["--jobs", "0"], "at least 1"),
        (["--course", "moon"], "--course list"),
        (["--case", "Z"], "not one of A, B"),
        (["--length-m", "100"], "not between 500 and 20000"),
    ],
)
def test_bad_options_are_refused(options: list[str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        _main(options)


def test_a_small_rms_counts_only_over_many_drives() -> None:
    assert CourseScore("home", (run_of(error_m=0.5),)).failures == []
    assert CourseScore("home", (run_of(error_m=0.5),) * ENOUGH_RUNS).failures == ["rms 0.17 sigma"]


@pytest.mark.long
def test_a_position_of_a_stream_is_judged_by_what_is_known_of_it(library: RoadLibrary, tmp_path: Path) -> None:
    """Whatever its message says, the journal has its own standard deviation: that of one message in about five."""
    run = drive(COURSES["px4-aided"], 1, LENGTH_M, WORLD, tmp_path, library)
    lines = (tmp_path / JOURNAL).read_text().splitlines()
    recorded = [one["sigma_m"] for one in map(json.loads, lines) if one["event"] == "fix_sent"]
    assert len(recorded) > 20
    assert np.isclose(recorded, run.sent.sigma_m[:, None], rtol=1e-3).any(axis=0).all()
    assert run.sent.sigma_m.min() == pytest.approx(min(recorded), rel=0.1)
    assert np.median(run.sent.sigma_m) == pytest.approx(np.median(recorded), rel=0.1)


def test_each_seed_of_a_case_drives_the_next_of_its_courses_on_the_next_road() -> None:
    count = len(courses_of("B"))
    planned = command.plan(_options(["--case", "B", "--runs", f"{5 * count}"]))
    assert [one.seed for one in planned] == list(range(1, 1 + 5 * count))
    assert [one.course for one in planned[:count]] == [one.course for one in planned[count : 2 * count]]
    assert {(one.course, one.world) for one in planned} == {
        (name, world) for name in courses_of("B") for world in command.WORLDS
    }


def test_the_drives_of_a_course_have_one_road_after_the_other() -> None:
    assert [one.world for one in command.plan(_options(["--runs", "6"]))] == [*command.WORLDS, command.WORLDS[0]]
    assert {one.world for one in command.plan(_options(["--world", "7", "--runs", "2"]))} == {7}


def test_keypoints_are_compared_course_by_course_with_lines() -> None:
    planned = command.plan(_options(["--course", "home,person", "--runs", "2", "--keypoints"]))
    lane_m = np.column_stack([np.full(50, 0.2), np.full(50, -0.1)])
    runs = {one: run_of(lane_m=lane_m if one.keypoints else 10 * lane_m) for one in planned}
    names = [f"{name}, {what}" for name in ("home", "person") for what in ("sequence matches", "keypoint poses")]
    table = [row.split(" | ") for row in shown(command.compare(runs), TABLES["keypoints"]).splitlines()[2:]]
    assert [row[0].lstrip("| ") for row in table] == names
    assert [row[2:4] for row in table[:2]] == [
        ["2.00 / 2.00 m", "1.00 / 1.00 m"],
        ["0.20 / 0.20 m", "0.10 / 0.10 m"],
    ]


def test_headings_and_beliefs_of_drives_are_counted_together() -> None:
    runs = tuple(run_of(turned_deg=np.full(2, one), used=50, believed=40, wrong=3) for one in (-1.0, 7.0))
    row = shown([CourseScore("home, looks", runs)], TABLES["keypoints"]).splitlines()[2].split(" | ")
    assert row[4] == "5.00 deg" and row[-2:] == ["80 of 100", "6 |"]


def test_of_vehicles_that_nobody_knew_it_is_said_after_which_way_a_place_was_believed() -> None:
    runs = run_of(known=BELIEVED), run_of(known=BELIEVED[:1])
    row = shown([CourseScore("kidnapped, looks", runs)], TABLES["known"]).splitlines()[2]
    assert row == "| kidnapped, looks | 2 | 72 m, - | 100 | 0.7 / 0.7 | 2 |"


def fused(one: Course) -> Course:
    """With an ArduPilot that fuses keypoint poses."""

    def lay(draft: CourseDraft) -> None:
        one.lay(draft)
        draft.firmware = "ardupilot-fused"

    return replace(one, lay=lay)


@pytest.mark.long
@pytest.mark.parametrize("name", ["home-fused", "repeat-dusk"])
def test_with_keypoints_positions_are_a_meter_from_the_lane_that_was_taught(
    name: str, library: RoadLibrary, tmp_path: Path
) -> None:
    """The way home, in the other lane, and the way out again: the daemon's own poses, by rendered pictures."""
    run = drive(on_keypoints(fused(COURSES[name])), 1, SHORT_M, WORLD, tmp_path, library)
    assert not run.failures, line(name, run)
    assert np.percentile(run.track.error_m[~run.track.gps], 95) < 2.0, "as flown: 0.5 to 1.3 m"
    along_m, cross_track_m = np.percentile(np.abs(run.lane_m), 90, axis=0)
    assert len(run.lane_m) > 20 and max(along_m, cross_track_m) < 1.0
    sent = [json.loads(one) for one in (tmp_path / JOURNAL).read_text().splitlines()]
    assert any(one.get("points", 0) >= 12 for one in sent if one["event"].startswith("fix_"))


@pytest.mark.long
@pytest.mark.parametrize("name", ["standing-start", "kidnapped-off"])
def test_with_keypoints_a_place_is_known_where_nobody_knew_the_vehicle(
    name: str, library: RoadLibrary, tmp_path: Path
) -> None:
    run = drive(on_keypoints(COURSES[name]), 1, SHORT_M, WORLD, tmp_path, library)
    assert not run.failures, line(name, run)


@pytest.mark.long
def test_home_begins_earlier_on_the_map_of_the_way_out_where_that_has_keypoints(
    library: RoadLibrary, tmp_path: Path
) -> None:
    """Out by day, mapped by a rear camera, and home at dusk without GPS, which is lost at the turn."""
    run = drive(on_keypoints(fused(COURSES["take-me-home-dusk"])), 1, SHORT_M, WORLD, tmp_path, library)
    first_m = float(np.interp(run.sent.of_s[0], run.track.time_s, run.track.along_m))
    lost_m = float(run.track.along_m[run.track.gps.argmin()])
    assert first_m - lost_m < 50
    assert not failures(run, HONEST), line("take-me-home-dusk", run)


def test_in_short_there_is_a_row_for_each_case_and_a_word_on_each_course_that_fails() -> None:
    failed = replace(run_of(error_m=10.0), failures=(Failure("close", "10 m"),))
    several, passed = CourseScore("**all**", (run_of(), failed)), CourseScore("home", (run_of(),))
    tow = CourseScore("tow", (failed, run_of()))
    found = in_short([several, passed, tow]).splitlines()
    assert [row.split(" | ")[0] for row in found[2:-4]] == ["| **all**"]
    assert found[-3].startswith("Not as required: `tow`: close (1), ")
    assert found[-1] == "All drives of 1 courses pass."
    alone = in_short([passed, tow]).splitlines()
    assert [row.split(" | ")[0] for row in alone[2:-2]] == ["| tow"]


def test_in_short_a_course_with_an_odd_rms_passes_and_one_with_positions_beyond_three_sigmas_does_not() -> None:
    odd, beyond = CourseScore("home", (run_of(error_m=3.6),)), CourseScore("tow", (run_of(error_m=9.3),))
    assert odd.failures == ["rms 1.20 sigma"]
    *rows, _, passed = in_short([odd, beyond]).splitlines()
    assert len(rows) == 3 and rows[2].startswith("| tow | 1 of 1 |")
    assert passed == "All drives of 1 courses pass, `home` (rms 1.20) among them."


def test_results_take_the_place_of_those_before(tmp_path: Path) -> None:
    page, begin, end = tmp_path / "trial.md", "<!-- results: begin -->", "<!-- results: end -->"
    page.write_text(f"before\n{begin}\nold\n{end}\nafter\n")
    put_between("results", page, "new")
    put_between("results", page, "newer")
    assert page.read_text() == f"before\n{begin}\n\nnewer\n\n{end}\nafter\n"
    page.write_text("no marks")
    with pytest.raises(ConfigError, match="no lines"):
        put_between("results", page, "new")


def test_the_courses_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert _main(["--course", "list"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert [entry.split()[0] for entry in listed] == [name for case in CASES for name in courses_of(case)]


def _options(options: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    command.add_command(parser.add_subparsers())
    return parser.parse_args(["fixes", *options])


def _main(options: list[str]) -> int:
    args = _options(options)
    runner: Callable[[argparse.Namespace], int] = args.run
    return runner(args)
