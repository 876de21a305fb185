"""`lookback eval` as people run it: on miniature feeds with the shipped network, and on matrices of their own."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from edge.__main__ import main
from edge.feed import read_feed

PLAN = """
title = "Miniature"
methods = ["Raw-fc6", "NSD-CR", "Lookback", "Raw-mine", "SeqSLAM"]
resamples = 20
sampling = { by = "frames" }
[traverses]
there = { feed = "there", external = { mine = "there.npy" } }
here = { feed = "here", external = { mine = "here.npy" } }
"""
EXPERIMENTS = """
published = { "NSD-CR" = 0.5 }
[experiments]
sequence_lengths = [2, 4]
spacings_m = [4.0]
sweep_methods = ["NSD-CR"]
cold_start = ["Lookback"]
"""


@pytest.fixture
def plan_path(tmp_path: Path, write_plan: Callable[[str, str], Path]) -> Path:
    plan = write_plan(PLAN, EXPERIMENTS)
    describe = np.random.default_rng(0).normal(size=(40, 16)).cumsum(axis=0)
    for name in ("there", "here"):
        at_m = [float(row.extra["route_m"]) for row in read_feed(tmp_path / name).rows]
        np.save(tmp_path / f"{name}.npy", describe[np.array(at_m, int)])
    return plan


def test_a_shipped_plan_goes_by_its_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dev", "paper", "run", "real_feeds", "--feeds", str(tmp_path), "-o", str(tmp_path / "out")]) == 78
    assert "corridor_reference: no such feed" in capsys.readouterr().err.splitlines()[-1]


def read_table(path: Path) -> dict[str, list[str]]:
    with path.open(newline="") as stream:
        return {row[0]: row[1:] for row in csv.reader(stream)}


def test_a_plan_becomes_a_report(plan_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = plan_path.parent / "out"
    assert main(["dev", "paper", "run", str(plan_path), "-o", str(out)]) == 0
    scores = read_table(out / "there_and_here_scores.csv")
    assert float(scores["Raw-mine"][0]) == 1.0  # the same rows, so every best match is right
    assert scores["NSD-CR"][-1] == "0.5" and scores["Raw-fc6"][-1] == ""
    overview = read_table(out / "overview.csv")
    assert f"Raw-mine  {float(overview['Raw-mine'][0]):.3f}" in capsys.readouterr().out
    page = (out / "report.html").read_text()
    for heading in ("Overview", "Sequence length", "Spacing", "Cold start"):
        assert heading in page


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('feed = "here"', 'feed = "gone"', "gone: no such feed"),
        ('"Raw-fc6", "NSD-CR", "Lookback"', '"Raw-fc7"', "'Raw-fc7': no such row"),
        ('"there.npy"', '"gone.npy"', "gone.npy: cannot read it"),
        ('"there.npy"', '"here.npy"', "here.npy has 12 rows, its feed has 16"),
        ('"Raw-fc6", "NSD-CR", "Lookback"', '"Raw-conv3"', "[networks.shipped]: has no conv3"),
        ("length = 4", "length = 40", "no frame with a known true place ends a sequence of 40"),
    ],
)
def test_what_is_wrong_is_one_line(
    plan_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, says: str
) -> None:
    plan_path.write_text(plan_path.read_text().replace(old, new, 1).partition("[experiments]")[0])
    assert main(["dev", "paper", "run", str(plan_path), "-o", str(plan_path.parent / "out")]) == 78
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("lookback: ") and says in error


def diagonal_costs() -> np.ndarray:
    """30 places, 40 queries: 25 along the map from place 3 on, then 15 of somewhere else."""
    costs = np.random.default_rng(1).uniform(0.5, 1.0, (30, 40))
    costs[np.arange(3, 28), np.arange(25)] = 0.1
    return costs


def test_a_matrix_is_searched_and_scored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.save(tmp_path / "costs.npy", diagonal_costs())
    (tmp_path / "truth.csv").write_text("\n".join([*(str(place) for place in range(3, 28)), *["-1"] * 15]))
    arguments = ["dev", "paper", "match", str(tmp_path / "costs.npy"), "--length", "5", "--tolerance", "2"]
    assert main([*arguments, "--truth", str(tmp_path / "truth.csv"), "-o", str(tmp_path / "matches.csv")]) == 0
    said = {line[:19].strip(): line[19:].split()[0] for line in capsys.readouterr().out.splitlines()}
    assert (said["queries judged"], said["accuracy"], said["recall at 100 %"]) == ("36,", "1.0000", "1.0000")
    matches = read_table(tmp_path / "matches.csv")
    assert [int(matches[str(query)][0]) for query in range(4, 25)] == list(range(7, 28))
    assert matches["20"][2] == "forward"


def test_a_matrix_of_right_places_is_a_truth_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Query 30 has two right places, neither its best; the second of them is among its best five."""
    costs = np.random.default_rng(1).uniform(0.5, 1.0, (30, 40))
    right = np.zeros(costs.shape, dtype=bool)
    right[np.arange(30), np.arange(30)] = True
    costs[right] = 0.1
    right[[3, 9], 30] = True
    costs[[20, 21, 9], 30] = 0.1, 0.2, 0.3
    np.save(tmp_path / "costs.npy", costs)
    for dtype in (bool, np.uint8):
        np.save(tmp_path / "right.npy", right.astype(dtype))
        arguments = ["dev", "paper", "match", str(tmp_path / "costs.npy"), "--length", "1"]
        assert main([*arguments, "--truth", str(tmp_path / "right.npy")]) == 0
        said = {line[:19].strip(): line[19:].split()[0] for line in capsys.readouterr().out.splitlines()}
        assert (said["R@1"], said["R@5"], said["R@25"]) == ("0.9677", "1.0000", "1.0000")
    np.save(tmp_path / "right.npy", right.T)
    assert main([*arguments, "--truth", str(tmp_path / "right.npy")]) == 78
    assert "its shape is (40, 30), and that of the costs (reference x query) (30, 40)" in capsys.readouterr().err


