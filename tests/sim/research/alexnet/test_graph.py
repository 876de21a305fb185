"""The graphs against AlexNet written out in NumPy, in the shapes of the published weights."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from edge.descriptor.model_file import FC6_FILE, ModelInfo, fc6_folder, read_model_file
from edge.descriptor.network import Network
from edge.errors import ModelError
from sim.model_tools.onnx_graph import Weights
from sim.model_tools.quantize import measure_ranges
from sim.research.alexnet.command import as_int8, read_layer_ranges
from sim.research.alexnet.graph import DIMENSIONS, build_float
from sim.research.alexnet.weights import read_weights

pytestmark = pytest.mark.long

onnx = pytest.importorskip("onnx", reason="importing models needs the extra `model`")

Oracle = Callable[..., dict[str, NDArray[np.float64]]]


@pytest.fixture(scope="module")
def weights(published_weights: Path) -> Weights:
    return read_weights(published_weights)[0]


@pytest.fixture(scope="module")
def image() -> NDArray[np.uint8]:
    """Noise at several scales, with pixels at both ends of the range and channels that differ."""
    random = np.random.default_rng(3)
    scales = [random.random((224 // n, 224 // n, 3)).repeat(n, axis=0).repeat(n, axis=1) for n in (1, 7, 28, 112)]
    mixed = np.sum(scales, axis=0) * [0.3, 0.5, 0.2]
    return np.asarray(np.clip(mixed * 200 - 20, 0, 255), np.uint8)


@pytest.fixture(scope="module")
def expected(weights: Weights, image: NDArray[np.uint8], alexnet: Oracle) -> dict[str, NDArray[np.float64]]:
    """The layers of the image by AlexNet."""
    return alexnet(weights, image)


def save(model: object, file: Path) -> Path:
    file.write_bytes(model.SerializeToString())  # type: ignore[attr-defined]
    return file


@pytest.mark.parametrize("tap", ["fc6", "conv3"])
def test_float_network_is_alexnet(
    tap: str,
    weights: Weights,
    image: NDArray[np.uint8],
    info: ModelInfo,
    expected: dict[str, NDArray[np.float64]],
    tmp_path: Path,
) -> None:
    info = msgspec.structs.replace(info, tap=tap, dimensions=DIMENSIONS[tap])
    network = Network.load(save(build_float(weights, info), tmp_path / "float.onnx"))
    layer = expected[tap].ravel()
    assert np.count_nonzero(layer) > 1000
    np.testing.assert_allclose(network.describe(image[None])[0], layer, rtol=1e-3, atol=1e-4)


def test_int8_network_is_close_to_alexnet(
    weights: Weights,
    image: NDArray[np.uint8],
    info: ModelInfo,
    expected: dict[str, NDArray[np.float64]],
    tmp_path: Path,
) -> None:
    exact = build_float(weights, info)
    greatest = measure_ranges(exact, [image, image[::-1].copy(), 255 - image])
    network = Network.load(save(as_int8(exact, greatest, info), tmp_path / "fc6_int8.onnx"))

    found = network.describe(image[None])
    cosine = found[0] @ expected["fc6"] / np.linalg.norm(found[0]) / np.linalg.norm(expected["fc6"])
    assert cosine > 0.999
    assert (tmp_path / "fc6_int8.onnx").stat().st_size < 42e6  # a layer left in float would be seen here


def test_shipped_network_is_what_its_weights_and_ranges_make(shared: Path) -> None:
    shipped = onnx.load(fc6_folder() / FC6_FILE)
    weights, _ = read_weights(shared / "model" / "alexnet_places100_fp16.npz")
    info = read_model_file(fc6_folder() / FC6_FILE).info
    made = as_int8(build_float(weights, info), read_layer_ranges(shared / "model" / "activation_ranges.json"), info)
    kinds = [Counter(node.op_type for node in one.graph.node) for one in (made, shipped)]
    constants = {tensor.name: onnx.numpy_helper.to_array(tensor) for tensor in made.graph.initializer}
    names = {tensor.name for tensor in shipped.graph.initializer}
    # From 1.28 on, ONNX Runtime leaves Flatten between its two neighbors' numbers, which are the same.
    assert set(kinds[1] - kinds[0]) <= {"QuantizeLinear", "DequantizeLinear"}
    assert not kinds[0] - kinds[1]
    assert constants.keys() <= names
    assert all("flatten" in name for name in names - constants.keys())
    for tensor in shipped.graph.initializer:
        if tensor.name in constants:
            np.testing.assert_array_equal(constants[tensor.name], onnx.numpy_helper.to_array(tensor), tensor.name)


def test_ranges_without_a_layer(tmp_path: Path) -> None:
    file = tmp_path / "ranges.json"
    file.write_text('{"features.0": {"min": -1, "max": 2}, "images": 3}')
    with pytest.raises(
        ModelError, match=r"ranges\.json: no range of features\.3; it needs \{min, max\} of features\.0"
    ):
        read_layer_ranges(file)


@pytest.mark.parametrize("text", ["", "[]", '{"features.0": 3', "{}"])
def test_ranges_that_are_no_ranges(text: str, tmp_path: Path) -> None:
    (tmp_path / "ranges.json").write_text(text)
    with pytest.raises(ModelError, match=r"ranges\.json: "):
        read_layer_ranges(tmp_path / "ranges.json")


def test_range_that_is_empty(tmp_path: Path) -> None:
    layers = ("features.0", "features.3", "features.6", "features.8", "features.10", "classifier.1")
    ranges = {layer: {"min": -1.0, "max": 0.0 if layer == "features.8" else 1.0} for layer in layers}
    (tmp_path / "ranges.json").write_text(json.dumps(ranges))
    with pytest.raises(ModelError, match=r"ranges\.json: features\.8: Expected `float` > 0"):
        read_layer_ranges(tmp_path / "ranges.json")
