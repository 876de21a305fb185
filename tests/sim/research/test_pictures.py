from __future__ import annotations

import shutil
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import msgspec
import pytest

pytest.importorskip("starlette")
pytest.importorskip("matplotlib")


from edge_plugins.page import PageConfig
from edge_plugins.page.server import StatusPage
from edge_plugins.page.snapshot import MapView
from sim.research.pictures import (
    DRAWN_BY,
    MADE_OF,
    ROOT,
    checksum_of_sources,
    photograph_page,
)
from tests.udp_port import free_port


@pytest.mark.skipif(not shutil.which("chromium"), reason="needs Chromium: apt-get install chromium")
def test_the_page_is_photographed_at_the_width_that_is_asked_for(tmp_path: Path) -> None:
    with closing(StatusPage(PageConfig(port=0), MapView(2, {}, (), lambda place: b""), answer_s=0.1)) as page:
        assert photograph_page(f"http://127.0.0.1:{page.port}/", tmp_path / "pictures/page.png", 700, 500)
    picture: Any = cv2.imread(str(tmp_path / "pictures/page.png"))
    assert picture.shape == (500, 700, 3)
    assert picture.std() > 5


@pytest.mark.skipif(not shutil.which("chromium"), reason="needs Chromium: apt-get install chromium")
def test_a_page_that_does_not_answer_leaves_the_older_picture_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "page.png").write_bytes(b"older")
    assert not photograph_page(f"http://127.0.0.1:{free_port()}/", tmp_path / "page.png", 700, 500)
    assert (tmp_path / "page.png").read_bytes() == b"older"


@pytest.mark.parametrize("name", DRAWN_BY)
def test_a_picture_of_the_docs_is_as_new_as_what_draws_it(name: str) -> None:
    """If this fails: python -m sim.research.pictures docs/pictures"""
    pictures = ROOT / "docs/pictures"
    assert msgspec.json.decode((pictures / MADE_OF).read_bytes())[name] == checksum_of_sources(name)


def test_no_picture_is_kept_that_nothing_shows() -> None:
    pages = [ROOT / "README.md", ROOT / "docs/site_pages.py", *(ROOT / "docs").glob("*.md")]
    text = "".join(page.read_text(encoding="utf-8") for page in pages)
    for path in (ROOT / "docs/pictures").iterdir():
        assert path.name == MADE_OF or f"pictures/{path.name}" in text, path
