"""Gradients against differences, and maps that point where the evidence is."""

from __future__ import annotations

from typing import Any

import numpy as np

from sim.research.evaluation.activation_maps import activation_map, overlay, scores_and_gradients


def small_head(rng: np.random.Generator) -> dict[str, Any]:
    sizes = {"classifier.1": (20, 4 * 9), "classifier.4": (12, 20), "classifier.6": (5, 12)}
    weights = {f"{name}.weight": rng.normal(size=shape).astype(np.float32) for name, shape in sizes.items()}
    return weights | {f"{name}.bias": rng.normal(size=shape[0]).astype(np.float32) for name, shape in sizes.items()}


def slow_scores(weights: dict[str, Any], pooled: np.ndarray) -> np.ndarray:
    hidden = np.maximum(weights["classifier.1.weight"] @ pooled.ravel() + weights["classifier.1.bias"], 0)
    hidden = np.maximum(weights["classifier.4.weight"] @ hidden + weights["classifier.4.bias"], 0)
    return np.asarray(weights["classifier.6.weight"] @ hidden + weights["classifier.6.bias"])


def test_gradients_are_the_differences_of_the_scores() -> None:
    rng = np.random.default_rng(3)
    # In float64, so that differences of 1e-6 can be told.
    weights: dict[str, Any] = {name: value.astype(np.float64) for name, value in small_head(rng).items()}
    pooled: Any = np.abs(rng.normal(size=(4, 3, 3)))
    probabilities, rank, gradients = scores_and_gradients(weights, pooled)
    scores = slow_scores(weights, pooled)
    np.testing.assert_array_equal(rank, np.argsort(-scores))
    np.testing.assert_allclose(probabilities, np.exp(scores) / np.exp(scores).sum(), rtol=1e-4)
    for number, category in enumerate(rank[:3]):
        for index in np.ndindex(pooled.shape):
            nudged = pooled.copy()
            nudged[index] += 1e-6
            slope = (slow_scores(weights, nudged)[category] - scores[category]) / 1e-6
            np.testing.assert_allclose(gradients[number][index], slope, atol=1e-3)


def test_the_map_is_where_the_channel_that_speaks_is_active() -> None:
    pooled = np.zeros((2, 3, 3), dtype=np.float32)
    pooled[0, 0, 2], pooled[1, 2, 0] = 5.0, 9.0
    gradient = np.stack([np.full((3, 3), 0.5), np.full((3, 3), -0.5)]).astype(np.float32)
    found = activation_map(pooled, gradient)
    assert found[0, 2] == 1.0 and found.sum() == 1.0
    assert not activation_map(pooled, -np.abs(gradient)).any()
    warm = overlay(np.full((60, 60, 3), 90, np.uint8), found)
    assert warm.shape == (60, 60, 3) and warm[5, 55, 2] > warm[55, 5, 2]  # redder where it speaks
