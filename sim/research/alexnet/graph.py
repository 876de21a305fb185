"""AlexNet weights to float ONNX graphs: the network, cut at a tap."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edge.descriptor.model_file import ModelInfo
from sim.model_tools.onnx_graph import MEAN_RGB, STD_RGB, GraphBuilder, Weights
from sim.research.alexnet.weights import CONVS, FC6, FC6_SHAPE, Conv

if TYPE_CHECKING:
    import onnx

INPUT_SIZE = 224
PAD_LEVEL = 114
"""Gray level that stands for nothing: the mean of MEAN_RGB, and what conv1 sees beyond the picture's edge.

The networks were trained with zeros there, after normalization, which is up to 10 levels from this gray. A gray
that all channels share lets the pixels enter the int8 network as they are, without rounding them again.
"""
DIMENSIONS = {"fc6": FC6_SHAPE[0], "conv3": 384 * 13 * 13}


def alexnet_info(
    name: str,
    tap: str = "fc6",
    *,
    license: str = "not stated",
    source: str = "not stated",
    weights_sha256: str = "",
    calibration: str = "",
) -> ModelInfo:
    """The metadata of a float network that `build_float` makes."""
    return ModelInfo(
        name=name,
        tap=tap,
        dimensions=DIMENSIONS[tap],
        precision="float32",
        input_size=INPUT_SIZE,
        channel_order="BGR",
        mean_rgb=MEAN_RGB,
        std_rgb=STD_RGB,
        license=license,
        source=source,
        weights_sha256=weights_sha256,
        calibration=calibration,
    )


def build_float(weights: Weights, info: ModelInfo) -> onnx.ModelProto:
    """Pixels (B, 224, 224, 3) uint8 BGR to the tap that `info` names, after ReLU, (B, dimensions) float32."""
    graph = GraphBuilder()
    # pixel - PAD_LEVEL; with step 1 and the int8 zero point PAD_LEVEL - 128 this costs no rounding.
    graph.add("DequantizeLinear", ["image", graph.constant("step", 1.0), graph.constant("grey", np.uint8(PAD_LEVEL))])
    graph.add("Transpose", [graph.last], output="input", perm=[0, 3, 1, 2])
    for conv in CONVS:
        _add_conv(graph, conv, *_conv_parameters(weights, conv.layer))
        if info.tap == "conv3" and conv.layer == "features.6":
            graph.add("Flatten", [graph.last], output=info.tap, axis=1)
            break
    else:
        graph.add("Flatten", [graph.last], axis=1)
        graph.add_dense(FC6, weights)
        graph.add("Relu", [graph.last], output=info.tap)
    return graph.finish("image", [INPUT_SIZE, INPUT_SIZE, 3], np.uint8, info)


def _add_conv(graph: GraphBuilder, conv: Conv, weight: NDArray[np.float32], bias: NDArray[np.float32]) -> None:
    """Convolution of the tensor that was added last, ReLU (its output is named as the layer) and max pool."""
    parameters = [graph.constant(f"{conv.layer}.weight", weight), graph.constant(f"{conv.layer}.bias", bias)]
    kernel, strides, pads = list(conv.shape[2:]), [conv.stride] * 2, [conv.pad] * 4
    graph.add("Conv", [graph.last, *parameters], kernel_shape=kernel, strides=strides, pads=pads)
    graph.add("Relu", [graph.last], output=conv.layer)
    if conv.pool:
        graph.add("MaxPool", [graph.last], kernel_shape=[3, 3], strides=[2, 2])


def _conv_parameters(weights: Weights, layer: str) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Weights and biases; into conv1's go the normalization of RGB and the order BGR of its input."""
    weight, bias = weights[f"{layer}.weight"], weights[f"{layer}.bias"]
    if layer != CONVS[0].layer:
        return weight, bias
    # w (x / 255 - mean) / std + b = w' (x - gray) + b', with w' = w / (255 std), b' = b + sum w' (gray - 255 mean)
    mean, std = (255 * np.asarray(values, np.float64).reshape(1, 3, 1, 1) for values in (MEAN_RGB, STD_RGB))
    scaled = weight / std
    shifted = bias + (scaled * (PAD_LEVEL - mean)).sum(axis=(1, 2, 3))
    return scaled[:, ::-1].astype(np.float32), shifted.astype(np.float32)
