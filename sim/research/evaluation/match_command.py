"""`lookback dev paper match COSTS.npy`: the sequence search and the scores on a cost matrix of any origin."""

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
from sim.research.evaluation.bootstrap import Resampling, interval
from sim.research.evaluation.descriptions import read_matrix
from sim.research.evaluation.matching import Matches, judge, judged_queries, match_costs
from sim.research.evaluation.scores import max_f1_of_places, scores


def run(args: argparse.Namespace) -> int:
    """Search a matrix; matches as CSV, and scores where the truth is known. ConfigError for bad input."""
    costs = read_matrix(args.costs)
    sequence = checked_option(SequenceConfig(), "--length", length=args.length)
    sequence = msgspec.structs.replace(sequence, directions=args.directions, region_order="frame")
    if not args.tolerance > 0:
        raise ConfigError(f"--tolerance: {args.tolerance:g} is not above 0")
    truth = _read_truth(args.truth, costs.shape) if args.truth else None
    matches = match_costs(costs, sequence, max(1, round(2 * args.tolerance)))
    if args.output:
        try:
            with args.output.open("w", newline="", encoding="utf-8") as stream:
                _write(matches, stream)
        except OSError as error:
            raise ConfigError(f"{args.output}: cannot write the matches: {error.strerror}") from None
    elif truth is None:
        _write(matches, sys.stdout)
    if truth is not None:
        _score(matches, truth, args.tolerance, args.length)
    return 0


def _write(matches: Matches, stream: TextIO) -> None:
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["query", "place", "uniqueness", "direction"])
    for query, place in enumerate(matches.place.tolist()):
        if place >= 0:
            direction = "reverse" if matches.reverse[query] else "forward"
            writer.writerow([query, place, f"{matches.confidence[query]:.6f}", direction])


def _score(matches: Matches, truth: NDArray[np.float64], tolerance: float, length: int) -> None:
    errors = np.abs(truth[:, np.newaxis] - np.arange(matches.costs.shape[1]))
    errors[truth < 0] = np.inf
    answers = judge(matches, errors, tolerance, judged_queries(errors, length))
    found = scores(answers)
    sure = interval(max_f1_of_places, answers, Resampling(block=2 * length))
    print(f"queries judged     {found.queries}, from number {length - 1} on; {found.on_map} of them on the map")
    print(f"accuracy           {found.accuracy:.4f}")
    print(f"max-F1 (places)    {found.max_f1_of_places:.4f}   {sure.low:.4f} to {sure.high:.4f} at {sure.level:.0%}")
    print(f"max-F1 (correct)   {found.max_f1_of_correct:.4f}   its recall reaches 1 by construction")
    print(f"average precision  {found.average_precision:.4f}")
    print(f"recall at 100 %    {found.recall_at_100:.4f}")
    print(f"recall at 99 %     {found.recall_at_99:.4f}")


def _read_truth(path: Path, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """True reference index of each query, (Q,); ConfigError names the file and the line."""
    truth = read_matrix(path, dimensions=1) if path.suffix == ".npy" else np.array(_read_column(path))
    if len(truth) != shape[1]:
        raise ConfigError(f"{path}: {len(truth)} rows for {shape[1]} queries; the matrix is reference x query")
    if truth.max() >= shape[0]:
        raise ConfigError(f"{path}: index {truth.max():g}, but the matrix has {shape[0]} places, from 0")
    return truth


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
