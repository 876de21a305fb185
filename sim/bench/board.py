"""`lookback dev bench`: measure this board: a row for docs/fleet.md with each network that is installed.

It needs no package beyond those of `lookback run`. `--stages` measures each stage beside its floor and its rival, with
the packages of the extra `bench` (`make bench`).
"""

from __future__ import annotations

import argparse
import csv
import resource
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import cv2

from edge.config import NETWORKS, RigConfig
from edge.descriptor.network import Network
from edge.errors import ConfigError, ModelError
from edge.recognition.recognizer import model_key
from sim.bench.frames import SIZE_PX, run_frames
from sim.bench.simulated_map import write_simulated_map
from sim.bench.table import cells, machine_name, page, table
from sim.bench.timing import wall_ns
from sim.output import needing

PLACES = 10_000
HEADER = (
    "| board | of | regions | network | matching | search | belief | whole frame, median / 95 % | peak memory |"
    " slower at the end | hottest | throttled |\n|---|---|---|---|---|---|---|---|---|---|---|---|"
)
SLOWER = 1.1
"""Ratio of the frame times at the end and at the beginning from which a board counts as throttled."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback dev bench`."""
    parser.description = (
        "Recognizes random pictures on one core, without a pause, on a map of random places in a temporary"
        " folder. Stop the service first; leave the board in its housing, and cool it as on the vehicle. Times are CPU"
        " times of one thread, in milliseconds."
    )
    heat = "with each network, default 150: heat takes time"
    parser.add_argument("--seconds", type=float, default=150.0, metavar="S", help=heat)
    parser.add_argument("--places", type=int, default=PLACES, metavar="N", help=f"places of the map (default {PLACES})")
    parser.add_argument("--folder", type=Path, help="where to put the map meanwhile, 80 MB (default: temporary files)")
    stages = parser.add_argument_group("instead, each stage beside its floor and its rival")
    about = "the page docs/bench.md; needs the extra bench"
    stages.add_argument("--stages", action="store_true", help=about)
    stages.add_argument("--quick", action="store_true", help="of --stages: smaller sizes, in about a minute")
    about = "of --stages: the page, and beside it a CSV file"
    stages.add_argument("-o", "--output", type=Path, metavar="FILE", help=about)
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    if not args.seconds > 0 or args.places < 100:
        raise ConfigError("bench: --seconds must be above 0 and --places at least 100")
    cv2.setNumThreads(1)
    if args.stages:
        return _stages(args)
    words = f"frames of {SIZE_PX[0]}x{SIZE_PX[1]}, {args.places:,} places, Lookback {version('lookback-nav')}"
    print(HEADER)
    # The smaller one first: the peak of memory is that of the whole process.
    for number, name in enumerate(NETWORKS):
        try:
            network = Network.load(Path(name))
        except ModelError as missing:
            print(missing, file=sys.stderr)
            continue
        with tempfile.TemporaryDirectory(prefix="lookback-bench-", dir=args.folder) as folder:
            run = measure(Path(folder), args.places, args.seconds, network)
        print(row("" if number else board_name(), name, run), flush=True)
        print(f"{name}: {len(run.frames)} {words}", file=sys.stderr)
    print("Please paste the table into an issue, for docs/fleet.md.", file=sys.stderr)
    return 0


def _stages(args: argparse.Namespace) -> int:
    """Measure each stage, print the rows, and write a page and a file of them."""
    with needing("--stages", "bench"):
        from sim.bench import drives, stages
    began_s, rounds = time.monotonic(), 7 if args.quick else 21
    rows = [*stages.measure(rounds, (10_000,) if args.quick else (10_000, 100_000))]
    with tempfile.TemporaryDirectory(prefix="lookback-bench-", dir=args.folder) as folder:
        rows += drives.measure(Path(folder), rounds, quick=args.quick)
    made = f"Made by `make bench{'-quick' if args.quick else ''}` in {time.monotonic() - began_s:.0f} s."
    print(table(rows))
    if args.output:
        file = args.output.with_suffix(".csv")
        args.output.write_text(page(rows, made, file.name), encoding="utf-8")
        with file.open("w", newline="", encoding="utf-8") as opened:
            csv.writer(opened, lineterminator="\n").writerows(cells(rows))
    return 0


