"""Whether small pictures are enough to recognize a drive: R@1 of single frames, by the width they were shrunk to.

    python -m sim.research.evaluation.picture_size out home --truth route_m --tolerance 20 --ahead 6

REFERENCE and QUERY are recordings as `lookback try` takes them, with what the truth needs. Pictures are shrunk by the
mean over the area of each new pixel, and keep their shape. Descriptors are normalized over the whole drive (NSD).
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

import lookback
from edge.feed import FeedImages
from lookback.matching import compare, nearest
from sim.datasets.pictures import read_drive

WIDTHS = (640, 320, 160, 97, 64, 48)


def shrunk(drive: Path, width: int) -> list[NDArray[np.uint8]]:
    """The pictures (H, W, 3) of a drive, none wider than `width`."""
    feed = read_drive(drive)
    images, found = FeedImages(feed), []
    for row in range(len(feed.rows)):
        image = images.read(row)
        if image.shape[1] > width:
            size = width, round(image.shape[0] * width / image.shape[1])
            image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        found.append(image)
    return found


def described(drive: Path, width: int, network: str) -> NDArray[np.float32]:
    """Normalized descriptors (N, R, D) of a drive."""
    return lookback.normalize(lookback.describe(shrunk(drive, width), network, progress=False))


def rows_of(
    reference: Path, query: Path, right: NDArray[np.bool_], widths: Sequence[int], networks: Sequence[str]
) -> Iterator[str]:
    """A row for each width, with two columns for each network: both drives shrunk, and the query alone."""
    largest = max(widths)
    maps = {network: described(reference, largest, network) for network in networks}
    yield "| width, pixels | " + " | ".join(f"{one} | {one}, query alone" for one in networks) + " |"
    yield "|---" * (1 + 2 * len(networks)) + "|"
    for width in sorted(widths, reverse=True):
        cells = []
        for network, places in maps.items():
            frames = described(query, width, network)
            for one in (described(reference, width, network) if width < largest else places, places):
                cells.append(f"{lookback.recall_at(nearest(compare(frames, one)), right):.2f}")
        yield f"| {width} | {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reference", type=Path)
    parser.add_argument("query", type=Path)
    parser.add_argument("--truth", default="positions", choices=("positions", "route_m", "rows"))
    parser.add_argument("--tolerance", type=float, required=True, help="within which a place is right, m or frames")
    parser.add_argument("--ahead", type=float, default=0.0, help="of the query lies the right place, m or frames")
    parser.add_argument("--widths", type=int, nargs="+", default=WIDTHS)
    parser.add_argument("--networks", nargs="+", default=["grid", "fc6"], help="default: both")
    args = parser.parse_args()
    right = lookback.truth(args.query, args.reference, tolerance=args.tolerance, kind=args.truth, ahead=args.ahead)
    for row in rows_of(args.reference, args.query, right, args.widths, args.networks):
        print(row, flush=True)


if __name__ == "__main__":
    main()
