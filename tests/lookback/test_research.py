"""What a researcher does: two folders to recall@1 and a curve; a map; pictures one after another."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import edge
import lookback

PLACES = 40
DRIVE = np.random.default_rng(0).random((9, 2, 8))


def street(at: int, light: float, seed: int) -> NDArray[np.uint8]:
    """A window of a fixed random wall, in some light, with some noise."""
    wall = np.random.default_rng(7).integers(0, 255, (12, 200, 3)).astype(np.float64)
    seen = wall[:, at * 4 : at * 4 + 20].repeat(8, axis=0).repeat(8, axis=1)
    return (seen * light + np.random.default_rng(seed).normal(0, 6, seen.shape)).clip(0, 255).astype(np.uint8)


def write(folder: Path, places: range, light: float) -> Path:
    folder.mkdir()
    for number, at in enumerate(places):
        cv2.imwrite(str(folder / f"{number}.png"), street(at, light, number))
    return folder


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A drive by day, and its second half by dusk."""
    base = tmp_path_factory.mktemp("drives")
    return write(base / "out", range(PLACES), 1.0), write(base / "again", range(10, PLACES), 0.5)


def test_two_folders_to_recall_and_a_curve(folders: tuple[Path, Path]) -> None:
    reference, query = (lookback.describe(folder, progress=False) for folder in folders)
    similarity = lookback.compare(lookback.normalize(query), lookback.normalize(reference))
    truth = np.abs(np.arange(10, PLACES)[:, np.newaxis] - np.arange(PLACES)) <= 2
    found = lookback.search(similarity, length=5)
    assert lookback.recall_at(similarity, truth) > 0.8
    assert lookback.recall_at(similarity, truth, 5) >= lookback.recall_at(similarity, truth)
    assert (found.place[:4] == -1).all() and (np.abs(found.place[4:] - np.arange(14, PLACES)) <= 2).all()
    curve = lookback.pr_curve(found, truth)
    assert lookback.auc(curve) == pytest.approx(26 / 30)  # all that is answered is right
    assert len(lookback.match_pairs(found)) == 26
    believed = lookback.believe(query, reference, length=5)
    assert lookback.recall_at(believed, truth) > 0.6


def test_a_soft_place_is_masked_and_the_next_best_counts() -> None:
    similarity = np.array([[0.9, 0.8, 0.1, 0.0], [0.2, 0.7, 0.9, 0.1], [0.1, 0.2, 0.3, 0.8]])
    truth, soft = np.zeros((3, 4), np.bool_), np.zeros((3, 4), np.bool_)
    truth[0, 1] = truth[1, 0] = soft[0, 0] = soft[0, 1] = soft[1, 2] = soft[2, 3] = True
    assert [lookback.recall_at(similarity, truth, count, soft) for count in (1, 2)] == [0.5, 1.0]
    curve = lookback.pr_curve(similarity, truth, soft)
    assert curve.thresholds.tolist() == [0.8, 0.7, 0.3]
    assert curve.precision == pytest.approx([1, 1 / 2, 1 / 3])
    assert curve.recall_of_places == pytest.approx([0.5, 0.5, 0.5])


def test_frames_without_an_answer_are_not_those_of_the_last_place() -> None:
    """Also where the last place is a soft one."""
    found, truth = lookback.search(np.eye(20), length=5), np.eye(20, dtype=bool)
    soft = np.zeros_like(truth)
    soft[:, -1] = True
    assert lookback.auc(lookback.pr_curve(found, truth, soft)) == lookback.auc(lookback.pr_curve(found, truth)) == 0.8
    assert lookback.recall_at(found, truth, soft=soft) == 0.8


def test_without_a_soft_place_a_sequence_has_its_next_best_line_and_a_belief_none() -> None:
    drive = np.random.default_rng(1).random((PLACES, 2, 64), dtype=np.float32)
    truth = np.eye(PLACES, dtype=bool)
    wrong = np.roll(truth, 1, axis=1)
    similarity = lookback.compare(lookback.normalize(drive), lookback.normalize(drive))
    found = lookback.search(similarity, length=5, window=2)
    masked = found.without(truth)
    answered = found.place >= 0
    assert (found.place == np.arange(PLACES))[answered].all() and (masked.place != np.arange(PLACES))[answered].all()
    assert (masked.confidence < found.confidence)[answered].all() and (masked.place[~answered] == -1).all()
    assert lookback.recall_at(found, wrong, soft=truth) == np.mean(masked.place == (np.arange(PLACES) + 1) % PLACES)
    believed = lookback.believe(drive, drive, length=5)
    assert lookback.recall_at(believed, truth) > 0.5
    assert lookback.recall_at(believed, wrong, soft=truth) == 0.0
    assert (believed.without(truth).place[believed.place == np.arange(PLACES)] == -1).all()