@dataclass(frozen=True)
class BoardRun:
    """frames: CPU milliseconds by stage. temperatures_c: of the hottest sensor. limits: what slowed the board down."""

    frames: Sequence[dict[str, float]]
    temperatures_c: Sequence[float]
    limits: frozenset[str]


def measure(folder: Path, places: int, seconds: float, network: Network) -> BoardRun:
    """Recognize pictures for that long, at least two of them, and read the sensors between them."""
    frames, temperatures, limits = [], [], set()
    until_ns = 0.0
    path = folder / "board.map"
    write_simulated_map(path, places, model_key(network))
    for frame in run_frames(path, places, sys.maxsize // 2, network, RigConfig()):
        until_ns = until_ns or wall_ns() + seconds * 1e9  # neither the map nor the warm-up counts
        frames.append(frame)
        temperatures += hottest_c()
        limits |= throttling()
        if wall_ns() >= until_ns and len(frames) >= 2:
            break
    return BoardRun(frames, temperatures, frozenset(limits))


def row(board: str, network: str, run: BoardRun) -> str:
    """The row of one board and one network."""

    def median(stage: str) -> str:
        return f"{statistics.median(frame.get(stage, 0.0) for frame in run.frames):.1f}"

    whole = [sum(frame.values()) for frame in run.frames]
    fifth = max(1, len(whole) // 5)
    slower = statistics.median(whole[-fifth:]) / statistics.median(whole[:fifth])
    throttled = ", ".join(sorted(run.limits)) or ("no" if slower < SLOWER else "yes, by the times")
    cells = [
        board,
        network,
        *(median(stage) for stage in ("regions", "network", "matching", "search", "belief")),
        f"{statistics.median(whole):.1f} / {statistics.quantiles(whole, n=20)[-1]:.1f}",
        f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB",
        f"{100 * (slower - 1):+.0f} %",
        f"{max(run.temperatures_c):.0f} °C" if run.temperatures_c else "no sensor",
        throttled,
    ]
    return f"| {' | '.join(cells)} |"


def board_name(model: Path = Path("/proc/device-tree/model")) -> str:
    """What the board calls itself (its device tree), if it does, with processor, system and versions."""
    if not model.exists():
        return machine_name()
    return f"{model.read_text(encoding='utf-8').rstrip(chr(0))}: {machine_name()}"


def hottest_c(sensors: Path = Path("/sys/class/thermal")) -> list[float]:
    """The temperature of the hottest sensor; none where no sensor can be read."""
    found = []
    for file in sensors.glob("thermal_zone*/temp"):
        try:
            found.append(int(file.read_text()) / 1000)
        except (OSError, ValueError):
            continue  # a sensor that is switched off
    return [max(found)] if found else []


RASPBERRY_PI_BITS = {0: "under-voltage", 1: "frequency capped", 2: "throttled", 3: "temperature limit"}
"""https://www.raspberrypi.com/documentation/computers/os.html#get_throttled"""


def throttling(
    raspberry_pi: Path = Path("/sys/devices/platform/soc/soc:firmware/get_throttled"),
    cooling: Path = Path("/sys/class/thermal"),
) -> set[str]:
    """What slows the board down now: flags of a Raspberry Pi's firmware, or limits that the kernel sets."""
    found = set()
    if raspberry_pi.exists():
        flags = int(raspberry_pi.read_text(), 16)
        found |= {name for bit, name in RASPBERRY_PI_BITS.items() if flags >> bit & 1}
    for device in cooling.glob("cooling_device*"):
        kind, state = (device / "type"), (device / "cur_state")
        if "cpu" in kind.read_text().lower() and int(state.read_text()) > 0:
            found.add("kernel limits the processor")
    return found
