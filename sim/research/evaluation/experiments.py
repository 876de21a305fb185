"""The experiments of a plan: sequence length, spacing, cold start."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from sim.evaluation.report import Cell, Figure, Section, Table
from sim.research.evaluation import plots as draw
from sim.research.evaluation.comparison import Results
from sim.research.evaluation.method_runner import MethodRunner, Outcome
from sim.research.evaluation.plan import Pair, Plan
from sim.research.evaluation.scores import max_f1_of_places

Step = Callable[[str], None]


def sweep_pairs(plan: Plan) -> list[Pair]:
    """The pairs of the sweeps; pairs that differ in the length only count once."""
    wanted = plan.experiments.sweep_pairs
    chosen = [pair for pair in plan.pairs if not wanted or pair.name in wanted]
    apart = {(pair.reference, pair.query, pair.tolerance): pair for pair in reversed(chosen)}
    return list(reversed(apart.values()))


def sequence_lengths(runner: MethodRunner, step: Step) -> Section:
    """Max-F1 over the length of a sequence (fig. 12), judged on the same frames at every length."""
    lengths = sorted(runner.plan.experiments.sequence_lengths)
    rows: list[Sequence[Cell]] = []
    plots = []
    for number, pair in enumerate(sweep_pairs(runner.plan)):
        lines: dict[str, tuple[Sequence[float], Sequence[float]]] = {}
        for text in runner.plan.experiments.sweep_methods:
            values = []
            for length in lengths:
                step(f"{pair.name}: {text}, length {length}")
                values.append(_f1_from(runner.run(pair, text, length=length), lengths[-1]))
            rows.append([pair.name, text, *values])
            lines[text] = (lengths, values)
        plot = draw.line_plot(lines, "frames in a sequence", "max-F1 (places)")
        plots.append(Figure(f"sequence_length_{number}", pair.name, plot))
    columns = ("pair", "method", *(f"{length}" for length in lengths))
    text = "Frames are judged from the first whole sequence of the greatest length on, so that all lengths share them."
    return Section(
        "Sequence length (fig. 12)", text, [Table("sequence_length", "Max-F1 (places)", columns, rows)], plots
    )


def spacings(runner: MethodRunner, step: Step) -> Section:
    """Max-F1 with places this far apart, the sequence as long in meters as the plan has it."""
    rows: list[Sequence[Cell]] = []
    distances = runner.plan.experiments.spacings_m
    for pair in sweep_pairs(runner.plan):
        for text in runner.plan.experiments.sweep_methods:
            values: list[Cell] = []
            for spacing_m in distances:
                step(f"{pair.name}: {text}, a place every {spacing_m:g} m")
                values.append(max_f1_of_places(runner.run(pair, text, spacing_m=spacing_m).answers))
            rows.append([pair.name, text, *values])
    columns = ("pair", "method", *(f"{spacing_m:g} m" for spacing_m in distances))
    return Section("Spacing of the places", "", [Table("spacing", "Max-F1 (places)", columns, rows)])


def cold_start(runner: MethodRunner, results: Results) -> Section:
    """Right answers in each third of the drive: online statistics begin without data."""
    rows: list[Sequence[Cell]] = []
    for (pair, _), outcome in results.items():
        if outcome.method.name in runner.plan.experiments.cold_start:
            thirds = np.array_split(outcome.answers.correct, 3), np.array_split(outcome.answers.has_truth, 3)
            shares = [
                float(right.sum() / known.sum()) if known.any() else float("nan")
                for right, known in zip(*thirds, strict=True)
            ]
            rows.append([pair, outcome.method.name, *shares])
    columns = ("pair", "method", "first third", "second third", "last third")
    return Section("Cold start", "", [Table("cold_start", "Accuracy by thirds of the drive", columns, rows)])


def _f1_from(outcome: Outcome, length: int) -> float:
    """Max-F1 on the frames that a sequence of `length` can end at."""
    return max_f1_of_places(outcome.answers.take(np.flatnonzero(outcome.judged >= length - 1)))
