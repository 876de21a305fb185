"""Live mapping in the daemon: the drive becomes a map while it is driven, searched with the others."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack

import numpy as np
from numpy.typing import NDArray

from edge.camera import Frame
from edge.opened_parts import OpenedParts
from edge.plugin import Plugin, UsedFrame
from edge.recognizer import model_key
from edge.reference_map import MapSoFar
from edge_plugins.mapping.drive_mapper import DriveMapper


class Mapping(Plugin):
    """[mapping]: `DriveMapper` at the daemon's moments."""

    def __init__(self, parts: OpenedParts) -> None:
        self._parts = parts
        self._grown: MapSoFar | None = None
        others = parts.autopilot, parts.record, parts.clock_ns
        with ExitStack() as opened:
            key = model_key(parts.network)
            self.mapper = DriveMapper(parts.config, key, opened, *others, frames=parts.mapping_frames)
            self._opened = opened.pop_all()

    def newest_map(self) -> MapSoFar | None:
        """The part that may be searched."""
        return self.mapper.live.so_far()

    def spare_turn(self, waited_s: float, describe: Callable[[Frame], NDArray[np.float32]]) -> None:
        """Map a frame of the second camera."""
        self.mapper.map_next(waited_s, describe)

    def frame_used(self, used: UsedFrame) -> None:
        """Map a frame that was recognized."""
        parts, raw = self._parts, self._parts.recognizer.raw_of(used.frame.stamp_ns)
        if raw is not None and not parts.pictures.why_undated:
            self._grown = self.mapper.map_recognized(used.frame, raw, used.distance_m, used.missed)
        parts.times.lap("mapping")

    def grown_map(self) -> MapSoFar | None:
        """Where enough further places lie far enough behind."""
        grown, self._grown = self._grown, None
        return grown

    def stop(self) -> None:
        """Map what waits for its position."""
        self.mapper.add_placed()

    def close(self) -> None:
        """Close the camera and the file."""
        self._opened.close()


def open_plugin(parts: OpenedParts) -> Mapping | None:
    """Where [mapping] folder is set; SetupError for its camera."""
    return Mapping(parts) if parts.config.mapping.folder else None
