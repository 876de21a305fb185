"""`lookback model import`: the network of a vehicle, from an ONNX or PyTorch network or a recipe."""

from __future__ import annotations

import argparse
import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
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
from sim.model_tools import efficientnet, onnx_graph, onnx_import, quantize, xfeat
from sim.model_tools.frames import kinds_of, pictures_of
from sim.model_tools.torch_file import export_onnx
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
    about = (
        f"a network (.onnx, TorchScript .pt, exported .pt2), {efficientnet.NAME} (extra efficientnet) or {xfeat.NAME}"
    )
    parser.add_argument("weights", type=Path, metavar="MODEL", help=about)
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


@dataclass(frozen=True)
class _Source:
    """A float ONNX file, and what is known of it."""

    data: bytes
    sha256: str
    name: str
    license: str
    source: str
    wanted: onnx_import.ImageInput
    tap: str
    pool: tuple[int, int] | None
    columns: int | None


def run(args: argparse.Namespace) -> int:
    """Write the network file."""
    if str(args.weights) == xfeat.NAME:
        return _keypoints(args)
    is_recipe = str(args.weights) == efficientnet.NAME
    if not (is_recipe or args.weights.suffix in (".onnx", ".pt", ".pt2")):
        raise ConfigError(f"{args.weights}: not an .onnx, .pt or .pt2 file")
    if not (args.calibrate or args.float_only):
        raise ConfigError("model import: give feeds to --calibrate, or --float-only")
    source = _recipe(args) if is_recipe else _file(args)
    found = onnx_import.import_onnx(args.weights, source.data, source.wanted, source.tap, source.pool, source.columns)
    info = _info(args, source, found)
    file = network_file(args.output, NETWORK_FILE)
    exact = found.model
    onnx_graph.set_info(exact, info)
    if args.float or args.float_only:
        written = file if args.float_only and args.output.suffix == ".onnx" else file.with_name("network_float32.onnx")
        write(exact, written)
    if not args.float_only:
        write(_rounded(args.calibrate, exact, info), file)
    return 0


def _keypoints(args: argparse.Namespace) -> int:
    """XFeat, which is no descriptor and whose graph has nothing to choose."""
    no = ("calibrate", "name", "license", "source", "tap", "float", "pool", "columns", "size", "layout", "mean", "std")
    if given := [f"--{name}" for name in no if getattr(args, name)]:
        raise ConfigError(f"model import {xfeat.NAME}: has no {', '.join(given)}; it is made whole, and in float")
    write(xfeat.build(*xfeat.read_packaged_weights()), network_file(args.output, "network_float32.onnx"))
    return 0


def _file(args: argparse.Namespace) -> _Source:
    """An ONNX or PyTorch file, prepared as the options say."""
    if not (args.white > 0 and min(args.std or (1.0,)) > 0):
        raise ConfigError("--white and --std: need numbers above 0")
    scale = 1 / args.white
    mean = [scale * one for one in args.mean] if args.mean else onnx_graph.MEAN_RGB
    std = [scale * one for one in args.std] if args.std else onnx_graph.STD_RGB
    size = _pair("--size", args.size)
    wanted = onnx_import.ImageInput(
        size, args.layout, (mean[0], mean[1], mean[2]), (std[0], std[1], std[2]), args.channels
    )
    with refusing(ModelError, f"{args.weights}: cannot read the network"):
        data = args.weights.read_bytes()
    sha256 = hashlib.sha256(data).hexdigest()
    if args.weights.suffix != ".onnx":
        data = export_onnx(args.weights, size or (onnx_import.DEFAULT_SIZE,) * 2)
    name = args.name or args.weights.name.partition(".")[0]
    terms = args.license or "not stated", args.source or args.weights.name
    return _Source(data, sha256, name, *terms, wanted, args.tap or "", _pair("--pool", args.pool), args.columns)


def _recipe(args: argparse.Namespace) -> _Source:
    """EfficientNet-Lite0: the grid, unless the options say where to tap it."""
    weights, sha256 = efficientnet.read_packaged_weights()
    wanted = onnx_import.ImageInput(None, None, efficientnet.MEAN_RGB, efficientnet.STD_RGB)
    own = args.tap is not None
    size = _pair("--size", args.size) or ((efficientnet.INPUT_SIZE,) * 2 if own else efficientnet.GRID_SIZE)
    pool = _pair("--pool", args.pool) if own or args.pool else efficientnet.GRID
    columns = args.columns if own or args.pool else efficientnet.GRID_COLUMNS
    data = efficientnet.build(weights, size).SerializeToString(deterministic=True)
    name, tap = args.name or ("grid" if args.tap is None else efficientnet.NAME), args.tap or efficientnet.TAP
    return _Source(data, sha256, name, efficientnet.LICENSE, efficientnet.SOURCE, wanted, tap, pool, columns)


def _info(args: argparse.Namespace, source: _Source, found: onnx_import.FloatGraph) -> ModelInfo:
    height, width = found.size
    return ModelInfo(
        name=source.name,
        tap=found.tap,
        dimensions=found.dimensions,
        precision="float32",
        input_size=height if height == width else (height, width),
        channel_order="BGR",
        mean_rgb=source.wanted.mean_rgb,
        std_rgb=source.wanted.std_rgb,
        license=source.license,
        source=source.source,
        weights_sha256=source.sha256,
        calibration="" if args.float_only else "feeds " + ", ".join(path.name for path in args.calibrate),
        pool=onnx_import.spell(source.pool) if source.pool else "",
        columns=found.columns,
    )


def _rounded(feeds: list[Path], exact: onnx.ModelProto, info: ModelInfo) -> onnx.ModelProto:
    """The int8 network, with as many of its first layers in float as it needs to pass the check on the feeds."""
    info = msgspec.structs.replace(info, precision="int8")
    images = [list(calibration_images([path], info)) for path in feeds]
    ranges = quantize.measure_ranges(exact, chain.from_iterable(images))
    best = None
    for count in FLOAT_LAYERS:
        said = f"{info.calibration}, first {count} layers in float" if count else info.calibration
        as_made = msgspec.structs.replace(info, calibration=said)
        model = quantize.quantize(exact, ranges, as_made, float_layers=count)
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
        data = model.SerializeToString()
        network = Network(ModelFile(Path("network"), data, onnx_graph.get_info(model)))
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


def network_file(output: Path, name: str) -> Path:
    """`output`, or the file of that name in it; the folder is made before the long work. ModelError."""
    file = output if output.suffix == ".onnx" else output / name
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
