"""`lookback dev paper networks` on miniature feeds: the shipped network beside a small one."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from edge.__main__ import main
from sim.model_tools.onnx_graph import GraphBuilder

PLAN = """
title = "Miniature"
methods = ["NSD-CR"]
sampling = { by = "frames" }
[traverses]
there = { feed = "there" }
here = { feed = "here" }
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A network of one convolution with random weights, 16 x 16 pixels to 64 averages."""
    pytest.importorskip("onnx", reason="importing models needs the extra `model`")
    graph, random = GraphBuilder(), np.random.default_rng(0)
    kernel = graph.constant("kernel", random.normal(size=(64, 3, 4, 4)).astype(np.float32))
    graph.add("Conv", ["x", kernel], kernel_shape=[4, 4], strides=[4, 4])
    graph.add("Relu", [graph.last])
    graph.add("GlobalAveragePool", [graph.last])
    graph.add("Flatten", [graph.last], output="out", axis=1)
    given, made = tmp_path / "given.onnx", tmp_path / "small.onnx"
    given.write_bytes(graph.model("small", [("x", np.float32, [3, 16, 16])], 64).SerializeToString())
    options = ["--float-only", "--license", "CC0, as a test"]
    assert main(["model", "import", str(given), "-o", str(made), *options]) == 0
    return made


def test_networks_side_by_side(
    write_plan: Callable[[str], Path], small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["dev", "paper", "networks", str(write_plan(PLAN)), "--model", f"small={small}", "-o", str(out)]) == 0
    with (out / "networks.csv").open(encoding="utf-8") as stream:
        rows = {row["network"]: row for row in csv.DictReader(stream)}
    assert list(rows) == ["shipped", "small"]
    assert (rows["small"]["dimensions"], rows["small"]["license"]) == ("64", "CC0")
    assert int(rows["shipped"]["map, bytes a place"]) - int(rows["small"]["map, bytes a place"]) == 2 * (4096 - 64)
    for row in rows.values():
        assert 0.0 <= float(row["accuracy"]) <= 1.0
        assert float(row["time, ms"]) > 0.0
        assert float(row["memory, MB"]) > 0.0
    assert float(rows["shipped"]["memory, MB"]) > 30.0  # its weights alone have 40 MB
    said = capsys.readouterr().out.splitlines()
    assert said[-1] == str(out / "report.html")
    assert any(line.startswith("| small | ") for line in said)


@pytest.mark.parametrize(
    ("model", "reason"),
    [
        ("small.onnx", "--model: 'small.onnx' is not NAME=PATH"),
        ("a@b=x", "--model: 'a@b=x' is not NAME=PATH"),
        ("other=none.onnx", "[networks.other]: has no fc6"),
    ],
)
def test_a_model_that_cannot_be_used(
    model: str,
    reason: str,
    write_plan: Callable[[str], Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert (
        main(["dev", "paper", "networks", str(write_plan(PLAN)), "--model", model, "-o", str(tmp_path / "out")]) == 78
    )
    assert reason in capsys.readouterr().err
