"""Drives over one road as its layers, and what each was good for. `lookback map learn` chooses which are searched.

`learner` runs that command after the drives that live mapping made
`tally`   what the daemon recognized, by map, light and stretch; a file for each run
`stored`  the maps of a folder on the disk, and which are deleted for want of space
`plugin`  counts, for the daemon
`road`    which drives pass the same road, and how alike they look there
"""

from __future__ import annotations

import os
from typing import ClassVar

from edge.config import Config, Section


class LayersConfig(Section, frozen=True):
    """[layers]: what each map of a folder is good for is counted; it has no keys."""

    plugin: ClassVar[str] = "edge_plugins.layers.plugin:Layers"

    def asks(self, config: Config) -> bool:
        """Where the map is a folder of maps."""
        return not os.path.exists(f"{config.map.path}/map.json")  # noqa: PTH110  # Path.exists raises
