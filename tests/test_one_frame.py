"""How much of edge/ a reader must hold in mind: files that a frame visits, and attributes of the classes there.

Files are counted by tracing the daemon on a small map.
"""

from __future__ import annotations

import ast
import sys
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import FrameType

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray

import edge
from edge.camera import Frame
from edge.config import AcceptanceConfig, Config, GatesConfig, MapConfig, SamplingConfig, SequenceConfig
from edge.config import TelemetryConfig as Telemetry
from edge.daemon import Daemon
from edge.descriptor.network import Network
from edge.feed import FeedImages, read_feed
from edge.journal.journal import QueuedJournal
from edge.journal.records import FixSent, FrameUsed, PlaceFix
from edge.opened_parts import OpenedParts
from edge.telemetry import open_link
from edge_plugins.page import PageConfig
from sim import Pose
from sim.vehicle.autopilot import SimulatedAutopilot
from tests.faults.simulated_daemon import ScriptedFrames
from tests.udp_port import free_port

EDGE = Path(edge.__file__).parent
FRAMES, LENGTH = 80, 10
PERIOD_NS, STEP_NS = 200_000_000, 20_000_000
FRAME_FUNCTIONS = (Daemon._process_frame, Daemon._publish_position)
"""What a frame goes through once the camera has handed it over: to its match, its position and the journal.

The path ends where telemetry is called: that file counts, and what it calls does not. The rest of a turn reads the
autopilot's messages, encodes and sends, decides the daemon's health, and serves the page and the watchdog.
"""
READS = "telemetry/position_history.py"
"""Keeps the autopilot's positions."""
USED_FRAME_FILES_MOST = 46
"""A file counts once, if any function of it is called. Five keep the evidence and decide by it, and one of them is the
whole decision; a network says which regions of a picture it needs. Two believe a place with where the vehicle is
reckoned to be, one moves it by its gyros, and one reads keypoints."""
TURN_FILES_MOST = 63
"""Of a turn that reads a local position as well. One selects the sources of an autopilot that fuses poses, and one is
the table of what each autopilot can do."""
MANY_ATTRIBUTES, SUCH_CLASSES_MOST = 10, 19
"""How many classes may have more attributes than that; records are not counted."""


