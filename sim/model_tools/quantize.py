"""Float graph to int8: static QDQ, signed weights per output channel.

The graph is quantized with given ranges: they may have been measured elsewhere.
Nothing is fused beforehand: ONNX Runtime's pre-processing would rename the tensors that the ranges are given for.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edge.descriptor.model_file import ModelInfo
from edge.descriptor.network import IMAGE, open_session
from edge.errors import ModelError
from sim.model_tools.onnx_graph import NORMALIZE, set_info

if TYPE_CHECKING:
    import onnx

Ranges = dict[str, tuple[float, float]]
"""Least and greatest value by tensor name."""

QUANTIZED_OPERATORS = ["Conv", "Relu", "Clip", "Add", "Mul", "MaxPool", "Flatten", "Gemm", "Concat"]
_SAME_RANGE = ("MaxPool", "Flatten")
_PIXELS = "input"  # the tensor of pixels less the gray that stands for nothing


def measure_ranges(float_model: onnx.ModelProto, images: Iterable[NDArray[np.uint8]]) -> Ranges:
    """Least and greatest value of each tensor that is quantized, over images (H, W, 3) uint8 BGR."""
    import onnx

    model = onnx.ModelProto()
    model.CopyFrom(float_model)
    names = _tensors(model)
    del model.graph.output[:]
    model.graph.output.extend(onnx.helper.make_tensor_value_info(n, onnx.TensorProto.FLOAT, None) for n in names)
    session = open_session(model.SerializeToString())
    low, high = np.full(len(names), np.inf), np.full(len(names), -np.inf)
    for image in images:
        found = session.run(names, {IMAGE: image[None]})
        low = np.minimum(low, [one.min() for one in found])
        high = np.maximum(high, [one.max() for one in found])
    if not (np.isfinite(low) & np.isfinite(high) & (high > low)).all():
        flat = names[int((np.isfinite(low) & np.isfinite(high) & (high > low)).argmin())]
        raise ModelError(f"no output of {flat} over the calibration images; use real ones")
    return dict(zip(names, zip(low.tolist(), high.tolist(), strict=True), strict=True))


def quantize(
    float_model: onnx.ModelProto,
    ranges: Ranges,
    info: ModelInfo,
    *,
    signed: bool = False,
    share: float = 1.0,
    float_layers: int = 0,
) -> onnx.ModelProto:
    """int8 model of a network, with the ranges of its tensors.

    Every output of a fully connected layer stays float32: its accumulators are int32 anyway. signed: of activations;
    ONNX Runtime fuses additions only where they are not. share: of a tensor's least and greatest value that int8 spans.
    float_layers: so many of the first convolutions and fully connected layers stay in float.
    """
    import onnx
    from onnxruntime.quantization import CalibrationMethod, QuantType
    from onnxruntime.quantization.calibrate import TensorData, TensorsData
    from onnxruntime.quantization.qdq_quantizer import QDQQuantizer

    model = onnx.ModelProto()
    model.CopyFrom(float_model)
    spans = {
        name: TensorData(lowest=np.float32(low), highest=np.float32(high))
        for name, (low, high) in _tensor_ranges(model, ranges, share).items()
    }
    quantizer = QDQQuantizer(
        model,
        per_channel=True,
        reduce_range=False,
        weight_qType=QuantType.QInt8,
        activation_qType=QuantType.QInt8 if signed else QuantType.QUInt8,
        tensors_range=TensorsData(CalibrationMethod.MinMax, spans),
        nodes_to_quantize=[],
        nodes_to_exclude=_in_float(model, float_layers),
        op_types_to_quantize=QUANTIZED_OPERATORS,
        extra_options={"OpTypesToExcludeOutputQuantization": ["Gemm"]},
    )
    logging.disable(logging.WARNING)  # a line for each channel whose weights are tiny
    try:
        quantized: onnx.ModelProto = quantizer.quantize_model()
    finally:
        logging.disable(logging.NOTSET)
    set_info(quantized, info)
    return quantized


def _tensors(model: onnx.ModelProto) -> list[str]:
    """What enters and leaves the operators that are quantized, without constants and pixels."""
    constants = {tensor.name for tensor in model.graph.initializer}
    names = [
        name
        for node in model.graph.node
        if node.op_type in QUANTIZED_OPERATORS and not node.name.startswith(NORMALIZE)
        for name in [*node.input, *node.output]
    ]
    return [name for name in dict.fromkeys(names) if name and name not in constants and name != _PIXELS]


def layer_count(model: onnx.ModelProto) -> int:
    """How many convolutions and fully connected layers there are to quantize."""
    return sum(_is_layer(node) for node in model.graph.node)


def _is_layer(node: onnx.NodeProto) -> bool:
    return node.op_type in ("Conv", "Gemm") and not node.name.startswith(NORMALIZE)


def _in_float(model: onnx.ModelProto, layers: int) -> list[str]:
    """Names of the nodes before the layer of that number, and of those that are never quantized."""
    names, passed = [], 0
    for node in model.graph.node:
        passed += _is_layer(node)
        if (passed <= layers and layers) or node.name.startswith(NORMALIZE):
            names.append(node.name)
    return names


def _tensor_ranges(model: onnx.ModelProto, given: Ranges, share: float) -> Ranges:
    """Ranges of every tensor between nodes: what enters a ReLU has the range of what leaves it."""
    import onnx

    spans = {name: (share * low, share * high) for name, (low, high) in given.items()}
    ranges: Ranges = {}
    grey = next(tensor for tensor in model.graph.initializer if tensor.name == "grey")
    level = float(onnx.numpy_helper.to_array(grey))
    ranges[_PIXELS] = (-level, 255 - level)
    for node in model.graph.node:
        source, result = node.input[0], node.output[0]
        for name in node.input:
            if name in spans:
                ranges.setdefault(name, spans[name])
        if node.op_type in _SAME_RANGE and source in ranges:
            ranges[result] = ranges[source]
        elif result in spans:
            ranges[result] = spans[result]
            if node.op_type in ("Relu", "Clip"):
                ranges[source] = spans[result]
    return ranges
