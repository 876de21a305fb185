"""`lookback dev paper match`: the sequence search and the scores on a cost matrix of any origin, or on VPR-Bench."""

from __future__ import annotations

import argparse
import csv
import sys
from pathlib import Path
from typing import TextIO

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.config import SequenceConfig, checked_option
from edge.errors import ConfigError
from sim.research.evaluation import vpr_bench
from sim.research.evaluation.bootstrap import Resampling, interval
from sim.research.evaluation.descriptions import read_matrix
from sim.research.evaluation.matching import Matches, errors_of, judge, judged_queries, match_costs
from sim.research.evaluation.scores import max_f1_of_places, recall_of_best, scores

COUNTS = (1, 5, 10, 20, 25)
"""N of R@N as papers print it; R@1 is the accuracy but for queries without an answer."""


def run(args: argparse.Namespace) -> int:
    """Search a matrix; matches as CSV, and scores where the truth is known. ConfigError for bad input."""
    is_bench = args.costs.is_dir()
    costs = vpr_bench.costs(args.costs) if is_bench else read_matrix(args.costs)
    truth_file = args.costs / vpr_bench.GROUND_TRUTH if is_bench and args.truth is None else args.truth
    length = args.length or (1 if is_bench else 20)
    sequence = checked_option(SequenceConfig(), "--length", length=max(length, 2))
    sequence = msgspec.structs.replace(sequence, length=length, directions=args.directions, region_order="frame")
    if not args.tolerance > 0:
        raise ConfigError(f"--tolerance: {args.tolerance:g} is not above 0")
    errors = _read_truth(truth_file, costs.shape) if truth_file else None
    matches = match_costs(costs, sequence, max(1, round(2 * args.tolerance)))
    if args.output:
        try:
            with args.output.open("w", newline="", encoding="utf-8") as stream:
                _write(matches, stream)
        except OSError as error:
            raise ConfigError(f"{args.output}: cannot write the matches: {error.strerror}") from None
    elif errors is None:
        _write(matches, sys.stdout)
    if errors is not None:
        _score(matches, errors, args.tolerance, length)
    return 0


def _write(matches: Matches, stream: TextIO) -> None:
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["query", "place", "uniqueness", "direction"])
    for query, place in enumerate(matches.place.tolist()):
        if place >= 0:
            direction = "reverse" if matches.reverse[query] else "forward"
            writer.writerow([query, place, f"{matches.confidence[query]:.6f}", direction])


def _score(matches: Matches, errors: NDArray[np.float64], tolerance: float, length: int) -> None:
    judged = judged_queries(errors, length)
    answers = judge(matches, errors, tolerance, judged)
    found = scores(answers)
    sure = interval(max_f1_of_places, answers, Resampling(block=2 * length))
    best = errors_of(matches.candidates, errors)[judged]
    recalls = recall_of_best(best, errors.min(axis=1)[judged], COUNTS, [tolerance])[:, 0]
    print(f"queries judged     {found.queries}, from number {length - 1} on; {found.on_map} of them on the map")
    print(f"accuracy           {found.accuracy:.4f}")
    print(f"max-F1 (places)    {found.max_f1_of_places:.4f}   {sure.low:.4f} to {sure.high:.4f} at {sure.level:.0%}")
    print(f"max-F1 (correct)   {found.max_f1_of_correct:.4f}   its recall reaches 1 by construction")
    print(f"average precision  {found.average_precision:.4f}")
    print(f"recall at 100 %    {found.recall_at_100:.4f}")
    print(f"recall at 99 %     {found.recall_at_99:.4f}")
    for count, recall in zip(COUNTS, recalls, strict=True):
        print(f"{f'R@{count}':<19}{recall:.4f}")


def _read_truth(path: Path, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """How far each place is from being right for each query, (Q, N); ConfigError names the file and the line.

    Truth is the right index of each query, in places, or a matrix that says which are right: 0 or infinitely far.
    """
    if path.name == vpr_bench.GROUND_TRUTH:
        return np.where(vpr_bench.truth(path, shape).T, 0.0, np.inf)
    if path.suffix == ".npy" and (right := _read_right(path)) is not None:
        if right.shape != shape:
            raise ConfigError(f"{path}: its shape is {right.shape}, and that of the costs (reference x query) {shape}")
        return np.where(right.T, 0.0, np.inf)
    truth = read_matrix(path, dimensions=1) if path.suffix == ".npy" else np.array(_read_column(path))
    if len(truth) != shape[1]:
        raise ConfigError(f"{path}: {len(truth)} rows for {shape[1]} queries; the matrix is reference x query")
    if truth.max() >= shape[0]:
        raise ConfigError(f"{path}: index {truth.max():g}, but the matrix has {shape[0]} places, from 0")
    errors = np.abs(truth[:, np.newaxis] - np.arange(shape[0]))
    errors[truth < 0] = np.inf
    return errors


def _read_right(path: Path) -> NDArray[np.bool_] | None:
    """A matrix of truth values, or of 0 and 1; None for a .npy of anything else."""
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None  # `read_matrix` names what is wrong
    if array.ndim != 2 or (array.dtype.kind != "b" and not np.isin(array, (0, 1)).all()):
        return None
    return np.asarray(array, dtype=bool)


def _read_column(path: Path) -> list[float]:
    try:
        lines = path.read_text(encoding="utf-8").split()
    except OSError as error:
        raise ConfigError(f"{path}: cannot read it: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: not UTF-8 text") from None
    values = []
    for number, line in enumerate(lines, 1):
        try:
            values.append(float(line))
        except ValueError:
            raise ConfigError(f"{path}: line {number}: {line[:40]!r} is not a reference index") from None
    if not values or not np.isfinite(values).all():
        raise ConfigError(f"{path}: needs a finite number a line; -1 for a query that is off the map")
    return values
