"""[recording]: the frames that showed a new place, as a feed, while the daemon runs."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path

from edge.camera import Frame
from edge.feed import FeedWriter
from edge.files import named_by_time
from edge.opened_parts import OpenedParts
from edge.plugin import Plugin, UsedFrame
from edge_plugins.recording.recorder import Recorder, begun_feed


class RecordingPlugin(Plugin):
    """`Recorder` at the daemon's moments."""

    def __init__(self, parts: OpenedParts) -> None:
        self._parts, config = parts, parts.config

        def begin(frame: Frame) -> FeedWriter:
            return begun_feed(named_by_time(Path(config.recording.folder), time.time()), config.camera, frame)

        self._recorder = Recorder(begin, config.recording.min_free_mb * 1e6)

    def frame_used(self, used: UsedFrame) -> None:
        """Record it, once the vehicle's position then is known."""
        if not self._parts.pictures.why_undated:
            record = partial(self._recorder.record, used.frame, used.distance_m)
            self._parts.autopilot.history.when_known(used.frame.stamp_ns, record)

    def close(self) -> None:
        """Write what is left."""
        self._recorder.close()


def open_plugin(parts: OpenedParts) -> RecordingPlugin | None:
    """Where [recording] folder is set."""
    return RecordingPlugin(parts) if parts.config.recording.folder else None
