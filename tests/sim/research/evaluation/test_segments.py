"""The likeliest path against all paths, and runs that are long enough."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.research.evaluation.methods import likeliest_states, runs


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), frames=st.integers(1, 6), states=st.integers(1, 3))
def test_no_other_path_is_likelier(seed: int, frames: int, states: int) -> None:
    change = 0.2
    probabilities = np.random.default_rng(seed).dirichlet(np.ones(states), frames)

    def likelihood(path: tuple[int, ...]) -> float:
        total = sum(math.log(max(probabilities[frame, state], 1e-12)) for frame, state in enumerate(path))
        return total + sum(
            math.log(1 - change) if before == after else math.log(change / (states - 1))
            for before, after in itertools.pairwise(path)
        )

    best = max(likelihood(path) for path in itertools.product(range(states), repeat=frames))
    assert likelihood(tuple(likeliest_states(probabilities, change).tolist())) == pytest.approx(best)


def test_one_odd_frame_does_not_make_a_segment() -> None:
    sure, unsure = [0.9, 0.1], [0.1, 0.9]
    states = likeliest_states(np.array([sure] * 20 + [unsure] + [sure] * 20 + [unsure] * 20))
    assert states.tolist() == [0] * 41 + [1] * 20
    assert runs(states) == [(0, 41), (41, 61)]


def test_short_runs_join_their_neighbors_and_every_frame_is_in_one() -> None:
    states = np.repeat([0, 1, 2, 3, 0], [2, 12, 3, 15, 1])
    assert runs(states, shortest=10) == [(0, 17), (17, 33)]
    assert runs(np.zeros(3, dtype=np.intp), shortest=10) == [(0, 3)]
