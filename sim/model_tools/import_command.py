"""`lookback model import`: the network of a vehicle, from an ONNX network."""

from __future__ import annotations

import argparse
import hashlib
import re
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.descriptor.model_file import NETWORK_FILE, ModelFile, ModelInfo, hash_file, read_model_file
from edge.descriptor.network import Network
from edge.descriptor.open_network import NSD_COSINE_MIN, nsd_cosines
from edge.errors import ConfigError, ModelError
from edge.feed import read_feed
from edge.files import replacing
from sim.model_tools import onnx_graph, onnx_import, quantize
from sim.model_tools.frames import kinds_of, pictures_of
from sim.output import refusing

if TYPE_CHECKING:
    import onnx

MAX_CALIBRATION_FRAMES = 500  # of each feed, evenly spread; more move the ranges by little
MAX_COMPARED = 60  # regions on which int8 is compared with float while it is chosen what stays in float
FLOAT_LAYERS = (0, 2, 4, 6, 8, 12, 16, 24, 32)
"""How many of the first layers are tried in float until int8 is close enough; the first ones lose most by rounding."""
MARGIN = 0.001
"""By how much the calibration images must exceed NSD_COSINE_MIN: other images do a little worse."""


def add_import(parser: argparse.ArgumentParser) -> None:
    """Add the options of `lookback model import`."""
    parser.add_argument("weights", type=Path, metavar="MODEL", help="an ONNX file, of PyTorch by `torch.onnx.export`")
    parser.add_argument("-o", "--output", type=Path, required=True, help="a folder, or the network file (.onnx)")
    about = "measure the ranges of int8 on these feeds"
    parser.add_argument("--calibrate", type=Path, nargs="+", metavar="FEED", help=about)
    parser.add_argument("--name", help="name of the network (default: that of the file)")
    parser.add_argument("--license", help="terms of the weights, kept in the file")
    parser.add_argument("--source", help="origin of the weights, kept in the file")
    parser.add_argument("--tap", help="the tensor to use (default: the network's output)")
    parser.add_argument("--float", action="store_true", help="write the float network beside it, for `model verify`")
    parser.add_argument("--float-only", action="store_true", help="write the float network instead of an int8 one")
    image = parser.add_argument_group("image networks")
    image.add_argument("--pool", metavar="RxC", help="average a feature map over a grid, such as 1x1, 2x2 or 4x4")
    columns = "give the network the whole picture: so many of the grid's columns at each side are its two regions"
    image.add_argument("--columns", type=int, metavar="N", help=columns)
    image.add_argument("--size", metavar="HxW", help="height and width of the image, where the file leaves them open")
    image.add_argument("--layout", choices=("nchw", "nhwc"), help="order of the axes (default: by the axis of size 3)")
    image.add_argument("--channels", choices=("RGB", "BGR"), default="RGB", help="order of the colors (default RGB)")
    rgb = ("R", "G", "B")
    image.add_argument("--mean", type=float, nargs=3, metavar=rgb, help="subtracted first (default: of ImageNet)")
    image.add_argument("--std", type=float, nargs=3, metavar=rgb, help="divided by then (default: of ImageNet)")
    image.add_argument("--white", type=float, default=1.0, help="of a white pixel, before --mean: 1 (default) or 255")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the network file."""
    if args.weights.suffix != ".onnx":
        raise ConfigError(f"{args.weights}: not an .onnx file; `torch.onnx.export` makes one of a network of PyTorch")
    if not (args.calibrate or args.float_only):
        raise ConfigError("model import: give feeds to --calibrate, or --float-only")
    wanted, pool = _wanted(args), _pair("--pool", args.pool)
    with refusing(ModelError, f"{args.weights}: cannot read the network"):
        data = args.weights.read_bytes()
    found = onnx_import.import_onnx(args.weights, data, wanted, args.tap or "", pool, args.columns)
    height, width = found.size
    info = ModelInfo(
        name=args.name or args.weights.name.partition(".")[0],
        tap=found.tap,
        dimensions=found.dimensions,
        precision="float32",
        input_size=height if height == width else (height, width),
        channel_order="BGR",
        mean_rgb=wanted.mean_rgb,
        std_rgb=wanted.std_rgb,
        license=args.license or "not stated",
        source=args.source or args.weights.name,
        weights_sha256=hashlib.sha256(data).hexdigest(),
        calibration="" if args.float_only else "feeds " + ", ".join(path.name for path in args.calibrate),
        pool=onnx_import.spell(pool) if pool else "",
        columns=found.columns,
    )
    file = network_file(args.output)
    exact = found.model
    onnx_graph.set_info(exact, info)
    if args.float or args.float_only:
        written = file if args.float_only and args.output.suffix == ".onnx" else file.with_name("network_float32.onnx")
        write(exact, written)
    if not args.float_only:
        write(_rounded(args.calibrate, exact, info), file)
    return 0


def _wanted(args: argparse.Namespace) -> onnx_import.ImageInput:
    """How the network wants its image, as the options say."""
    if not (args.white > 0 and min(args.std or (1.0,)) > 0):
        raise ConfigError("--white and --std: need numbers above 0")
    mean = [one / args.white for one in args.mean] if args.mean else onnx_graph.MEAN_RGB
    std = [one / args.white for one in args.std] if args.std else onnx_graph.STD_RGB
    size = _pair("--size", args.size)
    return onnx_import.ImageInput(
        size, args.layout, (mean[0], mean[1], mean[2]), (std[0], std[1], std[2]), args.channels
    )


def _rounded(feeds: list[Path], exact: onnx.ModelProto, info: ModelInfo) -> onnx.ModelProto:
    """The int8 network, with as many of its first layers in float as it needs to pass the check on the feeds."""
    info = msgspec.structs.replace(info, precision="int8")
    images = [list(calibration_images([path], info)) for path in feeds]
    ranges = quantize.measure_ranges(exact, chain.from_iterable(images))
    best = None
    for count in FLOAT_LAYERS:
        said = f"{info.calibration}, first {count} layers in float" if count else info.calibration
        model = quantize.quantize(exact, ranges, msgspec.structs.replace(info, calibration=said), float_layers=count)
        cosine = min(_agreement(exact, model, feed[:: -(-len(feed) // MAX_COMPARED)]) for feed in images)
        print(f"int8 with {count} layers in float: cosine to float after NSD {cosine:.4f}")
        if best is None or cosine > best[0]:
            best = cosine, model
        if cosine >= NSD_COSINE_MIN + MARGIN or count >= quantize.layer_count(exact):
            break
    assert best is not None
    if best[0] < NSD_COSINE_MIN:
        print(f"int8 loses too much of this network ({NSD_COSINE_MIN} is needed); --float-only keeps it in float")
    return best[1]


def _agreement(exact: onnx.ModelProto, rounded: onnx.ModelProto, images: list[NDArray[np.uint8]]) -> float:
    """Mean cosine after NSD over the images."""
    described = []
    for model in (exact, rounded):
        network = Network(ModelFile(Path("network"), model.SerializeToString(), onnx_graph.get_info(model)))
        described.append(np.stack([network.describe(image[np.newaxis]) for image in images]))
    return float(nsd_cosines(*described).mean())


def calibration_images(paths: list[Path], info: ModelInfo) -> Iterator[NDArray[np.uint8]]:
    """Whole images and, if the network takes regions, both sides of the feeds' frames."""
    for feed in [read_feed(path) for path in paths]:
        step = -(-len(feed.rows) // MAX_CALIBRATION_FRAMES)
        for kind in kinds_of(info):
            for pictures in pictures_of(feed, kind, info, step):
                yield from pictures


def _pair(option: str, text: str | None) -> tuple[int, int] | None:
    """Two whole numbers as 2x3, or one for both; ConfigError names the option."""
    if not text or text == "none":
        return None
    match = re.fullmatch(r"(\d{1,4})(?:x(\d{1,4}))?", text)
    pair = (int(match[1]), int(match[2] or match[1])) if match else (0, 0)
    if min(pair) < 1:
        raise ConfigError(f"{option}: {text!r} is not two numbers such as 4x4")
    return pair


def network_file(output: Path) -> Path:
    """`output`, or NETWORK_FILE in it; the folder is made before the long work. ModelError."""
    file = output if output.suffix == ".onnx" else output / NETWORK_FILE
    with refusing(ModelError, f"{file}: cannot write it"):
        file.parent.mkdir(parents=True, exist_ok=True)
    return file


def write(model: onnx.ModelProto, file: Path) -> str:
    """Write a network, and the file of its sha256, which a vehicle asks for; read it back, and return that."""
    data = model.SerializeToString(deterministic=True)
    line = f"{hashlib.sha256(data).hexdigest()}  {file.name}\n"
    for path, content in ((file, data), (hash_file(file), line.encode())):
        with refusing(ModelError, f"{path}: cannot write it"), replacing(path) as stream:
            stream.write(content)
    info = read_model_file(file).info
    print(f"{file}: {info.output}, {info.precision}, {file.stat().st_size / 1e6:.1f} MB, sha256 {info.sha256}")
    return info.sha256
