"""Runs the goldens: the only file here that knows the insides of the program, next to `record`.

`replay_case` runs commands with their arguments, in this process. `run_case` gives the real `Daemon` recorded frames
and, over a pseudo-terminal, recorded telemetry; all clocks are simulated, so that each run is the same to the byte.
`drive_case` replays an excerpt of a drive on a real autopilot, as `lookback dev flights` does.
"""

from __future__ import annotations

import csv
import fcntl
import hashlib
import json
import re
import shutil
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, closing
from multiprocessing import get_context
from pathlib import Path
from typing import Protocol

import cv2
import msgspec
import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.camera import CameraHealth, Frame
from edge.commands.parser import build_parser
from edge.config import FIRST_NETWORK, load_config
from edge.daemon import Daemon
from edge.descriptor.network import Network
from edge.opened_parts import OpenedParts
from edge.telemetry.codec import Message
from sim.research.trial.recorded_drive import read_drive
from sim.research.trial.replayed_drive import replay
from sim.trial.views import RoadLibrary
from sim.vehicle.pty_link import Cable
from tests.tlog import frames_of

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

HERE = Path(__file__).parent
RECORDINGS = HERE / "recordings"
CASE, SETTINGS, TELEMETRY = "case.toml", "lookback.toml", "telemetry.tlog"
EXPECTED, JOURNAL, SENT = "expected.jsonl", "journal.jsonl", "sent.jsonl"
START_NS, STEP_NS, LATENCY_NS = 1_000_000_000_000, 10_000_000, 120_000_000


