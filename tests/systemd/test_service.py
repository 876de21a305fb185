"""What the daemon says to systemd: the real program as its own process, with this test as the service manager."""

from __future__ import annotations

import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from edge.config import DescriptorConfig, SamplingConfig
from edge.errors import EXIT_SETUP
from edge.extras import install_command
from edge.feed import FeedHeader, FeedRow, read_feed
from edge.feed.writer import FeedWriter
from edge.journal.records import Stopped
from sim.journal import read_journal
from sim.maps.command import build_map
from tests.common import PATIENCE_S

UNIT = (Path(__file__).parents[2] / "systemd" / "lookback.service").read_text()
WATCHDOG_S, STOP_S = (
    float(re.findall(rf"^{key}=(\d+)$", UNIT, re.MULTILINE)[0]) for key in ("WatchdogSec", "TimeoutStopSec")
)
FRAMES, PERIOD_NS = 600, 50_000_000  # plays for half a minute, longer than any test here


class Manager:
    """systemd's side of sd_notify, for one process."""

    def __init__(self, folder: Path) -> None:
        self.address = str(folder / "notify")
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(self.address)
        self._process: subprocess.Popen[str] | None = None

    def start(self, config: Path) -> subprocess.Popen[str]:
        """As the unit does, with its environment."""
        lines = re.findall(r"^Environment=(.*)$", UNIT, re.MULTILINE)
        environment = dict(word.split("=", 1) for line in lines for word in shlex.split(line))
        self._process = subprocess.Popen(
            [sys.executable, "-m", "edge", "run", str(config)],
            env={**os.environ, **environment, "NOTIFY_SOCKET": self.address},
            stderr=subprocess.PIPE,
            text=True,
        )
        return self._process

    def words(self) -> Iterator[str]:
        """What the process says, as it says it; ends when it has said no more and is gone."""
        assert self._process is not None
        give_up_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < give_up_s:
            gone = self._process.poll() is not None
            self._socket.settimeout(0 if gone else 0.1)
            try:
                yield from self._socket.recv(65536).decode().splitlines()
            except TimeoutError:
                continue
            except BlockingIOError:
                return

    def close(self) -> None:
        self._socket.close()
        if self._process is not None:
            self._process.kill()
            with self._process:  # reaps it, and closes its pipe
                pass


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    manager = Manager(tmp_path)
    yield manager
    manager.close()


@pytest.fixture(scope="module")
def state(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a feed to play, and a map of its beginning."""
    folder = tmp_path_factory.mktemp("state")
    blocks = np.random.default_rng(0).integers(0, 256, (8, 4, 4, 3), dtype=np.uint8)
    pictures = blocks.repeat(24, axis=1).repeat(32, axis=2)
    for name, frames in (("feed", FRAMES), ("beginning", len(pictures))):
        with FeedWriter(folder / name, FeedHeader(name, "front", 128, 96)) as writer:
            for index in range(frames):
                writer.write(pictures[index % len(pictures)], FeedRow("", 1_000_000_000 + index * PERIOD_NS))
    build_map([read_feed(folder / "beginning")], folder / "map", DescriptorConfig(), SamplingConfig(by="frames"))
    return folder


@pytest.fixture
def config(state: Path, tmp_path: Path) -> Path:
    config = tmp_path / "lookback.toml"
    config.write_text(
        f'[camera]\nkind = "feed"\ndevice = "{state}/feed"\n'
        '[sampling]\nby = "frames"\n'
        f'[map]\npath = "{state}/map"\n'
        "[sequence]\nlength = 4\n"
        '[telemetry]\nconnection = "udp:127.0.0.1:9"\njournal = "events.jsonl"\n'
    )
    return config


def test_ready_then_watchdog_then_stopping(manager: Manager, config: Path) -> None:
    process = manager.start(config)
    words, heard, fed_s, told_to_stop_s = manager.words(), [], [time.monotonic()], None
    for word in words:
        if word == "READY=1":
            fed_s = [time.monotonic()]
        elif word == "WATCHDOG=1":
            fed_s.append(time.monotonic())
        heard.append(word)
        if told_to_stop_s is None and heard.count("WATCHDOG=1") >= 20:
            told_to_stop_s = time.monotonic()
            process.send_signal(signal.SIGTERM)
    assert told_to_stop_s is not None, process.communicate()[1]
    stopped_in_s = time.monotonic() - told_to_stop_s
    print(f"stopped in {stopped_in_s:.2f} s, longest time unfed {max(np.diff(fed_s)):.2f} s")
    assert process.returncode == 0
    assert [word for word in heard if word in {"READY=1", "STOPPING=1"}] == ["READY=1", "STOPPING=1"]
    assert heard.index("READY=1") < heard.index("WATCHDOG=1")
    assert "WATCHDOG=1" not in heard[heard.index("STOPPING=1") :]
    assert any(word.startswith("STATUS=") for word in heard)
    assert max(np.diff(fed_s)) < WATCHDOG_S / 2
    assert stopped_in_s < STOP_S
    assert isinstance(list(read_journal(config.with_name("events.jsonl")))[-1].record, Stopped)


WITHOUT = """
import sys
sys.modules.update(dict.fromkeys(sys.argv.pop(1).split(",")))  # None makes `import` say that there is no such module
from edge.__main__ import main
sys.exit(main())
"""


@pytest.mark.parametrize(
    ("command", "code", "says"),
    [
        (["config"], 0, "[camera]"),
        (
            ["demo", "-o", "folder"],
            EXIT_SETUP,
            f"lookback: demo: needs the package matplotlib: {install_command('sim')}",
        ),
    ],
)
def test_a_vehicle_needs_no_desk_packages(command: list[str], code: int, says: str) -> None:
    """Lookback as a vehicle has it, without its extras: what a desk needs must not keep the daemon from starting."""
    desk = "depthai,onnx,torch,panda3d,direct,jinja2,matplotlib,hypothesis,mavsdk,pytest"
    result = subprocess.run(
        [sys.executable, "-c", WITHOUT, desk, *command], capture_output=True, text=True, check=False
    )
    assert result.returncode == code, result.stderr
    assert says in (result.stdout or result.stderr).splitlines()
    assert "Traceback" not in result.stderr


def test_never_ready_with_a_bad_config(manager: Manager, config: Path) -> None:
    config.write_text(config.read_text().replace("length = 4", "length = 1"))
    process = manager.start(config)
    assert list(manager.words()) == []
    assert process.communicate()[1] == f"lookback: {config}: [sequence] length: expected a whole number >= 2\n"
    assert process.returncode == EXIT_SETUP


@pytest.mark.parametrize(
    ("what", "change"),
    [
        ("no-map", ("/map", "/no-map")),
        ("no-model", ("[map]", '[descriptor]\nmodel = "no-model.onnx"\n[map]')),
        ("no-owner", ("[sequence]", 'require_signature_by = "no-owner.pub"\n[sequence]')),
    ],
)
def test_never_ready_without_map_model_or_key(
    manager: Manager, config: Path, what: str, change: tuple[str, str]
) -> None:
    config.write_text(config.read_text().replace(*change))
    process = manager.start(config)
    starting, failed = manager.words()
    assert starting == "STATUS=starting: no picture has been used yet"
    assert failed.startswith("STATUS=failed: ")
    assert what in failed
    (line,) = process.communicate()[1].splitlines()
    assert what in line
    assert process.returncode == EXIT_SETUP
