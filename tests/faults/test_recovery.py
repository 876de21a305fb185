"""A camera that shows nothing for a while, an autopilot that falls silent, a recognizer that is slow.

All say so in the same words, nothing old is sent, and it comes back.
"""

from __future__ import annotations

import queue
import socket
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.camera import Frame
from edge.camera.newest import NewestFrame
from edge.descriptor.network import Network
from edge.errors import CameraLost
from edge.feed import FeedImages, read_feed
from edge.health.health import MAV_STATES, Health
from edge.journal.records import StateChanged
from edge.telemetry import encoders
from sim.journal import records_of
from sim.vehicle.autopilot import EXTERNAL_POSITION_ESTIMATE
from tests.common import PATIENCE_S

LENGTH = 10
FAULT_FROM, FAULT_TO = 35, 51
FRAMES = 80
Image = NDArray[np.uint8]
Fault = Callable[[int, Image, int, int], "Frame | Exception"]


@pytest.fixture
def images(street: Path) -> list[Image]:
    feed = FeedImages(read_feed(street / "feed"))
    return [feed.read(row) for row in range(FRAMES)]


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """systemd's end of what the daemon tells it."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        yield manager


class Witness:
    """Hears what a daemon says of itself, step by step, and whether all its voices agree."""

    def __init__(self, bench: Any, manager: socket.socket, journal: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self._bench, self._manager, self._journal = bench, manager, journal
        self._status = ""
        self._beats: list[int] = []  # as sent: they may wait in the cable
        monkeypatch.setattr(encoders, "heartbeat", self._send)
        self.states: list[Health] = []
        self.fixes_at: list[int] = []

    def step(self, image: Image | None, number: int) -> None:
        """A step of the bench. What arrives in it, the daemon has sent before its last turn."""
        fixes, heartbeats, before = self._fixes(), len(self._beats), self.states[-1:]
        self._bench.step(image, number)
        self.fixes_at += [number] * (self._fixes() - fixes)
        self.states.append(self._bench.daemon.parts.monitor.health)
        may_be = {MAV_STATES[state.state] for state in (*before, self.states[-1])}
        assert set(self._beats[heartbeats:]) <= may_be
        self._status = self._newest_status() or self._status
        assert self._status == f"STATUS={self.states[-1]}"

    def agree(self, words: str) -> list[str]:
        """The states in their order, after all voices have been compared; `words` are a reason among them."""
        spoken = [str(state) for state in self.states]
        changes = [spoken[at] for at in range(1, len(spoken)) if spoken[at] != spoken[at - 1]]
        journalled = [Health(record.state, record.why) for record in records_of(self._journal, StateChanged)]  # type: ignore[arg-type]
        assert [str(health) for health in journalled][1:] == changes
        assert any(state.state == "degraded" and state.why.startswith(words) for state in self.states), changes
        texts = " ".join(message.text for message in self._heard("STATUSTEXT"))
        assert texts.count(f"Lookback degraded: {words}") == 1
        heard, sent = self._heard("HEARTBEAT"), iter(self._beats)
        assert all(beat.system_status in sent for beat in heard), "in the order in which they were sent"
        assert len(heard) >= len(self.states) // 5 - 1, "once a second, blind or not"
        assert self.states[-1].state == "on the map"
        return changes

    def during(self, words: str) -> list[int]:
        """The steps, in frames of the drive, at which a reason was told."""
        return [number - 20 for number, state in enumerate(self.states) if words in state.why]

    def _send(self, status: int, kind: int, *, heartbeat: Callable[[int, int], Any] = encoders.heartbeat) -> Any:
        self._beats.append(status)
        return heartbeat(status, kind)

    def _heard(self, kind: str) -> list[Any]:
        return [item.message for item in self._bench.autopilot.received if item.message.get_type() == kind]

    def _fixes(self) -> int:
        return sum(message.command == EXTERNAL_POSITION_ESTIMATE for message in self._heard("COMMAND_INT"))

    def _newest_status(self) -> str:
        newest = ""
        while True:
            try:
                word = self._manager.recv(4096).decode()
            except BlockingIOError:
                return newest
            if word.startswith("STATUS="):
                newest = word


@pytest.fixture
def make_witness(manager: socket.socket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[Any], Witness]:
    return lambda bench: Witness(bench, manager, tmp_path / "events.jsonl", monkeypatch)


@pytest.fixture
def fixing(write_config: Callable[..., Path]) -> Path:
    """A configuration that sends positions five times a second."""
    return write_config(
        telemetry={"emit": "external_position"},
        gates={"min_interval_s": 0.2, "risk": 1.0, "max_move_m": 100_000.0, "min_move_m": 0.0},
    )


def lost(bench: Any, image: Image, last: Image) -> Image | None:
    bench.frames.health = replace(bench.frames.health, state="lost", reason="/dev/video0: unplugged")
    return None


def covered(bench: Any, image: Image, last: Image) -> Image | None:
    return np.random.default_rng(int(image.sum())).normal(90, 6, image.shape).clip(0, 255).astype(np.uint8)


def frozen(bench: Any, image: Image, last: Image) -> Image | None:
    return last


@pytest.mark.parametrize(
    ("fault", "words", "told_after"),
    [
        (lost, "not recognized: camera: /dev/video0: unplugged", 1),
        (covered, "not recognized: camera: the image is covered", 4),
        (frozen, "not recognized: camera: the image is frozen", 11),
    ],
)
def test_a_blindness(
    fault: Callable[[Any, Image, Image], Image | None],
    words: str,
    told_after: int,
    images: list[Image],
    make_bench: Callable[..., Any],
    fixing: Path,
    make_witness: Callable[[Any], Witness],
    figures: Callable[[str], None],
) -> None:
    """No fix goes out from the first picture on that shows nothing, also while it is too early to tell."""
    bench = make_bench(fixing)
    witness = make_witness(bench)
    for number in range(-20, FRAMES):
        image = images[number] if number >= 0 else None
        if FAULT_FROM <= number < FAULT_TO:
            image = fault(bench, images[number], images[FAULT_FROM - 1])
        else:
            bench.frames.health = replace(bench.frames.health, state="running", reason="")
        witness.step(image, number)
    witness.agree(words)
    blind = witness.during(words)
    assert FAULT_FROM <= blind[0] <= FAULT_FROM + told_after
    assert blind[-1] in (FAULT_TO - 1, FAULT_TO)
    fixes_at = witness.fixes_at
    assert [at for at in fixes_at if at < FAULT_FROM], "it was on the map before"
    assert [at for at in fixes_at if FAULT_FROM < at < FAULT_TO + LENGTH - 1] == []
    assert [at for at in fixes_at if at >= FAULT_TO + LENGTH - 1], "and is again"
    figures(f"blind at frames {blind[0]} to {blind[-1]}, fixes at {fixes_at}")


def gives_nothing(number: int, image: Image, now_ns: int, openings: int) -> Frame | Exception:
    """It can be opened, again and again, and no frame ever comes."""
    return CameraLost("/dev/video0: no frame for 2 s")


def another_size(number: int, image: Image, now_ns: int, openings: int) -> Frame | Exception:
    return Frame(image[::2, ::2], now_ns, number)


def time_goes_back(number: int, image: Image, now_ns: int, openings: int) -> Frame | Exception:
    """Until it is opened again."""
    return Frame(image, now_ns - (10**10 if openings == 1 else 0), number)


class HandedCamera:
    """A camera of which each frame, or loss, is handed over."""

    differences: tuple[str, ...] = ()
    read_timeout_s = 3600.0

    def __init__(self, handed: queue.Queue[Frame | Exception | None], waits: threading.Semaphore) -> None:
        self._handed, self._waits = handed, waits

    def read(self) -> Frame | None:
        self._waits.release()
        item = self._handed.get()
        if isinstance(item, Exception):
            raise item
        return item

    def close(self) -> None:
        """Nothing to close."""


@pytest.mark.parametrize(
    ("fault", "words", "blind_from", "blind_to"),
    [
        (gives_nothing, "not recognized: camera: /dev/video0: no frame for 2 s", FAULT_FROM, FAULT_TO - 1),
        (
            another_size,
            "not recognized: camera: nothing but bad frames for 2 s "
            "(an image of 80 x 60 pixels, but the first was of 160 x 120 pixels); opened again",
            FAULT_FROM + 10,
            FAULT_TO - 1,
        ),
        (
            time_goes_back,
            "not recognized: camera: nothing but bad frames for 2 s (timestamp not after the last frame's);"
            " opened again",
            FAULT_FROM + 10,
            FAULT_FROM + 10,
        ),
    ],
)
def test_a_camera_that_is_opened_again(
    fault: Fault,
    words: str,
    blind_from: int,
    blind_to: int,
    images: list[Image],
    make_bench: Callable[..., Any],
    fixing: Path,
    make_witness: Callable[[Any], Witness],
    figures: Callable[[str], None],
) -> None:
    """Through the camera's own thread: one blindness, told once, however often it is opened in vain."""
    handed: queue.Queue[Frame | Exception | None] = queue.Queue()
    waits, openings = threading.Semaphore(0), 0

    def open_camera() -> HandedCamera:
        nonlocal openings
        openings += 1
        return HandedCamera(handed, waits)

    bench = make_bench(
        fixing,
        frames=lambda clock_ns: NewestFrame(
            open_camera, first_back_off_s=0.001, longest_back_off_s=0.001, clock_ns=clock_ns
        ),
    )
    witness = make_witness(bench)
    assert waits.acquire(timeout=PATIENCE_S)
    for number in range(-20, FRAMES):
        if number >= 0:
            faulty = FAULT_FROM <= number < FAULT_TO
            image, now_ns = images[number], bench.now_ns
            handed.put(fault(number, image, now_ns, openings) if faulty else Frame(image, now_ns, number))
            assert waits.acquire(timeout=PATIENCE_S), "the thread has taken it in, and waits for the next"
        witness.step(None, number)
    handed.put(None)
    witness.agree(words)
    blind = witness.during(words)
    assert (blind[0], blind[-1]) == (blind_from, blind_to)
    assert blind == list(range(blind_from, blind_to + 1)), "not for a moment did it seem to see"
    fixes_at = witness.fixes_at
    assert [at for at in fixes_at if at < FAULT_FROM], "it was on the map before"
    assert [at for at in fixes_at if blind_from < at < blind_to + LENGTH] == []
    assert [at for at in fixes_at if at > blind_to + LENGTH], "and is again"
    figures(f"blind at frames {blind[0]} to {blind[-1]}, opened {openings} times")


