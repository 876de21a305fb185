"""The shipped network, on real frames where they are there."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
from numpy.typing import NDArray

from edge.descriptor.model_file import FC6_FILE, fc6_folder
from edge.descriptor.network import Network, Regions, cut_regions
from edge.descriptor.open_network import NSD_COSINE_MIN, nsd_cosines
from edge.feed import FeedImages, read_feed
from sim.model_tools.onnx_graph import MEAN_RGB, STD_RGB
from tests.descriptor.accuracy import matching_accuracy

PAD_LEVEL = 114
"""Gray that stands for nothing: the mean of MEAN_RGB, which all channels share, and what conv1 sees beyond the edge."""


@pytest.fixture(scope="module")
def network() -> Network:
    return Network.load()


@pytest.fixture(scope="module")
def images() -> NDArray[np.uint8]:
    """Two pictures that differ, (2, 224, 224, 3)."""
    coarse = np.random.default_rng(1).integers(0, 256, (2, 14, 14, 3), dtype=np.uint8)
    return coarse.repeat(16, axis=1).repeat(16, axis=2)


def read_regions(feed: Path, kind: Regions, every: int = 1) -> NDArray[np.uint8]:
    """Frames of a feed as (N, R, 224, 224, 3)."""
    images, rows = FeedImages(read_feed(feed)), range(0, len(read_feed(feed).rows), every)
    return np.stack([cut_regions(images.read(row), kind, 0.4, (224, 224)) for row in rows])


def describe(network: Network, regions: NDArray[np.uint8]) -> NDArray[np.float32]:
    return np.stack([network.describe(frame) for frame in regions])


def test_shipped_network_says_what_it_is(network: Network) -> None:
    info = network.info
    assert (info.name, info.tap, info.dimensions, info.precision) == ("alexnet_places100", "fc6", 4096, "int8")
    assert (info.input_size, info.channel_order) == (224, "BGR")
    assert "non-commercial" in info.license
    card = (fc6_folder() / "README.md").read_text(encoding="utf-8")
    assert info.sha256[:16] in card


def test_every_large_layer_runs_in_int8(tmp_path: Path) -> None:
    """ONNX Runtime says nothing when it does not fuse a layer into an int8 kernel and runs it in float instead."""
    onnx = pytest.importorskip("onnx", reason="needs the extra `model`")
    options = onnxruntime.SessionOptions()
    options.optimized_model_filepath = str(tmp_path / "optimized.onnx")
    options.log_severity_level = 3  # it warns that such a file is for this machine only
    onnxruntime.InferenceSession(fc6_folder() / FC6_FILE, options, providers=["CPUExecutionProvider"])
    found = Counter(node.op_type for node in onnx.load(tmp_path / "optimized.onnx").graph.node)
    assert (found["QLinearConv"], found["QGemm"], found["Conv"]) == (5, 1, 0)


def test_descriptors_are_float32_after_relu(network: Network, images: NDArray[np.uint8]) -> None:
    descriptors = network.describe(images)
    assert descriptors.shape == (2, 4096)
    assert descriptors.dtype == np.float32
    assert descriptors.min() == 0.0
    assert 0.1 < (descriptors > 0).mean() < 0.9


def test_repeated_and_split_batches_are_identical_to_the_bit(network: Network, images: NDArray[np.uint8]) -> None:
    both = network.describe(images)
    again = network.describe(images)
    one_by_one = np.concatenate([network.describe(images[:1]), network.describe(images[1:])])
    other_session = Network.load().describe(images[::-1].copy())[::-1]
    for other in (again, one_by_one, other_session):
        np.testing.assert_array_equal(both, other)


def test_channel_order_matters(network: Network, images: NDArray[np.uint8]) -> None:
    swapped = network.describe(np.ascontiguousarray(images[..., ::-1]))
    assert not np.array_equal(swapped, network.describe(images))


def float_fc6(weights: Mapping[str, NDArray[np.float32]], image_bgr: NDArray[np.uint8]) -> NDArray[np.float32]:
    """AlexNet up to fc6 of one image (224, 224, 3), layer by layer as its paper draws it."""
    padded = np.full((228, 228, 3), PAD_LEVEL, np.float32)
    padded[2:-2, 2:-2] = image_bgr[..., ::-1]
    x = ((padded / 255 - MEAN_RGB) / STD_RGB).transpose(2, 0, 1).astype(np.float32)
    for layer, stride, pad, is_pooled in ((0, 4, 0, 1), (3, 1, 2, 1), (6, 1, 1, 0), (8, 1, 1, 0), (10, 1, 1, 1)):
        kernels = weights[f"features.{layer}.weight"]
        x = np.pad(x, ((0, 0), (pad, pad), (pad, pad)))
        windows = np.lib.stride_tricks.sliding_window_view(x, kernels.shape[2:], axis=(1, 2))[:, ::stride, ::stride]
        x = np.tensordot(kernels, windows, axes=((1, 2, 3), (0, 3, 4)))
        x = np.maximum(x + weights[f"features.{layer}.bias"][:, None, None], 0)
        if is_pooled:
            x = np.lib.stride_tricks.sliding_window_view(x, (3, 3), axis=(1, 2))[:, ::2, ::2].max(axis=(3, 4))
    return np.asarray(np.maximum(weights["classifier.1.weight"] @ x.ravel() + weights["classifier.1.bias"], 0))


@pytest.mark.long
def test_int8_keeps_descriptors_and_matches_of_real_frames(shared: Path, network: Network) -> None:
    file = shared / "model" / "alexnet_places100_fp16.npz"
    assert hashlib.sha256(file.read_bytes()).hexdigest() == network.info.weights_sha256
    with np.load(file) as arrays:
        weights = {name.replace("module.", ""): array.astype(np.float32) for name, array in arrays.items()}
    both = [read_regions(shared / "feeds" / f"corridor_{name}", "left-right", 3) for name in ("query", "reference")]
    exact = [np.stack([[float_fc6(weights, one) for one in frame] for frame in regions]) for regions in both]
    rounded = [describe(network, regions) for regions in both]
    for pair in zip(exact, rounded, strict=True):
        assert nsd_cosines(*pair).mean() >= NSD_COSINE_MIN
    rows = 3 * np.arange(len(both[0]))
    correct = abs(rows[:, None] - rows) <= 3
    float_share, int8_share = (matching_accuracy(one, other, correct) for one, other in (exact, rounded))
    assert float_share > 0.8
    assert int8_share >= float_share - 0.01
