"""What GitHub runs: actions by the checksum of a commit, and lines of YAML that are what they look like."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

import edge

GITHUB = Path(__file__).parents[2] / ".github"


@pytest.mark.parametrize("file", sorted((GITHUB / "workflows").glob("*.yml")), ids=lambda file: file.name)
def test_actions_are_named_by_checksum(file: Path) -> None:
    """A tag can be moved to another commit by whoever owns the action."""
    used = re.findall(r"uses: (\S+)(.*)", file.read_text())
    assert used
    for action, comment in used:
        assert re.fullmatch(r"[\w./-]+@[0-9a-f]{40}", action), action
        assert re.fullmatch(r" # v\d+\.\d+\.\d+", comment), action


def test_every_python_is_in_the_matrix_of_the_release() -> None:
    project = (GITHUB.parent / "pyproject.toml").read_text()
    supported = re.findall(r"Programming Language :: Python :: (3\.\d+)", project)
    (matrix,) = re.findall(r"python: \[(.*)\]", (GITHUB / "workflows/release.yml").read_text())
    assert re.findall(r"3\.\d+", matrix) == supported


def released() -> tuple[str, str]:
    """The version and the date of the newest release, by the changelog."""
    version, date = re.findall(r"^## (\S+) - (\S+)$", (GITHUB.parent / "CHANGELOG.md").read_text(), re.MULTILINE)[0]
    return version, date


def test_what_follows_a_release_has_a_version_of_its_own() -> None:
    """Code between two releases is called after the next one, with .dev0: no two codes have the same version."""
    next_version, is_dev, _ = edge.__version__.partition(".dev")
    version, _ = released()
    numbers = [tuple(map(int, one.split("."))) for one in (next_version, version)]
    assert numbers[0] > numbers[1] if is_dev else numbers[0] == numbers[1]


def test_the_changelog_has_notes_of_the_release(tmp_path: Path) -> None:
    """By the line of release.yml: ten lines, of what a user must do, gained and lost."""
    (make,) = re.findall(r"^ *(sed -n .*) >notes\.md$", (GITHUB / "workflows/release.yml").read_text(), re.MULTILINE)
    (tmp_path / "source").symlink_to(GITHUB.parent)
    environment = {**os.environ, "GITHUB_REF_NAME": f"v{released()[0]}"}
    done = subprocess.run(
        ["bash", "-c", make], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    notes = done.stdout.strip().splitlines()
    assert 5 < len(notes) <= 10
    for word in ("**You must**", "**Gained:**", "**Lost:**"):
        assert any(line.startswith(f"- {word}") for line in notes)


def test_what_is_cited_is_the_release() -> None:
    cited, (version, date) = (GITHUB.parent / "CITATION.cff").read_text(), released()
    assert f"\nversion: {version}\n" in cited
    assert f"\ndate-released: {date}\n" in cited


FORMS = sorted((GITHUB / "ISSUE_TEMPLATE").glob("*.yml"))


@pytest.mark.parametrize("file", FORMS, ids=lambda file: file.name)
def test_forms_of_issues_are_as_github_wants_them(file: Path) -> None:
    """https://docs.github.com/en/communities/using-templates-to-encourage-useful-issues-and-pull-requests/syntax-for-issue-forms"""
    yaml = pytest.importorskip("yaml")
    form = yaml.safe_load(file.read_text(encoding="utf-8"))
    if file.name == "config.yml":
        assert form == {"blank_issues_enabled": True}
        return
    assert set(form) == {"name", "description", "body"}
    fields = [one for one in form["body"] if one["type"] != "markdown"]
    assert fields and {one["type"] for one in fields} <= {"textarea", "input"}
    assert len({one["id"] for one in fields}) == len(fields)
    assert all(one["attributes"]["label"] for one in fields)
    assert any(one.get("validations", {}).get("required") for one in fields)


def test_what_a_drive_that_went_wrong_needs_is_asked_for() -> None:
    text = (GITHUB / "ISSUE_TEMPLATE" / "drive.yml").read_text(encoding="utf-8")
    for word in ("journal", "map.json", "lookback doctor", "lookback record", "lookback --version"):
        assert word in text
