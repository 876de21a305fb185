"""For `boot.sh`, to a FOLDER: a feed that plays for four hours, longer than that takes, and a map of its beginning."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from edge.config import DescriptorConfig, SamplingConfig
from edge.feed import FeedHeader, FeedRow, read_feed
from edge.feed.writer import FeedWriter
from sim.maps.command import build_map


def main(folder: Path) -> None:
    """Write both."""
    folder.mkdir(parents=True)
    blocks = np.random.default_rng(0).integers(0, 256, (8, 4, 4, 3), dtype=np.uint8)
    pictures = blocks.repeat(24, axis=1).repeat(32, axis=2)
    for name in ("feed", "beginning"):
        with FeedWriter(folder / name, FeedHeader(name, "front", 128, 96)) as writer:
            for index in range(8):
                writer.write(pictures[index], FeedRow("", 1_000_000_000 * (index + 1)))
    files = [row.file for row in read_feed(folder / "feed").rows]
    rows = [f"{files[second % 8]},{1_000_000_000 * (second + 1)}" for second in range(4 * 3600)]
    (folder / "feed/frames.csv").write_text("\n".join(["file,stamp_ns", *rows, ""]))
    grid = DescriptorConfig(model="grid")  # the only network in the package
    build_map([read_feed(folder / "beginning")], folder / "map", grid, SamplingConfig(by="frames"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
