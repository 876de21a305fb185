"""`lookback dev ablate`: what recorded drives would get without each of the rules, and with other constants."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np

from edge import __version__
from edge.config import Config
from edge.errors import FeedError
from edge.localization import NO_PLACES, Fix, PositionEstimator
from edge.localization.decide import RULES, NoFix, Rule
from edge.localization.drive_file import read_drive
from edge.localization.events import ImageProcessed
from edge.localization.position_estimator import Entry, FixResult
from sim.research.trial import recorded_drive
from sim.research.trial.flight_score import off_truth, position_of
from sim.research.trial.recorded_drive import LINK, RecordedDrive
from sim.research.trial.table import put_between
from sim.vehicle.position_inputs import east_north_m

STREAM_S = 0.2
"""Between two positions of a stream, and the least between two of which the drive had none: frames come seldom."""
SECTION = "ablation"
CONSTANTS: dict[str, object] = {
    "position_aiding.SETTLED_NS": 0,
    "gps_monitor.FIRM": 0.0,
    "gps_monitor.LONGEST_GAP_M": math.inf,
    "gps_monitor.MOST_PLACES": math.inf,
    "tracker.BESIDE_M": 0.0,
    "integrity.MAP_SHIFTED": 0.0,
    "integrity.ONE_MORE": 1.0,
    "pose_measurement.SHARED_M": 0.0,
    "place_fix.PUSHED": -math.inf,
    "place_fix.heads_along": lambda road_rad, heading_rad: True,
    "sequence_match.SHARP": 1e-9,
    "tracker.CALL": math.inf,
    "tracker.DISAGREE": math.inf,
    "fused_poses.FIRST": 1,
    "tracker.LEAST_SHARPNESS": 0.0,
    "tracker.STOOD_NS": math.inf,
}
"""Of `edge.localization`, with what puts each out of action."""
NAMES = (*(rule.reason for rule in RULES if rule.reason != NO_PLACES), *CONSTANTS)
"""Without a place there is nothing to publish."""
FEW = 0.01
"""By less than this share of the positions hardly anything changes."""
HEADER = (
    "| without | positions | beyond 3, 4 sigma | largest error | above their levels | GPS: wrong, not recognized |\n"
    "|---|---|---|---|---|---|"
)


Off: TypeAlias = tuple[float, float, float, float]
"""Of a position: meters, standard deviations, and the shares of its levels along and across, 0 without one."""
Run: TypeAlias = tuple[Config, Sequence[tuple[int, Entry]]]
"""The list of a drive, or of a part of it."""


class AblationAnswers(NamedTuple):
    """What a drive got; verdicts: on GPS."""

    positions: list[Off]
    verdicts: list[str]


def add_lists(parser: argparse.ArgumentParser) -> None:
    """Arguments of a command that replays the lists of recorded drives and writes a table."""
    parser.add_argument("lists", type=Path, metavar="LISTS", help="output of `lookback dev flights`, with its lists")
    parser.add_argument("flights", nargs="+", type=Path, metavar="FOLDER", help="the recorded drives, for the truth")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="drives replayed side by side (default 1)")
    parser.add_argument("--page", type=Path, metavar="FILE", help="a page of docs, to write the table into")


def listed(args: argparse.Namespace) -> tuple[list[Path], list[Path]]:
    """The folders of the drives, and those of which there are lists; FeedError where there are none."""
    folders = [path.parent for given in args.flights for path in sorted(given.glob(f"**/{LINK}"))]
    drives = [folder for folder in folders if list((args.lists / folder.name).glob("*.drive"))]
    if not drives:
        raise FeedError(
            f"{args.lists}: no list of these drives; `lookback dev flights FOLDER -o {args.lists}` makes it"
        )
    return folders, drives


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback dev ablate`."""
    add_lists(parser)
    one = "a rule or a constant, as often as wanted (default: each of all)"
    parser.add_argument("--without", action="append", choices=[*NAMES], metavar="NAME", help=one)
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    folders, drives = listed(args)
    without = args.without or NAMES
    with get_context("spawn").Pool(args.jobs) as pool:
        found = pool.map(partial(ablated, args.lists, without), drives, chunksize=1)
    text = table(found)
    if args.page is not None:
        given = " ".join(path.name for path in args.flights)
        constants = sum(name in CONSTANTS for name in without)
        rules = f"Without each of {len(without) - constants} rules and {constants} constants"
        missing = [folder.name for folder in folders if folder not in drives]
        names = f"all{' but ' * bool(missing)}{', '.join(missing)}"
        if len(missing) > len(drives):
            names = ", ".join(drive.name for drive in drives)
        made = f"`lookback dev ablate LISTS {given}` of version {__version__}:\n\n{rules}; drives: {names}."
        put_between(SECTION, args.page, f"{made}\n\n{text}")
    print(text)
    return 0


def ablated(lists: Path, names: Sequence[str], folder: Path) -> dict[str, AblationAnswers]:
    """What one drive got, "" for all rules and constants as they are, and without each."""
    truth = recorded_drive.read_drive(folder)
    runs = [read_drive(path) for path in sorted((lists / folder.name).glob("*.drive"))]
    found = _replayed(runs, truth, ["", *(name for name in names if name not in CONSTANTS)])
    for name in names:
        if name in CONSTANTS:
            with _set(name, CONSTANTS[name]):
                found[name] = _replayed(runs, truth, [""])[""]
    return {name: found[name] for name in ("", *names)}


