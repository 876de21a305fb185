"""Weights files: the published layout is read; every wrong one is refused in a line that names file and layer."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.errors import ModelError
from sim.research.alexnet.weights import CONVS, read_weights

Arrays = dict[str, NDArray[Any]]


@pytest.fixture
def arrays() -> Arrays:
    """All layers up to fc6, zero."""
    shapes: dict[str, tuple[int, ...]] = {conv.layer: conv.shape for conv in CONVS}
    arrays: Arrays = {}
    for layer, shape in (shapes | {"classifier.1": (4096, 9216)}).items():
        arrays[f"{layer}.weight"] = np.zeros(shape, np.float16)
        arrays[f"{layer}.bias"] = np.zeros(shape[0], np.float32)
    return arrays


def save(arrays: Arrays, folder: Path) -> Path:
    named: dict[str, Any] = {**arrays}
    np.savez_compressed(folder / "weights.npz", **named)
    return folder / "weights.npz"


def test_published_layout_is_read(published_weights: Path) -> None:
    weights, sha256 = read_weights(published_weights)
    assert weights["features.0.weight"].dtype == np.float32
    assert weights["classifier.6.weight"].shape == (365, 4096)
    assert len(sha256) == 64


def test_missing_layer(arrays: Arrays, tmp_path: Path) -> None:
    del arrays["features.8.bias"]
    with pytest.raises(ModelError, match=r"weights\.npz: no features\.8\.bias; these are not AlexNet's weights"):
        read_weights(save(arrays, tmp_path))


def test_wrong_shape(arrays: Arrays, tmp_path: Path) -> None:
    arrays["features.3.weight"] = np.zeros((192, 48, 5, 5), np.float16)  # the two-GPU AlexNet of 2012
    with pytest.raises(
        ModelError, match=r"features\.3\.weight has the shape \(192, 48, 5, 5\), AlexNet's is \(192, 64"
    ):
        read_weights(save(arrays, tmp_path))


def test_values_that_are_not_finite(arrays: Arrays, tmp_path: Path) -> None:
    arrays["features.6.bias"][3] = np.nan
    with pytest.raises(ModelError, match=r"features\.6\.bias has values that are not finite"):
        read_weights(save(arrays, tmp_path))


@pytest.mark.parametrize("share", [0.0, 0.3, 0.95])
def test_truncated_file(share: float, arrays: Arrays, tmp_path: Path) -> None:
    file = save(arrays, tmp_path)
    file.write_bytes(file.read_bytes()[: int(file.stat().st_size * share)])
    with pytest.raises(ModelError, match=r"weights\.npz: not a whole \.npz file"):
        read_weights(file)


def test_damaged_member(arrays: Arrays, tmp_path: Path) -> None:
    file = save(arrays, tmp_path)
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0xFF
    file.write_bytes(data)
    with pytest.raises(ModelError, match=r"weights\.npz: not a whole \.npz file"):
        read_weights(file)


def test_header_that_claims_gigabytes(tmp_path: Path) -> None:
    file = tmp_path / "claim.npz"
    header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (2147483648,), }"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("features.0.weight.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
    with pytest.raises(ModelError, match=r"claim\.npz"):
        read_weights(file)


def test_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"none\.npz: cannot read the weights: No such file"):
        read_weights(tmp_path / "none.npz")


def test_checkpoint_of_pytorch(arrays: Arrays, tmp_path: Path) -> None:
    torch = pytest.importorskip("torch", reason="needs the extra `torch`")
    file = tmp_path / "alexnet_places365.pth.tar"
    state = {name.replace("features.", "features.module."): torch.from_numpy(value) for name, value in arrays.items()}
    torch.save({"epoch": 90, "arch": "alexnet", "state_dict": state}, file)
    weights, _ = read_weights(file)
    assert weights["classifier.1.weight"].shape == (4096, 9216)


def test_checkpoint_that_would_run_code(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch", reason="needs the extra `torch`")
    file = tmp_path / "bad.pth"
    torch.save({"state_dict": Path("/")}, file)
    with pytest.raises(ModelError, match=r"bad\.pth: not a PyTorch checkpoint of weights"):
        read_weights(file)
