"""`python -m sim.research.bench`: measure, print the page, and write it to a file."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import cv2

from edge.config import NETWORKS
from edge.descriptor.network import Network
from edge.errors import LookbackError
from edge.recognizer import model_key
from sim.bench.frames import SIZE_PX
from sim.research.bench import (
    daemon_rows,
    frame_rows,
    keypoint_rows,
    map_rows,
    mapping_rows,
    matching_rows,
    motion_rows,
    network_rows,
    search_rows,
)
from sim.research.bench.machine import Machine, measure_machine
from sim.research.bench.rows import Section, page

FULL, QUICK = (1_000, 10_000, 100_000), (1_000, 10_000)
FULL_MAPS = (*FULL, 1_000_000)
USUAL = 10_000


def main() -> int:
    """Run the bench; 1 with one line if a part of it could not run."""
    parser = argparse.ArgumentParser(prog="python -m sim.research.bench", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="smaller sizes and fewer runs: under a minute")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="write the page there as well")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    start = time.monotonic()
    try:
        rounds = 7 if args.quick else 21
        machine = measure_machine(1 << (28 if args.quick else 30), rounds)
        with tempfile.TemporaryDirectory(prefix="lookback-bench-") as folder:
            sections = list(_sections(machine, Path(folder), rounds, quick=args.quick))
    except (LookbackError, OSError) as error:
        print(f"bench: {error}", file=sys.stderr)
        return 1
    how_run = f"Made by `make bench{'-quick' if args.quick else ''}` in {time.monotonic() - start:.0f} s."
    text = page(machine, sections, how_run)
    print(text, end="")
    if args.output:
        args.output.write_text(text, encoding="utf-8")
    return 0


def _sections(machine: Machine, folder: Path, rounds: int, *, quick: bool) -> Iterator[Section]:
    places, maps, frames = (QUICK, QUICK, 60) if quick else (FULL, FULL_MAPS, 300)
    yield network_rows.measure(rounds)
    yield motion_rows.measure(rounds)
    yield keypoint_rows.measure(rounds)
    yield matching_rows.measure(machine, places, rounds)
    yield search_rows.measure(places, rounds)
    yield frame_rows.measure(folder, USUAL, frames)
    yield mapping_rows.measure(folder, USUAL, frames)
    models, sizes = (NETWORKS[1:], [SIZE_PX]) if quick else (NETWORKS, network_rows.SIZES)
    yield daemon_rows.measure(folder, USUAL, 2 if quick else 10, models, sizes)
    yield map_rows.measure(folder, maps, rounds, model_key(Network.load()))


if __name__ == "__main__":
    sys.exit(main())
