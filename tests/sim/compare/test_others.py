"""`lookback compare` on two folders of pictures, with what others made: networks, descriptors, similarities, truth."""

from __future__ import annotations

import argparse
import csv
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnxruntime
import pytest

import lookback
from edge.__main__ import main
from edge.errors import ConfigError, ModelError
from sim.compare.command import add_arguments
from sim.compare.foreign import ForeignNetwork, open_file
from sim.compare.matching import match_alone
from sim.compare.method_runner import MethodResult
from sim.compare.options import plan_of
from sim.compare.plan import Pair
from sim.compare.run import Folders, open_runner
from sim.compare.truth import matrix_errors, read_array
from sim.evaluation.report import Table, as_markdown
from tests.onnx_text import onnx_of

HERE, THERE = 12, 16
TUTORIAL = 60, 80
"""Queries and places."""
R_AT_1, R_AT_5, R_AT_10, R_P100 = 0.84, 0.9, 0.96, 0.8
TUTORIAL_CURVE = (1.964271, 1.0, 0.26), (1.556556, 1.0, 0.6), (1.352699, 0.930233, 0.8), (1.159034, 0.7, 0.84)
"""Thresholds, and precision and recall there."""
Compare = Callable[..., tuple[int, dict[str, dict[str, str]]]]


def network_file(path: Path, *, size: int = 16, rank: int = 2) -> Path:
    """A network of others: one convolution with random weights, its averages as the descriptor."""
    pytest.importorskip("onnx", reason="graphs are built with the extra `model`")
    text = (
        f"theirs (float[B, 3, {size}, {size}] x) => (float[B, {32 * (size // 4) ** 2}] out)"
        " { map = Conv<strides = [4, 4]>(x, kernel)  positive = Relu(map)  out = Flatten<axis = 1>(positive) }"
    )
    kernel = np.random.default_rng(0).normal(size=(32, 3, 4, 4)).astype(np.float32)
    path.write_bytes(onnx_of(text, kernel=kernel).SerializeToString())
    return path


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    """Pictures of a wall of random stripes: THERE places, and from the third on HERE of them in another light."""
    wall = np.random.default_rng(7).integers(0, 255, (6, 120, 3)).astype(np.float64)
    for name, first, count, light in (("there", 0, THERE, 1.0), ("here", 2, HERE, 0.6)):
        (tmp_path / name).mkdir()
        for number in range(count):
            at = 4 * (first + number)
            seen = wall[:, at : at + 16].repeat(8, axis=0).repeat(4, axis=1) * light
            cv2.imwrite(str(tmp_path / name / f"{number}.png"), seen.astype(np.uint8))
    return tmp_path / "there", tmp_path / "here"


@pytest.fixture
def compare(folders: tuple[Path, Path], tmp_path: Path) -> Compare:
    """compare(options...) runs the command on the two folders: its exit code, and the rows of its table by method."""

    def run(*options: str) -> tuple[int, dict[str, dict[str, str]]]:
        np.save(tmp_path / "gt.npy", np.abs(np.arange(2, 2 + HERE)[:, np.newaxis] - np.arange(THERE)) <= 1)
        what = [
            *map(str, folders),
            "-o",
            str(tmp_path / "report"),
            "--length",
            "3",
            "--truth",
            str(tmp_path / "gt.npy"),
        ]
        code = main(["compare", *what, *options])
        if code:
            return code, {}
        with (tmp_path / "report/scores.csv").open(encoding="utf-8", newline="") as stream:
            return code, {row["method"]: row for row in csv.DictReader(stream)}

    return run


def first(row: dict[str, str], column: str) -> float:
    return float(row[column].split()[0])


