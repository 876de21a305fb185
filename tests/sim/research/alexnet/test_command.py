"""`lookback dev alexnet`, and `lookback model` on what it writes, as a user calls them."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from edge.commands.parser import build_parser
from edge.descriptor.network import Network
from edge.errors import FeedError, ModelError
from edge.feed import FeedHeader, FeedRow
from edge.feed.writer import FeedWriter

pytest.importorskip("onnx", reason="importing models needs the extra `model`")


def lookback(*argv: object) -> int:
    words = [str(word) for word in argv]
    args = build_parser(words).parse_args(words)
    return int(args.run(args))


@pytest.fixture
def weights(shared: Path) -> Path:
    return shared / "model" / "alexnet_places100_fp16.npz"


@pytest.fixture
def feed(tmp_path: Path) -> Path:
    """Twelve different pictures, 20 m apart."""
    random = np.random.default_rng(5)
    with FeedWriter(tmp_path / "feed", FeedHeader(name="noise", view="front", width=64, height=48)) as writer:
        for row in range(12):
            coarse = random.integers(0, 256, (6, 8, 3), dtype=np.uint8)
            image = np.asarray(cv2.resize(coarse, (64, 48), interpolation=cv2.INTER_CUBIC), np.uint8)
            writer.write(image, FeedRow("", row * 10**9, lat_deg=-27.0 + row * 180e-6, lon_deg=153.0))
    return tmp_path / "feed"


def test_import_calibrated_on_a_feed_then_info_and_verify(
    weights: Path, feed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "model"
    assert lookback("dev", "alexnet", weights, "-o", folder, "--calibrate", feed, "--license", "CC0", "--float") == 0
    assert sorted(file.name for file in folder.iterdir()) == ["fc6_float32.onnx", "fc6_int8.onnx"]
    network = Network.load(folder)
    assert network.info.calibration == "0.8 of the greatest values in feeds feed"
    assert Network.load(folder / "fc6_float32.onnx").info.precision == "float32"

    capsys.readouterr()
    assert lookback("model", "info", folder) == 0
    said = capsys.readouterr().out.splitlines()
    assert f"sha256          {network.info.sha256}" in said
    assert "license         CC0" in said

    assert lookback("model", "verify", folder, feed, "--weights", folder / "fc6_float32.onnx") == 0
    said = capsys.readouterr().out.splitlines()
    assert said[-1] == "passed"


def test_import_at_conv3_with_wrong_ranges_fails_to_verify(
    weights: Path, feed: Path, shared: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, ranges = tmp_path / "model", tmp_path / "ranges.json"
    right = json.loads((shared / "model" / "activation_ranges.json").read_text())
    ranges.write_text(json.dumps(right | {"features.3": {"min": -1.0, "max": right["features.3"]["max"] / 20}}))
    file = folder / "conv3.onnx"
    assert lookback("dev", "alexnet", weights, "-o", file, "--ranges", ranges, "--tap", "conv3", "--float") == 0
    assert Network.load(file).describe(np.zeros((1, 224, 224, 3), np.uint8)).shape == (1, 384 * 13 * 13)
    assert sorted(path.name for path in folder.iterdir()) == ["conv3.onnx", "conv3_float32.onnx"]
    assert lookback("model", "verify", file, feed, "--weights", folder / "conv3_float32.onnx") == 1
    assert "FAILED: mean cosine after NSD below 0.995" in capsys.readouterr().out


def test_import_with_an_unreadable_picture(weights: Path, feed: Path, tmp_path: Path) -> None:
    (feed / "frames" / "000003.jpg").write_bytes(b"cut short")
    with pytest.raises(FeedError, match=r"000003\.jpg: not a complete JPEG or PNG image; remove that row"):
        lookback("dev", "alexnet", weights, "-o", tmp_path / "model", "--calibrate", feed)


def test_import_to_a_place_that_cannot_be_written(weights: Path, shared: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    ranges = shared / "model" / "activation_ranges.json"
    with pytest.raises(ModelError, match=r"fc6_int8\.onnx: cannot write it: "):
        lookback("dev", "alexnet", weights, "-o", tmp_path / "file", "--ranges", ranges)


def test_import_without_the_onnx_package(
    weights: Path, shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "onnx", None)  # as Python itself marks a module that cannot be imported
    ranges = shared / "model" / "activation_ranges.json"
    with pytest.raises(ModelError, match=r"needs the package onnx: .*\[model\]"):
        lookback("dev", "alexnet", weights, "-o", tmp_path / "model", "--ranges", ranges)
