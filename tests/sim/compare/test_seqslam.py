"""SeqSLAM against what the published program answered, and each step against loops that say what it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sim.compare.seqslam import describe, difference_matrix, enhance_contrast, search


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
