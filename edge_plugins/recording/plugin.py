"""[recording]: the frames that showed a new place, as a feed, while the daemon runs."""

from __future__ import annotations

import time
from pathlib import Path

from edge.camera import Frame
from edge.feed.writer import FeedWriter
from edge.files import named_by_time
from edge.plugin import Parts, Plugin, UsedFrame
from edge.telemetry.position_history import ExposureQueue
from edge_plugins.recording import RecordingConfig
from edge_plugins.recording.recorder import Recorder, begun_feed


class RecordingPlugin(Plugin):
    """`Recorder` at the daemon's moments."""

    def __init__(self, config: RecordingConfig, parts: Parts) -> None:
        self._parts = parts
        self._awaiting: ExposureQueue[UsedFrame] = ExposureQueue(parts.autopilot.history)

        def begin(frame: Frame) -> FeedWriter:
            return begun_feed(named_by_time(Path(config.folder), time.time()), parts.config.camera, frame)

        self._recorder = Recorder(begin, config.min_free_mb * 1e6)

    def frame_used(self, used: UsedFrame) -> None:
        """Have it wait for the vehicle's position then."""
        if not self._parts.pictures.why_undated:
            self._awaiting.add(used.frame.stamp_ns, used)

    def turn(self, spare_s: float | None, *, is_last: bool = False) -> None:
        """Record those whose position is known."""
        for used, position in self._awaiting.known(all_of_them=is_last):
            self._recorder.record(used.frame, used.distance_m, position)

    def end(self) -> None:
        """Begin to write what is left."""
        self.turn(None, is_last=True)
        self._recorder.end()

    def close(self) -> None:
        """Write what is left."""
        self.turn(None, is_last=True)
        self._recorder.close()
