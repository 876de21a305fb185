"""What each map of a folder is good for, counted by the daemon."""

from __future__ import annotations

import time
from uuid import uuid4

from edge.plugin import Parts, Plugin, UsedFrame
from edge.reference_map.store import HEADER
from edge_plugins.layers import LayersConfig
from edge_plugins.layers.tally import DriveTally


class Layers(Plugin):
    """Counts what a folder of maps recognizes."""

    def __init__(self, config: LayersConfig, parts: Parts) -> None:
        self._parts = parts
        self._tally: DriveTally | None = None

    def start(self) -> None:
        """Open this run's file of counts."""
        maps = self._parts.recognizer.map_set
        if maps.is_folder and not (maps.path / HEADER).exists():
            self._tally = DriveTally(maps.path, self._parts.config.camera.view, time.time(), uuid4().hex)

    def frame_used(self, used: UsedFrame) -> None:
        """Count a believed frame."""
        match = used.match
        if self._tally is None or match is None or not match.accepted:
            return
        maps, now_ns = self._parts.recognizer.map_set, self._parts.clock_ns()
        self._tally.count(maps, match.place_index, match.direction, used.frame.image, used.distance_m, now_ns)

    def close(self) -> None:
        """Write the counts."""
        if self._tally is not None:
            self._tally.close()
