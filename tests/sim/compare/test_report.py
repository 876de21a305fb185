"""One page that needs nothing beside it, and tables that other programs read."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
import pytest

from edge.errors import ConfigError
from sim.compare.comparison import match_plot
from sim.evaluation.report import Cell, Figure, Interval, Picture, ReportSection, ScoreGroup, Table, write_report
from tests.chromium import NEEDS_CHROMIUM, browser


def drawn() -> bytes:
    apart = np.abs(np.subtract.outer(np.arange(6.0), np.arange(8.0)))
    return match_plot(apart, apart, np.array([0, 1, 7, 3, -1, 5]), np.array([1, 2, 3]), 1.0)


def section() -> ReportSection:
    both = [ScoreGroup({"R@1": first, "R@P100": sure}) for first, sure in ((0.25, float("nan")), (0.5, 0.125))]
    rows: list[list[Cell]] = [["NSD <best>", Interval(0.5, 0.4, 0.625, 0.95), both[0]], ["SeqSLAM", 1.0, both[1]]]
    plot = Figure("matches", "Matches", drawn())
    return ReportSection(
        "One & two",
        "Text.",
        [Table("t", "T", ("m", "f", "n"), rows, "Note.")],
        [plot],
        [[Picture(b"\xff\xd8jpeg", "query 3")]],
    )


def test_the_page_is_whole_in_itself_and_escapes_what_it_is_given(tmp_path: Path) -> None:
    page = write_report(tmp_path / "out", "Title", {"command": "lookback eval x"}, [section()]).read_text()
    assert "NSD &lt;best&gt;" in page and "One &amp; two" in page and "lookback eval x" in page
    assert "0.500 (0.400 to 0.625)" in page and "data:image/png;base64," in page and "data:image/jpeg;base64," in page
    assert not re.search(r'(src|href)="(?!data:|#)', page) and "http" not in page


@NEEDS_CHROMIUM
def test_the_page_fits_a_phone(tmp_path: Path) -> None:
    """A network's long name, a command without a space, and a title of one word leave nothing to scroll sideways."""
    pytest.importorskip("selenium")
    about = {"network grid: efficientnet-lite0-blocks-2-to-4, features, int8": "sha256 " + 64 * "0", "plan": 80 * "x"}
    page = write_report(tmp_path, "reference_of_20260504_120000_on_query_20260504", about, [section()])
    with browser(390, 844) as driver:
        driver.get(page.as_uri())
        assert driver.execute_script("return document.documentElement.scrollWidth") <= 390


def test_tables_and_figures_are_files_too(tmp_path: Path) -> None:
    write_report(tmp_path, "Title", {}, [section()])
    with (tmp_path / "t.csv").open(newline="") as stream:
        rows = list(csv.reader(stream))
    assert rows == [
        ["m", "f", "f low", "f high", "n R@1", "n R@P100"],
        ["NSD <best>", "0.5", "0.4", "0.625", "0.25", "nan"],
        ["SeqSLAM", "1.0", "", "", "0.5", "0.125"],
    ]
    assert (tmp_path / "matches.png").read_bytes().startswith(b"\x89PNG")


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot write the report"):
        write_report(tmp_path / "file", "Title", {}, [])
