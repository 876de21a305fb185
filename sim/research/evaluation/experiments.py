"""The experiments of a plan: sequence length, spacing, cold start, int8, standing."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
import numpy as np

from edge.config import Config, SamplingConfig
from edge.descriptor.network import Network
from edge.feed import Feed
from edge.journal.records import FrameUsed
from edge.reference_map import MapSet
from edge.reference_map.store import open_map
from sim.evaluation.recognition import recognize
from sim.evaluation.report import Cell, Figure, Section, Table
from sim.maps.command import build_map
from sim.research.evaluation import plots as draw
from sim.research.evaluation.comparison import Results
from sim.research.evaluation.method_runner import MethodRunner, Outcome
from sim.research.evaluation.plan import Pair, Plan
from sim.research.evaluation.scores import max_f1_of_places, scores
from sim.research.evaluation.traverses import true_errors

Step = Callable[[str], None]


def replay_on_new_map(
    reference: Feed, query: Feed, config: Config, sampling: SamplingConfig, network: Network
) -> list[FrameUsed]:
    """Every used frame of `query`, taken by `sampling`, recognized on a map of `reference`."""
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "map"
        build_map([reference], path, config.descriptor, config.sampling, network=network)
        config = msgspec.structs.replace(config, sampling=sampling)
        return recognize(MapSet.of(open_map(path)), query, config, network).used


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


def int8_against_float(runner: MethodRunner, results: Results, step: Step) -> Section:
    """The same method with float network and descriptors: the cost of quantization."""
    rows: list[Sequence[Cell]] = []
    for pair in sweep_pairs(runner.plan):
        for text in runner.plan.experiments.int8:
            step(f"{pair.name}: {text} in float")
            exact = runner.run(pair, text, precision="float32")
            small = results.get((pair.name, text)) or runner.run(pair, text)
            agree = float((exact.matches.place == small.matches.place)[exact.judged].mean())
            rows.append(
                [
                    pair.name,
                    text,
                    scores(small.answers).accuracy,
                    scores(exact.answers).accuracy,
                    max_f1_of_places(small.answers),
                    max_f1_of_places(exact.answers),
                    agree,
                ]
            )
    columns = ("pair", "method", "accuracy, int8", "accuracy, float", "max-F1, int8", "max-F1, float", "same place")
    note = "int8 network and int8 descriptors against float32 of both. Same place: share of frames with equal answers."
    return Section("int8 against float", note, [Table("int8", "int8 against float", columns, rows)])


def standing(runner: MethodRunner, step: Step) -> Section:
    """The recognizer on a drive with halts and changing speed: frames by distance and by time, with the gate or not."""
    rows: list[Sequence[Cell]] = []
    by_time = SamplingConfig(by="frames")
    default = Config().descriptor.standing_change
    for drive in runner.plan.experiments.standing:
        pair = next(pair for pair in runner.plan.pairs if pair.name == drive.pair)
        pair = msgspec.structs.replace(pair, query=drive.query)
        for sampling, gate in ((runner.plan.sampling, default), (by_time, default), (by_time, 0.0)):
            by = f"{sampling.spacing_m:g} m" if sampling.by == "distance" else "every frame"
            step(f"{drive.query}: {by}, standing gate {gate:g}")
            rows.append([f"{pair.query} against {pair.reference}", by, gate, *_halting(runner, pair, sampling, gate)])
    columns = ("pair", "frames taken", "standing_change", "frames", "answered", "accuracy of answers")
    note = "The query through the recognizer of `lookback replay`; standing_change 0 turns its gate off."
    return Section("Standing still, speed changes", note, [Table("standing", "With and without", columns, rows)])


def _halting(runner: MethodRunner, pair: Pair, sampling: SamplingConfig, gate: float) -> tuple[int, int, float]:
    """Frames, answers, and the share of right ones."""
    reference, query = runner.traverse(pair.reference), runner.traverse(pair.query, sampling)
    network = runner.descriptions.network(next(iter(runner.plan.networks)), "fc6")
    config = msgspec.structs.replace(
        Config(),
        sampling=runner.plan.sampling,
        descriptor=msgspec.structs.replace(Config().descriptor, standing_change=gate),
        sequence=msgspec.structs.replace(Config().sequence, length=runner.sequence_length(pair)),
    )
    lines = replay_on_new_map(reference.feed, query.feed, config, sampling, network)
    errors = true_errors(reference, query, pair, runner.offset(pair, "Lookback"))
    answered = [(index, line.place) for index, line in enumerate(lines) if line.place is not None]
    right = sum(bool(errors[index, place] <= pair.tolerance) for index, place in answered)
    return len(lines), len(answered), right / len(answered) if answered else float("nan")


def _f1_from(outcome: Outcome, length: int) -> float:
    """Max-F1 on the frames that a sequence of `length` can end at."""
    return max_f1_of_places(outcome.answers.take(np.flatnonzero(outcome.judged >= length - 1)))
