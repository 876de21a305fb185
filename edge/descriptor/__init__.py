"""From a picture to what a place means: regions, a descriptor of each, and its normalization over the traverse.

    image (H, W, 3) --regions--> (R, h, w, 3) --network--> raw descriptors (R, D) --normalize--> NSD (R, D)

The file of the network says h, w and D; for the shipped one they are 224, 224 and 4096 (an AlexNet). `sim/model_tools`
makes such a file of any image network at a desk; `open_network` opens it on the provider that the config names.
"""

from __future__ import annotations

from edge.descriptor.normalize import NormalizedRows, RunningStatistics
from edge.descriptor.normalize import normalize as normalized

__all__ = ["NormalizedRows", "RunningStatistics", "normalized"]
