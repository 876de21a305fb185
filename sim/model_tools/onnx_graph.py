"""What a network file says of itself, and what the graphs that `lookback model import` makes have in common.

`onnx` is imported when a graph is made: a vehicle has no use for it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from edge.descriptor.model_file import METADATA_KEY, ModelInfo

if TYPE_CHECKING:
    import onnx

MEAN_RGB = (0.485, 0.456, 0.406)  # of ImageNet, over 0..1, as most published weights were trained with
STD_RGB = (0.229, 0.224, 0.225)
NORMALIZE = "normalize"
"""How the names of nodes begin that stay in float: what prepares an image, and what averages a feature map."""


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
