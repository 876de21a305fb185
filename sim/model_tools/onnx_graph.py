"""ONNX graphs of named nodes and constants, and what a network file says of itself.

`onnx` is imported only here and in `quantize`, when a graph is built: a vehicle has no use for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.descriptor.model_file import METADATA_KEY, ModelInfo
from edge.errors import ModelError
from sim.output import needing

if TYPE_CHECKING:
    import onnx

Weights = Mapping[str, NDArray[np.float32]]
"""By the names that PyTorch gives them."""
MEAN_RGB = (0.485, 0.456, 0.406)  # of ImageNet, over 0..1, as both published and shipped weights were trained with
STD_RGB = (0.229, 0.224, 0.225)
NORMALIZE = "normalize"
"""How the names of nodes begin that stay in float: what prepares an image, and what averages a feature map."""
OPSET, IR_VERSION = 17, 8  # read by ONNX Runtime since 1.12


class GraphBuilder:
    """Collects the nodes and constants of one ONNX graph; `last` is the tensor that was added last."""

    def __init__(self) -> None:
        """ModelError where the `onnx` package is missing."""
        with needing("importing a model", "model", ModelError):
            import onnx
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

    def add_dense(self, layer: str, weights: Weights) -> str:
        """Fully connected layer on `last`, named as the layer."""
        # ONNX Runtime keeps a weight matrix twice when it has to transpose it while loading (38 MB of fc6).
        weight = self.constant(f"{layer}.weight", weights[f"{layer}.weight"].T)
        return self.add("Gemm", [self.last, weight, self.constant(f"{layer}.bias", weights[f"{layer}.bias"])], layer)

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
    for later in ("pool", "columns"):
        if not fields[later]:
            del fields[later]  # networks that were made before there were such keep their bytes
    onnx.helper.set_model_props(model, {METADATA_KEY: msgspec.json.encode(fields).decode()})


def get_info(model: onnx.ModelProto) -> ModelInfo:
    """What `set_info` wrote."""
    return msgspec.json.decode(
        next(one.value for one in model.metadata_props if one.key == METADATA_KEY), type=ModelInfo
    )