def test_what_is_plotted_is_a_picture_in_a_notebook() -> None:
    pytest.importorskip("matplotlib", reason="the extra `sim`")
    similarity, truth = np.eye(8), np.eye(8, dtype=np.bool_)
    found, curve = lookback.nearest(similarity), lookback.pr_curve(similarity, truth)
    soft = np.roll(truth, 1, axis=1)
    shown = lookback.plot(similarity, soft, found, truth).axes[0].lines  # of which none finds a soft place
    assert [len(line.get_xdata()) for line in shown] == [2, 6]  # type: ignore[arg-type]
    for figure in (lookback.plot(similarity, truth, found), lookback.plot(curve), lookback.plot({"a": curve})):
        assert figure._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]


def test_a_sequence_driven_back_is_found_by_the_swapped_regions() -> None:
    drive = lookback.normalize(np.random.default_rng(1).random((PLACES, 2, 32), dtype=np.float32))
    back = drive[::-1, ::-1]  # the same camera looks the other way: left is right
    both = lookback.compare(back, drive, orders=True)
    assert both.shape == (2, PLACES, PLACES)
    found = lookback.search(both, length=5)
    assert found.reverse[4:].all() and (found.place[4:] == np.arange(PLACES)[::-1][4:]).all()
    assert np.array_equal(lookback.compare(back, drive), both.max(axis=0))


def test_the_truth_of_two_recordings_and_what_lacks_it(folders: tuple[Path, Path]) -> None:
    right = lookback.truth(folders[1], folders[0], tolerance=1, kind="rows")
    assert right.shape == (30, PLACES) and right[5].nonzero()[0].tolist() == [4, 5, 6]
    with pytest.raises(lookback.Error, match="no positions in any row"):
        lookback.truth(folders[1], folders[0], tolerance=1)


def test_a_map_and_one_picture_after_another(folders: tuple[Path, Path], tmp_path: Path) -> None:
    built = lookback.Map.build(folders[0], tmp_path / "map")
    with pytest.raises(lookback.Error, match=r"already exists; remove it, or name another folder$"):
        lookback.Map.build(folders[0], tmp_path / "map")
    again = lookback.Map.open(tmp_path / "map")
    assert len(again) == PLACES and again.descriptors.shape[:2] == (PLACES, 2) and again.picture(3).ndim == 3
    recognizer = lookback.Recognizer(built, length=5)
    matches = [recognizer.observe(street(at, 0.5, at)) for at in range(10, PLACES)]
    last = matches[-1]
    assert matches[0] is None and last is not None
    assert abs(last.place - (PLACES - 1)) <= 1 and last.direction == "forward" and last.accepted
    with pytest.raises(lookback.Error, match=r"made with the network grid.*not with fc6"):
        lookback.Map.open(tmp_path / "map", model="fc6")


def test_a_map_of_whole_meters_is_the_same_as_that_of_a_float(
    write_traverse: Callable[..., Path], tmp_path: Path
) -> None:
    drive = write_traverse(tmp_path / "drive", range(12))
    whole, decimal = (
        lookback.Map.build(drive, tmp_path / str(spacing_m), spacing_m=spacing_m) for spacing_m in (4, 4.0)
    )
    assert len(whole) == len(decimal) == 6
    assert whole.opened.header == decimal.opened.header


