"""From pictures to normalized descriptors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sized
from functools import lru_cache
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from edge.config import NETWORKS
from edge.descriptor.network import Network, Regions, pictures_for
from edge.descriptor.open_network import normalized_set
from edge.feed import FeedImages, read_picture
from lookback import checks
from sim.compare.foreign import ForeignNetwork, open_file
from sim.compare.methods import normalized_online
from sim.datasets.found import read_drive

Pictures = str | Path | Iterable[str | Path] | Iterable[NDArray[np.uint8]] | NDArray[np.uint8]
REGION_WIDTH = 0.4  # of each region, a share of the picture's width (section III-D)


def describe(
    pictures: Pictures,
    model: str | Path = "grid",
    *,
    regions: Regions | None = None,
    size: tuple[int, int] | None = None,
    progress: bool = True,
) -> NDArray[np.float32]:
    """Descriptors (N, R, D) of N pictures, as the network gives them.

    pictures: a folder of pictures in the order of their names, a recording (a feed, a video), or any iterable of files
    or images (H, W, 3) uint8 BGR. model: "grid" (comes with Lookback, Apache-2.0, finds R = 2 regions itself), "fc6"
    (the paper's, not for commercial use), or an ONNX file: any network from an RGB image, normalized as ImageNet's, to
    a descriptor, such as CosPlace, EigenPlaces, MixVPR or DINOv2. regions: "left-right" (R = 2, section III-D of the
    paper) or "whole" (R = 1); None: left-right, and whole for ONNX files of others. size: height and width of the
    images of such a file, where it takes any. progress: a bar on standard error.

    Raises `Error` for what cannot be read, and for a network that cannot be used.

    >>> images = np.random.default_rng(0).integers(0, 256, (3, 90, 120, 3), dtype=np.uint8)
    >>> describe(images, progress=False).shape[:2]
    (3, 2)
    """
    network = network_of(str(model), size)
    regions = regions or ("whole" if isinstance(network, ForeignNetwork) else "left-right")
    if regions not in get_args(Regions):
        raise ValueError(f"regions are one of {', '.join(map(repr, get_args(Regions)))}, not {regions!r}")
    images, count = _images(pictures)
    bar = tqdm(images, total=count, desc=str(model), unit="picture", disable=None if progress else True, leave=False)
    found = [network.describe(pictures_for(network.info, image, regions, REGION_WIDTH)) for image in bar]
    if not found:
        raise ValueError("no picture to describe")
    return np.stack(found)


@lru_cache(maxsize=4)
def network_of(model: str, size: tuple[int, int] | None = None) -> Network:
    """The network of that name or file, opened once."""
    path = Path(model)
    return Network.load(path) if model in NETWORKS or path.is_dir() else open_file(path, size)


def _images(pictures: Pictures) -> tuple[Iterator[NDArray[np.uint8]], int | None]:
    """The images, read when they are asked for, and how many there are; None where nobody knows yet."""
    if isinstance(pictures, (str, Path)):
        feed = read_drive(Path(pictures))
        opened = FeedImages(feed)
        return (opened.read(row) for row in range(len(feed.rows))), len(feed.rows)
    return (image_of(one) for one in pictures), len(pictures) if isinstance(pictures, Sized) else None


def image_of(given: str | Path | NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A picture (H, W, 3) uint8 BGR, read where it is a file. ValueError for other arrays."""
    if isinstance(given, (str, Path)):
        return read_picture(Path(given), cv2.IMREAD_COLOR)
    image = np.asarray(given)
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or not image.size:
        raise ValueError(f"an image is (H, W, 3) uint8, not {image.shape} {image.dtype}")
    return np.ascontiguousarray(image)


def normalize(descriptors: NDArray[np.float32], *, online: bool = False) -> NDArray[np.float32]:
    """The normalized set of descriptors, NSD (eq. 1): each dimension less its mean, over its deviation; (N, R, D).

    Each drive is normalized for itself, which takes out what all its pictures share: the light, the camera, the kind of
    road. online: each frame by the frames up to it alone, as a vehicle must do it (section III-B); the first are poor.

    >>> normalized = normalize(np.array([[[1.0, 5.0]], [[3.0, 5.0]]], dtype=np.float32))
    >>> normalized.tolist()  # the second dimension never changes, so it says nothing
    [[[-1.0, 0.0]], [[1.0, 0.0]]]
    """
    raw = checks.descriptors(descriptors)
    if not online:
        return normalized_set(raw)
    return np.stack([one.rows[0] for one in normalized_online(raw)])
