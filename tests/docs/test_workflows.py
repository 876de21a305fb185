"""What GitHub runs: actions by the checksum of a commit, and lines of YAML that are what they look like."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

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


def test_the_changelog_has_notes_of_a_release() -> None:
    """Which release.yml publishes: ten lines, of what a user must do, gained and lost."""
    unreleased = (GITHUB.parent / "CHANGELOG.md").read_text().split("\n## ")[1]
    (notes,) = re.findall(r"### In short\n(.*?)\n\n###", unreleased, re.DOTALL)
    assert len(notes.splitlines()) <= 12
    for word in ("**You must**", "**Gained:**", "**Lost:**"):
        assert f"- {word}" in notes
