"""`lookback compare` as people run it: on miniature feeds with the shipped network."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import pytest

from edge.__main__ import main

PLAN = """
title = "Miniature"
methods = ["Raw-fc6", "NSD-CR", "Lookback", "SeqSLAM"]
resamples = 20
sampling = { by = "frames" }
[traverses]
there = { feed = "there" }
here = { feed = "here" }
"""


@pytest.fixture
def plan_path(write_plan: Callable[[str], Path]) -> Path:
    return write_plan(PLAN)


def test_a_shipped_plan_goes_by_its_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", "real_feeds", "--feeds", str(tmp_path), "-o", str(tmp_path / "out")]) == 78
    assert "corridor_reference: no such feed" in capsys.readouterr().err.splitlines()[-1]


def read_table(path: Path) -> dict[str, list[str]]:
    with path.open(newline="") as stream:
        return {row[0]: row[1:] for row in csv.reader(stream)}


def test_a_plan_becomes_a_report(plan_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = plan_path.parent / "out"
    assert main(["compare", str(plan_path), "-o", str(out)]) == 0
    scores = read_table(out / "there_and_here_scores.csv")
    assert scores["method"] == ["precision", "recall", "offset", "median ahead"] and scores["NSD-CR"][:2] == [
        "1.0",
        "1.0",
    ]
    with (out / "scores.csv").open(newline="") as stream:
        rows = {row["method"]: row for row in csv.DictReader(stream)}
    assert f"{float(rows['Raw-fc6']['max-F1']):.3f}" in capsys.readouterr().out
    for row in rows.values():
        assert float(row["R@1 low"]) <= float(row["R@1"]) <= float(row["R@1 high"])
        assert float(row["R@1"]) <= float(row["R@5"]) <= float(row["R@10"]) or row["method"] == "Lookback"
        assert float(row["CPU ms a frame"]) > 0
    assert rows["Lookback"]["R@5"] == "nan"
    methods = ("Raw-fc6", "NSD-CR", "Lookback", "SeqSLAM")
    for name in methods:
        with (out / f"there_and_here_answers_{name.replace('-', '_')}.csv").open(newline="") as stream:
            answers = list(csv.DictReader(stream))
        judged = [answer for answer in answers if answer["right"]]
        assert len(answers) == 12 and [answer["query"] for answer in judged] == [str(row) for row in range(3, 12)]
        share = sum(answer["right"] == "1" for answer in judged) / len(judged)
        assert share == pytest.approx(float(rows[name]["R@1"])), name
        assert all((answer["score"] == "nan") == (answer["place"] == "-1") for answer in answers)
    for table, columns in (("scores", 10), ("means", 5)):
        markdown, latex = ((out / f"{table}.{kind}").read_text() for kind in ("md", "tex"))
        assert all(name in markdown and name in latex for name in methods)
        assert latex.count(" & ") == (columns - 1) * (1 + len(methods)) and r"\toprule" in latex
        assert markdown.splitlines()[0].count("|") == columns + 1
    page = (out / "report.html").read_text()
    for heading in ("Overview", "there and here", "Networks"):
        assert heading in page


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('feed = "here"', 'feed = "gone"', "gone: no such feed"),
        ('"Raw-fc6", "NSD-CR", "Lookback"', '"Raw-fc7"', "'Raw-fc7': no such row"),
        ("length = 4", "length = 40", "no frame with a known true place ends a sequence of 40"),
    ],
)
def test_what_is_wrong_is_one_line(
    plan_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, says: str
) -> None:
    plan_path.write_text(plan_path.read_text().replace(old, new, 1))
    assert main(["compare", str(plan_path), "-o", str(plan_path.parent / "out")]) == 78
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("lookback: ") and says in error
