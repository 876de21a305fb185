"""Files that are no network, or claim to be more than they are: one line each, and nothing allocated."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from edge.descriptor.model_file import (
    FC6_FILE,
    FC6_NAME,
    MAX_FILE_BYTES,
    ModelInfo,
    fc6_folder,
    network_of_map,
    read_model_file,
    resolve_model,
)
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


def test_without_its_package_fc6_is_refused_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("edge.descriptor.model_file.FC6_PACKAGE", "lookback_fc6_that_is_not_there")
    with pytest.raises(ModelError, match=r'non-commercial use, .*pip install .*fc6.*; or set .*model = "grid"'):
        resolve_model(None)
    assert read_model_file(resolve_model(Path("grid"))).info.license == "Apache-2.0"


@pytest.mark.parametrize(("name", "model"), [("grid", "grid"), (FC6_NAME, "fc6")])
def test_the_name_in_a_map_says_which_network_made_it(name: str, model: str) -> None:
    assert read_model_file(resolve_model(Path(model))).info.name == name
    assert (network_of_map(name), network_of_map("of_a_friend")) == (model, "")


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
    assert_refused(file, "bytes; a network has at most")


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_truncated_shipped_network(share: float, save: Save) -> None:
    data = (fc6_folder() / FC6_FILE).read_bytes()
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
    assert_refused(save(model), "claims 274877906944 weights and holds")


def test_operators_that_make_tensors_of_nothing_are_refused(model: Any, save: Save) -> None:
    shape = onnx.numpy_helper.from_array(np.array([2**19, 2**19]), "shape")
    model.graph.initializer.append(shape)
    model.graph.node.insert(0, onnx.helper.make_node("ConstantOfShape", ["shape"], ["huge"]))
    assert_refused(save(model), "has the operator 'ConstantOfShape'")


def test_operators_on_constants_alone_are_refused(model: Any, save: Save) -> None:
    """The product of a column and a row: 128 KB of weights would become 1 GiB while ONNX Runtime loads them."""
    for name, shape in (("column", (2**14, 1)), ("row", (1, 2**14))):
        model.graph.initializer.append(onnx.numpy_helper.from_array(np.ones(shape, np.float32), name))
    model.graph.node.append(onnx.helper.make_node("Gemm", ["column", "row"], ["product"]))
    assert_refused(save(model), "has the operator 'Gemm' on constants alone")


def test_sparse_weights_are_refused(model: Any, save: Save) -> None:
    model.graph.sparse_initializer.append(sparse_weights(2**19))
    assert_refused(save(model), "has sparse weights")


def sparse_weights(side: int) -> Any:
    """One number that is not zero, in a square of side x side."""
    one, where = np.ones(1, np.float32), np.zeros(1, np.int64)
    tensors = onnx.numpy_helper.from_array(one, "huge"), onnx.numpy_helper.from_array(where, "where")
    return onnx.SparseTensorProto(values=tensors[0], indices=tensors[1], dims=[side, side])


OPEN_AND_MEASURE = """
import re, sys
from edge.descriptor.network import onnxruntime
def peak_mb(): return int(re.search("VmHWM:.* ([0-9]+) kB", open("/proc/self/status").read())[1]) / 1024
options = onnxruntime.SessionOptions()
options.graph_optimization_level = getattr(onnxruntime.GraphOptimizationLevel, sys.argv[2])
before_mb = peak_mb()
onnxruntime.InferenceSession(open(sys.argv[1], "rb").read(), options, providers=["CPUExecutionProvider"])
print(peak_mb() - before_mb)
"""


@pytest.mark.parametrize(("attack", "level"), [("operator", "ORT_ENABLE_ALL"), ("sparse", "ORT_DISABLE_ALL")])
def test_onnx_runtime_itself_fills_the_memory_for_a_small_file(attack: str, level: str, save: Save) -> None:
    """Why the file is parsed here at all: once this test fails, ONNX Runtime has a guard of its own."""
    helper, size = onnx.helper, 2**13  # size x size floats are 256 MB
    inputs = [helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, ["B"])]
    outputs = [helper.make_tensor_value_info("y", onnx.TensorProto.FLOAT, ["B"])]
    nodes = [helper.make_node("ReduceSum", ["huge"], ["sum"], keepdims=0), helper.make_node("Add", ["x", "sum"], ["y"])]
    graph = helper.make_graph(nodes, "small", inputs, outputs)
    if attack == "sparse":
        graph.sparse_initializer.append(sparse_weights(size))
    else:
        graph.initializer.append(onnx.numpy_helper.from_array(np.array([size, size]), "shape"))
        graph.node.insert(0, helper.make_node("ConstantOfShape", ["shape"], ["huge"]))
    file = save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9))
    assert file.stat().st_size < 200
    command = [sys.executable, "-c", OPEN_AND_MEASURE, str(file), level]
    grown_mb = float(subprocess.run(command, check=True, capture_output=True, text=True, timeout=60).stdout)
    assert grown_mb > 256
    assert_refused(file, "has sparse weights|has the operator 'ConstantOfShape'")


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
    assert_refused(save(model), "ONNX Runtime rejects it: ")


def test_sha256_is_of_the_file(model: Any, save: Save) -> None:
    file = save(model)
    assert read_model_file(file).info.sha256 == hashlib.sha256(file.read_bytes()).hexdigest()