class Feeding:
    """A daemon on a map of 80 places, and its autopilot on the network; the test moves all time.

    A datagram has arrived when it is sent, so that which turn reads it does not depend on the load.
    """

    def __init__(self, street: Path, folder: Path, network: Network, parts: ExitStack) -> None:
        self.now_ns = 10**12
        self.frames = ScriptedFrames(self.clock_ns)
        port = free_port()
        link = open_link(f"udp:127.0.0.1:{port}")
        parts.callback(link.close)
        self.autopilot = SimulatedAutopilot(link, self._pose, self.clock_ns, gps=False)
        config = Config(
            sampling=SamplingConfig(by="frames"),
            map=MapConfig(path=str(street / "map")),
            sequence=SequenceConfig(length=LENGTH),
            acceptance=AcceptanceConfig(uniqueness_min=1.02, window_m=10.0, hold_off_s=0.0),
            gates=GatesConfig(risk=1.0, max_move_m=100_000.0),
            telemetry=Telemetry(
                connection=f"udpin:127.0.0.1:{port}", emit="external_position", journal=str(folder / "journal.jsonl")
            ),
            plugins={"page": PageConfig(port=0)},
        )
        config = replace(config, telemetry=replace(config.telemetry, journal_frames=True))
        self.daemon = Daemon(OpenedParts(config, parts, self.clock_ns, frames=self.frames, network=network))

    def clock_ns(self) -> int:
        return self.now_ns

    def _pose(self, time_s: float) -> Pose:
        driven_m = 10.0 * (time_s - 1000.0)
        return Pose(0.0, driven_m, 0.0, 10.0, driven_m)

    def turn(self) -> None:
        """One without a frame."""
        self.now_ns += STEP_NS
        self.autopilot.step()
        self.daemon.turn()

    def wait(self) -> None:
        """Turns without a frame until the next is due."""
        for _ in range(PERIOD_NS // STEP_NS - 1):
            self.turn()

    def show(self, image: NDArray[np.uint8], index: int) -> None:
        """Put a frame before the camera; the next turn uses it."""
        self.now_ns += STEP_NS
        self.autopilot.step()
        self.frames.next = Frame(image, self.now_ns, index)


class Files:
    """Counts calls into each file of edge/ and edge_plugins/ while it profiles: on the frame's path, and in all."""

    def __init__(self) -> None:
        self.turn: Counter[str] = Counter()
        self.idle_turn: Counter[str] = Counter()  # of the next turn, without a frame
        self.used_frame: Counter[str] = Counter()
        self.journaled: set[type] = set()
        """The kinds of records of the turn, as they are queued: the file gets them later, by another thread."""
        self._carriers = {function.__code__ for function in FRAME_FUNCTIONS}
        self._on_path = self._in_telemetry = 0

    def __call__(self, frame: FrameType, event: str, argument: object) -> None:
        file = frame.f_code.co_filename
        if event not in ("call", "return") or not file.startswith((f"{EDGE}/", f"{EDGE}_plugins/")):
            return
        name = file.removeprefix(f"{EDGE}/").removeprefix(f"{EDGE.parent}/")
        step = 1 if event == "call" else -1
        self._on_path += step * (frame.f_code in self._carriers)
        if event == "call":
            self.turn[name] += 1
            if frame.f_code is QueuedJournal.write.__code__:
                self.journaled.add(type(frame.f_locals["record"]))
            if self._on_path and not self._in_telemetry:
                self.used_frame[name] += 1
        self._in_telemetry += step * name.startswith("telemetry/")


def profiled(turn: Callable[[], object]) -> Files:
    files = Files()
    before = sys.getprofile()
    sys.setprofile(files)
    try:
        turn()
    finally:
        sys.setprofile(before)
    return files


@pytest.fixture(scope="module")
def visited(make_street: Callable[..., Path], grid: Network, tmp_path_factory: pytest.TempPathFactory) -> Files:
    """The files of the first turn that has it all: frame, place and position go out, and the autopilot's own comes."""
    street = make_street(range(FRAMES), period_ms=PERIOD_NS // 1_000_000)
    images = FeedImages(read_feed(street / "feed"))
    with ExitStack() as parts:
        drive = Feeding(street, tmp_path_factory.mktemp("drive"), grid, parts)
        for _ in range(15):
            drive.wait()  # until the autopilot's speed is known
        while READS not in profiled(drive.turn).turn:
            pass  # frames come when its positions do
        drive.wait()
        for index in range(FRAMES):
            # Not quite the map's own picture, or the network that remembers it would have nothing to do.
            drive.show(images.read(index) ^ np.uint8(1), index)
            files = profiled(drive.daemon.turn)
            if READS in files.turn and files.journaled >= {FrameUsed, PlaceFix, FixSent}:
                files.idle_turn = profiled(drive.daemon.turn).turn
                return files
            drive.wait()
    pytest.fail("no turn used a frame, reported its place and sent a position")


def report(what: str, files: Counter[str]) -> str:
    lines = [f"    {name:40} {calls:5}" for name, calls in sorted(files.items())]
    return "\n".join([f"{what}: {len(files)} files", *lines])


def test_one_used_frame_visits_few_files(visited: Files) -> None:
    print(report("from the frame to its match, its position and the journal", visited.used_frame))
    assert {"recognition/recognizer.py", "descriptor/network.py", "journal/journal.py"} <= set(visited.used_frame)
    assert len(visited.used_frame) <= USED_FRAME_FILES_MOST


def test_a_whole_turn_visits_few_files(visited: Files) -> None:
    print(report("a turn of the daemon's loop with a used frame", visited.turn))
    assert set(visited.used_frame) < set(visited.turn)
    assert len(visited.turn) <= TURN_FILES_MOST


def test_a_turn_without_a_frame_keeps_nothing_for_the_next_run(visited: Files) -> None:
    """Statistics that are written anew while the vehicle is parked would look as fresh as the file."""
    assert "recognition/warm_start.py" in visited.used_frame
    assert "daemon.py" in visited.idle_turn
    assert "recognition/warm_start.py" not in visited.idle_turn


def attributes_of(one: ast.ClassDef) -> set[str]:
    """Those that its methods assign on self; none for a record (a dataclass or a struct)."""
    is_record = any("dataclass" in ast.unparse(each) for each in one.decorator_list)
    is_record = is_record or any(each.arg == "frozen" for each in one.keywords)
    assigned = (node for node in ast.walk(one) if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store))
    return set() if is_record else {node.attr for node in assigned if ast.unparse(node.value) == "self"}


def test_few_classes_have_many_attributes() -> None:
    trees = {file: ast.parse(file.read_text(encoding="utf-8")) for file in EDGE.rglob("*.py")}
    classes = [(file, one) for file, tree in trees.items() for one in ast.walk(tree) if isinstance(one, ast.ClassDef)]
    counts = {f"{file.relative_to(EDGE)} {one.name}": len(attributes_of(one)) for file, one in classes}
    assert counts["daemon.py Daemon"] > 5
    many = sorted(name for name, count in counts.items() if count > MANY_ATTRIBUTES)
    assert len(many) <= SUCH_CLASSES_MOST, "\n".join(many)
