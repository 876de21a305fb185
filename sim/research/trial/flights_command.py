"""`lookback dev flights`: compute the positions of recorded drives anew, without feedback, beside those of then."""

from __future__ import annotations

import argparse
import logging
from pathlib import Path

import numpy as np

from edge.descriptor.network import Network
from edge.errors import FeedError
from edge_plugins.mapping import MappingConfig
from sim.research.trial.recorded_drive import JOURNAL, read_drive
from sim.research.trial.replayed_drive import Frames, Positions, Replayed, replay
from sim.trial.views import RoadLibrary

HEADER = (
    "| drive | positions | error, median / 95 % / largest | over own sigma, rms / largest | share of the time"
    " | first after | frames used, believed, false, furthest apart |\n|---|---|---|---|---|---|---|"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback dev flights`."""
    parser.add_argument("flights", nargs="+", type=Path, metavar="FOLDER", help="recorded drives, or a folder of them")
    kept = "keeps journals and rendered views"
    parser.add_argument("-o", "--output", type=Path, default=Path("flights"), metavar="FOLDER", help=kept)
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    logging.getLogger("edge").setLevel(logging.ERROR)
    folders = [
        path
        for given in args.flights
        for path in ([given] if (given / JOURNAL).exists() else sorted(given.iterdir() if given.is_dir() else []))
        if (path / JOURNAL).exists() and (path / "scenario.toml").exists()
    ]
    if not folders:
        raise FeedError(f"{args.flights[0]}: no recorded drive in it; one has {JOURNAL} and scenario.toml")
    library = RoadLibrary(Network.load(), args.output / "views")
    print(HEADER, flush=True)
    try:
        for folder in folders:
            output = args.output / folder.name
            output.mkdir(parents=True, exist_ok=True)
            drive = read_drive(folder)
            if drive.config.of(MappingConfig).folder:
                print(f"| {drive.name}: its map was made on the way, which is not replayed |", flush=True)
                continue
            print(rows(replay(drive, output, library)), flush=True)
            library.save()
    finally:
        library.save()
        library.close()
    return 0


def rows(found: Replayed) -> str:
    """Two rows of the table: as recorded, and computed anew."""
    then, now = _row(found.recorded, found.recorded_frames), _row(found.replayed, found.replayed_frames)
    return f"| {found.name}, then | {then} |\n| now | {now} |"


def _row(positions: Positions, frames: Frames) -> str:
    counts = f"{frames.used}, {frames.believed}, {frames.false}, {frames.apart_m.max(initial=0.0):.0f} m"
    errors_m = positions.error_m
    if not len(errors_m):
        return f"0 | - | - | 0.00 | - | {counts}"
    sigmas = (errors_m / positions.own_sigma_m)[~np.isnan(positions.own_sigma_m)]
    return (
        f"{len(errors_m)} | {np.median(errors_m):.1f} / {np.percentile(errors_m, 95):.1f} / {errors_m.max():.1f} m"
        f" | {np.sqrt(np.mean(sigmas**2)):.2f} / {sigmas.max(initial=0.0):.1f} | {positions.share:.2f}"
        f" | {positions.first_m:.0f} m | {counts}"
    )
