"""`lookback model`: switch to another network; import, inspect and verify networks."""

from __future__ import annotations

import argparse
from pathlib import Path

import msgspec

from edge.config import FIRST_NETWORK
from edge.descriptor.model_file import read_model_file, resolve_model
from edge.descriptor.network import Network
from edge.descriptor.open_network import NSD_COSINE_MIN, cosines, nsd_cosines
from edge.errors import ModelError
from edge.feed import read_feed
from sim.model_tools import providers
from sim.model_tools.frames import describe_feed, kinds_of
from sim.model_tools.import_command import add_import
from sim.model_tools.use_command import add_use


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback model`."""
    actions = parser.add_subparsers(required=True)

    add_import(actions.add_parser("import", help="make the network file of a vehicle from a network or from weights"))

    add_use(actions.add_parser("use", help="switch a config to another network, and say what that costs"))

    info = actions.add_parser("info", help="print the metadata of a network")
    about = "grid, fc6, a folder or a file (default %(default)s)"
    info.add_argument("model", type=Path, nargs="?", default=Path(FIRST_NETWORK), help=about)
    info.set_defaults(run=_info)

    verify = actions.add_parser("verify", help="compare an int8 network with its float one on a feed")
    verify.add_argument("model", type=Path, nargs="?", help="a folder or file (default fc6)")
    verify.add_argument("feed", type=Path, metavar="FEED")
    verify.add_argument("--weights", type=Path, required=True, help="the float network, of `model import --float`")
    verify.set_defaults(run=_verify)

    help_text = "compare the installed providers of ONNX Runtime with the CPU: agreement and time, as a table"
    providers.add_arguments(actions.add_parser("providers", help=help_text))


def _info(args: argparse.Namespace) -> int:
    file = read_model_file(resolve_model(args.model))
    print(f"{'file':15s} {file.path}")
    for field, value in msgspec.structs.asdict(file.info).items():
        if value != "":
            print(f"{field:15s} {value}")
    return 0


def _verify(args: argparse.Namespace) -> int:
    rounded = Network.load(args.model)
    networks = (_checked_float(rounded, Network.load(args.weights)), rounded)
    feed = read_feed(args.feed)
    passed = True
    for kind in kinds_of(rounded.info):
        descriptors = [describe_feed(network, feed, kind) for network in networks]
        raw, after = cosines(*descriptors), nsd_cosines(*descriptors)
        passed = passed and after.mean() >= NSD_COSINE_MIN
        print(f"{kind}: cosine to float, raw {raw.mean():.5f}, after NSD {after.mean():.4f} (least {after.min():.4f})")
    print("passed" if passed else f"FAILED: mean cosine after NSD below {NSD_COSINE_MIN}")
    return 0 if passed else 1


def _checked_float(network: Network, exact: Network) -> Network:
    """The float network itself; ModelError if it differs from `network` in more than its precision."""
    keys = ("weights_sha256", "tap", "pool", "columns", "size", "mean_rgb", "std_rgb")
    if exact.info.precision != "float32" or any(getattr(exact.info, k) != getattr(network.info, k) for k in keys):
        raise ModelError(f"{exact.path}: not the float network of {network.path}; import it again with --float")
    return exact
