"""Shrunk descriptors: directions against NumPy's own, and maps that keep them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from edge.descriptor.normalize import normalize
from edge.errors import MapError
from edge.reference_map.costs import COST_ONE, CostMatcher, project
from edge.reference_map.store import PROJECTION, ModelKey, ReferenceMap, open_map
from edge_plugins.mapping.builder import Place
from sim.maps.shrinking import principal_directions, shrink_to
from tests.map_of import map_of

DIMENSIONS = 64
MODEL = ModelKey("test", "0" * 64, "fc6", DIMENSIONS)


def street(places: int, *, carriers: int, noise: float = 0.05, seed: int = 0) -> np.ndarray:
    """Raw descriptors (n, 2, D) that vary along a few directions, each place a little like its neighbors."""
    rng = np.random.default_rng(seed)
    along = rng.normal(size=(places + 2, 2, carriers))
    along = along[:-2] + along[1:-1] + along[2:]
    directions = np.linalg.qr(rng.normal(size=(DIMENSIONS, carriers)))[0]
    return np.asarray(along @ directions.T + rng.normal(size=(places, 2, DIMENSIONS)) * noise, np.float32)


def build(path: Path, raw: np.ndarray, dimensions: int | None) -> ReferenceMap:
    places = [Place(row) for row in range(len(raw))]
    return map_of(path, raw, places, shrink=shrink_to(dimensions or DIMENSIONS, DIMENSIONS))


def test_directions_are_those_in_which_the_set_varies_most() -> None:
    rows = street(500, carriers=6, seed=3)
    found = principal_directions(lambda: np.array_split(rows, 7), DIMENSIONS, 6)
    np.testing.assert_allclose(found @ found.T, np.eye(6), atol=1e-5)
    flat = rows.reshape(-1, DIMENSIONS).astype(np.float64)
    _, _, exact = np.linalg.svd(flat, full_matrices=False)
    # The same subspace: every exact direction is whole within what was found.
    np.testing.assert_allclose(np.linalg.norm(exact[:6] @ found.T, axis=1), 1.0, atol=1e-3)
    carried = np.square(flat @ found.T).sum(axis=0)
    assert (np.diff(carried) <= 0).all()


def test_a_bad_number_does_not_reach_other_dimensions() -> None:
    directions = principal_directions(lambda: [street(100, carriers=6)], DIMENSIONS, 8)
    row = street(1, carriers=6)
    spoiled, without = row.copy(), row.copy()
    spoiled[0, 1, 5], without[0, 1, 5] = np.nan, 0
    np.testing.assert_array_equal(project(spoiled, directions), project(without, directions))


@pytest.mark.parametrize("count", [1, 2, 40])
def test_a_frame_and_a_whole_ring_are_shrunk_alike(count: int) -> None:
    directions = principal_directions(lambda: [street(100, carriers=6)], DIMENSIONS, 8)
    rows = street(count, carriers=6)
    exact = np.einsum("nrd,kd->nrk", rows.astype(np.float64), directions)
    np.testing.assert_allclose(project(rows, directions), exact, rtol=1e-5, atol=1e-5)


def test_a_shrunk_map_gives_nearly_the_costs_of_the_whole_one_in_both_orders(tmp_path: Path) -> None:
    raw = street(300, carriers=10)
    whole, shrunk = build(tmp_path / "whole", raw, None), build(tmp_path / "shrunk", raw, 12)
    assert whole.projection is None
    assert shrunk.descriptors.shape == (2, 300, 12)
    assert shrunk.projection is not None
    assert shrunk.projection.shape == (12, DIMENSIONS)
    rows = normalize(raw, raw.mean(axis=0, dtype=np.float64), raw.std(axis=0, dtype=np.float64))
    costs = [CostMatcher.of(one).costs(rows[40:45]) for one in (whole, shrunk)]
    assert np.abs(costs[0] - costs[1]).mean() < 0.05 * COST_ONE
    np.testing.assert_array_equal(costs[1][:, 0].argmin(axis=1), np.arange(40, 45))
    swapped = CostMatcher.of(shrunk).costs(rows[40:45, ::-1])
    np.testing.assert_array_equal(swapped, costs[1][:, ::-1])


def test_as_many_dimensions_as_there_are_is_no_projection(tmp_path: Path) -> None:
    assert build(tmp_path / "m", street(20, carriers=4), DIMENSIONS).projection is None


def test_more_dimensions_than_places(tmp_path: Path) -> None:
    assert build(tmp_path / "m", street(5, carriers=4), 40).descriptors.shape == (2, 5, 40)


def test_a_damaged_projection_is_noticed(tmp_path: Path) -> None:
    build(tmp_path / "m", street(20, carriers=4), 8)
    data = bytearray((tmp_path / "m" / PROJECTION).read_bytes())
    data[7] ^= 16
    (tmp_path / "m" / PROJECTION).write_bytes(data)
    with pytest.raises(MapError, match=rf"{PROJECTION}: damaged"):
        open_map(tmp_path / "m")
