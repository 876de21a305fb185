"""The learned directions: what a place keeps in another light counts, and what the light changes does not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.research.evaluation.belief import Described
from sim.research.evaluation.directions import AHEAD_M, examples, learn
from sim.research.evaluation.learned_map import beside_own, regions

PLACES, DIMENSIONS, LIGHT = 300, 64, slice(0, 52)


def drive(seed: int, road: NDArray[np.float32], route_m: NDArray[np.float64]) -> Described:
    """A drive past places (n, R, D) at `route_m`; along LIGHT its frames are strong, and its own."""
    raw = road + np.float32(0.2) * np.random.default_rng(seed).normal(size=road.shape).astype(np.float32)
    raw[:, :, LIGHT] = np.random.default_rng(seed + 1).normal(size=raw[:, :, LIGHT].shape) * 3
    return Described(raw, route_m, route_m - route_m[0])


def road_and_drives(seed: int) -> tuple[Described, dict[str, Described]]:
    """A road, the way home on it, and the same way, where left and right are swapped and things are seen ahead."""
    rng = np.random.default_rng(seed)
    places = rng.normal(size=(PLACES + 11, 2, DIMENSIONS)).astype(np.float32)
    # Neighbors are alike, as on a road: places beside the right one make pairs as well.
    places = sum(places[at : PLACES + at] for at in range(12)) / np.sqrt(12)
    route_m = 2.0 * np.arange(PLACES, dtype=np.float64)
    ahead = round(AHEAD_M / 2)
    home = drive(seed + 10, places, route_m)
    same_way = drive(seed + 20, places[ahead:, ::-1], route_m[: PLACES - ahead])
    return drive(seed + 30, places, route_m), {"reverse night": home, "forward dusk": same_way}


def found_share(directions: NDArray[np.float32], mapped: NDArray[np.float32], seen: NDArray[np.float32]) -> float:
    """Share of the rows whose most similar one along some directions is their own, or one beside it."""
    rows = [one @ directions.T for one in (mapped, seen)]
    rows = [one / np.linalg.norm(one, axis=1, keepdims=True) for one in rows]
    return float((np.abs((rows[1] @ rows[0].T).argmax(axis=1) - np.arange(len(seen))) <= 5).mean())


def test_what_the_light_changes_is_left_out() -> None:
    learned = learn(examples(*road_and_drives(1)), 12)
    assert learned.shape == (12, DIMENSIONS)
    assert np.square(learned[:, LIGHT]).sum() < 0.05 * np.square(learned).sum()
    road, drives = road_and_drives(2)
    other = examples(road, {"reverse night": drives["reverse night"]})
    mapped, seen = other.mapped[: 2 * PLACES : 2], other.seen[: 2 * PLACES : 2]
    assert found_share(learned, mapped, seen) > found_share(np.eye(DIMENSIONS, dtype=np.float32), mapped, seen) + 0.2


def test_a_map_has_its_own_directions_and_the_learned_ones_by_their_weight() -> None:
    road, drives = road_and_drives(1)
    rows = examples(road, drives).rows.reshape(-1, 2, DIMENSIONS)
    learned = learn(examples(road, drives), 12)
    directions = beside_own(learned, own=20, weight=0.5)(lambda: iter([rows[:100], rows[100:]]))
    assert directions.shape == (32, DIMENSIONS)
    own, other = (np.square(regions(rows) @ part.T).sum(axis=1).mean() for part in (directions[:20], directions[20:]))
    np.testing.assert_allclose([own, other], [1.0, 0.25], rtol=1e-4)
    np.testing.assert_allclose(directions[20:] / learned, directions[20, 0] / learned[0, 0], rtol=1e-3)


def test_pairs_are_of_one_place_the_same_way_with_the_regions_swapped_and_ahead() -> None:
    road, drives = road_and_drives(3)
    for name, drive_ in drives.items():
        pairs = examples(road, {name: drive_})
        seen, mapped = pairs.seen[:, LIGHT.stop :], pairs.mapped[:, LIGHT.stop :]
        alike = np.einsum("nd,nd->n", seen, mapped) / np.linalg.norm(seen, axis=1) / np.linalg.norm(mapped, axis=1)
        assert np.median(alike) > 0.6, name
