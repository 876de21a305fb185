"""The frames of a feed, as a network sees them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

import numpy as np
from numpy.typing import NDArray

from edge.descriptor.model_file import ModelInfo
from edge.descriptor.network import REGION_COUNT, Network, Regions, pictures_for
from edge.errors import FeedError, FrameError
from edge.feed import Feed, FeedImages

REGION_WIDTH = 0.4


def kinds_of(info: ModelInfo) -> tuple[Regions, ...]:
    """The regions that the network can describe."""
    return ("left-right",) if info.columns else tuple(REGION_COUNT)


def pictures_of(feed: Feed, kind: Regions, info: ModelInfo, step: int = 1) -> Iterator[NDArray[np.uint8]]:
    """What the network is given of every `step`-th frame; FeedError if one is unreadable."""
    with closing(FeedImages(feed)) as images:
        try:
            for row in range(0, len(feed.rows), step):
                yield pictures_for(info, images.read(row), kind, REGION_WIDTH)
        except FrameError as error:
            raise FeedError(f"{error}; remove that row from the feed") from None


def describe_feed(network: Network, feed: Feed, kind: Regions) -> NDArray[np.float32]:
    """Raw descriptors (N, R, D) of all frames."""
    return np.stack([network.describe(pictures) for pictures in pictures_of(feed, kind, network.info)])
