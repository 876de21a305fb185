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
from typing import NamedTuple

import numpy as np

from edge import __version__
from edge.errors import FeedError
from edge.localization import NO_PLACES, Fix, PositionEstimator
from edge.localization.drive_file import read_drive
from edge.localization.events import Frame
from edge.localization.position_estimator import Asked, Entry, Restored
from edge.localization.refusals import RULES
from sim.research.trial import recorded_drive
from sim.research.trial.flight_score import off_truth
from sim.research.trial.recorded_drive import LINK, RecordedDrive
from sim.research.trial.table import put_between
from sim.vehicle.position_inputs import east_north_m

STREAM_S = 0.2
"""Between two positions of a stream, and the least between two of which the drive had none: frames come seldom."""
SECTION = "ablation"
CONSTANTS: dict[str, object] = {
    "bound.SETTLED_NS": 0,
    "gps_judge.BESIDE_SIGMAS": math.inf,
    "gps_judge.FIRM": 0.0,
    "gps_judge.MOST_PLACES": math.inf,
    "gps_referee.LONGEST_GAP_M": math.inf,
    "integrity.GROWS": math.inf,
    "integrity.MAP_SHIFTED": 0.0,
    "integrity.ONE_MORE": 1.0,
    "own_motion.CHANGES": math.inf,
    "place_fix.LEAST_SHARPNESS": 0.0,
    "place_fix.PUSHED": -math.inf,
    "place_fix.heads_along": lambda road_rad, heading_rad: True,
    "route_estimate.WANDER": 0.0,
    "route_filter.DISAGREE": math.inf,
    "route_filter.STOOD_NS": math.inf,
    "sighting.SHARP": 1e-9,
    "track.BY_CHANCE": math.inf,
    "track.FADES_M": 1e-6,
}
"""Of `edge.localization`, with what puts each out of action."""
NAMES = (*(rule.reason for rule in RULES if rule.reason != NO_PLACES), *CONSTANTS)
"""Without a place there is nothing to publish."""
HEADER = (
    "| without | positions | beyond 3, 4 sigma | largest error | above their levels | GPS: wrong, not recognized |\n"
    "|---|---|---|---|---|---|"
)


