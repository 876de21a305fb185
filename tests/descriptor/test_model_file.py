"""Files that are no network, or claim to be more than they are: one line each, and nothing allocated."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from edge.descriptor.model_file import FC6_FILE, MAX_FILE_BYTES, SHIPPED_MODEL, ModelInfo, read_model_file
from edge.descriptor.network import Network
from edge.errors import ModelError
from sim.model_tools.onnx_graph import GraphBuilder

onnx = pytest.importorskip("onnx", reason="needs the extra `model`")

Save = Callable[..., Path]


def small_model(info: ModelInfo, dimensions: int = 4) -> Any:
    """uint8 image (B, 2, 2, 3) to `dimensions` numbers: the smallest graph that the checks let through."""
    graph = GraphBuilder()
    graph.add("DequantizeLinear", ["image", graph.constant("step", 1.0), graph.constant("zero", np.uint8(0))])
    graph.add("Flatten", [graph.last], axis=1)
    layer = {"fc.weight": np.ones((dimensions, 12), np.float32), "fc.bias": np.zeros(dimensions, np.float32)}
    graph.add_dense("fc", layer)
    graph.add("Relu", [graph.last], output="fc6")
    return graph.finish(
        "image", [2, 2, 3], np.uint8, msgspec.structs.replace(info, input_size=2, dimensions=dimensions)
    )


@pytest.fixture
def model(info: ModelInfo) -> Any:
    return small_model(info)


@pytest.fixture
def save(tmp_path: Path) -> Save:
    def _save(model: Any) -> Path:
        file = tmp_path / "model.onnx"
        file.write_bytes(model if isinstance(model, bytes) else model.SerializeToString())
        return file

    return _save


def assert_refused(file: Path, reason: str) -> None:
    with pytest.raises(ModelError, match=reason) as caught:
        Network.load(file)
    assert str(caught.value).startswith(str(file))
    assert "\n" not in str(caught.value)


def test_small_model_runs(model: Any, save: Save) -> None:
    network = Network.load(save(model))
    image = np.arange(12, dtype=np.uint8).reshape(1, 2, 2, 3)
    np.testing.assert_array_equal(network.describe(image), np.full((1, 4), 66, np.float32))


def test_missing_file(tmp_path: Path) -> None:
    assert_refused(tmp_path / "none.onnx", "cannot read the network: No such file")


def test_folder_without_a_network(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=rf"{FC6_FILE}: cannot read the network: No such file"):
        Network.load(tmp_path)


def test_too_large_file_is_not_read(tmp_path: Path) -> None:
    file = tmp_path / "model.onnx"
    with file.open("wb") as stream:
        stream.truncate(MAX_FILE_BYTES + 1)  # sparse: takes no room on the disk
    assert_refused(file, "bytes; an fc6 network has at most")


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_truncated_shipped_network(share: float, save: Save) -> None:
    data = (SHIPPED_MODEL / FC6_FILE).read_bytes()
    assert_refused(save(data[: int(len(data) * share)]), "not a whole ONNX file|no 'lookback' in its metadata")


@pytest.mark.parametrize("data", [b"\x00" * 64, b"hello, I am a text file\n" * 9, b"\xff" * 99, b"\x89PNG\r\n\x1a\n"])
def test_other_files(data: bytes, save: Save) -> None:
    assert_refused(save(data), "not a whole ONNX file")


def test_every_cut_of_a_small_model_is_refused(model: Any, save: Save) -> None:
    data = model.SerializeToString()
    for length in range(len(data)):
        assert_refused(save(data[:length]), "model.onnx")


def test_damaged_bytes_load_or_are_refused(model: Any, save: Save) -> None:
    data, random = model.SerializeToString(), np.random.default_rng(11)
    refused = 0
    for _ in range(300):
        damaged = bytearray(data)
        damaged[random.integers(len(data))] = random.integers(256)
        file = save(bytes(damaged))
        try:
            Network.load(file)
        except ModelError as error:
            assert str(error).startswith(str(file))
            assert "\n" not in str(error)
            refused += 1
    assert refused > 100  # the others are in names, texts and numbers, where any byte is as good


def test_claimed_weights_are_not_allocated(model: Any, save: Save) -> None:
    model.graph.initializer[0].dims[:] = [2**19, 2**19]
    assert_refused(save(model), "speaks of 274877906944 weights and holds")


def test_operators_that_make_tensors_of_nothing_are_refused(model: Any, save: Save) -> None:
    shape = onnx.numpy_helper.from_array(np.array([2**19, 2**19]), "shape")
    model.graph.initializer.append(shape)
    model.graph.node.insert(0, onnx.helper.make_node("ConstantOfShape", ["shape"], ["huge"]))
    assert_refused(save(model), "has the operator 'ConstantOfShape'")


def test_huge_padding_is_refused(model: Any, save: Save) -> None:
    model.graph.node.append(onnx.helper.make_node("MaxPool", ["fc6"], ["more"], kernel_shape=[1], pads=[2**30, 0]))
    assert_refused(save(model), "has an operator with a number over 4096")


def test_weights_in_another_file_are_refused(model: Any, save: Save) -> None:
    tensor = model.graph.initializer[0]
    tensor.data_location = onnx.TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="../../etc/passwd")
    assert_refused(save(model), "keeps weights in another file")


def test_foreign_domain_is_refused(model: Any, save: Save) -> None:
    model.graph.node[0].domain = "com.example"
    assert_refused(save(model), "has an operator of the domain 'com.example'")


def test_tensor_inside_an_operator_is_refused(model: Any, save: Save) -> None:
    value = onnx.numpy_helper.from_array(np.zeros(1, np.float32))
    model.graph.node[0].attribute.append(onnx.helper.make_attribute("value", value))
    assert_refused(save(model), "has a tensor or a graph inside an operator")


def test_foreign_network_without_metadata(model: Any, save: Save) -> None:
    del model.metadata_props[:]
    assert_refused(save(model), "no 'lookback' in its metadata; make it with `lookback model import`")


def test_metadata_of_a_wrong_type(model: Any, save: Save) -> None:
    model.metadata_props[0].value = model.metadata_props[0].value.replace('"dimensions":4', '"dimensions":"4"')
    assert_refused(save(model), r"metadata 'lookback': Expected `int`, got `str` - at `\$.dimensions`")


def test_shape_that_is_not_what_the_metadata_says(info: ModelInfo, save: Save) -> None:
    model = small_model(info, dimensions=5)
    model.metadata_props[0].value = model.metadata_props[0].value.replace('"dimensions":5', '"dimensions":4096')
    assert_refused(save(model), "has inputs and outputs .*5.*, its metadata needs .*4096")


def test_tap_that_is_not_what_the_metadata_says(model: Any, save: Save) -> None:
    model.metadata_props[0].value = model.metadata_props[0].value.replace('"fc6"', '"conv3"')
    assert_refused(save(model), "its metadata needs .*conv3")


def test_graph_that_does_not_fit_together(model: Any, save: Save) -> None:
    model.graph.node[0].input[0] = "nothing"
    assert_refused(save(model), "ONNX Runtime refuses it: ")


def test_sha256_is_of_the_file(model: Any, save: Save) -> None:
    file = save(model)
    assert read_model_file(file).info.sha256 == hashlib.sha256(file.read_bytes()).hexdigest()
