"""The fault bench: faults at the real boundary, with seeds and figures.

Quick sizes run with all other tests, from the same seed every time; the full ones with `make soak`, from a new seed
each time. Each test reports what it measured at the end of the run, and a failing one how to repeat it:
LOOKBACK_SEED=... and its own name.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import socket
import subprocess
import sys
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from msgspec.structs import replace
from numpy.typing import NDArray

from edge.camera import CameraHealth, Frame
from edge.config import SamplingConfig, load_config
from edge.daemon import Daemon
from edge.descriptor.normalize import normalize
from edge.feed import FeedImages, FeedWriter, read_feed
from edge.reference_map.builder import MapBuilder, Place
from edge.reference_map.store import ModelKey, RegionsKey
from sim import Pose
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.pty_link import open_pty

FIGURE = "fault bench"
PERIOD_MS = 40
CALM_FRAMES = 1500
PATIENCE_S = 120.0


def pytest_terminal_summary(terminalreporter: Any) -> None:
    calls = [
        report
        for reports in terminalreporter.stats.values()
        for report in reports
        if isinstance(report, pytest.TestReport) and report.when == "call"
    ]
    measured = [(call, value) for call in calls for name, value in call.user_properties if name == FIGURE]
    if measured:
        terminalreporter.section(FIGURE)
    for call, value in measured:
        terminalreporter.write_line(f"{call.nodeid.rpartition('::')[2]}: {value}")


@pytest.fixture
def figures(record_property: Callable[[str, object], None]) -> Callable[[str], None]:
    """Reports what a test measured, at the end of the run, from whichever worker ran it."""
    return lambda line: record_property(FIGURE, line)


@pytest.fixture
def seed(request: pytest.FixtureRequest) -> int:
    """The test's own seed, the same in every run unless LOOKBACK_SEED names another."""
    value = int(os.environ.get("LOOKBACK_SEED") or zlib.crc32(request.node.name.encode()))
    print(f"again: LOOKBACK_SEED={value} python -m pytest -m '' '{request.node.nodeid}'")
    return value


class ProcessNumbers:
    """What /proc says of a process."""

    def resident_bytes(self, pid: int | str = "self") -> int:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

    def open_descriptors(self, pid: int | str = "self") -> int:
        return len(list(Path(f"/proc/{pid}/fd").iterdir()))


@pytest.fixture
def proc() -> ProcessNumbers:
    return ProcessNumbers()


@pytest.fixture(scope="session")
def make_map() -> Callable[..., Path]:
    """Writes a map of made-up descriptors; 12 places of 2 x 16 values unless told otherwise."""

    def make(path: Path, places: int = 12, dimensions: int = 16, seed: int = 0, *, replace: bool = False) -> Path:
        rng = np.random.default_rng(seed)
        model, regions = ModelKey("made-up", "0" * 64, "fc6", dimensions), RegionsKey("left-right", 0.4, "set")
        with MapBuilder(path, model, regions, SamplingConfig(), replace=replace) as builder:
            builder.begin_segment("drive", "rear")
            for row in range(places):
                raw = np.maximum(rng.normal(size=(2, dimensions)), 0).astype(np.float32)
                builder.add(raw, Place(row, -27.0 + row * 2e-5, 153.0, 10.0, 0.0, 2.0 * row, b"picture" * 9))
            builder.finish(normalize, "test")
        return path

    return make


@pytest.fixture(scope="session")
def street(make_street: Callable[..., Path]) -> Path:
    return make_street(period_ms=PERIOD_MS)


@pytest.fixture(scope="session")
def calm_feed(street: Path) -> Path:
    """The street over and over, five frames a second for five minutes: also a busy machine keeps up, and has time."""
    feed, path = read_feed(street / "feed"), street / "calm"
    pictures = FeedImages(feed)
    with FeedWriter(path, feed.header) as writer:
        for number in range(CALM_FRAMES):
            writer.write(pictures.read(number % len(feed.rows)), number * 200_000_000)
    return path


@pytest.fixture
def write_config(street: Path, tmp_path: Path) -> Callable[..., Path]:
    """Writes a configuration for the street's feed and map; sections are changed by keyword."""

    def write(folder: Path = tmp_path, **sections: dict[str, Any]) -> Path:
        settings: dict[str, dict[str, Any]] = {
            "camera": {"kind": "feed", "device": str(street / "feed")},
            "sampling": {"by": "frames"},
            "map": {"path": str(street / "map")},
            "sequence": {"length": 10},
            "acceptance": {"uniqueness_min": 1.02, "window_m": 10.0, "hold_off_s": 0.2},
            "telemetry": {"connection": "udp:127.0.0.1:9", "journal": "events.jsonl"},
            "page": {"port": 0},
        }
        for name, changes in sections.items():
            settings[name] = {**settings.get(name, {}), **changes}
        path = folder / "lookback.toml"
        path.write_text(tomli_w.dumps(settings))
        return path

    return write


