"""Intervals that hold what they should hold, and blocks that are blocks."""

from __future__ import annotations

import numpy as np

from sim.compare.scores import block_indices, intervals
from sim.evaluation.metrics import Answers


def accuracy(answers: Answers) -> tuple[float]:
    return (float(answers.correct.mean()),)


def answers_that_are(correct: list[bool]) -> Answers:
    flags = np.array(correct)
    return Answers(flags.astype(np.float64), flags, np.ones(len(flags), dtype=bool))


def runs_of_luck(rng: np.random.Generator, count: int, run: int, share: float) -> Answers:
    """Frames that are right or wrong in runs, as neighbors on a road are."""
    return answers_that_are((rng.random(count // run) < share).repeat(run).tolist())


def test_blocks_are_contiguous_and_every_frame_is_as_likely() -> None:
    rng = np.random.default_rng(0)
    drawn = np.array([block_indices(100, 10, rng) for _ in range(3000)])
    assert drawn.shape == (3000, 100)
    steps = np.diff(drawn.reshape(3000, 10, 10), axis=2) % 100
    assert (steps == 1).all()
    counts = np.bincount(drawn.ravel(), minlength=100) / 3000
    assert abs(counts - 1).max() < 0.15
    assert len(block_indices(7, 50, rng)) == 7


def test_the_interval_covers_the_truth_as_often_as_it_says() -> None:
    rng = np.random.default_rng(1)
    covered_by_blocks = covered_by_frames = 0
    for seed in range(100):
        answers = runs_of_luck(rng, 600, 20, share=0.6)
        (by_blocks,) = intervals(accuracy, answers, 40, 200, seed)
        (by_frames,) = intervals(accuracy, answers, 1, 200, seed)
        covered_by_blocks += by_blocks.low <= 0.6 <= by_blocks.high
        covered_by_frames += by_frames.low <= 0.6 <= by_frames.high
    assert covered_by_blocks >= 80
    # Drawing frames one by one is what would call noise a result.
    assert covered_by_frames <= 60
