"""Float graph to int8 by ONNX Runtime's quantization: static QDQ, signed weights per output channel.

Nothing is fused beforehand: ONNX Runtime's pre-processing would rename the tensors that the ranges are given for.
"""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from edge.descriptor.model_file import ModelInfo
from edge.descriptor.network import IMAGE
from edge.errors import ModelError
from sim.model_tools.onnx_graph import NORMALIZE, set_info

if TYPE_CHECKING:
    import onnx

QUANTIZED_OPERATORS = ["Conv", "Relu", "Clip", "Add", "Mul", "MaxPool", "Flatten", "Gemm", "Concat"]
_PIXELS = "input"  # the tensor of pixels less the gray that stands for nothing


def measure_ranges(float_model: onnx.ModelProto, images: Iterable[NDArray[np.uint8]]) -> Any:
    """Least and greatest value of each tensor (ONNX Runtime's TensorsData), over images (H, W, 3) uint8 BGR."""
    import onnx
    from onnxruntime.quantization.calibrate import TensorData, create_calibrator

    given = ({IMAGE: image[np.newaxis]} for image in images)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "float.onnx"
        onnx.save(float_model, file)
        calibrator = create_calibrator(file, QUANTIZED_OPERATORS, str(Path(folder) / "augmented.onnx"))
        calibrator.collect_data(SimpleNamespace(get_next=lambda: next(given, None)))
        ranges = calibrator.compute_data()
    for name, found in ranges.items():
        low, high = found.range_value
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise ModelError(f"no output of {name} over the calibration images; use real ones")
    gray = next(tensor for tensor in float_model.graph.initializer if tensor.name == "grey")
    level = np.float32(onnx.numpy_helper.to_array(gray))
    # Pixels are whole numbers of this range: int8 has them as they are.
    ranges.data[_PIXELS] = TensorData(lowest=-level, highest=np.float32(255) - level)
    return ranges


def quantize(float_model: onnx.ModelProto, ranges: Any, info: ModelInfo, *, float_layers: int = 0) -> onnx.ModelProto:
    """int8 model of a network, with the ranges of its tensors.

    Every output of a fully connected layer stays float32: its accumulators are int32 anyway. float_layers: so many of
    the first convolutions and fully connected layers stay in float.
    """
    import onnx
    from onnxruntime.quantization import QuantType
    from onnxruntime.quantization.qdq_quantizer import QDQQuantizer

    model = onnx.ModelProto()
    model.CopyFrom(float_model)
    quantizer = QDQQuantizer(
        model,
        per_channel=True,
        reduce_range=False,
        weight_qType=QuantType.QInt8,
        activation_qType=QuantType.QUInt8,
        tensors_range=ranges,
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
