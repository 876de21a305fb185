"""`lookback dev train` from folders of pictures to an int8 network that describes; and what it refuses."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge.__main__ import main
from edge.descriptor.network import Network
from edge.extras import install_command

SMALL = ["--epochs", "2", "--batch", "6", "--size", "48", "--rate", "0.02", "--hold-out", "0.2", "--device", "cpu"]


def test_pictures_become_an_int8_network(write_classes: Any, tmp_path: Path, capsys: Any) -> None:
    pytest.importorskip("torch", reason="training needs the extra `torch`")
    pytest.importorskip("onnx", reason="importing models needs the extra `model`")
    weights = tmp_path / "small.npz"
    assert main(["dev", "train", str(write_classes(3)), "-o", str(weights), *SMALL]) == 0
    assert "epoch 2 of 2: loss" in (said := capsys.readouterr().out) and "2 held-out pictures: top-1" in said
    assert sorted(path.name for path in tmp_path.glob("small*")) == ["small.npz", "small.ranges.json"]
    beside = ["--ranges", str(tmp_path / "small.ranges.json")]
    assert main(["dev", "alexnet", str(weights), "-o", str(tmp_path / "model"), *beside]) == 0
    network = Network.load(tmp_path / "model")
    images = np.random.default_rng(1).integers(0, 255, (2, 224, 224, 3), dtype=np.uint8)
    fc6 = network.describe(images)
    assert fc6.shape == (2, 4096) and 500 < np.count_nonzero(fc6[0]) < 4096 and not np.array_equal(fc6[0], fc6[1])


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["--epochs", "0"], "--epochs: expected `int` >= 1"),
        (["--batch", "1"], "--batch: expected `int` >= 2"),
        (["--rate", "nan"], "--rate: expected `float` > 0.0"),
        (["--hold-out", "0.9"], "--hold-out: 0.9 is not above 0 and up to 0.5"),
        (["--size", "8"], "--size: 8 is not 32 or more"),
    ],
)
def test_options_out_of_range(options: list[str], line: str, tmp_path: Path, capsys: Any) -> None:
    assert main(["dev", "train", str(tmp_path), "-o", str(tmp_path / "w.npz"), *options]) == 78
    assert capsys.readouterr().err == f"lookback: {line}\n"


def test_without_pytorch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)  # as Python itself marks a module that cannot be imported
    assert main(["dev", "train", str(tmp_path), "-o", str(tmp_path / "w.npz")]) == 78
    assert capsys.readouterr().err == f"lookback: training needs PyTorch: {install_command('sim,model,torch')}\n"


@pytest.mark.parametrize(
    ("output", "line"), [("w.pth", "the weights' file must end in .npz"), ("no/w.npz", "no such folder to write")]
)
def test_an_output_that_cannot_be_written(
    output: str, line: str, write_classes: Any, tmp_path: Path, capsys: Any
) -> None:
    pytest.importorskip("torch", reason="training needs the extra `torch`")
    assert main(["dev", "train", str(write_classes(1)), "-o", str(tmp_path / output), *SMALL]) == 78
    assert line in capsys.readouterr().err


def test_fewer_pictures_than_a_batch(write_classes: Any, tmp_path: Path, capsys: Any) -> None:
    pytest.importorskip("torch", reason="training needs the extra `torch`")
    assert main(["dev", "train", str(write_classes(2)), "-o", str(tmp_path / "w.npz"), *SMALL, "--batch", "64"]) == 78
    assert "--batch: 64 pictures a step, but there are 4 in all" in capsys.readouterr().err
