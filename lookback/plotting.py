"""Curves and similarities as figures that notebooks show."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lookback.matching import of_better_order
from lookback.scoring import Curve
from sim.compare.matching import Matches
from sim.output import needing

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot(
    shown: Curve | Mapping[str, Curve] | NDArray[np.floating],
    truth: NDArray[np.bool_] | None = None,
    found: Matches | None = None,
) -> Figure:
    """A figure of curves by their names, or of S (Q, N) or (2, Q, N) with what is right and what was found.

    truth: (Q, N), whose borders are drawn. found: places, right ones in green and others in red. Save it with
    `figure.savefig("curve.png")`. Needs the extra `sim` (matplotlib).

    >>> plot(np.eye(3)).axes[0].get_ylabel()
    'frame of the query'
    """
    with needing("lookback.plot", "sim"):
        from lookback.shown_figure import ShownFigure
    figure = ShownFigure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.subplots()
    if isinstance(shown, np.ndarray):
        axes.imshow(of_better_order(shown), aspect="auto", cmap="viridis", interpolation="nearest")
        axes.set(xlabel="place of the reference", ylabel="frame of the query")
        if truth is not None:
            axes.contour(truth, levels=[0.5], colors="white", linewidths=0.7)
        if found is not None:
            rows = np.flatnonzero(found.place >= 0)
            right = np.ones(len(rows), np.bool_) if truth is None else truth[rows, found.place[rows]]
            for chosen, color in ((right, "tab:green"), (~right, "tab:red")):
                axes.plot(found.place[rows[chosen]], rows[chosen], ".", color=color, markersize=3)
        return figure
    curves = {"": shown} if isinstance(shown, Curve) else shown
    for name, curve in curves.items():
        axes.plot(curve.recall_of_places, curve.precision, drawstyle="steps-post", label=name)
    axes.set(xlabel="recall", ylabel="precision", xlim=(0, 1.01), ylim=(0, 1.03))
    axes.grid(alpha=0.3)
    if all(curves):
        axes.legend()
    return figure
