"""Plots of an evaluation as PNG, without a display."""

from __future__ import annotations

import io
from collections.abc import Mapping

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from sim.evaluation.metrics import PrecisionRecall

DPI = 110
WIDTH_IN = 6.4


def precision_recall_plot(curves: Mapping[str, PrecisionRecall]) -> bytes:
    """Precision over recall_of_places, a line a method."""
    figure, axes = plt.subplots(figsize=(WIDTH_IN, 4.2))
    for name, curve in curves.items():
        axes.plot(curve.recall_of_places, curve.precision, drawstyle="steps-post", label=name, linewidth=1.4)
    axes.set(xlabel="recall of places", ylabel="precision", xlim=(0, 1.01), ylim=(0, 1.03))
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7, loc="lower left", ncols=2)
    return to_png(figure)


def to_png(figure: Figure) -> bytes:
    """Draw, close, and give the bytes; no date in them, so that the same numbers give the same file."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=DPI, bbox_inches="tight", metadata={"Software": None})
    plt.close(figure)
    return stream.getvalue()