def test_methods_of_ours_and_of_others_in_one_table(compare: Compare, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    place = rng.normal(size=(THERE, 8))
    np.save(tmp_path / "reference.npy", place)
    np.save(tmp_path / "query.npy", place[2 : 2 + HERE] + rng.normal(scale=0.01, size=(HERE, 8)))
    code, rows = compare(
        "--network", f"theirs={network_file(tmp_path / 'theirs.onnx')}",
        "--descriptors", f"vlad={tmp_path / 'reference.npy'},{tmp_path / 'query.npy'}",
    )  # fmt: skip
    assert code == 0
    assert set(rows) >= {"Raw-single", "NSD-CR", "Lookback", "SeqSLAM", "NSD-single@theirs", "Raw-single@vlad"}
    assert first(rows["Raw-single@vlad"], "R@1") == 1.0 and rows["Raw-single@vlad"]["CPU ms a frame"] == "nan"
    assert first(rows["NSD-single@theirs"], "R@1") > 0.8 and first(rows["NSD-single@theirs"], "CPU ms a frame") > 0
    page = (tmp_path / "report/report.html").read_text()
    assert "query, frame" in page and "theirs.onnx" not in page  # a path says nothing to others


def test_similarities_of_others_alone_and_with_sequences(compare: Compare, tmp_path: Path) -> None:
    similarity = np.exp(-np.abs(np.arange(2, 2 + HERE)[:, np.newaxis] - np.arange(THERE)))
    similarity[4] = similarity[4][::-1]  # one frame that is wrong alone
    np.save(tmp_path / "s.npy", similarity)
    only = ("--method", "S", "--method", "S/sequences")
    code, rows = compare("--similarity", f"S={tmp_path / 's.npy'}", *only)
    assert code == 0 and list(rows) == ["S", "S/sequences"]
    assert first(rows["S"], "R@1") == pytest.approx(0.9) and first(rows["S/sequences"], "R@1") == 1.0
    assert first(rows["S"], "R@1") <= float(rows["S"]["R@5"]) <= float(rows["S"]["R@10"])


def test_soft_truth_as_vpr_tutorial_has_it(compare: Compare, tmp_path: Path) -> None:
    """GThard and GTsoft: a frame that finds its soft neighbor counts by the place that it finds next."""
    similarity = np.exp(-np.abs(np.arange(2, 2 + HERE)[:, np.newaxis] - np.arange(THERE)))
    similarity[4, 6] = similarity[5, 12] = 0.0
    similarity[4, 8] = similarity[5, 14] = 2.0  # a soft neighbor, and a wrong place
    np.save(tmp_path / "s.npy", similarity)
    np.save(tmp_path / "soft.npy", np.abs(np.arange(2, 2 + HERE)[:, np.newaxis] - np.arange(THERE)) <= 2)
    given = ("--similarity", f"S={tmp_path / 's.npy'}", "--soft", str(tmp_path / "soft.npy"))
    code, rows = compare(*given, "--method", "SeqSLAM")
    assert code == 0 and list(rows) == ["SeqSLAM", "S", "S/sequences"]
    assert first(rows["S"], "R@1") == pytest.approx(9 / 10)
    assert float(rows["S"]["median error"]) == 0.0


def test_the_numbers_of_vpr_tutorial(tmp_path: Path) -> None:
    """Its createPR, recallAtK and recallAt100precision (commit 2cb8918, single) gave these for the same matrices."""
    queries, places = np.arange(TUTORIAL[0])[:, np.newaxis], np.arange(TUTORIAL[1])
    away = np.abs(queries + 10 - places)
    noise = (queries * 7919 + places * 104729) ** 2 * 2654435761 % 2**32 / 2**32
    matrices = {"s": 1 / (1 + away) + 1.2 * noise, "hard": (away <= 1) & (queries < 50), "soft": away <= 3}
    for name, matrix in matrices.items():
        np.save(tmp_path / f"{name}.npy", matrix.T)
    for name, count in zip(("query", "reference"), TUTORIAL, strict=True):
        (tmp_path / name).mkdir()
        for number in range(count):
            blocks = np.random.default_rng(number).integers(0, 255, (6, 8, 3), dtype=np.uint8)
            cv2.imwrite(str(tmp_path / name / f"{number}.png"), blocks.repeat(4, axis=0).repeat(4, axis=1))
    files = {name: str(tmp_path / f"{name}.npy") for name in matrices}
    what = [str(tmp_path / "reference"), str(tmp_path / "query"), "-o", str(tmp_path / "report"), "--length", "1"]
    given = ["--truth", files["hard"], "--soft", files["soft"], "--similarity", f"S={files['s']}", "--transposed"]
    assert main(["compare", *what, *given, "--method", "S"]) == 0
    with (tmp_path / "report/scores.csv").open(encoding="utf-8", newline="") as stream:
        (row,) = csv.DictReader(stream)
    assert [first(row, column) for column in ("R@1", "R@5", "R@10", "R@P100")] == [R_AT_1, R_AT_5, R_AT_10, R_P100]
    curve = lookback.pr_curve(matrices["s"], matrices["hard"], matrices["soft"])
    for threshold, precision, recall in TUTORIAL_CURVE:
        at = np.flatnonzero(curve.thresholds >= threshold)[-1]
        assert (curve.precision[at], curve.recall_of_places[at]) == pytest.approx((precision, recall), abs=1e-6)
    for count, recall in ((1, R_AT_1), (5, R_AT_5), (10, R_AT_10)):
        assert lookback.recall_at(matrices["s"], matrices["hard"], count, soft=matrices["soft"]) == recall


def test_no_method_is_judged_on_other_frames_where_it_finds_soft_places(folders: tuple[Path, Path]) -> None:
    """By the command's own runner: also a method that names a single place, whose answer is none then."""
    right = np.abs(np.arange(2, 2 + HERE)[:, np.newaxis] - np.arange(THERE)) == 1
    soft = np.abs(np.arange(2, 2 + HERE)[:, np.newaxis] - np.arange(THERE)) <= 3
    np.save(folders[0].parent / "gt.npy", right)
    np.save(folders[0].parent / "soft.npy", soft)
    options = argparse.ArgumentParser()
    add_arguments(options)
    files = [f"--{name}={folders[0].parent / file}" for name, file in (("truth", "gt.npy"), ("soft", "soft.npy"))]
    args = options.parse_args([*map(str, folders), "-o", "report", "--length", "3", *files])
    runner = open_runner(plan_of(args), Folders(*[Path()] * 4))
    outcomes = [runner.run(runner.plan.pairs[0], name) for name in ("Raw-single", "NSD-CR", "Lookback", "SeqSLAM")]
    for one in outcomes:
        assert one.judged.tolist() == list(range(2, HERE))
        answered = one.judged[one.matches.place[one.judged] >= 0]
        assert not np.isnan(one.error_of_best()[one.judged]).any()
        assert not soft[answered, one.matches.place[answered]][~right[answered, one.matches.place[answered]]].any()
    single = outcomes[2]  # which believes where it is, and that is soft here
    assert (single.matches.place[single.judged] == -1).any() and single.answers.has_truth.all()


def test_a_chosen_row_keeps_those_of_other_options(compare: Compare, tmp_path: Path) -> None:
    place = np.random.default_rng(0).normal(size=(THERE, 8))
    np.save(tmp_path / "reference.npy", place)
    np.save(tmp_path / "query.npy", place[2 : 2 + HERE])
    given = ("--descriptors", f"vlad={tmp_path / 'reference.npy'},{tmp_path / 'query.npy'}")
    assert list(compare(*given, "--method", "SeqSLAM")[1]) == ["SeqSLAM", "Raw-single@vlad", "NSD-fc6@vlad"]
    assert list(compare(*given, "--method", "Raw-single@vlad")[1]) == ["Raw-single@vlad"]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--similarity", "S=none.npy", "--method", "S"), "none.npy: cannot read it"),
        (("--similarity", "S"), "--similarity: 'S' is not NAME=FILE"),
        (("--descriptors", "d=one.npy"), "is not NAME=REFERENCE.npy,QUERY.npy"),
        (("--network", "n=none.onnx"), "none.onnx: no such network"),
        (("--method", "NetVLAD"), "'NetVLAD': no such row"),
        (("--truth", "gps"), "'gps' is none of positions"),
        (("--transposed",), "queries and 16 places"),
    ],
)
def test_what_is_wrong_is_one_line(
    compare: Compare, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], says: str
) -> None:
    assert compare(*options)[0] == 78
    assert says in capsys.readouterr().err.splitlines()[-1]