class Process:
    """`lookback run` as its own process, with this test as its service manager."""

    def __init__(
        self, config: Path, folder: Path, environment: dict[str, str], wrapper: list[str], manager_reads: bool
    ) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(folder / "notify"))
        if not manager_reads:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender, contextlib.suppress(BlockingIOError):
                sender.connect(str(folder / "notify"))
                sender.setblocking(False)
                while True:
                    sender.send(b"STATUS=full")
        self._errors = (folder / "stderr").open("w+")
        self.popen = subprocess.Popen(
            [*wrapper, sys.executable, "-m", "edge", "run", str(config)],
            env={**os.environ, "NOTIFY_SOCKET": str(folder / "notify"), **environment},
            stderr=self._errors,
        )

    def word(self, timeout_s: float) -> str | None:
        """The next thing it tells systemd; None when it says nothing for that long."""
        self._socket.settimeout(timeout_s)
        try:
            return self._socket.recv(65536).decode()
        except (TimeoutError, BlockingIOError):
            return None

    def wait_for_word(self, beginning: str, timeout_s: float = PATIENCE_S) -> str:
        """Wait until it says something that begins like that."""
        deadline_s = time.monotonic() + timeout_s
        while time.monotonic() < deadline_s:
            word = self.word(0.2)
            if word is not None and word.startswith(beginning):
                return word
            assert self.popen.poll() is None, self.told()
        raise AssertionError(f"no {beginning!r} in {timeout_s} s: {self.told()}")

    def told(self) -> str:
        """What it has written to standard error so far."""
        return Path(self._errors.name).read_text()

    def end(self, by: signal.Signals = signal.SIGTERM) -> tuple[int, float]:
        """Send a signal; the exit code, and how many seconds it took, less those in which it waited for a processor."""
        gone, pid = os.pidfd_open(self.popen.pid), self.popen.pid
        waited_s, told_s = _waited_for_cpu_s(pid), time.monotonic()
        os.kill(pid, by)
        assert select.select([gone], [], [], PATIENCE_S)[0], self.told()
        took_s = time.monotonic() - told_s - (_waited_for_cpu_s(pid) - waited_s)
        os.close(gone)
        return self.popen.wait(), took_s

    def close(self) -> None:
        self.popen.kill()
        self.popen.wait()
        self._errors.close()
        self._socket.close()


def _waited_for_cpu_s(pid: int) -> float:
    """How long the first thread of a process, which may have ended, was ready and did not get to run."""
    return int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) / 1e9


@pytest.fixture
def start(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Process]]:
    """Starts daemons, and ends what a test has left running."""
    running: list[Process] = []

    def start_one(
        config: Path,
        *,
        environment: dict[str, str] | None = None,
        wrapper: list[str] | None = None,
        manager_reads: bool = True,
    ) -> Process:
        folder = tmp_path_factory.mktemp("run")
        running.append(Process(config, folder, environment or {}, wrapper or [], manager_reads))
        return running[-1]

    yield start_one
    for process in running:
        process.close()


class ScriptedFrames:
    """A camera whose time is the test's: what it shows and how it is are set from outside."""

    def __init__(self, clock_ns: Callable[[], int]) -> None:
        self._clock_ns = clock_ns
        self.health = CameraHealth("running", "", clock_ns())
        self.ended = False
        self.next: Frame | None = None

    def take(self, timeout_s: float) -> Frame | None:
        frame, self.next = self.next, None
        return frame

    def close(self) -> None:
        self.ended = True


class Bench:
    """A daemon in this process, with its autopilot, on a clock that the test moves: 5 frames a second."""

    def __init__(self, config: Path, parts: ExitStack, network: Any, speed_mps: float, frames: Any) -> None:
        self.now_ns = 10**12
        self.number = 0
        self.cable = open_pty()
        parts.callback(self.cable.close)
        self.moves = self.autopilot_speaks = True
        self._speed_mps = speed_mps
        settings = load_config(config)
        telemetry = replace(settings.telemetry, connection=f"serial:{self.cable.device}:921600")
        self.frames = frames(self.clock_ns)
        self.autopilot = SimulatedAutopilot(self.cable, self._pose, self.clock_ns, gps=False)
        self.daemon = Daemon(
            replace(settings, telemetry=telemetry), parts, self.clock_ns, frames=self.frames, network=network
        )

    def clock_ns(self) -> int:
        return self.now_ns

    def _pose(self, time_s: float) -> Pose:
        driven_m = self._speed_mps * (time_s - 1000.0)
        return Pose(0.0, driven_m, 0.0, self._speed_mps if self.moves else 0.0, driven_m)

    def step(self, image: NDArray[np.uint8] | None, index: int, turns: int = 2) -> None:
        """A fifth of a second with a picture at its beginning, or with none."""
        self.number = index
        for turn in range(turns):
            self.now_ns += 200_000_000 // turns
            if image is not None and turn == 0:
                self.frames.next = Frame(image, self.now_ns, index)
            if self.autopilot_speaks:
                self.autopilot.step()
            self.daemon.turn()


@pytest.fixture
def make_bench() -> Iterator[Callable[..., Bench]]:
    with ExitStack() as parts:
        yield lambda config, network=None, speed_mps=10.0, frames=ScriptedFrames: Bench(
            config, parts, network, speed_mps, frames
        )
