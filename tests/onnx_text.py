"""Small networks, as ONNX writes them in text."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray


def onnx_of(text: str, **constants: NDArray[Any]) -> Any:
    """The model of a graph, NAME (INPUTS) => (OUTPUTS) { NODES }, and of its constants."""
    import onnx

    model = onnx.parser.parse_model(f'<ir_version: 8, opset_import: ["": 17]> {text}')
    model.graph.initializer.extend(onnx.numpy_helper.from_array(array, name) for name, array in constants.items())
    onnx.checker.check_model(model)
    return model
