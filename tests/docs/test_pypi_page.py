"""README as the page on PyPI: what works beside the code has to work there."""

from __future__ import annotations

import io
import re
import runpy
from pathlib import Path
from typing import Any

import pytest

from tests.chromium import NEEDS_CHROMIUM, browser
from tests.common import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")
LINK = re.compile(r"\]\(([^)\s]+)\)")
GITHUB = "https://github.com/Us/lookback"


@pytest.fixture
def setup() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "setup.py"), run_name="read")


@pytest.fixture
def rendered(setup: dict[str, Any]) -> str:
    """As PyPI renders it."""
    markdown = pytest.importorskip("readme_renderer.markdown")
    pytest.importorskip("comrak")
    warnings = io.StringIO()
    page = markdown.render(setup["as_page"](README, GITHUB), stream=warnings)
    assert page and not warnings.getvalue()
    return str(page)


def test_every_link_and_picture_leads_to_the_version_in_the_repository(setup: dict[str, Any]) -> None:
    page = setup["as_page"](README, GITHUB)
    for link, shown in zip(LINK.findall(README), LINK.findall(page), strict=True):
        if link.startswith(("http", "#")):
            assert shown == link
        elif link == "../../deployments/github-pages":
            assert shown == "https://us.github.io/lookback/"
        elif link.startswith("../../"):
            assert shown == f"{GITHUB}/{link[6:]}"
            workflow = link[6:].removeprefix("actions/workflows/").removesuffix("/badge.svg")
            assert (ROOT / ".github/workflows" / workflow).exists()
        else:
            kind, version, path = shown.removeprefix(f"{GITHUB}/").split("/", 2)
            assert shown.startswith(GITHUB) and version == f"v{setup['VERSION']}" and path == link
            assert kind == ("raw" if link.endswith((".png", ".webp")) else "blob")
            assert (ROOT / link.partition("#")[0]).exists()
    assert "pip install" in page and set(setup["urls"](GITHUB)) == {"Source", "Documentation", "Changelog", "Issues"}
    assert setup["urls"](GITHUB)["Documentation"] == "https://us.github.io/lookback/"
    assert setup["urls"]("https://example.org/us/x")["Documentation"].startswith("https://example.org/us/x/tree/v")


def test_badges_are_of_this_project(rendered: str) -> None:
    """What they show comes from PyPI and from the workflow itself, so that it is true."""
    name = re.findall(r'^name = "(.*?)"', (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.MULTILINE)[0]
    badges = re.findall(r'<img[^>]* src="([^"]*(?:shields|badge)[^"]*)"', rendered)
    kinds = [f"https://img.shields.io/pypi/{kind}/{name}" for kind in ("v", "pyversions", "l")]
    assert badges == [f"{GITHUB}/actions/workflows/test.yml/badge.svg", *kinds]


def test_pypi_renders_all_of_it(rendered: str) -> None:
    """No markup is left, nothing is relative, and every table and block of code is one."""
    targets = re.findall(r' (?:href|src)="([^"]*)"', rendered)
    assert len(targets) > 30 and all(target.startswith(("https://", "#")) for target in targets)
    words = re.sub(r"<pre.*?</pre>|<code.*?</code>|<[^>]*>", "", rendered, flags=re.DOTALL)
    assert not re.search(r"\]\(|^\||```|\*\*", words, re.MULTILINE)
    assert rendered.count("<table") == len(re.findall(r"^\|[-|]+\|$", README, re.MULTILINE))


@NEEDS_CHROMIUM
@pytest.mark.parametrize("width", [390, 1280])
def test_the_page_is_no_wider_than_a_phone(rendered: str, tmp_path: Path, width: int) -> None:
    """By the rules of pypi/warehouse, blocks/_project-description.scss: code scrolls by itself, a table does not."""
    pytest.importorskip("selenium")
    style = "pre { overflow-x: auto } img { max-width: 100% } table { width: 100% } th, td { padding: 10px 7px }"
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><style>{style}</style>'
    local = rendered.replace(f"{GITHUB}/raw/", "file:///nowhere/").replace("https://", "file:///nowhere/")
    (tmp_path / "page.html").write_text(f"<!doctype html>{head}<body>{local}", encoding="utf-8")
    with browser(width, 844) as chromium:
        chromium.get(f"file://{tmp_path}/page.html")
        assert chromium.execute_script("return document.documentElement.scrollWidth") <= width


def test_without_a_repository_nothing_leads_astray(setup: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("GITHUB_REPOSITORY", "REPOSITORY_URL"):
        monkeypatch.delenv(name, raising=False)
    assert setup["repository"]() == "" and setup["urls"]("") == {}
    page = setup["as_page"](README, "")
    assert all(link.startswith(("http", "#")) for link in LINK.findall(page)) and "take_me_home.webp" not in page
    assert "badge.svg" not in page and "](" not in page.partition("](http")[0]
    monkeypatch.setenv("GITHUB_SERVER_URL", "https://github.com")
    monkeypatch.setenv("GITHUB_REPOSITORY", "us/lookback")
    assert setup["repository"]() == "https://github.com/us/lookback"
