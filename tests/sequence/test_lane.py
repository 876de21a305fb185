"""A vehicle in a lane beside the map's drive: its two regions show different places, and are matched as one."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.config import Config, RigConfig, SequenceConfig
from edge.descriptor import NormalizedRows
from edge.reference_map import COST_ONE, MapSet, ModelKey
from edge.sequence import PlaceMatch
from edge.sequence.lane import NO_LAGS, Lags, Lanes, lags_of, lane_costs
from edge.sequence.place_search import PlaceSearch
from edge_plugins.mapping.builder import Place
from sim.compare.temporary_map import MappedDrive, temporary_map

PLACES, LENGTH, DIMENSIONS = 120, 10, 64
LAG = 4
RIG = RigConfig(left_reverse_m=3.5)


@pytest.fixture(scope="module")
def raw() -> NDArray[np.float32]:
    """A road (places, regions, D) of which neighbors resemble each other a little."""
    rough = np.random.default_rng(4).normal(size=(PLACES + 2, 2, DIMENSIONS)).astype(np.float32)
    return np.abs(rough[:-2] / 2 + rough[1:-1] + rough[2:] / 2)


@pytest.fixture(scope="module")
def maps(raw: NDArray[np.float32]) -> Iterator[MapSet]:
    """Driven once with a rear camera, and once with a front one."""
    half = PLACES // 2
    places = [Place(row, route_m=2.0 * row) for row in range(half)]
    drives = [MappedDrive(raw[:half], places, "rear"), MappedDrive(raw[half:], places, "front")]
    with temporary_map(drives, ModelKey("test", "0" * 64, "fc6", DIMENSIONS)) as found:
        yield found


def normalized(raw: NDArray[np.float32]) -> NDArray[np.float32]:
    found: NDArray[np.float32] = ((raw - raw.mean(axis=0)) / raw.std(axis=0)).astype(np.float32)
    return found


def lanes(lags: Lags) -> Lanes:
    return Lanes(lags, "front", range(PLACES))


def way_home(raw: NDArray[np.float32], left_of_drive: int) -> NDArray[np.float32]:
    """Rows on the way back from the end of the rear drive; each region shows places that lie so many apart."""
    seen, half = normalized(raw), LAG // 2 * left_of_drive
    places = np.arange(PLACES // 2 - 5, 5, -1)
    return np.stack([seen[places + half, 0], seen[places - half, 1]], axis=1)


def test_lags_are_those_of_the_lanes() -> None:
    assert lags_of(Config(rig=RIG), 2.0) == Lags(alike=0, opposed=LAG)
    assert lags_of(Config(rig=RigConfig(left_reverse_m=-3.5)), 2.0) == Lags(0, -LAG)
    assert lags_of(Config(rig=RigConfig(left_forward_m=3.5)), 2.0) == Lags(LAG, 0)
    assert lags_of(Config(rig=RIG), 1.0) == Lags(0, 2 * LAG)
    assert lags_of(Config(), 2.0) == NO_LAGS


@pytest.mark.parametrize("side", [1, -1])
def test_in_its_lane_a_vehicle_fits_the_place_where_it_is(side: int, raw: NDArray[np.float32], maps: MapSet) -> None:
    ring = way_home(raw, side)[:LENGTH]
    here = PLACES // 2 - 5 - (LENGTH - 1)
    plain = lane_costs(maps, ring, [0], [(0, PLACES)], lanes(NO_LAGS))[0]
    lane = lane_costs(maps, ring, [0], [(0, PLACES)], lanes(Lags(0, side * LAG)))[0]
    assert lane[0].argmin() == here
    assert lane[0, here] < 0.1 * COST_ONE < 0.5 * COST_ONE < plain[0, here]
    np.testing.assert_array_equal(lane[1], plain[1], "regions in the other order are those of one frame")
    np.testing.assert_array_equal(
        lane[:, PLACES // 2 :], plain[:, PLACES // 2 :], "and so are the other camera's drives"
    )


def test_the_first_frames_and_the_ends_of_a_drive_are_matched_as_one_frame(
    raw: NDArray[np.float32], maps: MapSet
) -> None:
    ring, everything = way_home(raw, 1)[:LENGTH], [(0, PLACES)]
    plain = lane_costs(maps, ring, range(LENGTH)[::-1], everything, lanes(NO_LAGS))
    lane = lane_costs(maps, ring, range(LENGTH)[::-1], everything, lanes(Lags(0, LAG)))
    half, end = LAG // 2, PLACES // 2
    np.testing.assert_array_equal(lane[:LAG], plain[:LAG], "no frame is earlier")
    assert (lane[LAG:, 0, : end - half] != plain[LAG:, 0, : end - half]).any()
    np.testing.assert_array_equal(lane[:, 0, end - half : end], plain[:, 0, end - half : end])
    piece = lane_costs(maps, ring, range(LENGTH)[::-1], [(10, 40)], lanes(Lags(0, LAG)))
    np.testing.assert_array_equal(piece[:, :, : 30 - half], lane[:, :, 10 : 40 - half])


def test_fewer_places_than_half_a_lag_are_matched_as_one_frame(raw: NDArray[np.float32], maps: MapSet) -> None:
    ring = way_home(raw, 1)[:LENGTH]
    for ranges in ([(0, 1), (30, 40)], [(30, 40), (PLACES // 2 - 1, PLACES)]):
        plain = lane_costs(maps, ring, [0], ranges, lanes(NO_LAGS))
        for lags in (Lags(0, LAG), Lags(0, -LAG), Lags(LAG, LAG), Lags(0, 100)):
            lane = lane_costs(maps, ring, [0], ranges, lanes(lags))
            assert lane.shape == plain.shape
            np.testing.assert_array_equal(lane[0, 1], plain[0, 1])
            one_place = 0 if ranges[0] == (0, 1) else 10
            assert lane[0, 0, one_place] == plain[0, 0, one_place]


def test_a_search_uses_the_lane_where_distance_is_measured(raw: NDArray[np.float32], maps: MapSet) -> None:
    def last_match(*, is_measured: bool) -> PlaceMatch | None:
        search = PlaceSearch(maps, Config(rig=RIG, sequence=SequenceConfig(length=LENGTH)))
        rows = way_home(raw, 1)[: 3 * LENGTH]

        def push(number: int) -> PlaceMatch | None:
            newest = NormalizedRows(rows[number][np.newaxis])
            ring = rows[max(0, number - LENGTH + 1) : number + 1]
            return search.push(newest, lambda: ring, is_measured=is_measured)

        return [push(number) for number in range(len(rows))][-1]

    lane, alone = last_match(is_measured=True), last_match(is_measured=False)
    assert lane is not None and alone is not None
    assert (lane.place_index, lane.direction, lane.order) == (PLACES // 2 - 5 - (3 * LENGTH - 1), "reverse", "same")
    assert lane.uniqueness > 2 * alone.uniqueness
