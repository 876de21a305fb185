"""`python -m sim.research.bench`: measure, print the page, and write it to a file."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import cv2

from edge.descriptor.network import Network
from edge.errors import ConfigError, LookbackError
from edge.recognizer import model_key
from sim.research.bench import frame_rows, map_rows, mapping_rows, motion_rows, network_rows, search_rows
from sim.research.bench.machine import Machine, measure_machine
from sim.research.bench.rows import Section, page

FULL = (1_000, 10_000, 100_000)
QUICK = (1_000, 10_000)
FULL_MAPS = (1_000, 10_000, 100_000, 1_000_000)


def build_parser() -> argparse.ArgumentParser:
    """The options."""
    parser = argparse.ArgumentParser(prog="python -m sim.research.bench", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="smaller sizes and fewer runs: under a minute")
    parser.add_argument("--places", type=int, nargs="+", metavar="N", help="sizes of maps instead of the usual ones")
    parser.add_argument("--rounds", type=int, metavar="R", help="runs of each row (default 21, quick 7)")
    parser.add_argument("--frames", type=int, metavar="F", help="frames of whole-frame runs")
    parser.add_argument("--folder", type=Path, help="where to put simulated maps meanwhile (default: temporary files)")
    parser.add_argument(
        "--only", nargs="+", metavar="PART", help="network, motion, matching, search, frames, mapping, maps"
    )
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="write the page there as well")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the bench; 1 with one line if a part of it could not run."""
    args = build_parser().parse_args(argv)
    cv2.setNumThreads(1)
    start = time.monotonic()
    try:
        rounds = args.rounds or (7 if args.quick else 21)
        machine = measure_machine(1 << (28 if args.quick else 30), rounds)
        with tempfile.TemporaryDirectory(prefix="lookback-bench-", dir=args.folder) as folder:
            sections = list(_sections(args, machine, Path(folder), rounds))
    except (LookbackError, OSError) as error:
        print(f"lookback dev bench: {error}", file=sys.stderr)
        return 1
    how_run = f"Made by `make bench{'-quick' if args.quick else ''}` in {time.monotonic() - start:.0f} s."
    text = page(machine, sections, how_run)
    print(text, end="")
    if args.output:
        args.output.parent.mkdir(parents=True, exist_ok=True)
        args.output.write_text(text, encoding="utf-8")
    return 0


def _sections(args: argparse.Namespace, machine: Machine, folder: Path, rounds: int) -> Iterator[Section]:
    from sim.research.bench import matching_rows

    places = args.places or list(QUICK if args.quick else FULL)
    maps = args.places or list(QUICK if args.quick else FULL_MAPS)
    model = model_key(Network.load())
    usual = min(10_000, max(places))
    sections: dict[str, Callable[[], Section]] = {
        "network": lambda: network_rows.measure(rounds),
        "motion": lambda: motion_rows.measure(rounds),
        "matching": lambda: matching_rows.measure(machine, places, rounds),
        "search": lambda: search_rows.measure(places, rounds),
        "frames": lambda: frame_rows.measure(folder, usual, args.frames or (60 if args.quick else 300)),
        "mapping": lambda: mapping_rows.measure(folder, usual, args.frames or (60 if args.quick else 300)),
        "maps": lambda: map_rows.measure(folder, maps, rounds, model),
    }
    unknown = set(args.only or ()) - set(sections)
    if unknown:
        raise ConfigError(f"--only: {', '.join(sorted(unknown))}: it is one of {', '.join(sections)}")
    for name, measure in sections.items():
        if name not in (args.only or sections):
            continue
        print(f"{name} ...", file=sys.stderr)
        yield measure()


if __name__ == "__main__":
    sys.exit(main())
