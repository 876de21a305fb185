"""`lookback dev alexnet`: the network of a vehicle from weights of AlexNet, as the shipped one was made."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec

from edge.descriptor.model_file import ModelInfo
from edge.errors import ModelError
from sim.model_tools.import_command import add_kept_texts, calibration_images, network_file, spell_calibration, write
from sim.model_tools.quantize import Ranges, measure_ranges, quantize
from sim.research.alexnet.graph import DIMENSIONS, alexnet_info, build_float
from sim.research.alexnet.weights import CONVS, FC6, read_weights

if TYPE_CHECKING:
    import onnx

RANGE_SHARE = 0.8
"""Share of a tensor's least and greatest value that int8 spans; what is beyond is clipped.

The greatest value of many images is an outlier, and the finer step gains more than clipping it loses: cosine to
float after NSD 0.9963 to 0.9970 (mean over the corridor and track feeds), 0.967 to 0.978 on darkened frames.
"""
LAYERS = (*(conv.layer for conv in CONVS), FC6)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback dev alexnet`."""
    parser.add_argument(
        "weights", type=Path, metavar="WEIGHTS", help=".npz, or with PyTorch .pth and .pth.tar, in torchvision's layout"
    )
    parser.add_argument("-o", "--output", type=Path, required=True, help="a folder, or the network file (.onnx)")
    ranges = parser.add_mutually_exclusive_group(required=True)
    ranges.add_argument("--ranges", type=Path, metavar="JSON", help="measured ranges of the layers, before ReLU")
    ranges.add_argument("--calibrate", type=Path, nargs="+", metavar="FEED", help="measure the ranges on these feeds")
    add_kept_texts(parser)
    parser.add_argument("--tap", choices=tuple(DIMENSIONS), default="fc6", help="the layer to use (default fc6)")
    parser.add_argument("--float", action="store_true", help="write the float network beside it, for `model verify`")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    weights, sha256 = read_weights(args.weights)
    info = alexnet_info(
        args.name or args.weights.name.partition(".")[0],
        args.tap,
        license=args.license or "not stated",
        source=args.source or "not stated",
        weights_sha256=sha256,
        calibration=spell_calibration(args.calibrate, args.ranges, RANGE_SHARE),
    )
    file = network_file(args.output, f"{args.tap}_int8.onnx")
    exact = build_float(weights, info)
    if args.float:
        write(exact, file.with_name(f"{args.tap}_float32.onnx"))
    if args.ranges:
        ranges = read_layer_ranges(args.ranges)
    else:
        ranges = measure_ranges(exact, calibration_images(args.calibrate, info))
    write(as_int8(exact, ranges, msgspec.structs.replace(info, precision="int8")), file)
    return 0


def as_int8(exact: onnx.ModelProto, ranges: Ranges, info: ModelInfo) -> onnx.ModelProto:
    """int8 of the network, with signed activations."""
    return quantize(exact, ranges, info, signed=True, share=RANGE_SHARE)


class LayerRange(msgspec.Struct, frozen=True):
    """Least and greatest output of a layer before ReLU, over all calibration images."""

    min: float
    max: Annotated[float, msgspec.Meta(gt=0)]


def read_layer_ranges(path: Path) -> Ranges:
    """Ranges of AlexNet's layers after ReLU, of a JSON file {layer: {min, max}}. ModelError names file and layer."""
    try:
        given = msgspec.json.decode(path.read_bytes(), type=dict[str, msgspec.Raw])
    except OSError as error:
        raise ModelError(f"{path}: cannot read the ranges: {error.strerror}") from None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise ModelError(f"{path}: {error}") from None
    ranges = {}
    for layer in LAYERS:
        if layer not in given:
            raise ModelError(f"{path}: no range of {layer}; it needs {{min, max}} of {', '.join(LAYERS)}")
        try:
            ranges[layer] = (0.0, msgspec.json.decode(given[layer], type=LayerRange).max)
        except msgspec.ValidationError as error:
            raise ModelError(f"{path}: {layer}: {error}") from None
    return ranges
