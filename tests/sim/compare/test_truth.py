from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge.errors import FeedError
from edge.feed import Feed, FeedHeader, FeedRow, read_feed
from edge.geodesy import moved
from sim.compare.truth import errors_between, points_of
from sim.datasets import TruthKind

ORIGIN = (51.76, -1.26)


def feed_of(rows: list[FeedRow], name: str = "feed") -> Feed:
    return Feed(Path(name), FeedHeader(name, "front", 64, 48), tuple(rows))


def street(*north_m: float | None, east_m: float = 0.0) -> Feed:
    """A feed with a row at each of these meters north along a street; None is a row without a position."""
    rows = []
    for index, north in enumerate(north_m):
        row = FeedRow(f"{index}.jpg", index)
        if north is not None:
            lat_deg, lon_deg = moved(*ORIGIN, east_m, north)
            row = replace(row, lat_deg=lat_deg, lon_deg=lon_deg)
        rows.append(row)
    return feed_of(rows)


def with_extra(column: str, *values: str) -> Feed:
    return feed_of([FeedRow(f"{i}.jpg", i, extra={column: value}) for i, value in enumerate(values)])


def right(kind: TruthKind, reference: Feed, query: Feed, tolerance: float) -> list[list[int]]:
    """For each query the rows of the reference within the tolerance."""
    errors = errors_between(*points_of(kind, reference, query))
    return [np.flatnonzero(row <= tolerance).tolist() for row in errors]


def test_positions_are_right_within_the_tolerance_and_no_further() -> None:
    reference, query = street(0, 10, 20, 30, 200), street(11, 90, None, east_m=3.0)
    errors_m = errors_between(*points_of("positions", reference, query))
    assert errors_m[0, [0, 1, 4]] == pytest.approx([np.hypot(3, 11), np.hypot(3, 1), np.hypot(3, 189)], abs=1e-3)
    assert right("positions", reference, query, 40.0) == [[0, 1, 2, 3], [], []]


def test_errors_are_the_distances_of_all_pairs() -> None:
    random = np.random.default_rng(5)
    reference_at, query_at = random.uniform(0, 100, (60, 2)), random.uniform(0, 100, (40, 2))
    reference_at[::7], query_at[3] = np.nan, np.nan
    everything = np.full((40, 60), np.inf)
    for query in range(40):
        for reference in range(60):
            distance = np.hypot(*(query_at[query] - reference_at[reference]))
            if np.isfinite(distance):
                everything[query, reference] = distance
    known = np.delete(np.arange(40), 3)
    errors = errors_between(reference_at, query_at)
    assert (errors.shape, bool(np.isnan(errors[3]).all())) == ((40, 60), True)
    assert errors[known] == pytest.approx(everything[known])  # inf where the place is not known


def test_rows_of_aligned_traverses_match_by_number(shared: Path) -> None:
    reference = read_feed(shared / "feeds/corridor_reference")
    query = read_feed(shared / "feeds/corridor_query")
    assert right("rows", reference, query, 3)[50] == list(range(47, 54))


def test_the_frame_number_of_the_data_set_counts_where_a_feed_has_it() -> None:
    reference, query = with_extra("source_frame", "10", "12", "14"), with_extra("source_frame", "13")
    assert right("rows", reference, query, 1) == [[1, 2]]


def test_the_same_route_driven_backwards_is_matched_by_its_meters() -> None:
    reference, query = with_extra("route_m", "0", "50", "100"), with_extra("route_m", "95", "52", "")
    assert right("route_m", reference, query, 20) == [[2], [1], []]


def test_local_meters_serve_where_there_are_no_degrees() -> None:
    rows = [FeedRow(f"{i}.png", i, extra={"local_x_m": "3.0", "local_y_m": str(10.0 * i)}) for i in range(4)]
    assert right("positions", feed_of(rows), feed_of(rows[2:]), 5.0) == [[2], [3]]


@pytest.mark.parametrize(
    ("kind", "lack"), [("positions", "no positions in any row"), ("route_m", "no column route_m in any row")]
)
def test_a_feed_that_lacks_what_the_truth_needs_is_named(kind: TruthKind, lack: str) -> None:
    bare = feed_of([FeedRow("0.jpg", 0)], "bare")
    good = with_extra("route_m", "0") if kind == "route_m" else street(0.0)
    for reference, query in ((bare, good), (good, bare)):
        with pytest.raises(FeedError, match=rf"^bare/frames\.csv: {lack}"):
            points_of(kind, reference, query)
