"""What each map is good for, counted by the daemon, and `lookback map learn` while the vehicle stands."""

from __future__ import annotations

import time
from pathlib import Path
from uuid import uuid4

from edge.opened_parts import OpenedParts
from edge.plugin import Plugin, UsedFrame
from edge.reference_map.store import HEADER
from edge_plugins.layers import DriveTally, Learner, learn_command


class Layers(Plugin):
    """Counts what a folder of maps recognizes; with [mapping] layers it also learns from it."""

    def __init__(self, parts: OpenedParts) -> None:
        self._parts, mapping = parts, parts.config.mapping
        self._learner: Learner | None = None
        if mapping.folder and mapping.layers:
            self._learner = Learner(learn_command(Path(mapping.folder), mapping.layers))
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

    def turn(self) -> None:
        """Learn, while the vehicle stands."""
        if self._learner is not None:
            now_ns = self._parts.clock_ns()
            speed_mps = self._parts.autopilot.vehicle.motion.speed_mps(now_ns)
            self._learner.follow(now_ns, speed_mps, self._parts.config.gates.min_speed_mps)

    def close(self) -> None:
        """Write the counts, and end what still learns."""
        for part in (self._tally, self._learner):
            if part is not None:
                part.close()


def open_plugin(parts: OpenedParts) -> Layers:
    """Always: whether the maps are a folder is known when they are open."""
    return Layers(parts)
