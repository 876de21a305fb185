"""Told to stop at any moment: it ends, and all files are whole."""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from edge.files import PersistentFile
from edge.recognition.warm_start import WarmState
from sim.journal import read_journal

LATEST_S = 2.0
BURST_S = 0.2


@pytest.mark.parametrize("times", [3, pytest.param(200, marks=pytest.mark.soak)])
def test_sigterm_at_any_moment(
    times: int,
    write_config: Callable[..., Path],
    start: Callable[..., Any],
    tmp_path: Path,
    seed: int,
    figures: Callable[[str], None],
) -> None:
    rng = random.Random(seed)
    config = write_config(telemetry={"journal_frames": True})
    slowest_s, early = 0.0, 0
    for number in range(times):
        process = start(config)
        if number % 4:
            process.wait_for_word("STATUS=")  # from here on it knows of the signal
        time.sleep(rng.uniform(0.0, LATEST_S))
        code, took_s = process.end()
        slowest_s = max(slowest_s, took_s)
        early += code == -signal.SIGTERM  # before Python could know of any signal
        assert code in (0, -signal.SIGTERM), process.told()
        assert "Traceback" not in process.told()
        process.close()
        check_files(tmp_path)
    assert early <= -(-times // 4), "those that were not waited for"
    figures(f"{times} times, gone after {slowest_s:.2f} s at most, {early} before the program had begun")


@pytest.mark.parametrize("times", [3, pytest.param(50, marks=pytest.mark.soak)])
def test_a_burst_of_signals(
    times: int, write_config: Callable[..., Path], start: Callable[..., Any], tmp_path: Path, seed: int
) -> None:
    """`timeout` sends two at once, and a hand on Ctrl-C more: each may come while the one before is being handled."""
    rng = random.Random(seed)
    config = write_config(camera={"kind": "v4l2", "device": str(tmp_path / "no-camera")})
    for _ in range(times):
        process = start(config)
        process.wait_for_word("WATCHDOG=1")
        end_s = time.monotonic() + BURST_S
        while time.monotonic() < end_s:
            os.kill(process.popen.pid, rng.choice([signal.SIGTERM, signal.SIGINT]))
        code, _ = process.end()
        assert code == 0, process.told()
        process.close()


def test_a_signal_while_a_camera_that_says_nothing_is_opened(
    write_config: Callable[..., Path], start: Callable[..., Any]
) -> None:
    pytest.importorskip("av")
    process = start(write_config(camera={"kind": "stream", "device": "exec:sleep 60"}))
    process.wait_for_word("STATUS=")
    time.sleep(LATEST_S / 4)
    code, took_s = process.end()
    assert (code, "Traceback" in process.told()) == (0, False)
    assert "stopped" not in process.told(), "it had not begun, and does not wait for the camera"
    assert took_s < 5.0, "when systemd kills"


def test_a_disk_that_is_slow_at_the_end(
    calm_feed: Path,
    write_config: Callable[..., Path],
    start: Callable[..., Any],
    compile_shim: Callable[[str], Path],
    tmp_path: Path,
    figures: Callable[[str], None],
) -> None:
    """It took 16 s where a write took 2 s."""
    environment = {"LD_PRELOAD": str(compile_shim("slow_writes_shim")), "SLOW_US": str(2_000_000)}
    key = tmp_path / "mavlink.key"
    key.touch(0o600)
    key.write_text("00" * 32)
    telemetry = {"journal_frames": True, "signing_key": str(key), "connection": "udp:127.0.0.1:9"}
    config = write_config(
        camera={"device": str(calm_feed)}, telemetry=telemetry, recording={"folder": str(tmp_path / "recorded")}
    )
    process = start(config, environment=environment)
    process.wait_for_word("STATUS=")
    for _ in range(20):
        process.wait_for_word("WATCHDOG=1")
    code, took_s = process.end()
    assert (code, "Traceback" in process.told()) == (0, False), process.told()
    figures(f"a write of 2 s: gone after {took_s:.1f} s")
    assert took_s < 5.0, "when systemd kills"
    assert list(read_journal(tmp_path / "events.jsonl"))


def check_files(folder: Path) -> None:
    journal = folder / "events.jsonl"
    if journal.exists():
        lines = journal.read_bytes().splitlines()
        assert len(list(read_journal(journal))) == len(lines)
        assert not lines or journal.read_bytes().endswith(b"\n")
    state = folder / "events.state"
    if state.exists():
        assert PersistentFile(state, WarmState, "").read() is not None
    assert {path.name for path in folder.iterdir()} <= {"lookback.toml", "events.jsonl", "events.state"}
