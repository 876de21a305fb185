"""The statistics of calibration, on numbers whose answer is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.config import RigConfig, load_config
from edge.errors import ConfigError, LookbackError
from edge.feed import Feed, FeedHeader, FeedRow
from edge.reference_map.store import ReferenceMap
from edge_plugins.mapping.builder import Place
from sim import Pose
from sim.calibration.command import write_lines
from sim.calibration.offset import measure_offsets, rig_config
from sim.calibration.offset_samples import MapDrives, OffsetSample
from sim.calibration.threshold import DEFAULT, choose, curve_of_drive
from tests.map_of import map_of


def sample(
    ahead_m: float, confidence: float = 0.8, *, accepted: bool = True, line_sigma_m: float = 0.0, place_m: float = 0.0
) -> OffsetSample:
    line = {"line_sigma_m": line_sigma_m, "place_m": place_m}
    return OffsetSample("forward", "swapped", ahead_m, confidence, accepted, **line)


def along_road(errors_m: NDArray[np.float64], line_sigma_m: float = 0.0) -> list[OffsetSample]:
    """Matches 80 m apart from each other, so that each says something of its own."""
    return [sample(one, line_sigma_m=line_sigma_m, place_m=80.0 * at) for at, one in enumerate(errors_m)]


def test_a_third_of_wrong_matches_does_not_move_the_offset() -> None:
    rng = np.random.default_rng(1)
    seen = along_road(np.array([*rng.normal(26, 3, 200), *rng.uniform(-400, 400, 100), *[np.nan] * 10]))
    (offset,) = measure_offsets(seen)
    assert offset.ahead_m == pytest.approx(26, abs=1)
    assert offset.left_m == pytest.approx(3, abs=1)
    assert 90 <= offset.outliers <= 110
    sigma_m = round(offset.sigma_m, 1)
    assert rig_config([offset]) == RigConfig(
        ahead_forward_swapped_m=round(offset.ahead_m, 1), sigma_forward_swapped_m=sigma_m, sigma_along_m=sigma_m
    )


def test_what_the_daemon_knows_of_each_line_is_not_counted_twice() -> None:
    rng = np.random.default_rng(2)
    (offset,) = measure_offsets(along_road(rng.normal(26, 5, 1000), 3.0))
    assert offset.left_m == pytest.approx(5, abs=0.3)
    assert offset.sigma_m == pytest.approx(4, abs=0.3)
    (offset,) = measure_offsets(along_road(rng.normal(26, 5, 1000), 9.0))
    assert offset.sigma_m == offset.ahead_sigma_m == 0.5


@pytest.mark.parametrize("length_m", [400.0, 960.0])
def test_the_offset_is_as_certain_as_the_road_is_long(length_m: float) -> None:
    """What stands beside the road shifts the matches of each 80 m alike: 120 roads, by 4 m to one sigma."""
    rng, at_m, off = np.random.default_rng(5), np.arange(0.0, length_m, 2.0), []
    for _ in range(120):
        shift_m = rng.normal(6.0, 4.0, round(length_m / 80.0))[(at_m // 80.0).astype(int)]
        values = zip((shift_m + rng.normal(0, 0.5, at_m.size)).tolist(), at_m.tolist(), strict=True)
        (offset,) = measure_offsets([sample(one, place_m=place_m) for one, place_m in values])
        off.append((offset.ahead_m - 6.0) / offset.ahead_sigma_m)
    beyond = np.abs(off) > 2.0
    assert 0.01 < beyond.mean() < 0.2, "few stretches have the tails of a t-distribution"


def test_lines_that_the_daemon_would_not_follow_do_not_count_in_its_sigma() -> None:
    rng = np.random.default_rng(4)
    steep = along_road(rng.normal(26, 20, 50), np.nan)
    (offset,) = measure_offsets([*along_road(rng.normal(26, 8, 500)), *steep])
    assert offset.left_m > 9
    assert offset.sigma_m == pytest.approx(8, abs=0.5)


def test_each_kind_of_match_has_its_own_sigma_and_the_unmeasured_the_worst() -> None:
    rng = np.random.default_rng(3)
    home = [replace(one, direction="reverse", order="same") for one in along_road(rng.normal(0, 2, 500))]
    rig = rig_config(measure_offsets([*along_road(rng.normal(30, 8, 500)), *home]))
    assert rig.sigma_m("forward", "swapped") == pytest.approx(8, abs=0.5)
    assert rig.sigma_m("reverse", "same") == pytest.approx(2, abs=0.2)
    assert rig.sigma_m("forward", "same") == rig.sigma_m("forward", "swapped") == rig.sigma_along_m


def test_unbelieved_matches_and_a_handful_of_them_measure_nothing() -> None:
    assert measure_offsets([sample(26, accepted=False)] * 100 + [sample(26)] * 9) == []


def test_the_threshold_is_the_lowest_with_that_precision() -> None:
    right = [sample(20 + at % 3, 0.4 + at / 1000) for at in range(99)]
    wrong = [sample(200, 0.45), sample(np.nan, 0.3), sample(200, 0.0)]
    curve = curve_of_drive([*right, *wrong], RigConfig(ahead_forward_swapped_m=21), tolerance_m=10, length=20)
    assert curve.lowest_for(0.99) == pytest.approx((0.4 + 0.3) / 2)  # 99 right and one wrong above it
    assert curve.lowest_for(1.0) == pytest.approx((0.451 + 0.45) / 2)
    assert curve.stretches == 5


def test_what_was_matched_off_the_map_raises_the_threshold_and_nothing_leads_below_the_default() -> None:
    right = [sample(20, 0.3 + at / 1000) for at in range(99)]
    strangers = [0.9 + at / 500 for at in range(41)]

    def chosen(seen: list[OffsetSample], off_map: list[float]) -> float:
        return choose(curve_of_drive(seen, RigConfig(), tolerance_m=40, length=20), off_map, 0.9)

    assert chosen(right, []) == DEFAULT
    assert chosen(right, strangers) == pytest.approx(0.972)
    wrong = [sample(200, 0.965 + at / 10_000) for at in range(20)]
    better = [sample(20, 0.975 + at / 10_000) for at in range(99)]
    assert chosen([*better, *wrong], []) == pytest.approx(0.96585)  # 11 of 110 are wrong


def test_a_precision_that_nothing_reaches_is_one_line() -> None:
    curve = curve_of_drive([sample(200), sample(20, 0.2)], RigConfig(), tolerance_m=40, length=2)
    with pytest.raises(LookbackError, match=r"no threshold reaches a precision of 99\.0 %: the best is 50\.0 %"):
        curve.lowest_for(0.99)


@pytest.fixture
def out_and_back(tmp_path: Path) -> ReferenceMap:
    """A map of one drive 400 m north and back, a lane beside, of places with random descriptors."""
    rng = np.random.default_rng(0)
    north_m = np.concatenate([np.arange(0, 400, 2.0), np.arange(400, 0, -2.0)])
    places = [place(row, 0.0 if row < 200 else 4.0, meters, 2.0 * row) for row, meters in enumerate(north_m)]
    return map_of(tmp_path / "map", rng.normal(size=(400, 1, 64)), places)


def place(row: int, east_m: float, north_m: float, route_m: float) -> Place:
    return Place(row, *Pose(east_m, north_m, 0, 0, 0).geodetic(), heading_deg=0.0, route_m=route_m)


def feed_at(east_m: float, north_m: float) -> Feed:
    lat_deg, lon_deg = Pose(east_m, north_m, 0, 0, 0).geodetic()
    return Feed(Path("feed"), FeedHeader("feed", "front", 8, 8), (FeedRow("f", 0, lat_deg, lon_deg),))


@pytest.mark.parametrize(("place", "further_m"), [(60, 19.0), (45, -11.0), (345, -9.0), (360, 21.0)])
def test_the_vehicle_is_on_the_passing_of_the_road_that_was_matched(
    out_and_back: ReferenceMap, place: int, further_m: float
) -> None:
    """At 101 m north the drive passes at 101 m and, on the way back, at 699 m."""
    drives = MapDrives(out_and_back, feed_at(1.0, 101.0))
    assert drives.further_m(0, place) == pytest.approx(further_m, abs=0.01)


def test_a_vehicle_on_another_road_has_no_place(out_and_back: ReferenceMap) -> None:
    assert np.isnan(MapDrives(out_and_back, feed_at(-60.0, 101.0)).further_m(0, 50))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_lines_go_into_the_config_and_comments_stay(encoding: str, tmp_path: Path) -> None:
    file = tmp_path / "lookback.toml"
    file.write_text("# ours\n[acceptance]\nconfidence_from = 0.6  # guessed\nhold_off_s = 2.0\n", encoding=encoding)
    write_lines(file, {("rig", "ahead_reverse_same_m"): 3.5, ("acceptance", "confidence_from"): 0.5042})
    text = file.read_text()
    assert "# ours" in text
    assert "confidence_from = 0.5042  # guessed" in text
    config = load_config(file)
    assert config.rig.ahead_reverse_same_m == 3.5
    assert config.acceptance.hold_off_s == 2.0
    assert [path.name for path in tmp_path.iterdir()] == ["lookback.toml"]


def test_a_value_that_no_config_may_have_is_not_written(tmp_path: Path) -> None:
    file = tmp_path / "lookback.toml"
    file.write_text("[rig]\n")
    with pytest.raises(ConfigError, match="ahead_reverse_same_m"):
        write_lines(file, {("rig", "ahead_reverse_same_m"): 600.0})
    assert file.read_text() == "[rig]\n"
