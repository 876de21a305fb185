"""`lookback model import | info | verify`: from published weights to the int8 network of a vehicle, at a desk."""

from __future__ import annotations

import argparse
import logging
import tempfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.atomic_file import replacing
from edge.descriptor.model_file import FC6_FILE, HEAD_FILE, read_model_file, resolve_model
from edge.descriptor.network import Network
from edge.descriptor.regions import REGION_COUNT, Regions, cut_regions
from edge.errors import FeedError, FrameError, ModelError
from edge.feed import Feed, FeedImages, read_feed
from edge.geodesy import east_north
from sim.model_tools import fidelity, onnx_graph, quantize
from sim.model_tools.weights import has_head, read_labels, read_weights

if TYPE_CHECKING:
    import onnx

log = logging.getLogger(__name__)

MAX_CALIBRATION_FRAMES = 500  # of each feed, evenly spread; more move the ranges by little
REGION_WIDTH = 0.4


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `lookback model` to the command line."""
    actions = commands.add_parser("model", help="import, inspect and verify networks").add_subparsers(required=True)

    make = actions.add_parser("import", help="make an int8 network from AlexNet weights in torchvision's layout")
    make.add_argument("weights", type=Path, help=".npz, or a published .pth.tar (needs the extra torch)")
    make.add_argument("-o", "--output", type=Path, required=True, help="a folder, or the network file (.onnx)")
    make.add_argument("--labels", type=Path, help="names of the categories, one per line")
    ranges = make.add_mutually_exclusive_group(required=True)
    ranges.add_argument("--ranges", type=Path, metavar="JSON", help="measured ranges of the layers' outputs")
    ranges.add_argument("--calibrate", type=Path, nargs="+", metavar="FEED", help="measure the ranges on these feeds")
    make.add_argument("--name", help="name of the network (default: that of the weights file)")
    make.add_argument("--licence", default="not stated", help="terms of the weights, kept in the file")
    make.add_argument("--source", default="not stated", help="origin of the weights, kept in the file")
    make.add_argument("--tap", choices=tuple(onnx_graph.DIMENSIONS), default="fc6", help="layer (default fc6)")
    make.add_argument("--float", action="store_true", help="write the float network beside it")
    make.set_defaults(run=_import)

    info = actions.add_parser("info", help="print the metadata of a network")
    info.add_argument("model", type=Path, nargs="?", help="a folder or file (default: the shipped network)")
    info.set_defaults(run=_info)

    verify = actions.add_parser("verify", help="compare an int8 network with its float weights on a feed")
    verify.add_argument("model", type=Path, nargs="?", help="a folder or file (default: the shipped network)")
    verify.add_argument("feed", type=Path, metavar="FEED")
    verify.add_argument("--weights", type=Path, required=True, help="the weights that it was made from")
    verify.add_argument("--reference", type=Path, metavar="FEED", help="also match FEED to this one")
    verify.add_argument("--tolerance-frames", type=int, default=3, help="a match within this many rows is right")
    verify.add_argument("--tolerance-m", type=float, default=10.0, help="or within this distance, with positions")
    verify.set_defaults(run=_verify)


def _import(args: argparse.Namespace) -> int:
    weights, sha256 = read_weights(args.weights)
    info = onnx_graph.alexnet_info(
        args.name or args.weights.name.partition(".")[0],
        args.tap,
        labels=read_labels(args.labels, weights),
        licence=args.licence,
        source=args.source,
        weights_sha256=sha256,
        calibration=_spell_calibration(args),
    )
    file = args.output if args.output.suffix == ".onnx" else args.output / f"{args.tap}_int8.onnx"
    _make_folder(file)  # before the long work
    exact = onnx_graph.build_float(weights, info)
    greatest = quantize.read_ranges(args.ranges) if args.ranges else _measure(exact, args.calibrate)
    if args.float:
        _write(exact, file.with_name(f"{args.tap}_float32.onnx"))
    info = msgspec.structs.replace(info, precision="int8")
    network_sha256 = _write(quantize.quantize(exact, greatest, info), file)
    if args.tap == "fc6" and has_head(weights):
        head_info = msgspec.structs.replace(
            info, tap="categories", dimensions=len(info.labels), fc6_sha256=network_sha256
        )
        head = onnx_graph.build_head(weights, head_info)
        _write(quantize.quantize(head, greatest, head_info), file.with_name(HEAD_FILE))
    return 0


def _spell_calibration(args: argparse.Namespace) -> str:
    found = args.ranges.name if args.ranges else "feeds " + ", ".join(path.name for path in args.calibrate)
    return f"{quantize.RANGE_SHARE:g} of the greatest values in {found}"


def _measure(exact: onnx.ModelProto, paths: list[Path]) -> dict[str, float]:
    """Ranges over the whole image and both sides of the feeds' frames."""
    feeds = [read_feed(path) for path in paths]

    def images() -> Iterator[NDArray[np.uint8]]:
        for feed in feeds:
            step = -(-len(feed.rows) // MAX_CALIBRATION_FRAMES)
            for kind in REGION_COUNT:
                for regions in _regions(feed, kind, step):
                    yield from regions

    return quantize.measure_ranges(exact, images())


def _regions(feed: Feed, kind: Regions, step: int = 1) -> Iterator[NDArray[np.uint8]]:
    """Regions (R, 224, 224, 3) of every `step`-th frame; FeedError if one is unreadable."""
    with closing(FeedImages(feed)) as images:
        try:
            for row in range(0, len(feed.rows), step):
                yield cut_regions(images.read(row), kind, REGION_WIDTH)
        except FrameError as error:
            raise FeedError(f"{error}; remove that row from the feed") from None


def _make_folder(file: Path) -> None:
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ModelError(f"{file}: cannot write it: {error.strerror}") from None


def _write(model: onnx.ModelProto, file: Path) -> str:
    """Write a network in one step, read it back, and return its sha256."""
    try:
        with replacing(file) as stream:
            stream.write(model.SerializeToString(deterministic=True))
    except OSError as error:
        raise ModelError(f"{file}: cannot write it: {error.strerror}") from None
    info = read_model_file(file).info
    print(f"{file}: {info.tap}, {info.precision}, {file.stat().st_size / 1e6:.1f} MB, sha256 {info.sha256}")
    return info.sha256


def _info(args: argparse.Namespace) -> int:
    file = read_model_file(resolve_model(args.model, FC6_FILE))
    labels = file.info.labels
    print(f"{'file':15s} {file.path}")
    for field, value in msgspec.structs.asdict(file.info).items():
        if field != "labels" and value != "":
            print(f"{field:15s} {value}")
    print(f"{'labels':15s} {len(labels)}" + (f": {', '.join(labels[:3])} ..." if labels else ""))
    return 0


def _verify(args: argparse.Namespace) -> int:
    rounded = Network.load(args.model)
    networks = (_float_of(rounded, args.weights), rounded)
    feed = read_feed(args.feed)
    reference = read_feed(args.reference) if args.reference else None
    correct = _correct(feed, reference, args) if reference else None
    passed = True
    for kind in REGION_COUNT:
        descriptors = [_describe(network, feed, kind) for network in networks]
        found = fidelity.compare(*descriptors)
        passed = passed and found.nsd_mean >= fidelity.NSD_COSINE_MIN
        print(f"{kind}: cosine to float, raw {found.raw_mean:.5f}, after NSD {found.nsd_mean:.4f}", end="")
        print(f" (least {found.nsd_least:.4f})")
        if reference is not None and correct is not None:
            shares = [
                fidelity.matching_accuracy(query, _describe(network, reference, kind), correct)
                for network, query in zip(networks, descriptors, strict=True)
            ]
            print(
                f"{kind}: single frames matched right, float {shares[0]:.3f}, {rounded.info.precision} {shares[1]:.3f}"
            )
    print("passed" if passed else f"FAILED: mean cosine after NSD below {fidelity.NSD_COSINE_MIN}")
    return 0 if passed else 1


def _float_of(network: Network, weights_file: Path) -> Network:
    """The float network of the same tap; ModelError if the weights are not those that `network` was made from."""
    weights, sha256 = read_weights(weights_file)
    if sha256 != network.info.weights_sha256:
        raise ModelError(
            f"{weights_file}: {network.path} was made from other weights (sha256 {network.info.weights_sha256[:12]})"
        )
    info = msgspec.structs.replace(network.info, precision="float32", sha256="")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "float32.onnx"
        file.write_bytes(onnx_graph.build_float(weights, info).SerializeToString())
        return Network.load(file)


def _describe(network: Network, feed: Feed, kind: Regions) -> NDArray[np.float32]:
    """Raw descriptors (N, R, D) of all frames."""
    return np.stack([network.describe(regions) for regions in _regions(feed, kind)])


def _correct(query: Feed, reference: Feed, args: argparse.Namespace) -> NDArray[np.bool_]:
    """(N, M): the reference frames that are right for each query frame, by position or else by row."""
    here, there = _positions(query), _positions(reference)
    if here is not None and there is not None:
        meters = east_north(*np.concatenate([here, there]).T)
        apart_m = np.linalg.norm(meters[: len(here), None] - meters[len(here) :], axis=2)
        return np.asarray(apart_m <= args.tolerance_m)
    if len(query.rows) != len(reference.rows):
        raise FeedError(f"{query.path}, {reference.path}: no positions, and not the same number of rows to go by")
    rows = np.arange(len(query.rows))
    return np.asarray(abs(rows[:, None] - rows) <= args.tolerance_frames)


def _positions(feed: Feed) -> NDArray[np.float64] | None:
    """Latitude and longitude (N, 2) in degrees, None unless every row has both."""
    found = [(row.lat_deg, row.lon_deg) for row in feed.rows if row.lat_deg is not None and row.lon_deg is not None]
    return np.array(found, dtype=np.float64) if len(found) == len(feed.rows) else None
