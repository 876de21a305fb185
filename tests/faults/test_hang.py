"""A part that hangs: the watchdog is not fed any more, by nobody. A part that is lost and tried again: it is."""

from __future__ import annotations

import os
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from edge.camera.feed import read_feed
from edge.camera.newest import GRACE_S
from edge.camera.recorded import RecordedCamera

UNIT = Path(__file__).parents[2] / "systemd/lookback.service"
SILENCE_S = 1.0
"""Fed ten times a second, so this much silence is no accident; systemd waits for WatchdogSec."""


def silent_since(process: Any, patience_s: float) -> float:
    """When the last WATCHDOG=1 came, once none has come for a while."""
    give_up_s = time.monotonic() + patience_s
    fed_s = time.monotonic()
    while time.monotonic() < fed_s + SILENCE_S:
        word = process.word(0.2)
        assert process.popen.poll() is None, process.told()
        if word == "WATCHDOG=1":
            fed_s = time.monotonic()
            assert fed_s < give_up_s, "still fed"
    return fed_s


def still_silent(process: Any, seconds: float) -> bool:
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        if process.word(0.2) == "WATCHDOG=1":
            return False
    return True


@pytest.fixture
def blocked_picture(street: Path, tmp_path: Path) -> Path:
    """A feed of whose 20th picture nothing ever comes: a pipe that nobody writes to."""
    feed = tmp_path / "blocked"
    shutil.copytree(street / "feed", feed)
    (feed / "frames/000020.jpg").unlink()
    os.mkfifo(feed / "frames/000020.jpg")
    return feed


def test_a_camera_that_hangs_in_its_driver(
    blocked_picture: Path, write_config: Callable[..., Path], start: Callable[..., Any], figures: Callable[[str], None]
) -> None:
    config = write_config(camera={"device": str(blocked_picture)})
    process = start(config)
    process.wait_for_word("WATCHDOG=1")
    began_s = time.monotonic()
    fed_s = silent_since(process, 20.0)
    allowed_s = RecordedCamera(read_feed(blocked_picture)).read_timeout_s + GRACE_S
    assert "the camera hangs (reading)" in process.told()
    assert "degraded: blind, camera: it hangs (reading)" in process.told()
    assert still_silent(process, 0.5)
    figures(f"fed for {fed_s - began_s:.1f} s, of which a read may take {allowed_s:.1f} s and 20 pictures 0.8 s")
    process.popen.send_signal(signal.SIGTERM)
    assert process.popen.wait(3.0) == 0


def test_a_disk_that_hangs_stops_the_telemetry(
    write_config: Callable[..., Path], start: Callable[..., Any], tmp_path: Path, figures: Callable[[str], None]
) -> None:
    """The journal on a pipe that nobody empties, as on a network disk that went away: a write never comes back."""
    os.mkfifo(tmp_path / "events.jsonl")
    reader = os.open(tmp_path / "events.jsonl", os.O_RDONLY | os.O_NONBLOCK)
    feeder = os.open(tmp_path / "events.jsonl", os.O_WRONLY)
    os.set_blocking(feeder, False)
    process = start(write_config())
    process.wait_for_word("WATCHDOG=1")
    began_s = time.monotonic()
    try:
        while True:
            os.write(feeder, bytes(4096))  # until the pipe is full
    except BlockingIOError:
        filled_s = time.monotonic() - began_s
    fed_s = silent_since(process, 20.0)
    assert still_silent(process, 0.5)
    figures(f"full after {filled_s:.2f} s, last fed after {fed_s - began_s:.2f} s")
    os.close(reader)
    os.close(feeder)


def test_a_process_that_is_stopped(write_config: Callable[..., Path], start: Callable[..., Any]) -> None:
    process = start(write_config())
    process.wait_for_word("WATCHDOG=1")
    process.popen.send_signal(signal.SIGSTOP)
    silent_since(process, 10.0)
    assert still_silent(process, 0.5)
    process.popen.send_signal(signal.SIGCONT)
    process.wait_for_word("WATCHDOG=1")


def test_a_camera_that_is_not_there_is_no_hang(
    write_config: Callable[..., Path], start: Callable[..., Any], tmp_path: Path
) -> None:
    process = start(write_config(camera={"kind": "v4l2", "device": str(tmp_path / "no-camera")}))
    process.wait_for_word("STATUS=degraded: blind, camera: ")
    process.wait_for_word("READY=1")
    for _ in range(10):
        process.wait_for_word("WATCHDOG=1", 2.0)


def test_ready_waits_for_the_port_and_asks_for_time_meanwhile(
    write_config: Callable[..., Path], start: Callable[..., Any], tmp_path: Path
) -> None:
    from sim.pty_link import open_pty

    port = tmp_path / "autopilot"
    process = start(write_config(telemetry={"connection": f"serial:{port}:921600"}))
    assert process.wait_for_word("EXTEND_TIMEOUT_USEC=") == "EXTEND_TIMEOUT_USEC=40000000"
    process.wait_for_word(f"STATUS=degraded: link: {port}: no such port")
    cable = open_pty()
    port.symlink_to(cable.device)
    process.wait_for_word("READY=1", 3.0)
    process.wait_for_word("WATCHDOG=1", 1.0)
    cable.close()


def test_the_unit_waits_for_longer_than_a_lost_camera_takes() -> None:
    (watchdog_s,) = (
        float(line.partition("=")[2]) for line in UNIT.read_text().splitlines() if line.startswith("WatchdogSec=")
    )
    assert watchdog_s > SILENCE_S


def test_a_service_manager_that_does_not_read_holds_nobody_up(
    write_config: Callable[..., Path], start: Callable[..., Any], tmp_path: Path, figures: Callable[[str], None]
) -> None:
    """Its socket takes some words and then no more; the feed must be played to its end all the same."""
    process = start(write_config(), manager_reads=False)
    assert process.popen.wait(30) == 0, process.told()
    words = 0
    while process.word(0.0) is not None:
        words += 1
    figures(f"it ended, with {words} words unread")
    assert words > 0
