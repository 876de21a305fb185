"""`lookback check CONFIG`: whether the daemon could run with this config, without starting it."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge.config import DEFAULT_TOML, load_config
from edge.descriptor.network import Head, Network
from edge.recognizer import PlaceRecognizer
from edge.reference_map.signature import check_signature
from edge.reference_map.store import open_map
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
    reference_map = open_map(Path(config.map.path), every_file=True)
    if config.map.require_signature_by:
        check_signature(reference_map, Path(config.map.require_signature_by))
    PlaceRecognizer(network, Head.load(network), reference_map, config)
    AutopilotConnection(config.telemetry)  # reads connections and keys, and opens nothing yet
    print(f"{args.config}: good; model {network.info.name}, map of {reference_map.header.places} places")
    wanted, theirs = config.sampling, reference_map.header.sampling
    if wanted != theirs:
        print(f"note: the map was sampled by {theirs}, the config asks for {wanted}")
    return 0
