"""`lookback model`: info, use, and what import refuses, as a user calls them."""

from __future__ import annotations

from pathlib import Path

import pytest

from edge.commands.parser import build_parser
from edge.config import load_config
from edge.descriptor.open_network import open_network
from edge.errors import ConfigError


def lookback_model(*argv: object) -> int:
    words = ["model", *map(str, argv)]
    args = build_parser(words).parse_args(words)
    return int(args.run(args))


def test_info_of_the_networks_that_have_a_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert lookback_model("info") == 0
    assert "name            grid" in capsys.readouterr().out.splitlines()
    assert lookback_model("info", "fc6") == 0
    assert "name            alexnet_places100" in capsys.readouterr().out.splitlines()


def test_weights_alone_are_no_network(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"weights\.npz: not an \.onnx file; `torch.onnx.export` makes one"):
        lookback_model("import", tmp_path / "weights.npz", "-o", tmp_path / "model", "--float-only")


def test_a_config_is_switched_to_the_network_that_a_company_may_ship(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "lookback.toml"
    config.write_text("[map]\npath = 'maps'  # of the harbor\n")
    assert lookback_model("use", "grid", config) == 0
    said = capsys.readouterr().out
    assert "build each again" in said and "its license: Apache-2.0" in said
    assert load_config(config).descriptor.model == "grid"
    assert "# of the harbor" in config.read_text()
    assert open_network(load_config(config).descriptor).info.license == "Apache-2.0"
    assert lookback_model("use", "fc6", config) == 0
    assert "non-commercial" in capsys.readouterr().out
    assert open_network(load_config(config).descriptor).info.name == "alexnet_places100"