class Answers(NamedTuple):
    """What a drive got.

    positions: (n, 4), of each meters off, standard deviations off, and the shares of its levels along and across that
    it is off by, 0 without one. verdicts: those on GPS which the pilot was warned of.
    """

    positions: list[tuple[float, float, float, float]]
    verdicts: list[str]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback dev ablate`."""
    parser.add_argument("lists", type=Path, metavar="LISTS", help="output of `lookback dev flights`, with its lists")
    parser.add_argument("flights", nargs="+", type=Path, metavar="FOLDER", help="the recorded drives, for the truth")
    one = "a rule or a constant, as often as wanted (default: each of all)"
    parser.add_argument("--without", action="append", choices=[*NAMES], metavar="NAME", help=one)
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="drives replayed side by side (default 1)")
    parser.add_argument("--page", type=Path, metavar="FILE", help="a page of docs, to write the table into")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    folders = [path.parent for given in args.flights for path in sorted(given.glob(f"**/{LINK}"))]
    drives = [folder for folder in folders if list((args.lists / folder.name).glob("*.drive"))]
    if not drives:
        raise FeedError(
            f"{args.lists}: no list of these drives; `lookback dev flights FOLDER -o {args.lists}` makes it"
        )
    with get_context("spawn").Pool(args.jobs) as pool:
        found = pool.map(partial(ablated, args.lists, args.without or NAMES), drives, chunksize=1)
    text = table(found)
    if args.page is not None:
        given = " ".join(path.name for path in args.flights)
        rules = f"Without each of {len(NAMES) - len(CONSTANTS)} rules and {len(CONSTANTS)} constants"
        names = "all" if len(drives) == len(folders) else ", ".join(drive.name for drive in drives)
        made = f"`lookback dev ablate LISTS {given}` of version {__version__}:\n\n{rules}; drives: {names}."
        put_between(SECTION, args.page, f"{made}\n\n{text}")
    print(text)
    return 0


def ablated(lists: Path, names: Sequence[str], folder: Path) -> dict[str, Answers]:
    """What one drive got, "" for all rules and constants as they are, and without each."""
    truth = recorded_drive.read_drive(folder)
    runs = [read_drive(path) for path in sorted((lists / folder.name).glob("*.drive"))]
    found: dict[str, Answers] = {}

    def replay(name: str, without: str = "") -> None:
        found[name] = Answers([], [])
        for config, entries in runs:
            estimator = PositionEstimator(config, rules=[rule for rule in RULES if rule.reason != without])
            one = _replayed(estimator, entries, truth, config.gates.min_interval_s)
            found[name] = Answers(found[name].positions + one.positions, found[name].verdicts + one.verdicts)

    replay("")
    for name in names:
        if name not in CONSTANTS:
            replay(name, name)
            continue
        with _set(name.partition(".")[2], CONSTANTS[name]):
            replay(name)
    return found


@contextmanager
def _set(name: str, value: object) -> Iterator[None]:
    """A constant of `edge.localization` has another value, wherever it is used."""
    modules = [module for key, module in sys.modules.items() if key.startswith("edge.localization.")]
    before = [(module, getattr(module, name)) for module in modules if hasattr(module, name)]
    for module, _ in before:
        setattr(module, name, value)
    try:
        yield
    finally:
        for module, old in before:
            setattr(module, name, old)


def _replayed(
    estimator: PositionEstimator, entries: Sequence[tuple[int, Entry]], truth: RecordedDrive, interval_s: float
) -> Answers:
    """Open loop: the autopilot goes on by the positions of the list, but for those that no estimator here has given."""
    found = Answers([], [])
    answered_ns, stamp_ns, verdict = -math.inf, 0, ""
    for t_ns, entry in entries:
        if isinstance(entry, Asked):
            answer = estimator.fix(t_ns, entry.limits)
            period_s = STREAM_S if entry.limits.at == "now" else interval_s
            is_new = isinstance(answer, Fix) and answer.place.stamp_ns != stamp_ns
            if isinstance(answer, Fix) and is_new and t_ns - answered_ns >= period_s * 1e9 - STREAM_S * 1e9 / 2:
                answered_ns, stamp_ns = t_ns, answer.place.stamp_ns
                found.positions.append(_off(answer, truth))
        elif isinstance(entry, Restored):
            estimator.restore(t_ns, entry.kept)
        else:
            estimator.update(t_ns, entry)
            if isinstance(entry, Frame) and estimator.known.gps.state != verdict:
                verdict = estimator.known.gps.state
                found.verdicts.append(verdict)
    return found


def _off(fix: Fix, truth: RecordedDrive) -> tuple[float, float, float, float]:
    place = fix.place
    here_m = east_north_m(place.lat_deg or 0.0, place.lon_deg or 0.0)
    error_m, along_m, across_m = off_truth(truth, here_m, place.stamp_ns / 1e9)
    return error_m, error_m / place.sigma_m, abs(along_m) / fix.level.along_m, abs(across_m) / fix.level.across_m


def table(drives: Sequence[dict[str, Answers]]) -> str:
    """One row for each rule and constant; only its name where nothing changes."""
    names = {"": "nothing"} | {name: name for name in drives[0] if name}
    rows = {name: _row([one[name] for one in drives]) for name in names}
    spelled = {name: f"`{name}`" if name in CONSTANTS else words for name, words in names.items()}
    lines = [f"| {spelled[name]} | {rows[name]} |" for name in names if not name or rows[name] != rows[""]]
    same = "; ".join(spelled[name] for name in names if name and rows[name] == rows[""])
    return "\n".join([f"{len(drives)} drives:\n", HEADER, *lines, "", f"The same without: {same or 'none'}."])


def _row(drives: Sequence[Answers]) -> str:
    positions = np.array([one for drive in drives for one in drive.positions]).reshape(-1, 4)
    error_m, sigmas, *levels = positions.T
    calls = [sum(state in drive.verdicts for drive in drives) for state in ("wrong", "not recognized")]
    above = int((np.maximum(*levels) > 1).sum())
    largest = f"{error_m.max(initial=0.0):.1f} m, {sigmas.max(initial=0.0):.1f} sigma"
    beyond = f"{int((sigmas > 3).sum())}, {int((sigmas > 4).sum())}"
    return f"{len(error_m)} | {beyond} | {largest} | {above} | {calls[0]}, {calls[1]}"
