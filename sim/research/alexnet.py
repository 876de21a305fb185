"""The network fc6 in float, as an ONNX graph, from AlexNet's weights by torchvision's names.

The layout is that of torchvision.models.alexnet
(https://github.com/pytorch/vision/blob/main/torchvision/models/alexnet.py) and of the published Places365 network.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edge.descriptor.model_file import ModelInfo
from sim.model_tools.onnx_graph import MEAN_RGB, STD_RGB, GraphBuilder, Weights

if TYPE_CHECKING:
    import onnx


@dataclass(frozen=True)
class Conv:
    """A convolution of torchvision's `features`, and whether a max pool (3, stride 2) follows its ReLU."""

    layer: str
    shape: tuple[int, int, int, int]
    stride: int
    pad: int
    pool: bool


CONVS = (
    Conv("features.0", (64, 3, 11, 11), stride=4, pad=2, pool=True),
    Conv("features.3", (192, 64, 5, 5), stride=1, pad=2, pool=True),
    Conv("features.6", (384, 192, 3, 3), stride=1, pad=1, pool=False),
    Conv("features.8", (256, 384, 3, 3), stride=1, pad=1, pool=False),
    Conv("features.10", (256, 256, 3, 3), stride=1, pad=1, pool=True),
)
FC6 = "classifier.1"
FC6_SHAPE = (4096, 9216)
INPUT_SIZE = 224
PAD_LEVEL = 114
"""Gray level that stands for nothing: the mean of MEAN_RGB, and what conv1 sees beyond the picture's edge.

The networks were trained with zeros there, after normalization, which is up to 10 levels from this gray. A gray
that all channels share lets the pixels enter the int8 network as they are, without rounding them again.
"""


def alexnet_info(name: str) -> ModelInfo:
    """The metadata of a float network that `build_float` makes."""
    return ModelInfo(
        name=name,
        tap="fc6",
        dimensions=FC6_SHAPE[0],
        precision="float32",
        input_size=INPUT_SIZE,
        channel_order="BGR",
        mean_rgb=MEAN_RGB,
        std_rgb=STD_RGB,
        license="not stated",
        source="not stated",
        weights_sha256="",
        calibration="",
    )


def build_float(weights: Weights, info: ModelInfo) -> onnx.ModelProto:
    """Pixels (B, 224, 224, 3) uint8 BGR to fc6 after ReLU, (B, 4096) float32."""
    graph = GraphBuilder()
    # pixel - PAD_LEVEL; with step 1 and the int8 zero point PAD_LEVEL - 128 this costs no rounding.
    graph.add("DequantizeLinear", ["image", graph.constant("step", 1.0), graph.constant("grey", np.uint8(PAD_LEVEL))])
    graph.add("Transpose", [graph.last], output="input", perm=[0, 3, 1, 2])
    for conv in CONVS:
        _add_conv(graph, conv, *_conv_parameters(weights, conv.layer))
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
