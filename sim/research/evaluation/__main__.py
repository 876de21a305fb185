"""Measure a table of the docs on simulated roads, and write it between the marks of its name on a page.

    python -m sim.research.evaluation belief --seeds 9203 9311 --cache FOLDER [--page docs/tables/back-to-back.md]

What is rendered and described stays in the cache, and is not made again.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import cv2

from sim.research.evaluation import belief, keyframes, poses, reliability
from sim.research.trial.table import put_between


def _made(folder: str) -> Path:
    Path(folder).mkdir(parents=True, exist_ok=True)
    return Path(folder)


def _of_file(args: argparse.Namespace) -> Iterator[str]:
    """A table that another command made."""
    yield args.made.read_text(encoding="utf-8").strip()


OPTIONS: dict[str, dict[str, Any]] = {
    "seeds": {"type": int, "nargs": "+", "action": "append", "required": True, "help": "of a set of roads"},
    "cache": {"type": _made, "required": True, "help": "folder that keeps what is made of the roads"},
    "length": {"type": float, "default": 1000.0, "help": "of each road, m (default 1000)"},
    "draws": {"type": int, "default": 1, "help": "of each drive, with other errors or another seed (default 1)"},
    "networks": {"nargs": "+", "default": ["grid"], "help": "names, files or folders of networks (default grid)"},
    "feeds": {"type": Path, "help": "folder with the recordings of the plan real_front_rear"},
    "made": {"type": Path, "required": True, "help": "file with the table"},
    "page": {"type": Path, "help": "write the table between its marks on this page"},
}
ROADS = "seeds", "cache", "page"
TABLES: dict[str, tuple[Callable[[argparse.Namespace], Iterator[str]], Sequence[str]]] = {
    "belief": (belief.rows, (*ROADS, "length", "networks", "draws")),
    "reliability": (reliability.rows, (*ROADS, "length", "feeds")),
    "poses": (poses.rows, ROADS),
    "capture": (poses.capture, ROADS),
    "keyframes": (keyframes.on_map, (*ROADS, "draws")),
    "streets": (keyframes.on_streets, ROADS),
    "off-map": (keyframes.off_map, ("seeds", "cache")),
    "benchmark": (_of_file, ("made", "page")),
}


def main(words: Sequence[str] | None = None) -> None:
    """Print each row as soon as it is known, and write all of them."""
    parser = argparse.ArgumentParser("python -m sim.research.evaluation", description=(__doc__ or "").splitlines()[0])
    names = parser.add_subparsers(dest="table", required=True)
    for name, (rows, options) in TABLES.items():
        about = (rows.__doc__ or "").splitlines()[0]
        one = names.add_parser(name, help=about, description=about)
        for option in options:
            one.add_argument(f"--{option}", **OPTIONS[option])
    args = parser.parse_args(words)
    if "seeds" in args:
        args.sets, args.seeds = args.seeds, [*chain.from_iterable(args.seeds)]
    cv2.setNumThreads(1)
    known = []
    for row in TABLES[args.table][0](args):
        print(row, flush=True)
        known.append(row)
    if "page" in args and args.page:
        put_between(args.table, args.page, "\n".join(known))


if __name__ == "__main__":
    main()
