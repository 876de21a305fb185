"""`lookback model use`: switch a config to another network that comes with Lookback, and say what that costs."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge.config import NETWORKS
from edge.descriptor.model_file import read_model_file, resolve_model
from sim.calibration.command import check_writable, write_lines


def add_use(parser: argparse.ArgumentParser) -> None:
    """Add the options of `lookback model use`."""
    parser.add_argument("network", choices=NETWORKS, metavar="NETWORK", help=" or ".join(NETWORKS))
    parser.add_argument("config", type=Path, metavar="CONFIG", help="the config file")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    info = read_model_file(resolve_model(Path(args.network))).info
    check_writable(args.config)
    write_lines(args.config, {("descriptor", "model"): args.network})
    print(f'{args.config}: [descriptor] model = "{args.network}"; its license: {info.license}')
    print("maps of another network are excluded: build each again, `lookback map build FEED -o MAP --config CONFIG`")
    print("how the two compare, measured: docs/networks.md")
    return 0
