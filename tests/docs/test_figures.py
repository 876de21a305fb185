"""README's figures are those of the pages, drawings show what is there, and folders that a page names are there."""

from __future__ import annotations

import re

from tests.common import ROOT
from tests.docs.figures import ARCHITECTURE, architecture, stale
from tests.docs.pictures import MADE_OF, PICTURES, checksum_of_sources
from tests.docs.readme import PRINTED, README, by_tables, page, printed


def test_the_figures_of_readme_are_those_of_the_tables() -> None:
    """Those that its commands print are compared where these run: test_every_command_works."""
    text = README.read_text(encoding="utf-8")
    assert by_tables(text) == text, "write them anew: python -m tests.docs.readme"
    assert len(printed(text)) == sum(said.count("{}") for _, said in PRINTED)


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
    (wrong,) = re.findall(r"0 of \d+ frames and 0 of (\d+) frames are accepted and wrong", table)
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
    pages = [ROOT / "README.md", ROOT / "docs/site_pages.py", *(ROOT / "docs").glob("*.md")]
    text = "".join(one.read_text(encoding="utf-8") for one in pages)
    for path in PICTURES.iterdir():
        assert path.name == MADE_OF or path.name in text, path
