"""README's figures are those of the pages that commands wrote, and folders that a page names are there."""

from __future__ import annotations

import csv
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
ERRORS = ("median_m", "p95_m", "max_m", "lane_m_median", "lane_m_p95", "lane_m_max")
README = (ROOT / "README.md").read_text(encoding="utf-8")


def page(name: str) -> str:
    return (ROOT / "docs" / name).read_text(encoding="utf-8")


def test_the_flights_of_readme_are_those_of_their_page() -> None:
    flights = page("flights.md")
    (now,) = re.findall(r"^- now: (\d+) positions; of (\d+) whose .* has, 0 beyond three", flights, re.MULTILINE)
    by_night = dict(re.findall(r"^\| \d+ (\w+), night \| \d+ \| ([\d.]+) /", flights, re.MULTILINE))
    sent, known = (f"{int(number):,}" for number in now)
    assert f"{sent} positions, at night {by_night['ArduPilot']} m (ArduPilot) and {by_night['PX4']} m (PX4)" in README
    assert f"of {known} none beyond 3 sigma" in README


def test_each_drive_of_readme_is_one_that_was_recorded() -> None:
    with (ROOT / "docs/flights.csv").open(newline="", encoding="utf-8") as file:
        recorded = [row for row in csv.DictReader(file) if row["when"] == "then" and row["lane_m_max"]]
    drives = {
        (
            row["sent"],
            *(f"{float(row[name]):.1f}" for name in ERRORS),
        )
        for row in recorded
        if row["median_m"]
    }
    cells = re.findall(r"^\| .* \| (\d+) \| \**([\d. /]+) m\** \| \**([\d. /]+) m\** \|$", README, re.MULTILINE)
    assert len(cells) > 2
    for number, *errors_m in cells:
        assert (number, *" / ".join(errors_m).split(" / ")) in drives


def test_where_a_drive_is_recognized_is_said_as_its_page_says_it() -> None:
    table = page("keypoints.md").partition("<!-- looks: begin -->")[2]
    medians_m = re.findall(r"-> (\d+), \d+ m \|", table)
    (said_m,) = re.findall(r"mostly after (\d+) m\.", README)
    assert sorted(medians_m)[len(medians_m) // 2] == said_m


def test_the_folders_of_the_method_are_there() -> None:
    folders = re.findall(r"`(\w+)/`", page("method.md"))
    assert len(folders) > 4
    assert [
        one for one in folders if not any((ROOT / place / one).is_dir() for place in ("", "edge", "edge_plugins"))
    ] == []
