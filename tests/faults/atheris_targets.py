"""Coverage-guided fuzzing of what reads bytes from outside. Run by test_atheris.py.

python atheris_targets.py config|feed|map|state|journal|mavlink FOLDER -max_total_time=60 -seed=1
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from pathlib import Path

import atheris  # type: ignore[import-untyped, import-not-found, unused-ignore]

with atheris.instrument_imports(include=["edge", "pymavlink"]):
    from edge.config import parse_config
    from edge.errors import LookbackError
    from edge.feed import read_feed
    from edge.reference_map.store import read_header
    from edge.telemetry.codec import MavlinkCodec
    from edge.telemetry.vehicle import Vehicle
    from edge.warm_start import Moment, StateFile, StateKey
    from sim.journal import read_journal

NOW = Moment(1000.0, "boot", 10.0)
TARGET, FOLDER = sys.argv[1], Path(sys.argv[2])


def config(data: bytes) -> None:
    parse_config(data.decode("utf-8", errors="replace"), FOLDER / "lookback.toml")


def feed(data: bytes) -> None:
    toml, _, table = data.partition(b"\0")
    (FOLDER / "feed.toml").write_bytes(toml or b'name = "a"\nview = "front"\nwidth = 1\nheight = 1\n')
    (FOLDER / "frames.csv").write_bytes(table)
    read_feed(FOLDER)


def map_header(data: bytes) -> None:
    (FOLDER / "map.json").write_bytes(data)
    read_header(FOLDER)


def state(data: bytes) -> None:
    (FOLDER / "events.state").write_bytes(data)
    StateFile(FOLDER / "events.state", StateKey("m", "fc6", "left-right", 0.4, "h"), (2, 4)).read(NOW, 60.0)


def journal(data: bytes) -> None:
    (FOLDER / "events.jsonl").write_bytes(data)
    list(read_journal(FOLDER / "events.jsonl"))


def mavlink(data: bytes) -> None:
    codec, vehicle = MavlinkCodec(1, 191), Vehicle()
    for turn, message in enumerate(codec.decode(data)):
        vehicle.handle(message, turn * 20_000_000)


TARGETS: dict[str, Callable[[bytes], None]] = {
    "config": config,
    "feed": feed,
    "map": map_header,
    "state": state,
    "journal": journal,
    "mavlink": mavlink,
}


def once(data: bytes) -> None:
    """Only an error of ours in one line is an answer; of a config, a line for each mistake."""
    try:
        TARGETS[TARGET](data)
    except LookbackError as error:
        lines = str(error).split("\n")
        if len(lines) > 1 and not (TARGET == "config" and all(line.startswith(str(FOLDER)) for line in lines)):
            raise RuntimeError(f"more than one line: {error}") from None


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    atheris.Setup([sys.argv[0], *sys.argv[3:]], once)
    atheris.Fuzz()
