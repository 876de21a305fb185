"""Every row of the table, whole: normalize, match, search and tell apart, against loops that say what each is."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.config import SequenceConfig
from edge.errors import ConfigError
from edge.reference_map.costs import CostMatcher, encode
from edge.sequence.search import slopes_around_diagonal
from sim.compare.matching import costs_of_better_order, match, open_matcher
from sim.compare.methods import METHODS, Method, find_method, query_rows, reference_rows
from sim.compare.seqslam import describe, difference_matrix, enhance_contrast, search

LENGTH, PLACES, QUERIES, DIMENSIONS, WINDOW = 4, 14, 13, 24, 3.0
DESCRIBED = [name for name, method in METHODS.items() if method.layer != "pixels" and not method.recognizer]
Array = NDArray[np.float64]


def normalized(value: Array, known: Array) -> Array:
    """Equation 1 of one descriptor, with the statistics of those that are known."""
    out = np.zeros(value.shape)
    spread = known.std(axis=0)
    for index in np.ndindex(value.shape):
        if spread[index] > 1e-4 * spread.mean():
            out[index] = (value[index] - known[(slice(None), *index)].mean()) / spread[index]
    return out


def slow_reference(method: Method, raw: Array) -> list[Array]:
    raw = raw.astype(np.float16).astype(np.float64)  # as a map keeps it
    return [normalized(one, raw) for one in raw] if method.nsd else list(raw)


def slow_rings(method: Method, raw: Array) -> list[list[Array]]:
    """The whole ring as it stands after each frame."""
    rings: list[list[Array]] = []
    for frame, one in enumerate(raw):
        before = rings[-1][1 - LENGTH :] if rings else []
        rings.append([*before, normalized(one, raw[: frame + 1]) if method.nsd else one])
    return rings


def slow_int8(value: Array) -> Array:
    """As a map keeps a row: of two regions half their sum and half their difference, scaled to the largest value."""
    if len(value) == 2:
        value = np.stack([value[0] + value[1], value[0] - value[1]]) / 2
    most = np.abs(value).max()
    return np.rint(value * (127 / most)) if most > 0 else value


def slow_cost(query: Array, place: Array, swapped: bool) -> int:
    query, place = slow_int8(query[::-1] if swapped else query).ravel(), slow_int8(place).ravel()
    lengths = math.sqrt(float((query @ query) * (place @ place)))
    return round(16384 * (1 - (float(query @ place) / lengths if lengths else 0.0)))


def slow_answers(method: Method, reference: Array, query: Array) -> list[tuple[int, float] | None]:
    """Place and uniqueness for each frame: every line through the ring, added up cell by cell."""
    places = slow_reference(method, reference)
    answers: list[tuple[int, float] | None] = []
    swaps = (False, True) if method.regions == "left-right" else (False,)
    for frame, ring in enumerate(slow_rings(method, query), 1):
        if len(ring) < LENGTH:
            answers.append(None)
            continue
        costs = {
            (age, i, swap): slow_cost(ring[-1 - age], places[i], swap)
            for age in range(LENGTH)
            for i in range(PLACES)
            for swap in swaps
        }
        lines = [min(slow_lines(costs, frame, i, swaps), default=math.inf) for i in range(PLACES)]
        best = min(range(PLACES), key=lambda i: lines[i])
        second = min((lines[i] for i in range(PLACES) if abs(i - best) > WINDOW), default=math.inf)
        answers.append((best, second / max(lines[best], 1) if math.isfinite(second) else 1.0))
    return answers


def slow_lines(costs: dict[tuple[int, int, bool], int], frame: int, end: int, swaps: tuple[bool, ...]) -> list[int]:
    """Cost of every line that ends at a place: each direction and slope, and in each frame the better region order."""
    found = []
    for direction in (1, -1):
        for slope in slopes_around_diagonal(0.2, 21):
            passed = [
                math.floor(slope * frame + 0.5) - math.floor(slope * (frame - age) + 0.5) for age in range(LENGTH)
            ]
            ats = [end - direction * steps for steps in passed]
            if all(0 <= at < PLACES for at in ats):
                found.append(sum(min(costs[age, at, swap] for swap in swaps) for age, at in enumerate(ats)))
    return found


def described(rng: np.random.Generator, count: int, regions: int) -> NDArray[np.float32]:
    """Something like fc6 after ReLU: shared by neighbors, positive, with a dead dimension."""
    walk = rng.normal(size=(count, regions, DIMENSIONS)).cumsum(axis=0)
    raw = np.maximum(walk + rng.normal(size=(1, regions, DIMENSIONS)), 0)
    raw[..., 0] = 0
    return raw.astype(np.float32)


@pytest.mark.parametrize("name", DESCRIBED)
def test_each_row_answers_as_written_out(name: str) -> None:
    method = METHODS[name]
    rng = np.random.default_rng(len(name))
    regions = 2 if method.regions == "left-right" else 1
    reference = described(rng, PLACES, regions)
    query = reference[1:][::-1] + np.abs(rng.normal(size=(QUERIES, regions, DIMENSIONS))).astype(np.float32) * 0.3
    rows = query_rows(method, query)
    found = match(
        rows,
        costs_of_better_order(CostMatcher.of_encoded(encode(reference_rows(method, reference))).costs),
        open_matcher(
            np.full((PLACES, 2), np.nan),
            np.arange(PLACES, dtype=np.float64),
            WINDOW,
            SequenceConfig(length=LENGTH),
            views=("rear", "front"),
        ),
    )
    expected = slow_answers(method, reference.astype(np.float64), query.astype(np.float64))
    assert [place if place >= 0 else None for place in found.place] == [one and one[0] for one in expected]
    uniqueness = [one[1] if one else math.nan for one in expected]
    # float32 on one side and float64 on the other may round a cell of int8 apart.
    np.testing.assert_allclose(found.confidence, uniqueness, rtol=5e-3)


def test_a_row_may_name_its_network() -> None:
    assert find_method("NSD-fc6@objects", ["p365", "objects"]).network == "objects"
    assert find_method("NSD-fc6", ["p365", "objects"]).network == "p365"


@pytest.mark.parametrize("text", ["NSD-fc9", "NSD-fc6@nowhere"])
def test_a_row_that_is_not_there_is_one_line(text: str) -> None:
    with pytest.raises(ConfigError, match="there are") as caught:
        find_method(text, ["p365"])
    assert "\n" not in str(caught.value) and repr(text) in str(caught.value)


@pytest.fixture(scope="module")
def golden(shared: Path) -> dict[str, np.ndarray]:
    with np.load(shared / "golden" / "openseqslam_synthetic120x90.npz") as arrays:
        return dict(arrays)


@pytest.mark.parametrize(
    ("name", "length", "enhanced"),
    [("matches_ds10", 10, True), ("matches_ds20", 20, True), ("matches_ds10_noenhance", 10, False)],
)
def test_centered_matches_are_those_of_the_published_program(
    golden: dict[str, np.ndarray], name: str, length: int, enhanced: bool
) -> None:
    differences = enhance_contrast(golden["D"]) if enhanced else golden["D"]
    place, ratio, _ = search(differences, length)
    expected = golden[name]
    np.testing.assert_array_equal(np.isnan(expected[:, 0]), place < 0)
    np.testing.assert_array_equal(np.where(place < 0, np.nan, place + 1), expected[:, 0])
    np.testing.assert_allclose(ratio, expected[:, 1], rtol=2e-5)


def test_local_contrast_is_that_of_the_published_program(golden: dict[str, np.ndarray]) -> None:
    np.testing.assert_allclose(enhance_contrast(golden["D"]), golden["DD"], atol=1e-5)


def test_a_map_shorter_than_a_trajectory_gives_no_match() -> None:
    place, ratio, _ = search(np.ones((5, 30), dtype=np.float32), 10)
    assert (place == -1).all() and np.isnan(ratio).all()


def test_patches_are_normalized_one_by_one() -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(0, 255, (32, 64, 3), dtype=np.uint8)
    image[:] = image[:, :, :1]  # gray of the same size: neither step before the patches changes anything
    image[8:16, 16:24] = 77
    found = describe(image)
    for row in range(0, 32, 8):
        for column in range(0, 64, 8):
            patch = image[row : row + 8, column : column + 8, 0].astype(np.float64)
            spread = patch.std(ddof=1)
            slow = np.zeros_like(patch) if spread == 0 else np.round((patch - patch.mean()) / spread)
            np.testing.assert_array_equal(found[row : row + 8, column : column + 8], slow)


def test_differences_are_those_written_out() -> None:
    rng = np.random.default_rng(1)
    reference, query = (rng.normal(size=(n, 32, 64)).astype(np.float32) for n in (4, 3))
    found = difference_matrix(reference, query)
    for row in range(4):
        for column in range(3):
            assert found[row, column] == pytest.approx(np.abs(reference[row] - query[column]).mean(), rel=1e-5)
