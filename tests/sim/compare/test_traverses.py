"""Truth from positions, a route, equal rows and anchors; and what a feed must have for each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge.config import SamplingConfig
from edge.errors import ConfigError, FeedError
from edge.feed import FeedHeader, FeedRow
from edge.feed.writer import FeedWriter
from sim.compare.plan import Pair, TraversePlan
from sim.compare.traverses import (
    MethodTraverse,
    anchored_errors,
    load_traverse,
    moved_ahead,
    open_pictures,
    place_coordinates,
    true_errors,
)

EVERY = SamplingConfig(by="frames")


def pair(truth: Any, **changes: Any) -> Pair:
    return Pair(name="p", reference="there", query="here", truth=truth, **changes)


def load(path: Path, **changes: Any) -> MethodTraverse:
    return load_traverse(path.name, TraversePlan(feed=path.name, **changes), [path], EVERY)


def test_the_truth_is_the_distance_to_every_place(write_feed: Any) -> None:
    there = load(write_feed("there", [0.0, 10.0, 20.0, 30.0]))
    here = load(write_feed("here", [30.0, 12.0]))
    expected = np.abs(np.array([[30.0], [12.0]]) - [0.0, 10.0, 20.0, 30.0])
    np.testing.assert_allclose(true_errors(there, here, pair("positions")), expected, atol=0.1)
    np.testing.assert_allclose(true_errors(there, here, pair("route_m")), expected)
    np.testing.assert_array_equal(true_errors(there, here, pair("rows")), [[0, 1, 2, 3], [1, 0, 1, 2]])


def test_the_end_of_a_closed_feed_is_near_its_beginning(write_feed: Any) -> None:
    paths = [write_feed(name, [float(at) for at in range(5)]) for name in ("street", "lap")]
    both = load_traverse("both", TraversePlan(feeds=("street", "lap")), paths, SamplingConfig(by="frames"))
    errors = true_errors(both, both, pair("rows", loops={"lap": 5}))
    np.testing.assert_array_equal(errors[0], [0, 1, 2, 3, 4, *[np.inf] * 5])
    np.testing.assert_array_equal(errors[9], [*[np.inf] * 5, 1, 2, 2, 1, 0])
    # 2 ahead of the last row is row 1 of the next lap
    np.testing.assert_array_equal(true_errors(both, both, pair("rows", loops={"lap": 5}), 2.0)[9, 5:], [1, 0, 1, 2, 2])
    with pytest.raises(ConfigError, match=r"loops\.none: no feed of both"):
        true_errors(both, both, pair("rows", loops={"none": 5}))


def test_the_sampling_and_the_rows_of_the_plan_choose_the_frames(write_feed: Any) -> None:
    path = write_feed("there", [float(at) for at in range(12)])
    two_meters = SamplingConfig(by="distance", spacing_m=2.0)
    assert load_traverse("t", TraversePlan(feed="t"), [path], two_meters).rows.tolist() == [0, 2, 4, 6, 8, 10]
    part = load(path, last_row=3)
    assert part.rows.tolist() == [0, 1, 2, 3] and part.pixels.shape == (4, 32, 64)
    with pytest.raises(FeedError, match="at least 2"):
        load(path, last_row=0)


def test_anchors_are_interpolated_and_laps_wrap() -> None:
    laps = pair("anchors", anchors=[(10.0, 90.0), (30.0, 110.0), (50.0, 70.0)], loop=100)
    errors = anchored_errors(laps, np.array([9, 10, 20, 25, 40]), np.array([0, 50, 95]))
    assert np.isnan(errors[0]).all()  # before the first anchor nothing is known
    np.testing.assert_array_equal(errors[1:], [[10, 40, 5], [0, 50, 5], [5, 45, 10], [10, 40, 5]])


def test_places_of_a_loop_are_near_across_its_seam(write_feed: Any) -> None:
    there = load(write_feed("there", [float(at) for at in range(20)]))
    ground, along = place_coordinates(there, pair("anchors", anchors=[(0.0, 0.0), (1.0, 1.0)], loop=20))
    assert np.hypot(*(ground[19] - ground[0])) == pytest.approx(1.0, abs=0.01)
    np.testing.assert_array_equal(along, np.arange(20))
    ground, along = place_coordinates(there, pair("positions"))
    np.testing.assert_allclose(np.hypot(*(ground[19] - ground[0])), 19.0, atol=0.2)
    np.testing.assert_allclose(along, np.arange(20))


def test_what_a_feed_has_not_got_is_named(write_feed: Any, tmp_path: Path) -> None:
    path = write_feed("there", [0.0, 1.0, 2.0])
    rows = (path / "frames.csv").read_text().splitlines()
    blank = [rows[0], *(",".join([*row.split(",")[:2], *[""] * (row.count(",") - 1)]) for row in rows[1:])]
    (path / "frames.csv").write_text("\n".join(blank) + "\n")
    there = load(path)
    with pytest.raises(
        ConfigError, match=r"pair 'p': truth = \"positions\": .*there/frames\.csv: no positions in any row"
    ):
        true_errors(there, there, pair("positions"))
    with pytest.raises(ConfigError, match=r"there/frames\.csv: no column route_m in any row"):
        true_errors(there, there, pair("route_m"))


def test_a_feed_without_degrees_is_judged_by_its_own_meters(tmp_path: Path) -> None:
    meters = [("0.0", "0.0"), ("3.0", "4.0"), ("", "")]
    there = load(_write(tmp_path / "there", [{"local_x_m": x, "local_y_m": y} for x, y in meters]))
    here = load(
        _write(tmp_path / "here", [{"local_x_m": "", "local_y_m": ""}, {"local_x_m": "3.0", "local_y_m": "0.0"}])
    )
    with pytest.raises(ConfigError, match=r'here/feed.toml: positions in meters .* set origin = "there"$'):
        true_errors(there, here, pair("positions"))
    header = tmp_path / "here/feed.toml"
    header.write_text(header.read_text().replace('origin = ""', 'origin = "there"'))
    errors = true_errors(there, load(tmp_path / "here"), pair("positions"))
    assert np.isnan(errors[0]).all()  # nobody knows where this query was taken
    np.testing.assert_allclose(errors[1], [3.0, 4.0, np.inf])
    np.testing.assert_array_equal(place_coordinates(there, pair("positions"))[0], [[0, 0], [3, 4], [np.nan, np.nan]])


def test_aligned_feeds_are_judged_by_the_frame_they_were_made_from(tmp_path: Path) -> None:
    there = load(_write(tmp_path / "there", [{"source_frame": number} for number in ("0", "5", "10")]))
    here = load(_write(tmp_path / "here", [{"source_frame": number} for number in ("4", "10")]))
    np.testing.assert_array_equal(true_errors(there, here, pair("rows")), [[4, 1, 6], [10, 5, 0]])
    np.testing.assert_array_equal(place_coordinates(there, pair("rows"))[1], [0, 5, 10])


def test_the_right_place_lies_ahead_on_the_querys_own_drive(write_feed: Any) -> None:
    there = load(write_feed("there", [0.0, 10.0, 20.0, 30.0]))
    home = load(write_feed("home", [30.0, 12.0]))
    errors = true_errors(there, home, pair("positions"), ahead=7.0)
    np.testing.assert_allclose(errors, np.abs(np.array([[23.0], [5.0]]) - [0.0, 10.0, 20.0, 30.0]), atol=0.1)
    np.testing.assert_allclose(true_errors(there, there, pair("rows"), ahead=2.0)[1], [3, 2, 1, 0])
    corner = np.array([[0.0, 0.0], [0.0, 3.0], [np.nan, np.nan], [4.0, 3.0]])
    np.testing.assert_allclose(moved_ahead(corner, 3.5), [[0.5, 3.0], [3.5, 3.0], [np.nan, np.nan], [7.5, 3.0]])
    np.testing.assert_allclose(moved_ahead(corner[:2], -1.0), [[0.0, -1.0], [0.0, 2.0]])


def test_several_feeds_are_drives_of_one_traverse_and_only_equal_ones_are_right(
    write_feed: Any, tmp_path: Path
) -> None:
    paths = {name: write_feed(name, [0.0, 10.0, 20.0]) for name in ("a", "bb", "a_again", "bb_again")}
    plan = TraversePlan(feeds=("a", "bb"))
    there = load_traverse("there", plan, [paths["a"], paths["bb"]], EVERY)
    here = load_traverse("here", plan, [paths["a_again"], paths["bb_again"]], EVERY)
    assert there.drives() == [slice(0, 3), slice(3, 6)]
    errors = true_errors(there, here, pair("rows"), ahead=1.0)
    np.testing.assert_array_equal(errors[0], [1, 0, 1, np.inf, np.inf, np.inf])
    np.testing.assert_array_equal(errors[5], [np.inf, np.inf, np.inf, 3, 2, 1])
    pictures = open_pictures(there.feed)
    for row, name in ((1, "a"), (4, "bb")):
        np.testing.assert_array_equal(pictures.read(row), open_pictures(load(paths[name]).feed).read(1))
    rear = write_feed("rear", [0.0, 10.0], view="rear")
    with pytest.raises(FeedError, match="cameras that look the same way"):
        load_traverse("mixed", plan, [paths["a"], rear], EVERY)


def _write(path: Path, extras: list[dict[str, str]]) -> Path:
    rng = np.random.default_rng(1)
    with FeedWriter(path, FeedHeader(path.name, "front", 64, 48), extra_columns=tuple(extras[0])) as writer:
        for index, extra in enumerate(extras):
            picture = rng.integers(0, 255, (6, 8, 3), dtype=np.uint8).repeat(8, axis=0).repeat(8, axis=1)
            writer.write(picture, FeedRow("", index * 500_000_000, extra=extra))
    return path
