"""What all scripts that write a table of the docs share: options, and where the table goes.

`python -m sim.research.evaluation.tables NAME FILE PAGE` writes a file between the marks of that name on a page.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path

from sim.research.trial.table import put_between


def _made(folder: str) -> Path:
    Path(folder).mkdir(parents=True, exist_ok=True)
    return Path(folder)


def options(about: str | None, length_m: float, *, seeds: bool = True) -> argparse.ArgumentParser:
    """A script's options. length_m: of a road, by default. seeds: whether it takes those of one set of roads."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    if seeds:
        parser.add_argument("--seeds", type=int, nargs="+", required=True, help="of the roads")
    parser.add_argument("--cache", type=_made, required=True, help="folder that keeps descriptors of the roads")
    parser.add_argument("--length", type=float, default=length_m, help="of each road, m (default %(default)g)")
    parser.add_argument("--page", type=Path, help="write the tables between their marks on this page")
    return parser


def publish(name: str, rows: Iterable[str], page: Path | None) -> None:
    """Print each row as soon as it is known, and write all of them between the marks of that name on a page."""
    known = []
    for row in rows:
        print(row, flush=True)
        known.append(row)
    if page:
        put_between(name, page, "\n".join(known))


if __name__ == "__main__":
    name, made, page = sys.argv[1:]
    put_between(name, Path(page), Path(made).read_text(encoding="utf-8").strip())
