"""`make published`: the tables in docs that commands wrote, and how much of the code is newer."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

MADE = re.compile(r"^`(?P<command>[^`]+)`[^`|]* of version (?P<version>\d[^\s:]*):$")
CODE = ("edge", "edge_plugins", "lookback", "sim")


class Published(NamedTuple):
    """A line (from 1) of a page, which names the command and the version that made what follows."""

    page: str
    line: int
    command: str
    version: str


def published(folder: Path) -> Iterator[Published]:
    """Of every page in a folder, in the order of their names."""
    for page in sorted(folder.glob("*.md")):
        for number, text in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
            if found := MADE.match(text):
                yield Published(page.name, number, found["command"], found["version"])


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
        print(f"docs/{one.page}:{one.line}: version {one.version}, {newer} commits ago: {one.command[:60]}")


if __name__ == "__main__":
    main(Path(__file__).parents[2])
