"""`lookback demo`: the main task in simulation: out by day with GPS, and home at night without."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import edge
from sim.output import needing, replacing


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback demo`."""
    parser.add_argument("-o", "--output", type=Path, default=Path("demo"), metavar="FOLDER")
    parser.add_argument("--require-good", action="store_true", help="exit with 1 unless the vehicle came home (CI)")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    with needing("demo:", "sim"):
        # Here and not above: matplotlib would take a third of a second of every command's start.
        from sim.demo.story import drive_story, headline, pairs_of, require_good, sections_of
        from sim.evaluation.report import render_page
    folder: Path = args.output
    started_s = time.monotonic()
    with replacing(folder, "demo") as new:
        print("Out by day with two cameras; GPS fails at the far end; home at night on the map made on the way.")
        print("Then the same way without Lookback. Both take about a minute, in simulated time.", flush=True)
        story = drive_story(new / "take_me_home")
        sections = [*sections_of(story), pairs_of(story, new / "take_me_home")]
        page = render_page(headline(story), {"version": edge.__version__}, sections)
        (new / "report.html").write_text(page, encoding="utf-8")
    print(f"report: {folder / 'report.html'}   ({time.monotonic() - started_s:.0f} s)")
    print(f"Home at night without GPS: {headline(story)}")
    if args.require_good:
        require_good(story)
    return 0
