"""Semantic segments (section VI-B): runs of frames that show one kind of place, found with a hidden Markov model.

As in Garg et al. 2017 [29], the hidden state is the place category, and what is seen of it are the network's category
probabilities. A category lasts: it changes from one frame to the next with the probability CHANGE, to any other alike.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

CHANGE = 0.01
"""Once in 100 frames, 200 m at 2 m a frame. [29] does not give its transition probabilities."""

SHORTEST = 10
"""Frames; mean and deviation of fewer say nothing, so a shorter run joins the one before it."""


def likeliest_states(probabilities: NDArray[np.floating], change: float = CHANGE) -> NDArray[np.intp]:
    """The likeliest sequence of categories (Viterbi), (n,), given probabilities (n, C) of each frame alone."""
    count, states = probabilities.shape
    seen = np.log(np.maximum(probabilities.astype(np.float64), 1e-12))
    stay, leave = np.log1p(-change), np.log(change / max(states - 1, 1))
    score = seen[0]
    came_from = np.zeros((count, states), dtype=np.intp)
    for frame in range(1, count):
        # All changes cost alike, so the best state to come from is either the same one or the best of all.
        best = int(score.argmax())
        stays = score + stay >= score[best] + leave
        came_from[frame] = np.where(stays, np.arange(states), best)
        score = np.where(stays, score + stay, score[best] + leave) + seen[frame]
    path = np.empty(count, dtype=np.intp)
    path[-1] = score.argmax()
    for frame in range(count - 1, 0, -1):
        path[frame - 1] = came_from[frame, path[frame]]
    return path


def runs(states: NDArray[np.intp], shortest: int = SHORTEST) -> list[tuple[int, int]]:
    """[start, end) of each run of one state; runs below `shortest` frames join the one before, the first the next."""
    starts = [0, *(np.flatnonzero(np.diff(states)) + 1).tolist()]
    found = list(zip(starts, [*starts[1:], len(states)], strict=True))
    joined = found[:1]
    for start, end in found[1:]:
        before, _ = joined[-1]
        if end - start < shortest or joined[-1][1] - before < shortest:
            joined[-1] = (before, end)
        else:
            joined.append((start, end))
    return joined
