"""`make published`: the tables in docs that commands wrote, and how much of the code is newer."""

from __future__ import annotations

import itertools
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

MADE = re.compile(
    r"^(?P<made>Made by )?`(?P<command>(?:lookback|make) [^`]+)`(?:.* of version (?P<version>\d[^\s:]*):$)?"
)
TABLE = re.compile(r"^(\||<!--)")
CODE = ("edge", "edge_plugins", "lookback", "sim")


class FigureSource(NamedTuple):
    """A line (from 1) of a page, which names the command that made what follows, and the version, "" if it does not."""

    page: str
    line: int
    command: str
    version: str


def published(folder: Path) -> Iterator[FigureSource]:
    """Of every page below a folder, by their names: paragraphs with a table next, or that say "Made by"."""
    for page in sorted(folder.rglob("*.md")):
        lines = page.read_text(encoding="utf-8").splitlines()
        for number, text in enumerate(lines):
            found = MADE.match(text)
            if found and (found["made"] or found["version"] or TABLE.match(_next_paragraph(lines[number:]))):
                yield FigureSource(
                    page.relative_to(folder).as_posix(), number + 1, found["command"], found["version"] or ""
                )


def _next_paragraph(lines: list[str]) -> str:
    """The first line after the paragraph that these begin with."""
    after = itertools.dropwhile(bool, lines)
    return next(filter(None, after), "")


def commits_since(root: Path, page: str, line: int) -> int:
    """How many commits have changed the code since a line of a page was written. CalledProcessError outside a clone."""
    blame = _git(root, "blame", "--porcelain", "-L", f"{line},{line}", "--", page)
    wrote = blame.split(maxsplit=1)[0]
    return int(_git(root, "rev-list", "--count", f"{wrote}..HEAD", "--", *CODE)) if wrote.strip("0") else 0


def _git(root: Path, *arguments: str) -> str:
    return subprocess.run(("git", *arguments), cwd=root, check=True, capture_output=True, text=True).stdout


def main(root: Path) -> None:
    """Print a line for each table."""
    for one in published(root / "docs"):
        newer = commits_since(root, f"docs/{one.page}", one.line)
        version = f"version {one.version}, " if one.version else ""
        print(f"docs/{one.page}:{one.line}: {version}{newer} commits ago: {one.command[:60]}")


if __name__ == "__main__":
    main(Path(__file__).parents[2])
