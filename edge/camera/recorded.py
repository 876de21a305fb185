"""A recorded feed, or a bare video file, played as a camera.

Either at its recorded pace, in place of a live camera (`in_real_time`), or as fast as the reader asks, with the feed's
own timestamps (maps, replays).
"""

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
        self,
        feed: Feed,
        *,
        real_time: bool = False,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], object] = time.sleep,
    ) -> None:
        """Open the feed's images; FeedError if its video cannot be opened.

        real_time: each frame comes when it is due, with that time of `clock_ns` as its timestamp; the first is due at
        the first read(). A frame that is read late comes at once, with its due time.
        """
        self.differences: tuple[str, ...] = ()
        self._feed = feed
        self._images: FeedImages | None = FeedImages(feed)
        self._real_time = real_time
        self._clock_ns = clock_ns
        self._sleep = sleep
        self._next = 0
        stamps_ns = [row.stamp_ns for row in feed.rows]
        longest_ns = max((after - before for before, after in itertools.pairwise(stamps_ns)), default=0)
        self._offset_ns: int | None = None if real_time else 0  # from the feed's time to `clock_ns`
        self.read_timeout_s = DECODE_S + longest_ns / 1e9

    @classmethod
    def in_real_time(
        cls,
        config: CameraConfig,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], object] = time.sleep,
    ) -> RecordedCamera:
        """Play the feed or video `config.device` at its own pace; size and rate are the recording's, not the config's.

        Raises FeedError, and ConfigError for a mask that does not fit.
        """
        feed = preprocessed_feed(read_feed(Path(config.device)), config)
        camera = cls(feed, real_time=True, clock_ns=clock_ns, sleep=sleep)
        recorded, asked = feed.header.preprocessing, config.preprocessing
        if asked not in ("", recorded):
            camera.differences = (f"asked for {asked}; the feed was recorded with {recorded}, and stays as it is",)
        return camera

    def read(self) -> Frame | None:
        """The next row's frame, None after the last; FrameError names the image, and the next call continues.

        In real time this blocks until the frame is due, however long the gap in the recording is.
        """
        if self._images is None or self._next >= len(self._feed.rows):
            return None
        index, self._next = self._next, self._next + 1
        stamp_ns = self._due_ns(index)
        # Decode before the wait, so that the frame is returned at its timestamp.
        image = self._images.read(index)
        self._wait_until(stamp_ns)
        return Frame(image, stamp_ns, index)

    def _due_ns(self, index: int) -> int:
        if self._offset_ns is None:
            self._offset_ns = self._clock_ns() - self._feed.rows[0].stamp_ns
        return self._feed.rows[index].stamp_ns + self._offset_ns

    def _wait_until(self, stamp_ns: int) -> None:
        if not self._real_time:
            return
        wait_ns = stamp_ns - self._clock_ns()
        if wait_ns > 0:
            self._sleep(wait_ns / 1e9)

    def close(self) -> None:
        """Release the images; a later read() returns None."""
        if self._images is not None:
            self._images.close()
            self._images = None
