"""`lookback eval`: how well a map is recognized in your recordings; precision, recall and errors by their positions."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import edge
from edge.errors import ConfigError
from edge.reference_map import open_map_set
from sim.datasets.found import open_recording
from sim.evaluation.corruption import KINDS, Corruption
from sim.evaluation.metrics import OFFSET_SHARE, TOLERANCE_M, precision_recall
from sim.evaluation.recognition import COLUMNS, RecognitionScore, Value, judge, recognize
from sim.evaluation.replay import load_config_for_map
from sim.output import needing
from sim.traverse import config_as_mapped


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback eval`."""
    parser.description = (
        "Recognize recordings with known positions on a map of other recordings, as `lookback run` does. Precision: of"
        " the accepted frames, the share within the tolerance. Recall: of the frames on the map, the share that is"
        " accepted and right; and the share at the lowest confidence from which no frame is wrong, within the tolerance"
        " and within twice the tolerance. Errors: median and 95 % of accepted frames, after the offsets in [rig] of"
        " --config, which `lookback calibrate` measures."
    )
    parser.add_argument("feeds", nargs="+", type=Path, metavar="FEED", help="recordings with positions")
    parser.add_argument("--map", type=Path, required=True, help="a map, or a folder of maps")
    parser.add_argument("--config", type=Path, help="settings of the recognizer (default: those of the map)")
    add_tolerance_option(parser)
    about = f"also with worse pictures, and what the daemon says of its camera: {', '.join(KINDS)}; severity 1 to 5"
    parser.add_argument("--corrupt", action="append", default=[], metavar="NAME:SEVERITY", help=about)
    parser.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="write report.html, table and curves there")
    parser.set_defaults(run=_run)


def add_tolerance_option(parser: argparse.ArgumentParser) -> None:
    """Add the option for how far off a place may be."""
    about = "a place within M meters is right (default 40)"
    parser.add_argument("--tolerance-m", type=float, default=TOLERANCE_M, metavar="M", help=about)


def _run(args: argparse.Namespace) -> int:
    if not args.tolerance_m > 0:
        raise ConfigError(f"--tolerance-m: {args.tolerance_m:g} is not above 0")
    maps = open_map_set(args.map)
    made = maps.headers[0]
    config = load_config_for_map(args.config, made) if args.config else config_as_mapped(made)
    corruptions = [Corruption.parse(one) for one in args.corrupt]
    feeds = [one for feed in map(open_recording, args.feeds) for one in (feed, *(c.feed(feed) for c in corruptions))]
    judged, rows, columns = [], [], (*COLUMNS, "camera")[: None if corruptions else -1]
    for feed in feeds:
        seen = recognize(maps, feed, config)
        judged.append(judge(maps, seen, args.tolerance_m))
        rows.append((*judged[-1].row(), seen.camera)[: len(columns)])
    cells = [columns, *(list(map(_cell, row, columns)) for row in rows)]
    widths = [max(len(line[column]) for line in cells) for column in range(len(columns))]
    for line in cells:
        print("  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)))
    for one in judged:
        if abs(one.ahead_m) > OFFSET_SHARE * args.tolerance_m:
            side = "ahead of" if one.ahead_m > 0 else "behind"
            print(
                f"{one.name}: the median accepted place lies {abs(one.ahead_m):.0f} m {side} the vehicle, and the"
                f" tolerance is {args.tolerance_m:g} m: measure the camera's offset with `lookback calibrate`, and name"
                " the config with its [rig] by --config",
                file=sys.stderr,
            )
    if args.output:
        about = {
            "version": edge.__version__,
            "map": f"{args.map}, {maps.index.places} places",
            "model": f"{maps.headers[0].model.name}, sha256 {maps.headers[0].model.sha256}",
        }
        print(_write(args.output, about, args.map, judged, columns, rows), file=sys.stderr)
    return 0


def _cell(value: Value, column: str) -> str:
    return f"{value:.{1 if column.endswith(', m') else 3}f}" if isinstance(value, float) else str(value)


def _write(
    folder: Path,
    about: Mapping[str, str],
    map_path: Path,
    judged: Sequence[RecognitionScore],
    columns: tuple[str, ...],
    rows: Sequence[tuple[Value, ...]],
) -> Path:
    with needing("--output", "sim"):
        from sim.evaluation import figures, report
    curves = figures.precision_recall_plot({one.name: precision_recall(one.answers) for one in judged})
    plot = report.Figure("precision_recall", "Precision and recall at every confidence", curves)
    table = report.Table("recordings", "In numbers", columns, rows)
    section = report.ReportSection("Recordings", tables=[table], figures=[plot])
    lead = [
        f"{one.name}: {int(one.believed.sum())} of {len(one.believed)} frames accepted, precision {one.precision:.3f},"
        f" recall {one.recall:.3f}"
        for one in judged
    ]
    return report.write_report(folder, f"Recognized on {map_path.name}", about, [section], lead)
