"""The feed: a recorded traverse that every tool reads and writes.

`format` is the two text files, `reader` and `writer` the folder with its images, and `sampling` chooses the frames that
are places. `Frame` is the record that feeds and live cameras hand on. The writer is imported by those who write.
"""

from edge.feed.format import FeedHeader, FeedRow, View
from edge.feed.reader import Feed, FeedImages, FeedOptions, Frame, Pictures, decode_picture, read_feed, read_picture

__all__ = [
    "Feed",
    "FeedHeader",
    "FeedImages",
    "FeedOptions",
    "FeedRow",
    "Frame",
    "Pictures",
    "View",
    "decode_picture",
    "read_feed",
    "read_picture",
]
