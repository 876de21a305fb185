"""Curves and similarities as figures that notebooks show."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from lookback import checks
from lookback.matching import of_better_order
from lookback.scoring import Curve, judged
from sim.compare.matching import Matches
from sim.output import needing

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot(
    shown: Curve | Mapping[str, Curve] | ArrayLike,
    truth: ArrayLike | None = None,
    found: Matches | None = None,
    soft: ArrayLike | None = None,
) -> Figure:
    """A figure of curves by their names, or of S (Q, N) or (2, Q, N) with what is right and what was found.

    truth: (Q, N), whose borders are drawn. found: places, right ones in green and others in red. soft: places (Q, N)
    that are neither, see `pr_curve`. Save it with `figure.savefig("curve.png")`. Needs the extra `sim` (matplotlib).

    >>> plot(np.eye(3)).axes[0].get_ylabel()
    'frame of the query'
    """
    with needing("lookback.plot", "sim"):
        from lookback.shown_figure import ShownFigure
    figure = ShownFigure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.subplots()
    if not isinstance(shown, (Curve, Mapping)):
        similarity = of_better_order(checks.similarities(shown))
        right = None if truth is None else checks.flags("truth", truth, similarity.shape)
        axes.imshow(similarity, aspect="auto", cmap="viridis", interpolation="nearest")
        axes.set(xlabel="place of the reference", ylabel="frame of the query")
        if right is not None:
            axes.contour(right, levels=[0.5], colors="white", linewidths=0.7)
        if found is not None:
            if right is not None:
                found, _ = judged(found, right, soft)
            rows = np.flatnonzero(found.place >= 0)
            hit = np.ones(len(rows), np.bool_) if right is None else right[rows, found.place[rows]]
            for chosen, color in ((hit, "tab:green"), (~hit, "tab:red")):
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
