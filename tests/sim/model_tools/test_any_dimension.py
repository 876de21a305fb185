"""From an ONNX file of the least or the greatest dimension to a map, a replay, and a run with a page."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge.__main__ import main
from edge.errors import LookbackError
from tests.onnx_text import onnx_of

pytestmark = pytest.mark.long

pytest.importorskip("onnx", reason="importing models needs the extra `model`")
pytest.importorskip("starlette")

FRAMES, LENGTH, PERIOD_MS = 50, 10, 150
SHAPES = {64: (64, 4, 1), 32_768: (32, 2, 32)}
"""Of each dimension: channels, stride, and the side of the grid that they are averaged over."""


@pytest.fixture(params=SHAPES, ids=str)
def model(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """One convolution with random weights, of 64 x 64 pixels."""
    channels, stride, side = SHAPES[request.param]
    pads = [1, 1, 1, 1] if stride == 2 else [0, 0, 0, 0]
    average = "GlobalAveragePool" if side == 1 else "Identity"
    text = (
        f"random (float[B, 3, 64, 64] x) => (float[B, {request.param}] out)"
        f" {{ map = Conv<strides = [{stride}, {stride}], pads = {pads}>(x, kernel)  positive = Relu(map)"
        f" some = {average}(positive)  out = Flatten<axis = 1>(some) }}"
    )
    kernel = np.random.default_rng(0).normal(size=(channels, 3, 4, 4)).astype(np.float32)
    given, made = tmp_path / "given.onnx", tmp_path / "model.onnx"
    given.write_bytes(onnx_of(text, kernel=kernel).SerializeToString())
    assert main(["model", "import", str(given), "-o", str(made), "--float-only", "--license", "CC0, as a test"]) == 0
    return made


def test_everything_works_with_its_descriptors(
    model: Path,
    write_traverse: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    write_traverse(tmp_path / "first", range(FRAMES))
    write_traverse(tmp_path / "second", range(FRAMES), noise=6.0, period_ms=PERIOD_MS)
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_server(("127.0.0.1", 0)) as other:
        port, mavlink = server.getsockname()[1], other.getsockname()[1]
    Path("any.toml").write_text(
        f'[descriptor]\nmodel = "{model}"\n[map]\npath = "map"\n[camera]\nkind = "feed"\ndevice = "second"\n'
        f'[sampling]\nby = "frames"\n'
        f"[sequence]\nlength = {LENGTH}\n[page]\nport = {port}\n"
        f'[telemetry]\nconnection = "udpin:127.0.0.1:{mavlink}"\njournal = "journal.jsonl"\njournal_frames = true\n',
        encoding="utf-8",
    )
    assert main(["map", "build", "first", "-o", "map", "--config", "any.toml"]) == 0
    assert main(["map", "verify", "map"]) == 0
    assert main(["map", "info", "map"]) == 0
    assert main(["replay", "second", "--map", "map", "--config", "any.toml", "--all", "-o", "replay.jsonl"]) == 0
    answers = [json.loads(line) for line in Path("replay.jsonl").read_text().splitlines()]
    places = np.array([answer["place"] for answer in answers if answer["place"] is not None])
    assert len(places) == FRAMES - LENGTH + 1
    assert np.abs(places - np.arange(LENGTH - 1, FRAMES)).max() <= 1

    status, metrics = watched_run(port)
    assert status["newest"]["place"] is not None
    assert status["model"] == "given"
    assert "lookback_frames_used_total" in metrics
    journal = [json.loads(line) for line in Path("journal.jsonl").read_text().splitlines()]
    frames = [line for line in journal if line["event"] == "frame" and line["place"] is not None]
    # Poses on a flat strip, whose distance from the camera is not known, are a few places off now and then, and so are
    # sequences that lack frames which a busy computer dropped.
    assert frames and np.median([abs(line["frame"] - line["place"]) for line in frames]) <= 2


def watched_run(port: int) -> tuple[dict[str, Any], str]:
    """What the page and the metrics show while `lookback run` is on the map; it ends with its recording."""
    process = subprocess.Popen([sys.executable, "-m", "edge", "run", "any.toml"], stderr=subprocess.PIPE, text=True)
    shown: tuple[dict[str, object], str] | None = None
    while process.poll() is None:
        time.sleep(0.2)
        try:
            status = json.loads(_get(port, "/status.json"))
            if status["newest"] and status["newest"].get("place") is not None:
                shown = status, _get(port, "/metrics")
        except OSError:
            continue  # not up yet, or gone
    said = process.communicate()[1]
    if process.returncode != 0 or shown is None:
        raise LookbackError(f"lookback run ended with {process.returncode}: {said[-500:]}")
    return shown


def _get(port: int, path: str) -> str:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=60) as answer:
        return str(answer.read().decode())
