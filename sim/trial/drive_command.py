"""`lookback dev drive`: replay the list of a drive through the position estimator of today, and say what differs."""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

from edge.localization import Fix, NoFix
from edge.localization.drive_file import read_drive, replay
from sim.bundle import drive_list


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback dev drive`."""
    about = "list of a drive, as [telemetry] drive names it, or what `lookback bundle` made"
    parser.add_argument("file", type=Path, metavar="FILE", help=about)
    parser.add_argument("--all", action="store_true", help="print every answer, not only those that differ")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    with TemporaryDirectory() as folder:
        config, entries = read_drive(drive_list(args.file, Path(folder)))
    began_ns = entries[0][0] if entries else 0
    differing, counts = 0, Counter[str]()
    for t_ns, asked, now in replay(config, entries):
        differing += now != asked.answer
        counts["a position" if isinstance(now, Fix) else str(now.reason)] += 1
        if args.all or now != asked.answer:
            then = "" if now == asked.answer else f"  (then: {_spelled(asked.answer)})"
            print(f"{(t_ns - began_ns) / 1e9:9.2f} s  {_spelled(now)}{then}")
    for reason, count in counts.most_common():
        print(f"{count:7} times: {reason}")
    print(f"{differing} of {sum(counts.values())} answers differ from those of the drive")
    return 0


def _spelled(answer: Fix | NoFix) -> str:
    if isinstance(answer, NoFix):
        return str(answer)
    place = answer.place
    return f"place {place.place}: {place.lat_deg:.7f}, {place.lon_deg:.7f}, sigma {place.sigma_m:.1f} m"
