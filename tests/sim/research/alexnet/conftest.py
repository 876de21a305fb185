"""Weights in the published network's shape, of random numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.research.alexnet.weights import CONVS, FC6_SHAPE


def random_weights(hidden: int, classes: int) -> dict[str, NDArray[np.float16]]:
    """Kaiming-normal weights: activations keep their size through the layers, as in a trained network."""
    random = np.random.default_rng(7)
    shapes: dict[str, tuple[int, ...]] = {conv.layer: conv.shape for conv in CONVS}
    shapes |= {"classifier.1": FC6_SHAPE, "classifier.4": (hidden, 4096), "classifier.6": (classes, hidden)}
    weights = {}
    for layer, shape in shapes.items():
        deviation = np.float32(2 / np.prod(shape[1:])) ** 0.5
        weights[f"{layer}.weight"] = (random.standard_normal(shape, np.float32) * deviation).astype(np.float16)
        weights[f"{layer}.bias"] = (random.standard_normal(shape[0], np.float32) * 0.1).astype(np.float16)
    return weights


@pytest.fixture(scope="session")
def published_weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file in the published network's shape (fc7 4096 wide, 365 classes) and with its names (DataParallel)."""
    file = tmp_path_factory.mktemp("weights") / "alexnet_places365.npz"
    weights = random_weights(hidden=4096, classes=365)
    named: dict[str, Any] = {name.replace("features.", "features.module."): value for name, value in weights.items()}
    np.savez(file, **named)
    return file
