"""Weights in AlexNet's layout, and a slow, obvious AlexNet in NumPy to hold the graphs against."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.descriptor.model_file import ModelInfo
from edge.descriptor.model_import import DIMENSIONS, MEAN_RGB, PAD_LEVEL, STD_RGB
from edge.descriptor.weights import CONVS, FC6_SHAPE, Weights

Oracle = Callable[..., dict[str, NDArray[np.float64]]]


def random_weights(hidden: int, classes: int) -> dict[str, NDArray[np.float16]]:
    """Kaiming-normal weights: activations keep their size through the layers, as in a trained network."""
    random = np.random.default_rng(7)
    shapes = {conv.layer: conv.shape for conv in CONVS}
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
    np.savez(file, **{name.replace("features.", "features.module."): value for name, value in weights.items()})
    return file


@pytest.fixture
def info() -> ModelInfo:
    """What a float network of random weights says of itself."""
    return ModelInfo(
        name="random",
        tap="fc6",
        dimensions=DIMENSIONS["fc6"],
        precision="float32",
        input_size=224,
        channel_order="BGR",
        mean_rgb=MEAN_RGB,
        std_rgb=STD_RGB,
        labels=(),
        licence="none",
        source="random numbers",
        weights_sha256="",
        calibration="",
    )


@pytest.fixture(scope="session")
def alexnet() -> Oracle:
    """AlexNet in float64, layer by layer as the paper draws it; no code of the importer."""
    return _alexnet


def _alexnet(
    weights: Weights, image_bgr: NDArray[np.uint8], pad_level: float | NDArray[np.float64] = PAD_LEVEL
) -> dict[str, NDArray[np.float64]]:
    """conv3, fc6 and categories of one image (224, 224, 3) BGR; conv1 sees `pad_level` (RGB) around it."""
    padded = np.full((228, 228, 3), pad_level, dtype=np.float64)
    padded[2:-2, 2:-2] = image_bgr[..., ::-1]
    layers: dict[str, NDArray[np.float64]] = {}
    x = ((padded / 255 - MEAN_RGB) / STD_RGB).transpose(2, 0, 1)
    x = _pool(_conv(weights, "features.0", x, stride=4, pad=0))
    x = _pool(_conv(weights, "features.3", x, stride=1, pad=2))
    layers["conv3"] = x = _conv(weights, "features.6", x, stride=1, pad=1)
    x = _conv(weights, "features.8", x, stride=1, pad=1)
    x = _pool(_conv(weights, "features.10", x, stride=1, pad=1))
    layers["fc6"] = x = np.maximum(_dense(weights, "classifier.1", x.ravel()), 0)
    if "classifier.4.weight" in weights:
        x = _dense(weights, "classifier.6", np.maximum(_dense(weights, "classifier.4", x), 0))
        layers["categories"] = np.exp(x - x.max()) / np.exp(x - x.max()).sum()
    return layers


def _conv(weights: Weights, layer: str, x: NDArray[np.float64], stride: int, pad: int) -> NDArray[np.float64]:
    """Convolution and ReLU: every window times every kernel."""
    kernels = weights[f"{layer}.weight"].astype(np.float64)
    x = np.pad(x, ((0, 0), (pad, pad), (pad, pad)))
    windows = np.lib.stride_tricks.sliding_window_view(x, kernels.shape[2:], axis=(1, 2))[:, ::stride, ::stride]
    out = np.tensordot(kernels, windows, axes=((1, 2, 3), (0, 3, 4)))
    return np.maximum(out + weights[f"{layer}.bias"][:, None, None], 0)


def _pool(x: NDArray[np.float64]) -> NDArray[np.float64]:
    windows = np.lib.stride_tricks.sliding_window_view(x, (3, 3), axis=(1, 2))[:, ::2, ::2]
    return windows.max(axis=(3, 4))


def _dense(weights: Weights, layer: str, x: NDArray[np.float64]) -> NDArray[np.float64]:
    return weights[f"{layer}.weight"].astype(np.float64) @ x + weights[f"{layer}.bias"]
