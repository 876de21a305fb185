"""A recorded feed, or a bare video file, played at its own pace in place of a live camera."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from pathlib import Path

from edge.camera.preprocessing import preprocessed_feed
from edge.config import CameraConfig
from edge.feed import Feed, FeedImages, Frame, read_feed

DECODE_S = 2.0  # an image from a slow disk


class RecordedCamera:
    """Plays the rows of a feed in order; an unreadable image raises FrameError, and the next read continues."""

    def __init__(
        self, feed: Feed, clock_ns: Callable[[], int] = time.monotonic_ns, sleep: Callable[[float], object] = time.sleep
    ) -> None:
        """Open the feed's images; FeedError if its video cannot be opened.

        Each frame comes when it is due, with that time of `clock_ns` as its timestamp; the first is due at the first
        read(). A frame that is read late comes at once, with its due time.
        """
        self.differences: tuple[str, ...] = ()
        self._feed = feed
        self._images: FeedImages | None = FeedImages(feed)
        self._clock_ns, self._sleep, self._next = clock_ns, sleep, 0
        stamps_ns = [row.stamp_ns for row in feed.rows]
        longest_ns = max((after - before for before, after in itertools.pairwise(stamps_ns)), default=0)
        self._offset_ns: int | None = None  # from the feed's time to `clock_ns`
        self.read_timeout_s = DECODE_S + longest_ns / 1e9

    @classmethod
    def of(cls, config: CameraConfig, began_ns: int | None = None) -> RecordedCamera:
        """Play the feed or video `config.device`; size and rate are the recording's, not the config's.

        began_ns: CLOCK_MONOTONIC at which the first frame was due; None: at the first read().
        Raises FeedError, and ConfigError for a mask that does not fit.
        """
        feed = preprocessed_feed(read_feed(Path(config.device)), config)
        camera = cls(feed)
        if began_ns is not None and feed.rows:
            camera._offset_ns = began_ns - feed.rows[0].stamp_ns
        recorded, asked = feed.header.preprocessing, config.preprocessing
        if asked not in ("", recorded):
            camera.differences = (f"asked for {asked}; the feed was recorded with {recorded}, and stays as it is",)
        return camera

    def read(self) -> Frame | None:
        """The next row's frame, None after the last; FrameError names the image, and the next call continues.

        Blocks until the frame is due, however long the gap in the recording is.
        """
        if self._images is None or self._next >= len(self._feed.rows):
            return None
        index, self._next = self._next, self._next + 1
        if self._offset_ns is None:
            self._offset_ns = self._clock_ns() - self._feed.rows[0].stamp_ns
        stamp_ns = self._feed.rows[index].stamp_ns + self._offset_ns
        # Decode before the wait, so that the frame is returned at its timestamp.
        image = self._images.read(index)
        wait_ns = stamp_ns - self._clock_ns()
        if wait_ns > 0:
            self._sleep(wait_ns / 1e9)
        return Frame(image, stamp_ns, index)

    def close(self) -> None:
        """Release the images; a later read() returns None."""
        if self._images is not None:
            self._images.close()
            self._images = None
