"""Every score against a slow version that counts query by query, threshold by threshold."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from edge.keypoints import Keypoints
from edge.keypoints.network import KeypointNetwork
from sim.compare.scores import at_threshold, block_indices, intervals, of_curve
from sim.evaluation.matched_points import InlierMatches, side_by_side, with_lines
from sim.evaluation.metrics import Answers, answers_within, precision_recall, recall_at_precision


@st.composite
def some_answers(draw: st.DrawFn) -> Answers:
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = draw(st.integers(0, 40))
    # Few distinct confidences, so that there are ties; and some queries without an answer.
    confidence = rng.integers(0, draw(st.integers(1, 30)), count).astype(np.float64)
    confidence[rng.random(count) < draw(st.sampled_from([0.0, 0.3]))] = np.nan
    has_truth = rng.random(count) < draw(st.sampled_from([0.0, 0.6, 1.0]))
    return Answers(confidence, (rng.random(count) < 0.7) & has_truth, has_truth)


def count_at(answers: Answers, threshold: float) -> tuple[int, int]:
    """True positives and false positives, one query at a time."""
    true_positives = false_positives = 0
    for confidence, correct in zip(answers.confidence.tolist(), answers.correct.tolist(), strict=True):
        if confidence >= threshold:  # NaN is not
            true_positives += correct
            false_positives += not correct
    return true_positives, false_positives


def ratio(part: float, whole: float) -> float:
    return part / whole if whole else math.nan


@settings(max_examples=200, deadline=None)
@given(some_answers())
def test_scores_are_those_counted_by_hand(answers: Answers) -> None:
    thresholds = sorted({c for c in answers.confidence.tolist() if not math.isnan(c)}, reverse=True)
    on_map = int(answers.has_truth.sum())
    precision, of_places = [], []
    for threshold in thresholds:
        true_positives, false_positives = count_at(answers, threshold)
        precision.append(true_positives / (true_positives + false_positives))
        of_places.append(ratio(true_positives, on_map))
    curve = precision_recall(answers)
    np.testing.assert_array_equal(curve.thresholds, thresholds)
    np.testing.assert_allclose(curve.precision, precision)
    np.testing.assert_allclose(curve.recall_of_places, of_places)

    points = zip(precision, of_places, strict=True)
    best_f1 = max((2 * p * r / (p + r) for p, r in points if p + r > 0), default=0.0)
    accuracy, area, at_100, max_f1 = of_curve(answers)
    assert max_f1 == pytest.approx(best_f1)
    for least, recall in ((1.0, at_100), (0.99, recall_at_precision(curve, 0.99))):
        reached = [r for p, r in zip(precision, of_places, strict=True) if p >= least and not math.isnan(r)]
        assert on_map == 0 or recall == pytest.approx(max(reached, default=0.0))
    if on_map:
        steps = zip(precision, of_places, [0.0, *of_places], strict=False)
        assert area == pytest.approx(sum((r - before) * p for p, r, before in steps))
        answered = ~np.isnan(answers.confidence)
        assert accuracy == pytest.approx((answers.correct & answered).sum() / on_map)


def test_a_correct_match_off_the_map_is_refused() -> None:
    with pytest.raises(ValueError, match="off the map"):
        Answers(np.ones(1), np.array([True]), np.array([False]))
    with pytest.raises(ValueError, match="one shape"):
        Answers(np.ones(2), np.array([True]), np.array([True]))


def test_precision_and_recall_at_a_threshold_count_unanswered_queries_as_missed() -> None:
    confidence = np.array([0.9, 0.6, 0.5, 0.4, np.nan, 0.7])
    correct = np.array([True, True, True, True, False, False])
    answers = Answers(confidence, correct, np.array([True, True, True, True, True, False]))
    assert at_threshold(answers, 0.5) == (3 / 4, 3 / 5)
    precision, recall = at_threshold(answers, 1.0)
    assert np.isnan(precision) and recall == 0.0


def test_a_frame_a_little_beyond_the_tolerance_is_right_within_twice_of_it_also_beyond_the_maps_end() -> None:
    """The last two are off the map: 0.4 m beyond the tolerance, and far away."""
    error_m = np.array([3.0, 40.4, 12.0, 40.4, 300.0])
    on_map = np.array([True, True, True, False, False])
    confidence = np.array([0.6, 0.7, 0.9, 0.99, 0.5])
    strict = Answers(confidence, on_map & (error_m <= 40.0), on_map)
    assert recall_at_precision(precision_recall(strict), 1.0) == 0.0
    assert recall_at_precision(precision_recall(answers_within(confidence, error_m, on_map, 80.0)), 1.0) == 1.0
    surest = np.array([0.6, 0.7, 0.9, 0.99, 0.95])
    assert recall_at_precision(precision_recall(answers_within(surest, error_m, on_map, 80.0)), 1.0) == 0.0


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


def points(xy: list[tuple[float, float]], size: tuple[int, int]) -> Keypoints:
    return Keypoints(np.array(xy, np.float32), np.ones(len(xy), np.float32), np.zeros((len(xy), 64), np.int8), size)


def test_a_line_joins_each_pair_in_pictures_of_any_two_sizes() -> None:
    here, there = np.zeros((100, 120, 3), np.uint8), np.zeros((200, 160, 3), np.uint8)
    one, other = points([(10, 50), (30, 20)], (100, 120)), points([(40, 60), (80, 100)], (200, 160))
    found = InlierMatches(np.array([[0, 1]], np.int32), 1)
    drawn = with_lines((here, there), (one, other), found)
    assert drawn.shape == (100, 200, 3)
    rows, columns = np.nonzero(drawn.any(axis=2))
    assert (columns.min(), columns.max()) == (7, 163)  # from 10 to 120 + 80 / 2, with dots
    assert abs(rows - 50).max() <= 3
    assert not here.any(), "the given picture is not drawn on"


def test_pictures_of_one_place_have_many_lines() -> None:
    rng = np.random.default_rng(3)
    here: NDArray[np.uint8] = rng.integers(0, 255, (24, 32, 3), np.uint8).repeat(8, axis=0).repeat(8, axis=1)
    there = np.asarray(cv2.warpAffine(here, np.array([[1, 0, 9.0], [0, 1, 0]]), (256, 192)), np.uint8)
    drawn, found = side_by_side(KeypointNetwork(), here, there)
    assert drawn.shape == (192, 512, 3)
    assert found.inliers > 100
    assert (drawn != np.hstack([here, there])).any(axis=2).mean() > 0.05
