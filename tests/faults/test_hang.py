"""A part that hangs: the watchdog is not fed any more, by nobody. A part that is lost and tried again: it is."""

from __future__ import annotations

import contextlib
import ctypes
import os
import random
import re
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from edge.camera.newest import GRACE_S
from edge.camera.recorded import RecordedCamera
from edge.feed import read_feed
from tests.common import PATIENCE_S

UNIT = Path(__file__).parents[2] / "systemd/lookback.service"
(WATCHDOG_S,) = (float(word) for word in re.findall(r"^WatchdogSec=(\d+)$", UNIT.read_text(), re.MULTILINE))
SILENCE_S = 2.0
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


def silent(process: Any, seconds: float) -> None:
    """Nothing is said by a thread that has stopped, after what it had said before."""
    while process.word(0.0) is not None:
        pass
    assert process.word(seconds) is None


def not_fed(process: Any, fed_s: float, waits_s: float) -> None:
    """Nothing comes, for as long as systemd waits."""
    end_s = max(time.monotonic(), fed_s + SILENCE_S) + waits_s
    while time.monotonic() < end_s:
        assert process.word(0.2) != "WATCHDOG=1"


TO_THE_END = pytest.mark.parametrize("waits_s", [0.5, pytest.param(WATCHDOG_S, marks=pytest.mark.soak)])
"""In full until systemd would have missed it."""


@pytest.fixture
def hanging(compile_shim: Callable[[str], Path]) -> dict[str, str]:
    """The environment of a daemon to which nothing ever comes of the 20th picture of its feed."""
    return {"LD_PRELOAD": str(compile_shim("hanging_picture_shim"))}


@TO_THE_END
def test_a_camera_that_hangs_in_its_driver(
    waits_s: float,
    street: Path,
    hanging: dict[str, str],
    write_config: Callable[..., Path],
    start: Callable[..., Any],
    figures: Callable[[str], None],
) -> None:
    process = start(write_config(), environment=hanging)
    process.wait_for_word("WATCHDOG=1")
    began_s = time.monotonic()
    process.wait_for_word("STATUS=degraded: not recognized: camera: it hangs (reading)")
    fed_s = time.monotonic()
    allowed_s = RecordedCamera(read_feed(street / "feed")).read_timeout_s + GRACE_S
    assert "the camera hangs (reading)" in process.told()
    figures(f"fed for {fed_s - began_s:.1f} s, of which a read may take {allowed_s:.1f} s and 20 pictures 0.8 s")
    not_fed(process, fed_s, waits_s)
    assert process.end()[0] == 0, "it can be told to stop"


def test_a_disk_that_hangs_under_the_journal_stops_nothing(
    calm_feed: Path, write_config: Callable[..., Path], start: Callable[..., Any], tmp_path: Path
) -> None:
    """The journal on a pipe that nobody empties, as on a network disk that went away: a write never comes back."""
    os.mkfifo(tmp_path / "events.jsonl")
    reader = os.open(tmp_path / "events.jsonl", os.O_RDONLY | os.O_NONBLOCK)
    feeder = os.open(tmp_path / "events.jsonl", os.O_WRONLY)
    os.set_blocking(feeder, False)
    process = start(write_config(camera={"device": str(calm_feed)}, telemetry={"journal_frames": True}))
    process.wait_until_on_the_map()
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(feeder, bytes(4096))  # until the pipe is full
    for _ in range(5):
        process.wait_for_word("WATCHDOG=1")
    process.popen.send_signal(signal.SIGTERM)
    assert process.popen.wait(PATIENCE_S) == 0
    assert "the journal's disk hangs: " in process.told()
    os.close(reader)
    os.close(feeder)


@TO_THE_END
def test_a_disk_that_hangs_stops_the_signing(
    waits_s: float, write_config: Callable[..., Path], start: Callable[..., Any], tmp_path: Path
) -> None:
    """The signing clock is on the disk before a frame goes out; opening this file never comes back."""
    (tmp_path / "key").write_bytes(bytes(32))
    (tmp_path / "key").chmod(0o600)
    os.mkfifo(tmp_path / "clock.0.new")
    process = start(
        write_config(
            camera={"kind": "v4l2", "device": str(tmp_path / "no-camera")},
            telemetry={"signing_key": str(tmp_path / "key"), "signing_clock": str(tmp_path / "clock")},
        )
    )
    process.wait_for_word("WATCHDOG=1")
    not_fed(process, silent_since(process, PATIENCE_S), waits_s)
    process.popen.send_signal(signal.SIGABRT)  # as systemd ends it
    assert process.popen.wait(PATIENCE_S) == -signal.SIGABRT


