"""`lookback check CONFIG`: whether the daemon could run with this config, without starting it."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge.config import DEFAULT_TOML, load_config
from edge.descriptor.network import Head, Network
from edge.recognizer import PlaceRecognizer
from edge.reference_map.map_set import open_map_set
from edge.reference_map.signature import check_signatures
from edge.telemetry.autopilot import AutopilotConnection


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `lookback check` to the command line."""
    parser = commands.add_parser("check", help="check a config file, and the model and map that it names")
    parser.add_argument("config", type=Path, nargs="?", metavar="CONFIG")
    parser.add_argument("--default", action="store_true", help="print the commented default config instead")
    parser.set_defaults(run=_run)
    parser.set_defaults(error=parser.error)


def _run(args: argparse.Namespace) -> int:
    if args.default:
        print(DEFAULT_TOML.read_text(encoding="utf-8"), end="")
        return 0
    if args.config is None:
        args.error("name a config file, or use --default")
    config = load_config(args.config)
    network = Network.load(Path(config.descriptor.model) if config.descriptor.model else None)
    atlas = open_map_set(Path(config.map.path), lambda name, why: print(f"note: {why}; left out"))
    atlas.check_every_file()
    if config.map.require_signature_by:
        check_signatures(atlas, Path(config.map.require_signature_by))
    PlaceRecognizer(network, Head.load(network), atlas, config)
    AutopilotConnection(config.telemetry)  # reads connections and keys, and opens nothing yet
    print(f"{args.config}: good; model {network.info.name}, map of {atlas}")
    for sampling in {header.sampling: None for header in atlas.headers if header.sampling != config.sampling}:
        maps = [index for index, header in enumerate(atlas.headers) if header.sampling == sampling]
        print(f"note: {atlas.spell(maps)}: sampled by {sampling}, the config asks for {config.sampling}")
    return 0
