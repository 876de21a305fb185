"""`lookback eval`: how well a map is recognized in your recordings; precision, recall and errors by their positions."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.camera.preprocessing import preprocessed_feed
from edge.commands.replay import config_for_map, replay
from edge.config import load_config
from edge.errors import ConfigError, FeedError, MapError
from edge.extras import install_command
from edge.feed import Feed, read_feed
from edge.geodesy import east_north
from edge.recognizer import open_recognizer
from edge.reference_map import MapSet, open_map_set
from sim.evaluation.metrics import TOLERANCE_M, Answers, precision_recall, recall_at_precision

Value = str | int | float
OFFSET_SHARE = 0.5
"""Share of the tolerance by which half of the believed places may lie ahead of the vehicle, or behind it, without a
warning. Beyond it, the curve says more of the camera's offset than of the places."""

COLUMNS = (
    *("recording", "frames", "on the map", "precision", "recall"),
    *("recall at 100 %", "within twice", "error, m", "95 %, m"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback eval`."""
    parser.description = (
        "Recognize recordings with known positions on a map of other recordings, as `lookback run` does. Precision: of"
        " the believed frames, the share within the tolerance. Recall: of the frames on the map, the share that is"
        " believed and right; and the share at the lowest confidence from which no frame is wrong, within the tolerance"
        " and within twice the tolerance. Errors: median and 95 % of believed frames, after the offsets in [rig] of"
        " --config, which `lookback calibrate` measures."
    )
    parser.add_argument("feeds", nargs="+", type=Path, metavar="FEED", help="recordings with positions")
    parser.add_argument("--map", type=Path, required=True, help="a map, or a folder of maps")
    parser.add_argument("--config", type=Path, help="settings of the recognizer (default: those of the map)")
    parser.add_argument(
        "--tolerance-m",
        type=float,
        default=TOLERANCE_M,
        metavar="M",
        help="a place within M meters is right (default 40)",
    )
    parser.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="write report.html, table and curves there")
    parser.set_defaults(run=_run)


@dataclass(frozen=True)
class Judged:
    """A recording's frames with a known position. believed (Q,) bool; error_m (Q,), NaN where no place was matched.

    within_twice: the answers by twice the tolerance. ahead_m: of the median believed place, from the vehicle in
    the direction of travel; NaN if there is none.
    """

    name: str
    answers: Answers
    within_twice: Answers
    believed: NDArray[np.bool_]
    error_m: NDArray[np.float64]
    ahead_m: float

    def row(self) -> tuple[Value, ...]:
        """One row of COLUMNS."""
        right, errors_m = self.believed & self.answers.correct, self.error_m[self.believed]
        on_map = int(self.answers.has_truth.sum())
        nothing = float("nan")
        return (
            self.name,
            len(self.believed),
            on_map,
            float(right.sum() / self.believed.sum()) if self.believed.any() else nothing,
            float(right.sum() / on_map) if on_map else nothing,
            *(recall_at_precision(precision_recall(one), 1.0) for one in (self.answers, self.within_twice)),
            *(float(np.percentile(errors_m, share)) if errors_m.size else nothing for share in (50, 95)),
        )


def judge(maps: MapSet, feed: Feed, config_path: Path | None, tolerance_m: float) -> Judged:
    """Recognize one recording. FeedError, MapError where positions are missing."""
    config = load_config(config_path) if config_path else config_for_map(maps.headers[0])
    feed = preprocessed_feed(feed, config.camera)
    config = msgspec.structs.replace(config, camera=msgspec.structs.replace(config.camera, view=feed.header.view))
    used = list(replay(open_recognizer(config, map_set=maps), feed, config.sampling))
    rows = [feed.rows[one.frame] for one in used]
    used = [one for one, row in zip(used, rows, strict=True) if row.lat_deg is not None]
    if not used:
        raise FeedError(f"{feed.path}: no frame that is used has lat_deg and lon_deg, so nothing can be judged")
    places_deg = np.column_stack([maps.places["lat_deg"], maps.places["lon_deg"]])
    places_deg = places_deg[~np.isnan(places_deg).any(axis=1)]
    if not places_deg.size:
        raise MapError("no place of the map has a position, so nothing can be judged")
    truth_deg = np.array([(row.lat_deg, row.lon_deg) for row in rows if row.lat_deg is not None], dtype=float)
    found_deg = np.array([(one.lat_deg, one.lon_deg) for one in used], dtype=float)  # None becomes NaN
    east_north_m = east_north(*np.concatenate([truth_deg, found_deg, places_deg]).T)
    truth_m, found_m, places_m = np.split(east_north_m, [len(used), 2 * len(used)])
    on_map = np.array([np.hypot(*(places_m - one).T).min() <= tolerance_m for one in truth_m])
    error_m = np.hypot(*(found_m - truth_m).T)
    confidence = np.array([one.confidence for one in used], dtype=float)
    believed = np.array([one.accepted for one in used])
    heading_rad = np.radians(np.array([one.heading_deg for one in used], dtype=float))
    ahead_m = np.einsum("nd,nd->n", found_m - truth_m, np.column_stack([np.sin(heading_rad), np.cos(heading_rad)]))
    answers, within_twice = (
        Answers(confidence, on_map & (error_m <= within_m), on_map) for within_m in (tolerance_m, 2 * tolerance_m)
    )
    return Judged(
        feed.path.name,
        answers,
        within_twice,
        believed,
        error_m,
        float(np.median(ahead_m[believed])) if believed.any() else float("nan"),
    )


def _run(args: argparse.Namespace) -> int:
    if not args.tolerance_m > 0:
        raise ConfigError(f"--tolerance-m: {args.tolerance_m:g} is not above 0")
    judged = [judge(open_map_set(args.map), read_feed(path), args.config, args.tolerance_m) for path in args.feeds]
    rows = [one.row() for one in judged]
    cells = [COLUMNS, *([f"{cell:.3f}" if isinstance(cell, float) else str(cell) for cell in row] for row in rows)]
    widths = [max(len(line[column]) for line in cells) for column in range(len(COLUMNS))]
    for line in cells:
        print("  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)))
    for one in judged:
        if abs(one.ahead_m) > OFFSET_SHARE * args.tolerance_m:
            side = "ahead of" if one.ahead_m > 0 else "behind"
            print(
                f"{one.name}: the median believed place lies {abs(one.ahead_m):.0f} m {side} the vehicle, near the"
                f" tolerance of {args.tolerance_m:g} m: measure the camera's offset with `lookback calibrate`, and name"
                " the config with its [rig] by --config",
                file=sys.stderr,
            )
    if args.output:
        print(_write(args.output, args.map, judged, rows), file=sys.stderr)
    return 0


def _write(folder: Path, map_path: Path, judged: Sequence[Judged], rows: Sequence[tuple[Value, ...]]) -> Path:
    try:
        from sim.evaluation import figures, report
    except ModuleNotFoundError as error:
        raise ConfigError(f"--output needs the package {error.name}: {install_command('sim')}") from None
    curves = {one.name: precision_recall(one.answers) for one in judged}
    plot = report.Figure("precision_recall", "Every confidence", figures.precision_recall_plot(curves))
    table = report.Table("recordings", "In numbers", COLUMNS, rows)
    section = report.Section("Recordings", tables=[table], figures=[plot])
    return report.write_report(folder, f"Recognized on {map_path.name}", {"map": str(map_path)}, [section])