def vpr_bench(folder: Path, count: int) -> Path:
    """Queries are the references in other light and in another order; a reference beside the right one is right too."""
    rng = np.random.default_rng(3)
    pictures = [cv2.resize(rng.integers(0, 255, (6, 8, 3), dtype=np.uint8), (160, 120)) for _ in range(count)]
    truth = np.empty((count, 2), dtype=object)
    for name in ("ref", "query"):
        (folder / name).mkdir(parents=True)
    for index, picture in enumerate(pictures):
        query = (7 * index) % count
        cv2.imwrite(str(folder / f"ref/{index:07}.jpg"), picture)
        cv2.imwrite(str(folder / f"query/{query:07}.jpg"), (picture * 0.6).astype(np.uint8))
        truth[index] = [query, [index, (index + 1) % count]]
    np.save(folder / "ground_truth_new.npy", truth, allow_pickle=True)
    return folder


def test_a_folder_of_vpr_bench_is_described_and_scored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dev", "paper", "match", str(vpr_bench(tmp_path / "bench", 12))]) == 0
    said = {line[:19].strip(): line[19:].split()[0] for line in capsys.readouterr().out.splitlines()}
    assert (said["queries judged"], said["R@1"], said["R@10"]) == ("12,", "1.0000", "1.0000")


def test_a_ground_truth_that_would_run_a_program_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    class Program:
        def __reduce__(self) -> tuple[object, ...]:
            return os.mkdir, (str(tmp_path / "made"),)

    rows = np.empty((1, 2), dtype=object)
    rows[0] = [0, Program()]
    np.save(tmp_path / "ground_truth_new.npy", rows, allow_pickle=True)
    np.save(tmp_path / "costs.npy", np.ones((3, 2)))
    arguments = ["dev", "paper", "match", str(tmp_path / "costs.npy")]
    assert main([*arguments, "--truth", str(tmp_path / "ground_truth_new.npy")]) == 78
    assert "posix.mkdir in it is neither an array nor a number" in capsys.readouterr().err
    assert not (tmp_path / "made").exists()


def test_the_way_back_is_found_and_without_truth_matches_go_to_the_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(tmp_path / "costs.npy", diagonal_costs()[::-1] - 5)  # costs may be negative
    assert main(["dev", "paper", "match", str(tmp_path / "costs.npy"), "--length", "5"]) == 0
    rows = [line.split(",") for line in capsys.readouterr().out.splitlines()[1:]]
    assert rows[10][:2] == ["14", "12"] and rows[10][3] == "reverse"


@pytest.mark.parametrize(
    ("costs", "truth", "says"),
    [
        (np.ones(5), "0", "needs numbers in 2 dimensions"),
        (np.full((3, 2), np.nan), "0\n0", "not finite"),
        (np.ones((3, 2)), "0\n1\n2", "3 rows for 2 queries"),
        (np.ones((3, 2)), "0\n3", "index 3, but the matrix has 3 places"),
        (np.ones((3, 2)), "0\nx", "line 2: 'x'"),
    ],
)
def test_a_wrong_matrix_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], costs: np.ndarray, truth: str, says: str
) -> None:
    np.save(tmp_path / "costs.npy", costs)
    (tmp_path / "truth.csv").write_text(truth)
    assert main(["dev", "paper", "match", str(tmp_path / "costs.npy"), "--truth", str(tmp_path / "truth.csv")]) == 78
    assert says in capsys.readouterr().err.splitlines()[-1]


def test_an_action_does_not_wait_for_what_another_needs() -> None:
    code = "import sys, edge.__main__ as m; m.build_parser(['dev', 'paper', 'run']); print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "sim.research.evaluation.commands" in loaded
    assert not {"sim.research.evaluation.run", "sim.research.evaluation.match_command", "matplotlib", "jinja2"} & set(
        loaded
    )
