"""`lookback dev golden`: make a recording a test of the recognizer, or run it.

A folder keeps what to replay, and the output when it was right.

    golden.toml     the reference feeds, the query feed and the settings; paths are relative to the folder
    expected.jsonl  a line for every frame, as `replay --all` writes it

`lookback dev golden FOLDER` replays it and prints the first difference;
tests/sim/evaluation/test_golden.py does so for each folder under tests/golden. `--rebuild` accepts the present output.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from itertools import zip_longest
from pathlib import Path

import msgspec
import tomli_w

from edge.config import Config, SamplingConfig, SequenceConfig, checked_option
from edge.descriptor.network import Network
from edge.errors import ConfigError
from edge.feed import Feed, read_feed
from edge.journal.records import FrameUsed
from edge.reference_map import MapSet
from edge.reference_map.store import open_map
from edge.toml_file import read_toml
from sim.evaluation.recognition import recognize
from sim.evaluation.replay import as_line
from sim.maps.command import add_spacing_options, build_map, sampling_from

SETTINGS, EXPECTED = "golden.toml", "expected.jsonl"


class Golden(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`golden.toml`."""

    reference: tuple[str, ...]
    query: str
    length: int = SequenceConfig().length
    sampling: SamplingConfig = SamplingConfig()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback dev golden`."""
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("--reference", type=Path, nargs="+", metavar="FEED", help="make a test: the feeds of its map")
    parser.add_argument("--query", type=Path, metavar="FEED", help="and the feed to be recognized")
    parser.add_argument("--sequence-length", type=int, default=SequenceConfig().length, metavar="L")
    parser.add_argument("--rebuild", action="store_true", help="accept the present output")
    add_spacing_options(parser)
    parser.set_defaults(run=_run)


def load_golden(folder: Path) -> Golden:
    """Read `golden.toml`. ConfigError names it."""
    file = folder / SETTINGS
    if not file.exists():
        raise ConfigError(f"{file}: cannot read it: no such file; make one with --reference and --query")
    return read_toml(file, Golden)


def replay_golden(folder: Path, golden: Golden) -> str:
    """The present output."""
    config = Config(sampling=golden.sampling, sequence=SequenceConfig(length=golden.length))
    reference = [read_feed(folder / path) for path in golden.reference]
    frames = replay_on_new_map(reference, read_feed(folder / golden.query), config)
    return "".join(map(as_line, frames))


def replay_on_new_map(
    reference: list[Feed],
    query: Feed,
    config: Config,
    *,
    sampling: SamplingConfig | None = None,
    network: Network | None = None,
) -> list[FrameUsed]:
    """Every used frame of `query`, recognized on a map of `reference`; the camera's view is that of the query.

    sampling: of the query, where it is not that of the map. network: instead of the one that the config names.
    """
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "map"
        build_map(reference, path, config.descriptor, config.sampling, network=network)
        config = msgspec.structs.replace(config, sampling=sampling or config.sampling)
        return recognize(MapSet.of(open_map(path)), query, config, network).used


def first_difference(expected: str, now: str) -> str:
    """The number of the first line that differs, and both lines; "" if the two are equal."""
    for number, (old, new) in enumerate(zip_longest(expected.splitlines(), now.splitlines()), start=1):
        if old != new:
            return f"line {number}:\n  expected {old}\n  now      {new}"
    return ""


def _run(args: argparse.Namespace) -> int:
    if (args.reference is None) != (args.query is None):
        raise ConfigError("--reference and --query: name both to make a golden test, or none to run one")
    if args.query is not None:
        _make(args)
    golden = load_golden(args.folder)
    now = replay_golden(args.folder, golden)
    expected = args.folder / EXPECTED
    if args.query is not None or args.rebuild:
        expected.write_text(now, encoding="utf-8")
        print(f"{expected}: {len(now.splitlines())} lines written; check them before you commit them")
        return 0
    difference = first_difference(expected.read_text(encoding="utf-8"), now)
    print(f"{args.folder}: {difference or 'unchanged'}")
    return 1 if difference else 0


def _make(args: argparse.Namespace) -> None:
    file = args.folder / SETTINGS
    if file.exists() and not args.rebuild:
        raise ConfigError(f"{file}: exists already; name another folder, or use --rebuild")
    checked_option(SequenceConfig(), "--sequence-length", length=args.sequence_length)
    args.folder.mkdir(parents=True, exist_ok=True)
    golden = Golden(
        reference=tuple(os.path.relpath(path, args.folder) for path in args.reference),
        query=os.path.relpath(args.query, args.folder),
        length=args.sequence_length,
        sampling=sampling_from(args, SamplingConfig()),
    )
    file.write_text(tomli_w.dumps(msgspec.to_builtins(golden)), encoding="utf-8")
