from __future__ import annotations

import shutil
from contextlib import closing
from pathlib import Path

import cv2
import pytest

pytest.importorskip("starlette")
pytest.importorskip("matplotlib")


from edge.config import PageConfig
from edge.page import MapView
from edge.page.server import StatusPage
from sim.demo.pictures import photograph_page


@pytest.mark.skipif(not shutil.which("chromium"), reason="needs Chromium: apt-get install chromium")
def test_the_page_is_photographed_at_the_width_that_is_asked_for(tmp_path: Path) -> None:
    with closing(
        StatusPage(PageConfig(port=0), MapView(2, {}, (), lambda place: b"", Path("none")), answer_s=0.1)
    ) as page:
        assert photograph_page(f"http://127.0.0.1:{page.port}/", tmp_path / "pictures/page.png", 700, 500)
    picture = cv2.imread(str(tmp_path / "pictures/page.png"))
    assert picture.shape == (500, 700, 3)
    assert picture.std() > 5
