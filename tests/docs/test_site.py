"""The documentation as a site with versions, as the release publishes it, in a repository of the test's own."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.chromium import NEEDS_CHROMIUM, browser
from tests.common import ROOT

pytest.importorskip("mike")
pytest.importorskip("mkdocstrings")

pytestmark = pytest.mark.long
PARTS = ("README.md", "mkdocs.yml", "setup.py", "docs", "edge", "lookback")
PHONE = 390
WIDE = ("index", "troubleshooting", "mapping", "fleet", "evaluation", "api", "method")
STEP = re.compile(r"run: \|\n( +version=.*?)\n\s*\Z", re.DOTALL)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The branch gh-pages after two releases."""
    folder = tmp_path_factory.mktemp("site")
    for name in PARTS:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, folder / name)
    who = {f"GIT_{role}_{what}": "a@example.org" for role in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}
    environment = {
        **{name: value for name, value in os.environ.items() if not name.startswith("GIT")},
        **who,
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "SITE_URL": "https://us.github.io/lookback/",
        "GITHUB_SERVER_URL": "https://github.com",
        "GITHUB_REPOSITORY": "us/lookback",
        "NO_MKDOCS_2_WARNING": "1",
    }
    (step,) = STEP.findall((ROOT / ".github/workflows/release.yml").read_text(encoding="utf-8"))
    assert step.count(" --push") == 2
    commands = ["git init --quiet --initial-branch main", "git add --all", "git commit --quiet --message begin"]
    for tag in ("v0.3.1", "v0.4.0"):
        commands += [f"GITHUB_REF_NAME={tag}", step.replace(" --push", "")]
    commands.append("git checkout --quiet gh-pages")
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", "\n".join(commands)],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return folder


def test_each_version_stays_and_the_newest_one_opens(site: Path) -> None:
    versions = json.loads((site / "versions.json").read_text(encoding="utf-8"))
    assert [(one["version"], one["aliases"]) for one in versions] == [("0.4", ["latest"]), ("0.3", [])]
    assert "latest/" in (site / "index.html").read_text(encoding="utf-8")
    for version in ("0.3", "0.4", "latest"):
        assert (site / version / "troubleshooting.html").exists()


def test_the_site_is_made_for_it(site: Path) -> None:
    """Its own mark and colors, a dark switch, and the source: it was stock indigo, without these."""
    home = (site / "0.4/index.html").read_text(encoding="utf-8")
    assert "<title>Home - Lookback</title>" in home and 'href="https://github.com/us/lookback"' in home
    assert home.count('name="__palette"') == 2 and "site/mark.svg" in home and "site/site.css" in home
    shown = re.findall(r'src="(pictures/[^"]+)"', home)
    assert len(shown) == 4 and all((site / "0.4" / one).exists() for one in shown), "the drive, the page, two reports"
    api = (site / "0.4/api.html").read_text(encoding="utf-8")
    assert "__getattr__" not in api and re.search("blob/v[^/]+/docs/notebook.ipynb", api), "which GitHub renders"


def test_links_out_of_the_pages_lead_to_the_repository_and_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    pages = {page: page.read_text(encoding="utf-8") for page in (site / "0.4").rglob("*.html")}
    assert len(pages) > 20
    outside = re.findall(r'href="https://github\.com/us/lookback/blob/v[^/]+/([^"#]*)', "\n".join(pages.values()))
    assert "CONTRIBUTING.md" in outside and all((ROOT / path).exists() for path in outside)
    for page, text in pages.items():
        assert not re.search(r'<(?:script|img|iframe)[^>]* src="(?:https?:)?//', text), page
        assert not re.search(r'<link[^>]* rel="stylesheet"[^>]* href="(?:https?:)?//', text), page
        assert not re.search(r'class="(arithmatex|[^"]*mermaid)', text), f"{page}: an equation or figure needs a script"


@NEEDS_CHROMIUM
def test_no_page_is_wider_than_a_phone(site: Path) -> None:
    pytest.importorskip("selenium")
    with browser(PHONE, 844) as chromium:
        for name in WIDE:
            chromium.get((site / "0.4" / f"{name}.html").as_uri())
            assert chromium.execute_script("return document.documentElement.scrollWidth") <= PHONE, name
