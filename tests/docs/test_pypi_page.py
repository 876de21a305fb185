"""README as the page on PyPI: what works beside the code has to work there."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
LINK = re.compile(r"\]\(([^)\s]+)\)")


@pytest.fixture
def setup() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "setup.py"), run_name="read")


def test_every_link_and_picture_leads_to_the_version_in_the_repository(setup: dict[str, Any]) -> None:
    page = setup["as_page"](README, "https://example.org/us/lookback")
    begin, before = "https://example.org/us/lookback/", LINK.findall(README)
    for link, shown in zip(before, LINK.findall(page), strict=True):
        if link.startswith(("http", "#")):
            assert shown == link
        else:
            kind, version, path = shown.removeprefix(begin).split("/", 2)
            assert shown.startswith(begin) and version == f"v{setup['VERSION']}" and path == link
            assert kind == ("raw" if link.endswith((".png", ".webp")) else "blob")
            assert (ROOT / link.partition("#")[0]).exists()
    assert "pip install" in page and set(setup["urls"](begin)) == {"Source", "Documentation", "Changelog", "Issues"}


def test_without_a_repository_nothing_leads_astray(setup: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("GITHUB_REPOSITORY", "REPOSITORY_URL"):
        monkeypatch.delenv(name, raising=False)
    assert setup["repository"]() == "" and setup["urls"]("") == {}
    page = setup["as_page"](README, "")
    assert all(link.startswith(("http", "#")) for link in LINK.findall(page)) and "take_me_home.webp" not in page
    monkeypatch.setenv("GITHUB_SERVER_URL", "https://github.com")
    monkeypatch.setenv("GITHUB_REPOSITORY", "us/lookback")
    assert setup["repository"]() == "https://github.com/us/lookback"
