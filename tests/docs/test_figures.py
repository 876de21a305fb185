"""README's figures are those of the pages, drawings show what is there, and folders that a page names are there."""

from __future__ import annotations

import re

from tests.common import ROOT
from tests.docs.figures import ARCHITECTURE, architecture, stale
from tests.docs.pictures import MADE_OF, PICTURES, checksum_of_sources

README = (ROOT / "README.md").read_text(encoding="utf-8")


def page(name: str) -> str:
    return (ROOT / "docs" / name).read_text(encoding="utf-8")


def test_the_flights_of_readme_are_those_of_their_page() -> None:
    flights = page("flights.md")
    (now,) = re.findall(r"^- now: (\d+) positions; of (\d+) whose .* has, 0 beyond three", flights, re.MULTILINE)
    by_night = dict(re.findall(r"^\| \d+ (\w+), night \| \d+ \| ([\d.]+) /", flights, re.MULTILINE))
    sent, known = (f"{int(number):,}" for number in now)
    assert (
        f"{sent} positions, median error at night {by_night['ArduPilot']} m (ArduPilot), {by_night['PX4']} m (PX4)"
        in README
    )
    assert f"none of the {known} with a recorded sigma exceeds 3 sigma" in README


def test_each_drive_of_readme_is_one_of_the_page() -> None:
    """With Lookback and without, wheels right and 3 % wrong."""
    flown = r"^\| (\d+) \| (right|3 % wrong) \| (.* m) \| (.* m) \|$"
    by_road = {found[:2]: found[2:] for found in re.findall(flown, page("flights.md"), re.MULTILINE)}
    rows = re.findall(r"^\| (\d{3}) \| (.* m) \|$", README, re.MULTILINE)
    assert len(rows) == 3
    for road, cells in rows:
        assert cells.split(" | ") == [*by_road[road, "right"], *by_road[road, "3 % wrong"]]
    p95_m = [[float(cell.split(" / ")[1]) for cell in by_road[road, "3 % wrong"]] for road, _ in rows]
    with_m, alone_m = zip(*p95_m, strict=True)
    said = (
        f"{min(with_m)} to {max(with_m)} m (95th percentile, three roads), {min(alone_m)} to {max(alone_m)} m without"
    )
    assert said in README


def test_where_a_drive_is_recognized_is_said_as_its_page_says_it() -> None:
    table = page("keypoints.md").partition("<!-- keyframes: begin -->")[2]
    medians_m = re.findall(r"^\| \w+ \| \w+ \| \d+, \d+ m \| (\d+), \d+ m \|", table, re.MULTILINE)
    (said_m,) = re.findall(r"usually accepted \(believed\) after (\d+) m with", README)
    assert len(medians_m) >= 6
    assert sorted(medians_m)[len(medians_m) // 2] == said_m


def test_two_cameras_back_to_back_are_said_to_do_what_their_table_says() -> None:
    said, table = " ".join(page("back-to-back.md").split()), page("tables/back-to-back.md")
    row = r"^\| grid, (.+) \| (whole|second half|thirds) \| (\S+) \| (\S+) \| (.+) \| (.+) \| (\S+) \|$"
    rows = {one[:2]: one[2:] for one in re.findall(row, table, re.MULTILINE)}
    poor, snow, home = "the same way at dusk, night and in rain", "the same way in snow", "home at dusk and night"
    for words, drive in (("rain", poor), ("snow", snow), ("the way home", home)):
        alone, with_gps, first_alone, first, _ = rows[drive, "whole"]
        assert re.search(rf"{words}: {first}, {with_gps} \(\D*{first_alone}, {alone}\)", said)
    half, thirds, worst = rows[poor, "second half"][1], rows[poor, "thirds"][1], rows[poor, "whole"][-1]
    assert f"{half} in poor light, with two thirds {thirds}. The worst drive had {worst}, in snow" in said
    assert f"in snow {rows[snow, 'whole'][-1]}." in said
    counted = re.findall(r"^\| (beside|a car|a fork).* \| (\d+) \| (\d+), (\d+), (\d+);", table, re.MULTILINE)
    of = {name: tuple(map(int, found)) for name, *found in counted}
    frames, alone, now, late = map(sum, zip(of["beside"], of["a car"], strict=True))
    assert now == 0
    assert f"none of {frames:,} is accepted with GPS, {late} are 500 m after its loss, {alone} without any" in said
    assert f"{of['a fork'][2]} of {of['a fork'][0]:,} are accepted" in said
    (wrong,) = re.findall(r"0 of \d+ frames and 0 of (\d+) frames are believed and wrong", table)
    assert f"none of {int(wrong):,} frames is accepted and wrong" in said


def test_the_folders_of_the_method_are_there() -> None:
    folders = re.findall(r"`(\w+)/`", page("method.md"))
    assert len(folders) > 4
    assert [
        one for one in folders if not any((ROOT / place / one).is_dir() for place in ("", "edge", "edge_plugins"))
    ] == []


def test_the_architecture_is_the_list_of_the_front_door_and_each_picture_is_drawn_of_its_text() -> None:
    again = "draw it anew: python -m tests.docs.figures"
    assert architecture() == ARCHITECTURE.read_text(encoding="utf-8"), again
    assert "](pictures/architecture.svg)" in page("method.md")
    assert stale() == [], again


def test_the_picture_of_the_live_page_is_as_new_as_what_draws_it() -> None:
    made_of = (PICTURES / MADE_OF).read_text(encoding="utf-8")
    assert made_of == checksum_of_sources(), "make it anew: python -m tests.docs.pictures"


def test_no_picture_is_kept_that_nothing_shows() -> None:
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    text = "".join(one.read_text(encoding="utf-8") for one in pages)
    for path in PICTURES.iterdir():
        assert path.name == MADE_OF or f"pictures/{path.name}" in text, path
