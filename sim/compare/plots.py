"""A plot of the paper's comparisons as PNG."""

from __future__ import annotations

import numpy as np
from matplotlib import pyplot as plt
from numpy.typing import NDArray

from sim.compare.matching import errors_of
from sim.evaluation.figures import WIDTH_IN, to_png


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
