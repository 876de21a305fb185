"""Float graph to int8: static QDQ, signed activations, signed weights per output channel.

The graph is quantized with given ranges, so that ranges measured elsewhere and ranges measured here take one way.
Nothing is fused beforehand: ONNX Runtime's pre-processing would rename the tensors that the ranges are given for.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.descriptor.model_file import ModelInfo
from edge.descriptor.network import open_session
from edge.errors import ModelError
from sim.model_tools.onnx_graph import PAD_LEVEL, set_info
from sim.model_tools.weights import CONVS, FC6, FC8

if TYPE_CHECKING:
    import onnx

Ranges = dict[str, tuple[float, float]]
"""Least and greatest value by tensor name."""

_LAYERS = (*(conv.layer for conv in CONVS), FC6)
RANGE_SHARE = 0.8
"""Share of a layer's greatest value that int8 spans; what is above is clipped.

The greatest value of many images is an outlier, and the finer step gains more than clipping it loses: cosine to
float after NSD 0.9963 to 0.9970 (mean over the corridor and track feeds), 0.967 to 0.978 on darkened frames.
"""
QUANTIZED_OPERATORS = ["Conv", "Relu", "MaxPool", "Flatten", "Gemm"]


class LayerRange(msgspec.Struct, frozen=True):
    """Least and greatest output of a layer before ReLU, over all calibration images."""

    min: float
    max: Annotated[float, msgspec.Meta(gt=0)]


def read_ranges(path: Path) -> dict[str, float]:
    """Greatest output by layer from a JSON file {layer: {min, max}}. ModelError names file and layer."""
    try:
        given = msgspec.json.decode(path.read_bytes(), type=dict[str, msgspec.Raw])
    except OSError as error:
        raise ModelError(f"{path}: cannot read the ranges: {error.strerror}") from None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise ModelError(f"{path}: {error}") from None
    greatest = {}
    for layer in _LAYERS:
        if layer not in given:
            raise ModelError(f"{path}: no range of {layer}; it needs {{min, max}} of {', '.join(_LAYERS)}")
        try:
            greatest[layer] = msgspec.json.decode(given[layer], type=LayerRange).max
        except msgspec.ValidationError as error:
            raise ModelError(f"{path}: {layer}: {error}") from None
    return greatest


def measure_ranges(float_model: onnx.ModelProto, images: Iterable[NDArray[np.uint8]]) -> dict[str, float]:
    """Greatest output by layer of the fc6 float graph over images (224, 224, 3) uint8 BGR."""
    import onnx

    model = onnx.ModelProto()
    model.CopyFrom(float_model)
    layers = [layer for layer in _LAYERS if any(layer in node.output for node in model.graph.node)]
    del model.graph.output[:]
    model.graph.output.extend(onnx.helper.make_tensor_value_info(n, onnx.TensorProto.FLOAT, None) for n in layers)
    session = open_session(model.SerializeToString())
    greatest = np.zeros(len(layers))
    for image in images:
        greatest = np.maximum(greatest, [output.max() for output in session.run(layers, {"image": image[None]})])
    if not greatest.all():
        raise ModelError(f"no output of {layers[int(greatest.argmin())]} over the calibration images; use real ones")
    return dict(zip(layers, greatest.tolist(), strict=True))


def quantize(float_model: onnx.ModelProto, greatest: dict[str, float], info: ModelInfo) -> onnx.ModelProto:
    """int8 model of a network (greatest output by layer) or of a head (greatest fc6 under classifier.1).

    Every output of the last fully connected layer stays float32: its accumulators are int32 anyway.
    """
    import onnx
    from onnxruntime.quantization import CalibrationMethod, QuantType
    from onnxruntime.quantization.calibrate import TensorData, TensorsData
    from onnxruntime.quantization.qdq_quantizer import QDQQuantizer

    model = onnx.ModelProto()
    model.CopyFrom(float_model)
    ranges = {
        name: TensorData(lowest=np.float32(low), highest=np.float32(high))
        for name, (low, high) in _tensor_ranges(model, greatest).items()
    }
    quantizer = QDQQuantizer(
        model,
        per_channel=True,
        reduce_range=False,
        weight_qType=QuantType.QInt8,
        activation_qType=QuantType.QInt8,
        tensors_range=TensorsData(CalibrationMethod.MinMax, ranges),
        nodes_to_quantize=[],
        nodes_to_exclude=[FC8],  # of a head: small, and no range of its input is known
        op_types_to_quantize=QUANTIZED_OPERATORS,
        extra_options={"OpTypesToExcludeOutputQuantization": ["Gemm"]},
    )
    quantized: onnx.ModelProto = quantizer.quantize_model()
    set_info(quantized, info)
    return quantized


def _tensor_ranges(model: onnx.ModelProto, greatest: dict[str, float]) -> Ranges:
    """Ranges of every tensor between nodes: after ReLU from 0, and the same through pooling and flattening."""
    is_head = model.graph.input[0].name == "fc6"
    ranges: Ranges = (
        {"fc6": (0.0, RANGE_SHARE * greatest[FC6])} if is_head else {"input": (-PAD_LEVEL, 255 - PAD_LEVEL)}
    )
    for node in model.graph.node:
        source, result = node.input[0], node.output[0]
        if node.op_type == "Relu" and result in greatest:
            # The ReLU is the lower end of the range, so a convolution's own output shares it.
            ranges[source] = ranges[result] = (0.0, RANGE_SHARE * greatest[result])
        elif node.op_type in ("MaxPool", "Flatten"):
            ranges[result] = ranges[source]
    return ranges