class Case(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`case.toml`: `maps` names the recordings of each map; with more than one map, they are a folder of maps.

    tiles: places in a tile if the map is to be split, else 0. build, options: further ones of `map build` and `replay`.
    """

    query: str
    maps: dict[str, tuple[str, ...]]
    tiles: int = 0
    build: tuple[str, ...] = ()
    options: tuple[str, ...] = ()


def load_case(folder: Path) -> Case:
    return msgspec.convert(tomllib.loads((folder / CASE).read_text(encoding="utf-8")), Case)


def cases(kind: str) -> list[Path]:
    """The folders of a kind: "replay", "run" or "drives"."""
    return sorted(path.parent for path in (HERE / kind).glob(f"*/{SETTINGS}"))


def build_maps(case: Case, scratch: Path, network: Network) -> Path:
    """The map, the folder of maps, or the tiles of a case; cases that share `scratch` share them."""
    path = scratch / hashlib.sha256(msgspec.json.encode((case.maps, case.build))).hexdigest()
    tiles = path.with_suffix(f".{case.tiles}")
    with (scratch / "maps.lock").open("w") as lock:  # of cases that other processes run
        fcntl.flock(lock, fcntl.LOCK_EX)
        built = {name: _build(recordings, case, scratch, network) for name, recordings in case.maps.items()}
        if len(built) == 1:
            path = next(iter(built.values()))
        elif not path.exists():
            half_done = Path(tempfile.mkdtemp(dir=scratch))
            for name, one in built.items():
                shutil.copytree(one, half_done / name)
            half_done.rename(path)
        if case.tiles and not tiles.exists():
            _lookback("map", "split", str(path), "-o", str(tiles), "--places", str(case.tiles))
    return tiles if case.tiles else path


def _build(recordings: tuple[str, ...], case: Case, scratch: Path, network: Network) -> Path:
    path = scratch / hashlib.sha256(msgspec.json.encode((recordings, case.build))).hexdigest()
    if not path.exists():
        half_done, feeds = Path(tempfile.mkdtemp(dir=scratch)) / "map", [str(RECORDINGS / each) for each in recordings]
        _lookback("map", "build", *feeds, "-o", str(half_done), *case.build, network=network)
        half_done.rename(path)
    return path


def replay_case(folder: Path, scratch: Path, network: Network) -> dict[str, str]:
    """What `lookback replay --all` writes: the name of each golden file, and its text."""
    case, output = load_case(folder), scratch / f"{folder.name}.jsonl"
    maps = build_maps(case, scratch, network)
    query, settings = str(RECORDINGS / case.query), str(folder / SETTINGS)
    options = ("--map", str(maps), "--config", settings, "--all", "-o", str(output))
    _lookback("replay", query, *options, *case.options, network=network)
    return {EXPECTED: output.read_text(encoding="utf-8")}


def _lookback(*words: str, **parts: Network) -> None:
    """Run a command as the parser finds it, with parts that several commands share."""
    args = build_parser(words).parse_args(words)
    if args.run(args, **parts) != 0:
        raise RuntimeError(f"lookback {' '.join(words)}: failed")


class FarEnd(Protocol):
    """What is at the other end of the cable."""

    def step(self, now_ns: int) -> None:
        """One turn, each STEP_NS."""


class PlayedTelemetry:
    """Sends recorded telemetry when it is due, and keeps what the daemon sends as JSON lines."""

    def __init__(self, path: Path, cable: Cable) -> None:
        self._frames, self._cable = list(frames_of(path)), cable
        self._next = 0
        self._parser = mavlink.MAVLink(None)
        self.sent: list[str] = []

    def step(self, now_ns: int) -> None:
        for message in self._parser.parse_buffer(self._cable.receive()) or []:
            self.sent.append(sent_line((now_ns - START_NS) / 1e9, message))
        while self._next < len(self._frames) and self._frames[self._next][0] <= now_ns - START_NS:
            self._cable.send(self._frames[self._next][1])
            self._next += 1


def sent_line(at_s: float, message: Message) -> str:
    """A message that the daemon sent, as a line of SENT; at_s: since the start of the run."""
    return json.dumps({"at_s": at_s, "seq": message.get_seq(), **message.to_dict()}) + "\n"


class PlayedFrames:
    """A recording as the daemon's camera: each frame arrives LATENCY_NS after its exposure."""

    def __init__(self, path: Path) -> None:
        with (path / "frames.csv").open(newline="", encoding="utf-8") as file:
            self._rows = [(path / row["file"], START_NS + int(row["stamp_ns"])) for row in csv.DictReader(file)]
        self._next = 0
        self.now_ns = START_NS
        self.far_end: FarEnd | None = None

    def clock_ns(self) -> int:
        return self.now_ns

    @property
    def health(self) -> CameraHealth:
        return CameraHealth("running", "", START_NS, delivered=self._next)

    @property
    def ended(self) -> bool:
        return self._next >= len(self._rows)

    def take(self, timeout_s: float) -> Frame | None:
        """Let `timeout_s` pass for everybody; the frame that has arrived meanwhile."""
        for _ in range(round(timeout_s * 1e9) // STEP_NS):
            self.now_ns += STEP_NS
            assert self.far_end is not None
            self.far_end.step(self.now_ns)
        if self.ended or self._rows[self._next][1] + LATENCY_NS > self.now_ns:
            return None
        file, stamp_ns = self._rows[self._next]
        self._next += 1
        return Frame(np.asarray(cv2.imread(str(file)), dtype=np.uint8), stamp_ns, self._next - 1)

    def close(self) -> None:
        """There is nothing to release."""


def run_daemon(
    folder: Path,
    scratch: Path,
    cable: Cable,
    frames: PlayedFrames,
    network: Network,
    own: Path | None = None,
    drive: Path | None = None,
) -> str:
    """Run the daemon of a case to the end of its frames; its journal, without wall clock and durations.

    own: a folder that does not exist yet, None: one in `scratch`. drive: a file for the list of the drive.
    """
    text = (folder / SETTINGS).read_text(encoding="utf-8")
    changes = {
        'connection = "serial:autopilot:': f'connection = "serial:{cable.device}:',
        'path = "map"': f'path = "{build_maps(load_case(folder), scratch, network)}"',
    }
    for name, there in changes.items():
        if name not in text:
            raise ValueError(f"{folder / SETTINGS}: {name} is missing")
        text = text.replace(name, there)
    own = own or scratch / folder.name
    own.mkdir()
    (own / SETTINGS).write_text(text, encoding="utf-8")
    with ExitStack() as parts:
        config = load_config(own / SETTINGS)
        telemetry = msgspec.structs.replace(config.telemetry, drive="" if drive is None else str(drive))
        config = msgspec.structs.replace(config, telemetry=telemetry)
        daemon = Daemon(OpenedParts(config, parts, frames.clock_ns, frames=frames, network=network))
        while daemon.turn():
            pass
        daemon.last_words()
        assert frames.far_end is not None
        frames.far_end.step(frames.now_ns)
    return stable(own / JOURNAL).replace(cable.device, "autopilot")


def stable(journal: Path) -> str:
    """The journal but for the version, and what clocks measure that are not simulated: `unix_s`, and `stages_ms`."""
    text = re.sub(r'^\{"unix_s":[0-9.e+]+,', "{", journal.read_text(encoding="utf-8"), flags=re.MULTILINE)
    text = re.sub(r'(?<="lookback":)"[^"]*"', '""', text)
    return re.sub(r'(?<="stages_ms":)\{[^}]*\}', lambda found: re.sub(r":[0-9.e-]+", ":0", found[0]), text)


def run_case(
    folder: Path, scratch: Path, network: Network, own: Path | None = None, drive: Path | None = None
) -> dict[str, str]:
    """The journal of a run, and all that the daemon has sent: the name of each golden file, and its text.

    own, drive: see `run_daemon`.
    """
    with closing(Cable()) as cable:
        frames = PlayedFrames(RECORDINGS / load_case(folder).query)
        played = frames.far_end = PlayedTelemetry(folder / TELEMETRY, cable)
        journal = run_daemon(folder, scratch, cable, frames, network, own, drive)
    return {JOURNAL: journal, SENT: "".join(played.sent)}


def drive_case(folder: Path, scratch: Path, network: Network) -> dict[str, str]:
    """As `run_case`, of an excerpt of a drive on a real autopilot, with the pictures that its camera saw.

    In a process of its own, with the network of new installations: where another world was rendered before, 7 of 618
    pictures were different in a few pixels.
    """
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(_drive_case, folder, scratch).result()


def _drive_case(folder: Path, scratch: Path) -> dict[str, str]:
    drive = read_drive(folder)
    with closing(RoadLibrary(Network.load(Path(FIRST_NETWORK)), scratch / f"{folder.name}.views")) as library:
        sent = replay(drive, drive.used, scratch / folder.name, library)
    journal = re.sub(r"/dev/pts/\d+", "autopilot", stable(scratch / folder.name / JOURNAL))
    from_s = drive.runs[0].from_s
    return {JOURNAL: journal, SENT: "".join(sent_line(round(at_s - from_s, 6), message) for at_s, message in sent)}


KINDS = {"replay": replay_case, "run": run_case, "drives": drive_case}


def outputs_of(folder: Path, scratch: Path, network: Network) -> dict[str, str]:
    """The golden files of any case, as they come out now. Use one empty `scratch` for all cases, and each case once."""
    return KINDS[folder.parent.name](folder, scratch, network)