def test_the_version_is_that_of_the_package() -> None:
    assert lookback.__version__ == edge.__version__


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (lambda: lookback.compare(np.zeros((3, 2, 4)), np.zeros((3, 4))), "differ in regions or dimensions"),
        (lambda: lookback.normalize(np.zeros((3, 3, 4), np.float32)), "1 or 2 regions"),
        (lambda: lookback.search(np.full((9, 9), np.nan)), "finite numbers"),
        (lambda: lookback.recall_at(np.eye(3), np.eye(4, dtype=bool)), r"\(3, 3\) \(queries, places\)"),
        (lambda: lookback.search(np.zeros((3, 9, 9))), r"\(2, Q, N\), not \(3, 9, 9\)"),
        (lambda: lookback.search(np.eye(9), length=0), "length is a whole number from 1 to 500, not 0"),
        (lambda: lookback.search(np.eye(9), length=2.5), "length is a whole number"),  # type: ignore[arg-type]
        (lambda: lookback.search(np.eye(9), window=np.nan), "window is a number of at least 0, not nan"),
        (lambda: lookback.search(np.eye(9), views=("front", "left")), "views are two of"),  # type: ignore[arg-type]
        (lambda: lookback.search(np.eye(9), views=None), "views are two of.*not None"),  # type: ignore[arg-type]
        (lambda: lookback.truth("a", "b", tolerance="20"), "not '20'"),  # type: ignore[arg-type]
        (lambda: lookback.match_pairs(np.eye(3), least=""), "least is a confidence"),  # type: ignore[arg-type]
        (lambda: lookback.Map.build("here", "there", fov_deg=20), "fov_deg is a number from 30 to 120, not 20"),
        (lambda: lookback.Map.build("here", "there", spacing_m=None), "at least 0.01, not None"),  # type: ignore[arg-type]
        (lambda: lookback.believe(DRIVE, DRIVE, length=0), "length is a whole number"),
        (lambda: lookback.believe(DRIVE, DRIVE, query_m=np.arange(9.0)), "given together"),
        (lambda: lookback.believe(DRIVE, DRIVE, query_m=np.arange(8.0), reference_m=np.arange(9.0)), "each of 9 rows"),
        (lambda: lookback.compare(np.full((3, 4), np.nan), np.ones((3, 4))), "descriptors are finite numbers"),
        (lambda: lookback.normalize(np.full((3, 4), np.inf, np.float32)), "descriptors are finite numbers"),
        (lambda: lookback.recall_at(np.eye(3), np.full((3, 3), 2)), "truth is True or False, or 1 or 0"),
        (lambda: lookback.pr_curve(np.eye(3), np.eye(3), np.eye(4)), "soft is True or False"),
        (lambda: lookback.recall_at(np.eye(3), np.eye(3), 11), "from 1 to 10, not 11"),
        (lambda: lookback.truth("here", "there", tolerance=-1), "tolerance is a number of at least 0, not -1"),
        (lambda: lookback.describe(iter(()), progress=False), "no picture to describe"),
        (lambda: lookback.describe([np.zeros((4, 4), np.uint8)], progress=False), r"an image is \(H, W, 3\)"),
    ],
)
def test_wrong_arrays_are_named(wrong: object, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        wrong()  # type: ignore[operator]


def test_what_numpy_takes_for_arrays_works(folders: tuple[Path, Path]) -> None:
    """Lists, truth of ones and zeros, a generator of pictures."""
    given, right = np.eye(9).tolist(), np.eye(9, dtype=int)
    for truth in (right, right.tolist(), right.astype(float)):
        assert lookback.recall_at(given, truth) == lookback.auc(lookback.pr_curve(given, truth, truth)) == 1.0
    files = sorted(folders[0].iterdir())[:2]
    described = lookback.describe((str(file) for file in files), progress=False)
    assert np.array_equal(described, lookback.describe(files, progress=False))


def test_what_the_user_calls_sim_hides_nothing_silently(tmp_path: Path) -> None:
    (tmp_path / "sim").mkdir()
    (tmp_path / "sim/__init__.py").write_text("raise SystemExit('the user own package ran')\n")
    here = {**os.environ, "PYTHONPATH": str(Path(lookback.__file__).parents[1])}
    command = Path(sys.executable).with_name("lookback")
    done = subprocess.run([command, "compare", "--help"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    done = subprocess.run(
        [sys.executable, "-c", "import lookback"], cwd=tmp_path, env=here, capture_output=True, text=True, check=False
    )
    assert "sim/__init__.py hides the package 'sim' that Lookback is made of" in done.stderr.splitlines()[-1]


def test_one_query_says_which_place_a_picture_shows(folders: tuple[Path, Path]) -> None:
    """By the points that agree: of files, of images and of points alike."""
    out, again = (sorted(folder.glob("*.png"), key=lambda file: int(file.stem)) for folder in folders)
    places = [lookback.keypoints(file) for file in out]
    query = lookback.keypoints(np.asarray(cv2.imread(str(again[5])), np.uint8))  # of place 15
    inliers = [lookback.verify(query, place).inliers for place in places]
    assert int(np.argmax(inliers)) == 15
    assert inliers[15] == lookback.verify(again[5], out[15]).inliers > 3 * max(inliers[:10] + inliers[21:])


def test_a_map_with_keypoints_is_asked_for_poses_and_one_without_says_what_to_do(
    folders: tuple[Path, Path], tmp_path: Path
) -> None:
    without = lookback.Map.build(folders[0], tmp_path / "without")
    with pytest.raises(lookback.Error, match="no keypoints; add them with `lookback map keypoints`"):
        without.pose(street(3, 1.0, 3), 3)
    with_them = lookback.Map.build(folders[0], tmp_path / "with", fov_deg=80)
    assert with_them.pose(street(3, 1.0, 3), 3) is None, "nobody knows how far these pictures are apart"


def test_the_name_of_earlier_versions_still_works_and_says_so() -> None:
    with pytest.warns(DeprecationWarning, match="InlierMatches"):
        assert getattr(lookback, "Verified") is lookback.InlierMatches  # noqa: B009  # mypy knows only the new name
    with pytest.raises(AttributeError, match="verified"):
        getattr(lookback, "verified")  # noqa: B009
