"""The regions of a feed's frames, as a network sees them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

import numpy as np
from numpy.typing import NDArray

from edge.descriptor.network import Network, Regions, cut_regions
from edge.errors import FeedError, FrameError
from edge.feed import Feed, FeedImages

REGION_WIDTH = 0.4


def regions_of(feed: Feed, kind: Regions, size: tuple[int, int], step: int = 1) -> Iterator[NDArray[np.uint8]]:
    """Regions (R, height, width, 3) of every `step`-th frame; FeedError if one is unreadable."""
    with closing(FeedImages(feed)) as images:
        try:
            for row in range(0, len(feed.rows), step):
                yield cut_regions(images.read(row), kind, REGION_WIDTH, size)
        except FrameError as error:
            raise FeedError(f"{error}; remove that row from the feed") from None


def describe_feed(network: Network, feed: Feed, kind: Regions) -> NDArray[np.float32]:
    """Raw descriptors (N, R, D) of all frames."""
    return np.stack([network.describe(regions) for regions in regions_of(feed, kind, network.size)])
