"""`lookback dev bench --stages`."""

from __future__ import annotations

import argparse
import csv
import tempfile
import time
from pathlib import Path

import cv2

from sim.research.bench import drives, stages
from sim.research.bench.table import cells, page, table


def run(args: argparse.Namespace) -> int:
    """Of `lookback dev bench --stages`: measure, print the rows, and write a page and a file of them."""
    cv2.setNumThreads(1)
    began_s, rounds = time.monotonic(), 7 if args.quick else 21
    rows = [*stages.measure(rounds, (10_000,) if args.quick else (10_000, 100_000))]
    with tempfile.TemporaryDirectory(prefix="lookback-bench-", dir=args.folder) as folder:
        rows += drives.measure(Path(folder), rounds, quick=args.quick)
    made = f"Made by `make bench{'-quick' if args.quick else ''}` in {time.monotonic() - began_s:.0f} s."
    print(table(rows))
    if args.output:
        file = args.output.with_suffix(".csv")
        args.output.write_text(page(rows, made, file.name), encoding="utf-8")
        with file.open("w", newline="", encoding="utf-8") as opened:
            csv.writer(opened, lineterminator="\n").writerows(cells(rows))
    return 0