class Tracer:
    """Stops one thread of a child wherever it is, as ptrace does; the others go on."""

    SEIZE, INTERRUPT, DETACH, ALL_THREADS = 0x4206, 0x4207, 17, 0x40000000

    def __init__(self, thread: int) -> None:
        self._thread = thread
        self._libc = ctypes.CDLL(None, use_errno=True)
        self._ask(self.SEIZE)

    def stop(self) -> str:
        """Stop it; the system call that it is in, "-1" for none."""
        self._ask(self.INTERRUPT)
        os.waitpid(self._thread, self.ALL_THREADS)
        return Path(f"/proc/{self._thread}/syscall").read_text().split()[0]

    def let_go(self) -> None:
        self._ask(self.DETACH)

    def _ask(self, what: int) -> None:
        if self._libc.ptrace(what, self._thread, None, None) != 0:
            pytest.skip(f"ptrace is not permitted here: {os.strerror(ctypes.get_errno())}")


@pytest.mark.parametrize("times", [3, pytest.param(60, marks=pytest.mark.soak)])
def test_the_loop_stands_still_wherever_it_is(
    times: int,
    write_config: Callable[..., Path],
    start: Callable[..., Any],
    calm_feed: Path,
    seed: int,
    figures: Callable[[str], None],
) -> None:
    """The whole process is stopped, and then its thread alone, in whichever stage: other threads go on."""
    rng, calls = random.Random(seed), list[str]()
    process = start(write_config(camera={"device": str(calm_feed)}))
    process.wait_until_on_the_map()
    process.popen.send_signal(signal.SIGSTOP)
    os.waitpid(process.popen.pid, os.WUNTRACED)
    silent(process, 0.5)
    process.popen.send_signal(signal.SIGCONT)
    for _ in range(times):
        process.wait_for_word("WATCHDOG=1")
        time.sleep(rng.uniform(0.0, 0.1))
        tracer = Tracer(process.popen.pid)
        calls.append(tracer.stop())
        silent(process, 0.5)
        tracer.let_go()
    process.wait_for_word("WATCHDOG=1")
    figures(f"{times} times, {calls.count('-1')} of them between two system calls: not fed until it went on")


def test_one_place_feeds_the_watchdog() -> None:
    """And only the loop has it do so."""
    edge = Path(__file__).parents[2] / "edge"
    texts = {file.name: file.read_text(encoding="utf-8") for file in edge.rglob("*.py")}
    assert [name for name, text in texts.items() if re.search(r"notify\(.*WATCHDOG", text)] == ["monitor.py"]
    assert [name for name, text in texts.items() if re.search(r"monitor\.feed_watchdog\(", text)] == ["daemon.py"]


def test_ready_without_a_camera_or_a_port_and_link_up_when_it_appears(
    write_config: Callable[..., Path], start: Callable[..., Any], tmp_path: Path
) -> None:
    from sim.vehicle.pty_link import open_pty

    port, camera = tmp_path / "autopilot", {"kind": "v4l2", "device": str(tmp_path / "no-camera")}
    process = start(write_config(camera=camera, telemetry={"connection": f"serial:{port}:921600"}))
    status = process.wait_for_word("STATUS=degraded: not recognized: camera: ")
    assert f"; link: {port}: no such port" in status
    process.wait_for_word("READY=1")
    for _ in range(10):
        process.wait_for_word("WATCHDOG=1")
    cable = open_pty()
    port.symlink_to(cable.device)
    while str(port) in process.wait_for_word("STATUS="):
        pass
    cable.close()


def test_the_unit_waits_for_longer_than_the_loop_may_take() -> None:
    assert WATCHDOG_S > 2 * SILENCE_S


def test_a_service_manager_that_does_not_read_holds_nobody_up(
    write_config: Callable[..., Path], start: Callable[..., Any], tmp_path: Path, figures: Callable[[str], None]
) -> None:
    """Its socket takes some words and then no more; the feed must be played to its end all the same."""
    process = start(write_config(), manager_reads=False)
    assert process.popen.wait(PATIENCE_S) == 0, process.told()
    words = 0
    while process.word(0.0) is not None:
        words += 1
    figures(f"it ended, with {words} words unread")
    assert words > 0