def test_one_recording_is_none_to_compare(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", str(tmp_path), "-o", str(tmp_path / "compared")]) == 78
    assert capsys.readouterr().err.strip().endswith("needs a plan, or two recordings: the reference, then the query")


def test_what_is_not_known_is_a_dash_in_a_table() -> None:
    assert as_markdown(Table("t", "", ("a", "b"), [[float("nan"), 0.5]])).endswith("| – | 0.50 |")


def test_a_network_of_others_gets_rgb_as_imagenet_has_it(tmp_path: Path) -> None:
    theirs = open_file(network_file(tmp_path / "theirs.onnx"))
    assert isinstance(theirs, ForeignNetwork) and theirs.size == (16, 16) and theirs.info.dimensions == 512
    image = np.random.default_rng(1).integers(0, 255, (2, 16, 16, 3), dtype=np.uint8)
    session = onnxruntime.InferenceSession(str(theirs.path))
    scaled = (image[..., ::-1] / 255 - [0.485, 0.456, 0.406]) / [0.229, 0.224, 0.225]
    expected = session.run(None, {"x": scaled.transpose(0, 3, 1, 2).astype(np.float32)})[0]
    np.testing.assert_allclose(theirs.describe(image), expected, rtol=1e-3, atol=1e-4)
    (tmp_path / "broken.onnx").write_bytes(b"no network")
    with pytest.raises(ModelError, match=r"broken\.onnx: ONNX Runtime rejects it"):
        open_file(tmp_path / "broken.onnx")


def test_truth_as_vpr_bench_has_it_and_nothing_that_a_file_could_run(tmp_path: Path) -> None:
    lists = np.array([[0, [1, 2]], [1, []], [2, [0]]], dtype=object)
    np.save(tmp_path / "ground_truth_new.npy", lists)
    errors = matrix_errors(Pair("p", "r", "q", "ground_truth_new.npy", length=1), (3, 3), tmp_path)
    assert np.argwhere(errors == 0).tolist() == [[0, 1], [0, 2], [2, 0]]

    class Evil:
        def __reduce__(self) -> tuple[Any, ...]:
            return Path.touch, (tmp_path / "ran",)

    with (tmp_path / "evil.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "|O", "fortran_order": False, "shape": (1,)})
        pickle.dump(Evil(), file)
    with pytest.raises(ConfigError, match=r"evil\.npy: cannot read it as an array: it asks for"):
        read_array(tmp_path / "evil.npy")
    assert not (tmp_path / "ran").exists()


def test_recall_counts_places_among_the_best() -> None:
    similarity = np.array([[0.9, 0.8, 0.1], [0.1, 0.9, 0.8], [0.9, 0.2, 0.1]])
    errors = np.array([[9.0, 0.0, 9.0], [9.0, 9.0, 0.0], [9.0, 9.0, 0.0]])
    pair: Any = Pair("p", "r", "q", "rows", tolerance=1.0, length=1)
    nothing: Any = None
    outcome = MethodResult(
        pair, nothing, 1, nothing, nothing, match_alone(similarity), 0.0, errors, np.arange(3), nothing
    )
    assert [round(outcome.recall_within(count), 2) for count in (1, 2, 3)] == [0.0, 0.67, 1.0]
