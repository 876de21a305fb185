"""From a picture to what a place means: regions, a descriptor of each, and its normalization over the traverse.

    image (H, W, 3) --regions--> (R, h, w, 3) --network--> raw descriptors (R, D) --normalize--> NSD (R, D)

The file of the network says h, w and D; for the shipped one they are 224, 224 and 4096 (an AlexNet). `sim/model_tools`
makes such a file of any image network at a desk; `open_network` opens it on the provider that the config names.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from edge.descriptor.normalize import NormalizedRows, RunningStatistics
from edge.descriptor.normalize import normalize as normalized

if TYPE_CHECKING:
    from edge.descriptor.other_network import Run

__all__ = ["NormalizedRows", "RunningStatistics", "normalized", "open_graph"]


def open_graph(name: str, outputs: tuple[str, ...]) -> Run:
    """The function that gives these outputs for pictures (B, H, W, 3) uint8 BGR; ModelError in one line.

    name: of a network that ships, or its file, which is read, hashed and checked as that of any network.
    """
    from edge.descriptor import other_network  # with ONNX Runtime, which not every use of this package needs

    return other_network.open_graph(Path(name), outputs)
