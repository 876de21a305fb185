"""The shipped network, on real frames where they are there."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import onnxruntime
import pytest
from numpy.typing import NDArray

from edge.descriptor.model_file import FC6_FILE, fc6_folder
from edge.descriptor.network import Network, Regions, cut_regions
from edge.descriptor.open_network import NSD_COSINE_MIN, nsd_cosines
from edge.feed import FeedImages, read_feed
from sim.model_tools.onnx_graph import MEAN_RGB, Weights
from sim.research.alexnet import build_float
from tests.descriptor.accuracy import matching_accuracy

Oracle = Callable[..., dict[str, NDArray[np.float64]]]


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


def read_weights(file: Path) -> Weights:
    with np.load(file) as arrays:
        return {name.replace("module.", ""): array.astype(np.float32) for name, array in arrays.items()}


@pytest.fixture(scope="module")
def float_network(shared: Path, network: Network, tmp_path_factory: pytest.TempPathFactory) -> Network:
    """The shipped network's weights, in float."""
    pytest.importorskip("onnx", reason="needs the extra `model`")
    file = shared / "model" / "alexnet_places100_fp16.npz"
    assert hashlib.sha256(file.read_bytes()).hexdigest() == network.info.weights_sha256
    weights = read_weights(file)
    file = tmp_path_factory.mktemp("float") / "fc6.onnx"
    file.write_bytes(build_float(weights, msgspec.structs.replace(network.info, sha256="")).SerializeToString())
    return Network.load(file)


def test_int8_keeps_descriptors_and_matches_of_real_frames(
    shared: Path, network: Network, float_network: Network
) -> None:
    names = "corridor_query", "corridor_reference"
    query, reference = (read_regions(shared / "feeds" / name, "left-right", 3) for name in names)
    exact, rounded = ((describe(each, query), describe(each, reference)) for each in (float_network, network))
    for pair in zip(exact, rounded, strict=True):
        assert nsd_cosines(*pair).mean() >= NSD_COSINE_MIN
    rows = 3 * np.arange(len(query))
    correct = abs(rows[:, None] - rows) <= 3
    float_share, int8_share = matching_accuracy(*exact, correct), matching_accuracy(*rounded, correct)
    assert float_share > 0.8
    assert int8_share >= float_share - 0.01


def test_gray_edge_is_close_to_the_edge_of_the_training(shared: Path, float_network: Network, alexnet: Oracle) -> None:
    """Training had zeros after normalization beyond the edge; the graph has one gray for all channels."""
    weights = read_weights(shared / "model" / "alexnet_places100_fp16.npz")
    regions = read_regions(shared / "feeds" / "corridor_reference", "whole")[::40, 0]
    mean_level = 255 * np.array(MEAN_RGB)
    expected = np.stack([alexnet(weights, image, pad_level=mean_level)["fc6"] for image in regions])
    found = float_network.describe(regions)
    cosines = (found * expected).sum(axis=1) / np.linalg.norm(found, axis=1) / np.linalg.norm(expected, axis=1)
    assert cosines.min() > 0.9995
