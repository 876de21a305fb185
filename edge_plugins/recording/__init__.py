"""Frames become a feed: `recorder` writes it by a thread, for the daemon and for `lookback record` (`command`)."""

from __future__ import annotations

from typing import ClassVar

from edge.config import Config, FilePath, NotNegative, Section


class RecordingConfig(Section, frozen=True):
    """[recording]: the frames that `lookback run` uses, written as one feed per run."""

    plugin: ClassVar[str] = "edge_plugins.recording.plugin:RecordingPlugin"
    folder: FilePath = ""
    min_free_mb: NotNegative = 500.0

    def asks(self, config: Config) -> bool:
        """Where a folder is named, and pictures may be kept."""
        return bool(self.folder) and config.camera.keep_pictures
