"""Plots of drives and evaluations as PNG, without a display."""

from __future__ import annotations

import io
from collections.abc import Mapping

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from sim.evaluation.metrics import PrecisionRecall

DPI = 110
WIDTH_IN = 6.4
BLUE, ORANGE, GRAY, RED = "#1f6fb4", "#e6820e", "#9aa3ad", "#c0392b"
Points = NDArray[np.float64]
Flags = NDArray[np.bool_]


def precision_recall_plot(curves: Mapping[str, PrecisionRecall]) -> bytes:
    """Precision over recall_of_places, a line a method."""
    figure, axes = plt.subplots(figsize=(WIDTH_IN, 4.2))
    for name, curve in curves.items():
        axes.plot(curve.recall_of_places, curve.precision, drawstyle="steps-post", label=name, linewidth=1.4)
    axes.set(xlabel="recall of places", ylabel="precision", xlim=(0, 1.01), ylim=(0, 1.03))
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7, loc="lower left", ncols=2)
    return to_png(figure)


def route_plot(road_m: Points, right_m: Points, wrong_m: Points, missed_m: Points, tolerance_m: float) -> Figure:
    """The mapped road from above, and where places were believed or not; each (N, 2), meters east and north."""
    figure = Figure(figsize=(WIDTH_IN, 5.2), layout="constrained")
    axes = figure.subplots()
    axes.plot(*road_m.T, color=GRAY, lw=3, label="the map's route")
    if len(missed_m):
        axes.plot(*missed_m.T, ".", color=ORANGE, ms=4, label="not accepted")
    if len(right_m):
        axes.plot(*right_m.T, "o", color=BLUE, ms=4, label="accepted")
    if len(wrong_m):
        axes.plot(*wrong_m.T, "x", color=RED, ms=7, label=f"over {tolerance_m:.0f} m off")
    axes.set(xlabel="east, m", ylabel="north, m")
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(fontsize=8)
    return figure


def cost_matrix(costs: NDArray[np.float32], places: Points, accepted: Flags) -> Figure:
    """Cosine distance of each frame from each place (Q, N), and the place of its best match, (Q,), NaN for none."""
    figure = Figure(figsize=(WIDTH_IN, 5.2), layout="constrained")
    axes = figure.subplots()
    shown = axes.imshow(costs.T, origin="lower", aspect="auto", cmap="viridis", vmin=0.6, vmax=1.1)
    figure.colorbar(shown, label="cosine distance")
    rows = np.arange(len(places))
    axes.plot(rows[~accepted], places[~accepted], ".", color="white", ms=3, label="best, not accepted")
    axes.plot(rows[accepted], places[accepted], ".", color=ORANGE, ms=4, label="accepted")
    axes.set(xlabel="frame of this drive", ylabel="place of the map", ylim=(0, costs.shape[1]))
    # Below the matrix, which is full; on gray, so that the white dots are visible.
    figure.legend(loc="outside lower center", ncols=3, fontsize=9, facecolor=GRAY, markerscale=2.5)
    return figure


def confidence_plot(at: Points, unit: str, confidence: Points, right: Flags, wrong: Flags, least: float) -> Figure:
    """The confidence of each frame along the drive, (Q,) each, over what is asked for."""
    figure = Figure(figsize=(WIDTH_IN, 2.6), layout="constrained")
    axes = figure.subplots()
    axes.plot(at, confidence, color=GRAY, lw=1)
    if right.any():
        axes.plot(at[right], confidence[right], ".", color=BLUE, ms=4, label="accepted")
    if wrong.any():
        axes.plot(at[wrong], confidence[wrong], "x", color=RED, ms=5, label="accepted, wrong")
    axes.axhline(least, color=ORANGE, lw=1, label=f"asked for: {least:g}")
    axes.set(xlabel=f"driven, {unit}", ylabel="confidence", ylim=(0, 1.03))
    axes.legend(fontsize=8, loc="lower right", ncols=3)
    return figure


def to_png(figure: Figure) -> bytes:
    """Draw, close, and give the bytes; no date in them, so that the same numbers give the same file."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=DPI, bbox_inches="tight", metadata={"Software": None})
    plt.close(figure)
    return stream.getvalue()
