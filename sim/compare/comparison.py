"""Every method on every pair: tables and curves of figs. 5 to 9."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib import pyplot as plt
from numpy.typing import NDArray

from sim.compare.matching import errors_of
from sim.compare.method_runner import MethodResult, MethodRunner
from sim.compare.plan import Pair
from sim.compare.scores import at_threshold, intervals, of_curve, recall_at_1, recall_at_100
from sim.compare.traverses import open_pictures
from sim.evaluation import figures
from sim.evaluation.figures import WIDTH_IN, to_png
from sim.evaluation.metrics import OFFSET_SHARE, precision_recall
from sim.evaluation.report import Cell, Figure, Interval, Picture, ReportSection, ScoreGroup, Table, format_cell


def match_plot(
    errors: NDArray[np.float64],
    costs: NDArray[np.floating],
    place: NDArray[np.intp],
    judged: NDArray[np.intp],
    tolerance: float,
) -> bytes:
    """The cost matrix (Q, N), the true band, and every answer: of `judged` queries right ones green, wrong ones red."""
    figure, axes = plt.subplots(figsize=(WIDTH_IN, 5.0))
    low, high = np.quantile(costs, [0.02, 0.98])
    axes.imshow(costs, cmap="Greys_r", aspect="auto", vmin=low, vmax=high, interpolation="nearest")
    axes.contour(errors <= tolerance, levels=[0.5], colors="tab:blue", linewidths=0.7)
    right, is_judged = errors_of(place, errors) <= tolerance, np.isin(np.arange(len(place)), judged)
    kinds = ((right & is_judged, "tab:green", "right"), (~right & is_judged, "tab:red", "wrong"))
    for chosen, color, label in (*kinds, (~is_judged, "tab:gray", "not judged")):
        shown = np.flatnonzero(chosen & (place >= 0))
        axes.plot(place[shown], shown, ".", color=color, markersize=2.5, label=label)
    axes.set(xlabel="place of the reference", ylabel="query frame", xlim=(0, costs.shape[1] - 1))
    axes.legend(fontsize=7, loc="upper right", markerscale=3)
    return to_png(figure)


Results = dict[tuple[str, str], MethodResult]
"""Outcome by the names of pair and method."""

SCORES = ("method", "precision", "recall", "offset", "median ahead")
SCORE_NOTE = (
    "Precision, recall: of what is accepted at the default threshold. Offset: how far ahead of the vehicle a match is"
    " expected, meters or frames; what is right is judged there. Median ahead: how far ahead right answers lie. Without"
    " an offset it is limited to the tolerance."
)


def compare(runner: MethodRunner, step: Callable[[str], None]) -> Results:
    """Run every method on every pair; `step` is called before each with its name."""
    found: Results = {}
    for pair in runner.plan.pairs:
        for text in runner.plan.methods:
            step(f"{pair.name}: {text}")
            found[pair.name, text] = runner.run(pair, text)
    return found


def pair_section(runner: MethodRunner, pair: Pair, results: Results) -> ReportSection:
    """All scores of one pair, its curves, and the matches of one method."""
    outcomes = [results[pair.name, text] for text in runner.plan.methods]
    shown = shown_outcome(runner, pair, results)
    slug = _slug(pair.name)
    curves = {outcome.method.name: precision_recall(outcome.answers) for outcome in outcomes}
    plot = match_plot(shown.errors, shown.matches.costs, shown.matches.place, shown.judged, pair.tolerance)
    return ReportSection(
        title=f"{pair.name}" + (f" (like the paper's {pair.figure})" if pair.figure else ""),
        text=_describe(pair, shown),
        tables=[Table(f"{slug}_scores", "At the threshold", SCORES, list(map(_scores_of, outcomes)), SCORE_NOTE)],
        files=[answers_table(one, f"{slug}_answers_{_slug(one.method.name)}") for one in outcomes],
        figures=[
            Figure(f"{slug}_precision_recall", "Precision and recall", figures.precision_recall_plot(curves)),
            Figure(
                f"{slug}_matches", f"Costs and matches of {shown.method.name}", plot, "Between the blue lines: true."
            ),
        ],
        pictures=matched_pictures(shown),
    )


def shown_outcome(runner: MethodRunner, pair: Pair, results: Results) -> MethodResult:
    """The outcome whose matches are drawn and written: that of Lookback, or of the last method."""
    texts = runner.plan.methods
    return results[pair.name, "Lookback" if "Lookback" in texts else texts[-1]]


SUMMARY = ("pair", "method", "R@1", "R@5", "R@10", "AUC", "R@P100", "max-F1", "median error", "CPU ms a frame")
SUMMARY_NOTE = (
    "R@K: share of the frames on the map that have a true place among their K best. AUC: area under precision over"
    " recall of places. R@P100: recall of places at 100 % precision. Intervals: block bootstraps at 95 %. Median error:"
    " of right answers, in meters or frames along the road. CPU time: to describe and match a frame here, in one run."
)


def summary(runner: MethodRunner, results: Results) -> Table:
    """A row for every method on every pair."""
    rows = [_summary_row(runner, *key, outcome) for key, outcome in results.items()]
    note = " ".join(offset_warnings(runner, results))
    return Table("scores", "Every method on every pair", SUMMARY, rows, note)


def _summary_row(runner: MethodRunner, pair: str, method: str, outcome: MethodResult) -> list[Cell]:
    # Sequences that far apart share no frame.
    first, *curve = intervals(of_curve, outcome.answers, 2 * outcome.length, runner.plan.resamples)
    others = [outcome.recall_within(count) for count in (5, 10)]
    return [pair, method, first, *others, *curve, outcome.median_error(), outcome.frame_ms]


MEANS_NOTE = (
    "R@1: the share of the frames on the map whose best match is right. R@P100: of those that can be used without a"
    " single wrong place among them. Means over all pairs; of each kind of pair R@1, R@P100."
)


def means(runner: MethodRunner, results: Results) -> Table:
    """A row for every method: R@1 and R@P100 over all pairs, and on each kind of pair."""
    pairs = runner.plan.pairs
    kinds = list(dict.fromkeys(pair.kind or pair.name for pair in pairs))
    rows: list[list[Cell]] = []
    for text in runner.plan.methods:
        outcomes = [results[pair.name, text] for pair in pairs]
        each = np.array([(recall_at_1(one.answers), recall_at_100(one.answers)) for one in outcomes])
        columns = [each[[(pair.kind or pair.name) == kind for pair in pairs]] for kind in kinds]
        time_ms = float(np.median([one.frame_ms for one in outcomes]))
        rows.append([text, *each.mean(axis=0).tolist(), *map(_mean_cell, columns), f"{time_ms:.1f}"])
    return Table("means", "R@1 and R@P100", ("method", "R@1", "R@P100", *kinds, "CPU ms a frame"), rows, MEANS_NOTE)


def _mean_cell(each: NDArray[np.float64]) -> ScoreGroup:
    """R@1 and R@P100 (n, 2) of pairs of one kind."""
    return ScoreGroup(dict(zip(("R@1", "R@P100"), each.mean(axis=0).tolist(), strict=True)))


ANSWERS = ("query", "place", "score", "right", "query row", "place row")


def answers_table(outcome: MethodResult, name: str) -> Table:
    """What the method answered to each frame of the query, and whether that is right: 1, 0, empty where not judged.

    query, place: counted as in matrices, place -1 without an answer; rows: of the recordings.
    """
    matches, judged = outcome.matches, set(outcome.judged.tolist())
    right, place_rows = outcome.error_of_best() <= outcome.pair.tolerance, [*outcome.reference.rows.tolist(), ""]
    rows: list[list[Cell]] = [
        [query, place, score, int(right[query]) if query in judged else "", query_row, place_rows[place]]
        for query, (place, score, query_row) in enumerate(
            zip(matches.place.tolist(), matches.confidence.tolist(), outcome.query.rows.tolist(), strict=True)
        )
    ]
    return Table(name, f"Answers of {outcome.method.name}", ANSWERS, rows)


def _slug(text: str) -> str:
    return "".join(letter if letter.isalnum() else "_" for letter in text)


def as_short(cell: Cell) -> str:
    """A cell on the terminal: of an interval its value."""
    return format_cell(cell.value if isinstance(cell, Interval) else cell)


def matched_pictures(outcome: MethodResult) -> list[list[Picture]]:
    """Frames of the query, spread over the drive, each beside the place that was found."""
    answered = outcome.judged[outcome.matches.place[outcome.judged] >= 0]
    chosen = answered[np.linspace(0, len(answered) - 1, min(6, len(answered))).round().astype(int)]
    query, reference = (open_pictures(one.feed) for one in (outcome.query, outcome.reference))
    error, rows = outcome.error_of_best(), []
    for frame in chosen:
        place, says = outcome.matches.place[frame], "right" if error[frame] <= outcome.pair.tolerance else "wrong"
        here = Picture.of(query.read(outcome.query.rows[frame]), f"query, frame {frame}")
        there = Picture.of(reference.read(outcome.reference.rows[place]), f"place {place}: {says}")
        rows.append([here, there])
    for one in (query, reference):
        one.close()
    return rows


def networks_section(runner: MethodRunner, results: Results) -> ReportSection:
    """What each network takes, and who owns it."""
    rows: list[list[Cell]] = []
    for name, network in runner.descriptions.opened().items():
        info, size_mb = network.info, network.path.stat().st_size / 1e6
        size = f"{info.size[0]} x {info.size[1]}"
        rows.append([name, info.dimensions, size, f"{size_mb:.1f}", info.license.partition(",")[0]])
    columns = ("network", "dimensions", "image, pixels", "file, MB", "license")
    return ReportSection("Networks", tables=[Table("networks", "Networks", columns, rows)])


def overview(runner: MethodRunner, results: Results) -> ReportSection:
    """All scores in one table, and the means of every method."""
    described = [f"{text}: {runner.method(text).description}." for text in runner.plan.methods]
    text = " ".join([*described, SUMMARY_NOTE])
    return ReportSection("Overview", text, [summary(runner, results), means(runner, results)])


def median_ahead(outcome: MethodResult) -> float:
    """How far ahead of the query right answers lie, in the direction of travel; NaN if none is right."""
    ahead = outcome.ahead_of_query()[outcome.judged[outcome.answers.correct]]
    return float(np.median(ahead)) if ahead.size else float("nan")


def _describe(pair: Pair, outcome: MethodResult) -> str:
    unit = "m" if pair.truth in ("positions", "route_m") else "frames"
    on_map = int(outcome.answers.has_truth.sum())
    known = outcome.errors[outcome.judged][outcome.answers.has_truth]
    guess = float((known <= pair.tolerance).sum() / (~np.isnan(known)).sum()) if on_map else 0.0
    return (
        f"{pair.query} against {pair.reference}: {len(outcome.query.rows)} frames and {len(outcome.reference.rows)}"
        f" places, sequences of {outcome.length} frames, tolerance {pair.tolerance:g} {unit}."
        f" {len(outcome.judged)} frames are judged: those with a known position, from the first whole sequence on."
        f" {on_map} of them have a true place in the map. A guess is right in {100 * guess:.1f} % of them."
    )


def _scores_of(outcome: MethodResult) -> list[Cell]:
    """A row of the table of a pair."""
    precision, recall = at_threshold(outcome.answers, outcome.threshold)
    return [outcome.method.name, precision, recall, outcome.ahead, median_ahead(outcome)]


def offset_warnings(runner: MethodRunner, results: Results) -> list[str]:
    """A line for each pair of which the shown answers lie so far from the offset that the tolerance cuts them off."""
    lines = []
    for pair in runner.plan.pairs:
        shown = shown_outcome(runner, pair, results)
        ahead = median_ahead(shown)
        if abs(ahead - shown.ahead) > OFFSET_SHARE * pair.tolerance:
            lines.append(
                f"pair {pair.name!r}: right answers of {shown.method.name} lie a median of {ahead:.0f} ahead, where"
                f" {shown.ahead:.0f} is expected, near the tolerance of {pair.tolerance:g}: set ahead or calibration."
            )
    return lines
