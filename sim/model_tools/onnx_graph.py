"""AlexNet weights to float ONNX graphs: the network, cut at a tap, and the head after fc6.

`onnx` is imported only here and in `quantize`, when a graph is built: a vehicle has no use for it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.descriptor.model_file import METADATA_KEY, ModelInfo
from edge.errors import ModelError
from edge.extras import install_command
from sim.model_tools.weights import CONVS, FC6, FC6_SHAPE, FC7, FC8, Conv, Weights

if TYPE_CHECKING:
    import onnx

INPUT_SIZE = 224
MEAN_RGB = (0.485, 0.456, 0.406)  # of ImageNet, over 0..1, as both published and shipped weights were trained with
STD_RGB = (0.229, 0.224, 0.225)
PAD_LEVEL = 114
"""Gray level that stands for nothing: the mean of MEAN_RGB, and what conv1 sees beyond the picture's edge.

The networks were trained with zeros there, after normalization, which is up to 10 levels from this gray. A gray
that all channels share lets the pixels enter the int8 network as they are, without rounding them again.
"""
NORMALIZE = "normalize"
"""How the names of nodes begin that stay in float: what prepares an image, and what averages a feature map."""
OPSET, IR_VERSION = 17, 8  # read by ONNX Runtime since 1.12
DIMENSIONS = {"fc6": FC6_SHAPE[0], "conv3": 384 * 13 * 13}


def alexnet_info(
    name: str,
    tap: str = "fc6",
    *,
    labels: tuple[str, ...] = (),
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
        labels=labels,
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
    tensor = graph.add("Transpose", [graph.last], output="input", perm=[0, 3, 1, 2])
    for conv in CONVS:
        tensor = graph.add_conv(conv, tensor, *_conv_parameters(weights, conv.layer))
        if info.tap == "conv3" and conv.layer == "features.6":
            graph.add("Flatten", [tensor], output=info.tap, axis=1)
            break
    else:
        graph.add("Flatten", [tensor], axis=1)
        graph.add_dense(FC6, weights)
        graph.add("Relu", [graph.last], output=info.tap)
    return graph.finish("image", [INPUT_SIZE, INPUT_SIZE, 3], np.uint8, info)


def build_head(weights: Weights, info: ModelInfo) -> onnx.ModelProto:
    """fc6 after ReLU (R, 4096) float32 to the categories' probabilities (R, C) float32."""
    graph = GraphBuilder()
    graph.last = "fc6"
    graph.add_dense(FC7, weights)
    # A ReLU here would be fused with the float layer before that is made int8, at fifty times the cost.
    graph.add("Max", [graph.last, graph.constant("zero", 0.0)])
    graph.add_dense(FC8, weights)
    graph.add("Softmax", [graph.last], output=info.tap, axis=1)
    return graph.finish("fc6", [FC6_SHAPE[0]], np.float32, info)


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


class GraphBuilder:
    """Collects the nodes and constants of one ONNX graph; `last` is the tensor that was added last."""

    def __init__(self) -> None:
        """ModelError where the `onnx` package is missing."""
        try:
            import onnx
        except ImportError:
            raise ModelError(f"importing a model needs the onnx package: {install_command('model')}") from None
        self._onnx = onnx
        self._nodes: list[onnx.NodeProto] = []
        self._constants: list[onnx.TensorProto] = []
        self.last = ""

    def constant(self, name: str, value: float | NDArray[Any] | np.generic) -> str:
        """Add a constant (Python numbers become float32) and return its name."""
        array = np.ascontiguousarray(np.float32(value) if isinstance(value, float) else value)
        # ascontiguousarray makes a scalar one-dimensional; a scale must stay a scalar.
        self._constants.append(self._onnx.numpy_helper.from_array(array.reshape(np.shape(value)), name))
        return name

    def add(self, operator: str, inputs: list[str], output: str = "", **attributes: Any) -> str:
        """Add a node and return the name of its output."""
        self.last = output or f"{inputs[0]}.{operator.lower()}"
        self._nodes.append(self._onnx.helper.make_node(operator, inputs, [self.last], name=self.last, **attributes))
        return self.last

    def add_conv(self, conv: Conv, tensor: str, weight: NDArray[np.float32], bias: NDArray[np.float32]) -> str:
        """Convolution, ReLU (its output is named as the layer) and max pool."""
        kernel = list(conv.shape[2:])
        parameters = [self.constant(f"{conv.layer}.weight", weight), self.constant(f"{conv.layer}.bias", bias)]
        self.add("Conv", [tensor, *parameters], kernel_shape=kernel, strides=[conv.stride] * 2, pads=[conv.pad] * 4)
        self.add("Relu", [self.last], output=conv.layer)
        if conv.pool:
            self.add("MaxPool", [self.last], kernel_shape=[3, 3], strides=[2, 2])
        return self.last

    def add_dense(self, layer: str, weights: Weights) -> str:
        """Fully connected layer on `last`, named as the layer."""
        # ONNX Runtime keeps a weight matrix twice when it has to transpose it while loading (38 MB of fc6).
        weight = self.constant(f"{layer}.weight", weights[f"{layer}.weight"].T)
        return self.add("Gemm", [self.last, weight, self.constant(f"{layer}.bias", weights[f"{layer}.bias"])], layer)

    def finish(self, name: str, shape: list[int], dtype: type[np.generic], info: ModelInfo) -> onnx.ModelProto:
        """The model with one input and, as its one output, the tensor that was added last; with its metadata."""
        model = self.model("alexnet", [(name, dtype, shape)], info.dimensions)
        set_info(model, info)
        return model

    def model(
        self, name: str, inputs: list[tuple[str, type[np.generic], list[int]]], dimensions: int
    ) -> onnx.ModelProto:
        """The model; each input has a name, a type, and a shape without its first axis, the batch."""
        helper, kinds = self._onnx.helper, self._onnx.TensorProto
        given = [
            helper.make_tensor_value_info(key, helper.np_dtype_to_tensor_dtype(np.dtype(dtype)), ["B", *shape])
            for key, dtype, shape in inputs
        ]
        result = helper.make_tensor_value_info(self.last, kinds.FLOAT, ["B", dimensions])
        graph = helper.make_graph(self._nodes, name, given, [result], self._constants)
        model: onnx.ModelProto = helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION
        )
        self._onnx.checker.check_model(model)
        return model


def set_info(model: onnx.ModelProto, info: ModelInfo) -> None:
    """Write what the file says of itself into its metadata."""
    import onnx

    fields = msgspec.to_builtins(info)
    if not info.pool:
        del fields["pool"]  # networks that were made before there was a pool keep their bytes
    onnx.helper.set_model_props(model, {METADATA_KEY: msgspec.json.encode(fields).decode()})


def get_info(model: onnx.ModelProto) -> ModelInfo:
    """What `set_info` wrote."""
    return msgspec.json.decode(
        next(one.value for one in model.metadata_props if one.key == METADATA_KEY), type=ModelInfo
    )