def test_an_autopilot_that_falls_silent(
    images: list[Image],
    make_bench: Callable[..., Any],
    write_config: Callable[..., Path],
    make_witness: Callable[[Any], Witness],
) -> None:
    """Twice along the street; the autopilot is back before the end, and receives the state."""
    bench = make_bench(write_config())
    witness = make_witness(bench)
    drive = [*images, *images]
    for number in range(-20, len(drive)):
        bench.autopilot_speaks = not 30 <= number < 100
        witness.step(drive[number] if number >= 0 else None, number)
    changes = witness.agree("link: no autopilot heard")
    assert "degraded: link: no autopilot heard; on the map" in changes
    silent = witness.during("link: no autopilot heard")
    assert 30 + 5 * 5 <= silent[0] <= 30 + 5 * 11
    assert 99 <= silent[-1] <= 100 + 5 * 2


class LateNetwork:
    """The shipped network; for some frames the bench's clock goes on by more than a second in it."""

    def __init__(self, network: Network) -> None:
        self._network = network
        self.info, self.size, self.path, self.provider = network.info, network.size, network.path, network.provider
        self.wait: Callable[[], None] = lambda: None

    def describe(self, pictures: Image) -> NDArray[np.float32]:
        self.wait()
        return self._network.describe(pictures)


def test_a_frame_that_takes_too_long(
    images: list[Image],
    make_bench: Callable[..., Any],
    write_config: Callable[..., Path],
    make_witness: Callable[[Any], Witness],
    grid: Network,
) -> None:
    slow = LateNetwork(grid)
    bench = make_bench(write_config(), network=slow)
    witness = make_witness(bench)

    def wait() -> None:
        bench.now_ns += 1_500_000_000 if 40 <= bench.number < 50 else 0

    slow.wait = wait
    for number in range(-20, FRAMES):
        witness.step(images[number] if number >= 0 else None, number)
    witness.agree("slow: a frame took over 1 s; on the map")
    assert witness.during("slow: ") == list(range(40, 50))