@contextmanager
def _set(path: str, value: object) -> Iterator[None]:
    """A constant of `edge.localization` has another value, wherever it is used; not one of the same name elsewhere."""
    home, _, name = path.partition(".")
    before = getattr(sys.modules[f"edge.localization.{home}"], name)
    modules = [module for key, module in sys.modules.items() if key.startswith("edge.localization.")]
    users = [module for module in modules if getattr(module, name, None) is before]
    for module in users:
        setattr(module, name, value)
    try:
        yield
    finally:
        for module in users:
            setattr(module, name, before)


def _replayed(runs: Sequence[Run], truth: RecordedDrive, without: Sequence[str]) -> dict[str, AblationAnswers]:
    """Open loop: the autopilot goes on by the positions of the list, but for those that no estimator here has given.

    without: rules, "" for none, which are compared in one replay, since asking changes nothing.
    """
    found = {name: AblationAnswers([], []) for name in without}
    for config, entries in runs:
        estimator, verdict = PositionEstimator(config), ""
        streams = {name: _Stream(answers.positions) for name, answers in found.items()}
        for t_ns, entry in entries:
            if isinstance(entry, FixResult):
                period_s = STREAM_S if entry.request.at == "now" else config.gates.min_interval_s
                due = [name for name, stream in streams.items() if stream.is_due(t_ns, period_s)]
                answer = estimator.fix(t_ns, entry.request) if due else None
                for name in due:
                    withheld = isinstance(answer, NoFix) and answer.reason == name
                    one = estimator.fix(t_ns, entry.request, _without(name)) if withheld else answer
                    streams[name].add(t_ns, one, truth)
            else:
                estimator.update(t_ns, entry)
                if isinstance(entry, ImageProcessed) and estimator.state.gps.state != verdict:
                    verdict = estimator.state.gps.state
                    for answers in found.values():
                        answers.verdicts.append(verdict)
    return found


def _without(name: str) -> list[Rule]:
    return [rule for rule in RULES if rule.reason != name]


class _Stream:
    """Positions as they would be sent, one a period at most."""

    def __init__(self, positions: list[Off]) -> None:
        self._positions = positions
        self._answered_ns, self._stamp_ns = -math.inf, 0

    def is_due(self, t_ns: int, period_s: float) -> bool:
        """Whether one more may be sent; drives were sent them up to half a period of a stream early."""
        return t_ns - self._answered_ns >= period_s * 1e9 - STREAM_S * 1e9 / 2

    def add(self, t_ns: int, answer: Fix | NoFix | None, truth: RecordedDrive) -> None:
        """What was asked for then."""
        fix = position_of(answer)
        if fix is not None and fix.place.stamp_ns != self._stamp_ns:
            self._answered_ns, self._stamp_ns = t_ns, fix.place.stamp_ns
            self._positions.append(_off(fix, truth))


def _off(fix: Fix, truth: RecordedDrive) -> Off:
    place = fix.place
    here_m = east_north_m(place.lat_deg or 0.0, place.lon_deg or 0.0)
    error_m, along_m, cross_track_m = off_truth(truth, here_m, place.stamp_ns / 1e9)
    return (
        error_m,
        error_m / place.sigma_m,
        abs(along_m) / fix.level.along_track_m,
        abs(cross_track_m) / fix.level.cross_track_m,
    )


def table(drives: Sequence[dict[str, AblationAnswers]]) -> str:
    """One row for each rule and constant; only its name where hardly anything changes, or nothing."""
    names = {"": "nothing"} | {name: name for name in drives[0] if name}
    rows = {name: _row([one[name] for one in drives]) for name in names}
    spelled = {name: f"`{name}`" if name in CONSTANTS else words for name, words in names.items()}
    same = [name for name in names if name and rows[name] == rows[""]]
    few = [name for name in names if name and name not in same and _hardly(rows[name], rows[""])]
    lines = [f"| {spelled[name]} | {rows[name]} |" for name in names if name not in (*same, *few)]
    told = {f"Under {FEW:.0%} of the positions changes, and nothing else, without": few, "The same without": same}
    lists = [f"\n{words}: {'; '.join(spelled[name] for name in found)}." for words, found in told.items() if found]
    return "\n".join([f"{len(drives)} drives:\n", HEADER, *lines, *lists])


def _hardly(row: str, whole: str) -> bool:
    """Whether only the number of positions changes, and that by less than FEW."""
    (count, rest), (of, whole_rest) = (one.split(" | ", 1) for one in (row, whole))
    return rest == whole_rest and abs(int(count) - int(of)) < FEW * int(of)


def _row(drives: Sequence[AblationAnswers]) -> str:
    positions = np.array([one for drive in drives for one in drive.positions]).reshape(-1, 4)
    error_m, sigmas, *levels = positions.T
    calls = [sum(state in drive.verdicts for drive in drives) for state in ("faulty", "not recognized")]
    above = int((np.maximum(*levels) > 1).sum())
    largest = f"{error_m.max(initial=0.0):.1f} m, {sigmas.max(initial=0.0):.1f} sigma"
    beyond = f"{int((sigmas > 3).sum())}, {int((sigmas > 4).sum())}"
    return f"{len(error_m)} | {beyond} | {largest} | {above} | {calls[0]}, {calls[1]}"
