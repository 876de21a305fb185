"""Only a network whose hash is known is given to ONNX Runtime; what is no network is one line."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from edge.__main__ import main
from edge.descriptor.model_file import (
    FC6_FILE,
    FC6_NAME,
    GRID,
    MAX_FILE_BYTES,
    SHIPPED,
    XFEAT,
    ModelInfo,
    hash_file,
    network_of_map,
    read_model_file,
    resolve_model,
)
from edge.descriptor.network import Network
from edge.errors import ModelError
from sim.model_tools.onnx_graph import set_info
from tests.onnx_text import onnx_of

onnx = pytest.importorskip("onnx", reason="needs the extra `model`")

Save = Callable[..., Path]


def small_model(info: ModelInfo, dimensions: int = 4) -> Any:
    """uint8 image (B, 2, 2, 3) to `dimensions` numbers."""
    model = onnx_of(
        f"small (uint8[B, 2, 2, 3] image) => (float[B, {dimensions}] fc6)"
        " { pixels = DequantizeLinear(image, step, zero)  flat = Flatten<axis = 1>(pixels)"
        " fc = Gemm(flat, weight)  fc6 = Relu(fc) }",
        step=np.array(1, np.float32),
        zero=np.array(0, np.uint8),
        weight=np.ones((12, dimensions), np.float32),
    )
    set_info(model, msgspec.structs.replace(info, input_size=2, dimensions=dimensions))
    return model


@pytest.fixture
def model(info: ModelInfo) -> Any:
    return small_model(info)


@pytest.fixture
def save(tmp_path: Path) -> Save:
    def _save(model: Any) -> Path:
        """The hash beside it is right, as if `lookback model import` had made it."""
        file = tmp_path / "model.onnx"
        file.write_bytes(model if isinstance(model, bytes) else model.SerializeToString())
        hash_file(file).write_text(f"{hashlib.sha256(file.read_bytes()).hexdigest()}  model.onnx\n")
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


def test_what_ships_is_known_by_its_hash() -> None:
    files = (GRID, XFEAT, resolve_model(None))
    assert {hashlib.sha256(file.read_bytes()).hexdigest() for file in files} == SHIPPED
    assert not any(hash_file(file).exists() for file in files)


@pytest.mark.parametrize(("name", "file"), [("grid", GRID), ("xfeat", XFEAT)])
def test_what_ships_says_what_it_is(name: str, file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["model", "info", name]) == 0
    said, card = capsys.readouterr().out, file.with_name("README.md").read_text(encoding="utf-8")
    assert "license         Apache-2.0" in said
    assert read_model_file(file).info.sha256[:16] in card


@pytest.mark.parametrize("hashed", ["", "0" * 64, "b\xe9", "of another file"])
def test_a_file_that_nothing_vouches_for_is_refused(hashed: str, model: Any, save: Save) -> None:
    """ONNX Runtime can fill the memory while it loads a file of 200 bytes, so it gets none that was not checked."""
    file = save(model)
    if hashed == "of another file":
        file.write_bytes(file.read_bytes() + b"\0")
    elif hashed:
        hash_file(file).write_bytes(hashed.encode("latin-1"))
    else:
        hash_file(file).unlink()
    assert_refused(
        file, r"model.onnx.sha256 beside it does not have its sha256, [0-9a-f]{12}\.\.\.; copy both files again"
    )


def test_a_shipped_network_that_is_damaged_is_refused(tmp_path: Path) -> None:
    file, data = tmp_path / "model.onnx", bytearray(GRID.read_bytes())
    file.write_bytes(data)
    assert Network.load(file).info.name == "grid"
    data[len(data) // 2] ^= 1
    for damaged in (data, data[:-1], b""):
        file.write_bytes(damaged)
        assert_refused(file, "not a network that comes with Lookback")


@pytest.mark.parametrize("data", [b"\x00" * 64, b"hello, I am a text file\n" * 9, b"\xff" * 99, b"\x89PNG\r\n\x1a\n"])
def test_other_files(data: bytes, save: Save) -> None:
    assert_refused(
        save(data), "(not a whole ONNX file|no .lookback. in its metadata); make it with `lookback model import`"
    )


def test_metadata_of_a_wrong_type(model: Any, save: Save) -> None:
    model.metadata_props[0].value = model.metadata_props[0].value.replace('"dimensions":4', '"dimensions":"4"')
    assert_refused(save(model), r"metadata 'lookback': Expected `int`, got `str` - at `\$.dimensions`")


def test_shape_that_is_not_what_the_metadata_says(info: ModelInfo, save: Save) -> None:
    model = small_model(info, dimensions=5)
    model.metadata_props[0].value = model.metadata_props[0].value.replace('"dimensions":5', '"dimensions":4096')
    assert_refused(save(model), "has inputs and outputs .*5.*, its metadata needs .*4096")


def test_graph_that_does_not_fit_together(model: Any, save: Save) -> None:
    model.graph.node[0].input[0] = "nothing"
    assert_refused(save(model), "ONNX Runtime rejects it: ")
