"""`lookback model use`: switch a config to another network, and say what that costs."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge.errors import ConfigError
from sim.calibration.command import check_writable, write_lines
from sim.model_tools import efficientnet, import_command

SHIPPED = "alexnet"
PRICES = {
    SHIPPED: "the shipped network; its weights are for non-commercial use",
    efficientnet.NAME: (
        "weights under Apache-2.0; recall at a precision of 100 %, of it and of the shipped network: 0.75 and 0.76 on"
        " recordings by one camera, 0.01 and 0.24 front against rear on real streets, 0.99 and 0.98 on simulated"
        " streets; 1604 and 8260 bytes a place (docs/networks.md)"
    ),
}
"""What is measured of each network, in docs/networks.md."""


def add_use(parser: argparse.ArgumentParser) -> None:
    """Add the options of `lookback model use`."""
    parser.add_argument("network", choices=tuple(PRICES), metavar="NETWORK", help=" or ".join(PRICES))
    parser.add_argument("config", type=Path, metavar="CONFIG", help="the config file; the network goes beside it")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    check_writable(args.config)
    name = "" if args.network == SHIPPED else args.network
    folder = args.config.parent / args.network
    if name and not folder.exists():
        importing = argparse.ArgumentParser()
        import_command.add_import(importing)
        import_command.run(importing.parse_args([name, "-o", str(folder)]))
    elif name and not folder.is_dir():
        raise ConfigError(f"{folder}: is no folder; move it away, the network goes there")
    write_lines(args.config, {("descriptor", "model"): name})
    print(f'{args.config}: [descriptor] model = "{name}": {PRICES[args.network]}')
    print("maps of another network are excluded: build each again, `lookback map build FEED -o MAP --config CONFIG`")
    return 0
