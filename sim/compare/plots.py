"""Plots of the paper's comparisons as PNG."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import pyplot as plt
from numpy.typing import NDArray

from sim.evaluation.figures import WIDTH_IN, to_png

MARKERS = "osD^v<>Pp*hX"


def match_plot(
    errors: NDArray[np.float64],
    costs: NDArray[np.floating],
    place: NDArray[np.intp],
    wrong: NDArray[np.bool_],
    tolerance: float,
) -> bytes:
    """The cost matrix (Q, N), the true band, and every answer: right ones dark, wrong ones red."""
    figure, axes = plt.subplots(figsize=(WIDTH_IN, 5.0))
    low, high = np.quantile(costs, [0.02, 0.98])
    axes.imshow(costs, cmap="Greys_r", aspect="auto", vmin=low, vmax=high, interpolation="nearest")
    axes.contour(errors <= tolerance, levels=[0.5], colors="tab:blue", linewidths=0.7)
    queries = np.arange(len(place))
    for chosen, color, label in ((~wrong, "tab:green", "right"), (wrong, "tab:red", "wrong")):
        shown = chosen & (place >= 0)
        axes.plot(place[shown], queries[shown], ".", color=color, markersize=2.5, label=label)
    axes.set(xlabel="place of the reference", ylabel="query frame", xlim=(0, costs.shape[1] - 1))
    axes.legend(fontsize=7, loc="upper right", markerscale=3)
    return to_png(figure)


def bar_plot(groups: Sequence[str], bars: Mapping[str, Sequence[float]], label: str) -> bytes:
    """Grouped bars: one group a pair, one bar a method."""
    figure, axes = plt.subplots(figsize=(max(WIDTH_IN, 1.6 * len(groups)), 4.0))
    width = 0.85 / max(len(bars), 1)
    colors = plt.get_cmap("tab20").colors  # type: ignore[attr-defined]
    for index, (name, heights) in enumerate(bars.items()):
        offset = (index - (len(bars) - 1) / 2) * width
        axes.bar(np.arange(len(groups)) + offset, heights, width, label=name, color=colors[index % len(colors)])
    axes.set_xticks(range(len(groups)), [textwrap.fill(group, 18) for group in groups], fontsize=7)
    axes.set(ylabel=label, ylim=(0, 1.02))
    axes.grid(axis="y", alpha=0.3)
    axes.legend(fontsize=7, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.18))
    return to_png(figure)


def line_plot(lines: Mapping[str, tuple[Sequence[float], Sequence[float]]], x_label: str, y_label: str) -> bytes:
    """A line a name: (x values, y values); NaN breaks it."""
    figure, axes = plt.subplots(figsize=(WIDTH_IN, 4.0))
    for index, (name, (x, y)) in enumerate(lines.items()):
        axes.plot(x, y, marker=MARKERS[index % len(MARKERS)], markersize=4, label=name, linewidth=1.2)
    axes.set(xlabel=x_label, ylabel=y_label, ylim=(0, 1.03))
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7)
    return to_png(figure)
