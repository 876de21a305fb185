"""Flip, crop and mask of [camera]: applied to each image once, before anything else sees it.

Live cameras are wrapped in a `PreprocessedCamera`, and recordings in `preprocessed_feed`. A recording of `lookback
record` or [recording] holds the processed images and says so in feed.toml, so that nothing is applied twice.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import msgspec
import numpy as np
from msgspec import UNSET
from numpy.typing import NDArray

from edge.camera.frame import Camera
from edge.config import CameraConfig
from edge.errors import ConfigError, FrameError
from edge.feed import Feed, FeedImages, Frame, read_picture

FLIP_CODES = {"horizontal": 1, "vertical": 0, "both": -1}
FILL = 114
"""Gray level of masked pixels: the mean of the images that the network was trained with, which excites it least."""
BLACK_BELOW = 128
SHAPE_TOLERANCE = 0.02


class Preprocessor:
    """Flips, crops and masks, in this order."""

    def __init__(self, config: CameraConfig) -> None:
        """Read the mask. ConfigError if it cannot be used."""
        self._flip = FLIP_CODES.get(config.flip)
        self._crop, self._mask_name = config.crop, config.mask
        self._mask = _read_mask(Path(config.mask)) if config.mask else None
        self._fitted: tuple[NDArray[np.uint8], NDArray[np.uint8]] | None = None

    def apply(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The processed image, a new contiguous array. FrameError if the mask has another shape than the image."""
        if self._flip is not None:
            image = np.asarray(cv2.flip(image, self._flip), dtype=np.uint8)
        top, bottom, left, right = self._box(*image.shape[:2])
        image = np.ascontiguousarray(image[top:bottom, left:right])
        if self._mask is None:
            return image
        if self._fitted is None or self._fitted[0].shape != image.shape:
            self._fitted = self._fit(self._mask, image.shape[0], image.shape[1])
        kept, fill = self._fitted
        return np.asarray(cv2.bitwise_or(cv2.bitwise_and(image, kept), fill), dtype=np.uint8)

    def size(self, width: int, height: int) -> tuple[int, int]:
        """Width and height of the processed image of one of this size. ConfigError if the mask does not fit it."""
        top, bottom, left, right = self._box(height, width)
        if self._mask is not None:
            try:
                self._fit(self._mask, bottom - top, right - left)
            except FrameError as error:
                raise ConfigError(str(error)) from None
        return right - left, bottom - top

    def _box(self, height: int, width: int) -> tuple[int, int, int, int]:
        left, top, right, bottom = self._crop
        return round(height * top), height - round(height * bottom), round(width * left), width - round(width * right)

    def _fit(self, mask: NDArray[np.uint8], height: int, width: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """All ones where the image stays, and the gray elsewhere, each (height, width, 3)."""
        mask_height, mask_width = mask.shape
        if abs(mask_width * height / (mask_height * width) - 1) > SHAPE_TOLERANCE:
            raise FrameError(
                f"[camera] mask: {self._mask_name} has {mask_width} x {mask_height} pixels, which is not the shape of"
                f" the flipped and cropped image, {width} x {height}"
            )
        scaled = cv2.resize(mask, (width, height), interpolation=cv2.INTER_NEAREST)
        kept = np.repeat(np.where(scaled < BLACK_BELOW, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)
        return kept, np.where(kept, 0, FILL).astype(np.uint8)


def _read_mask(file: Path) -> NDArray[np.uint8]:
    try:
        mask = read_picture(file, cv2.IMREAD_GRAYSCALE)
    except FrameError as error:
        raise ConfigError(f"[camera] mask: {error}") from None
    if not (mask >= BLACK_BELOW).any():
        raise ConfigError(f"[camera] mask: {file}: it is all black, so nothing of the image would be used")
    return mask


class PreprocessedCamera:
    """A camera whose images are processed."""

    def __init__(self, camera: Camera, preprocessor: Preprocessor) -> None:
        self._camera, self._preprocessor = camera, preprocessor
        self.differences = camera.differences
        self.read_timeout_s = camera.read_timeout_s

    def read(self) -> Frame | None:
        """See Camera. FrameError also if the mask does not fit."""
        frame = self._camera.read()
        return frame and replace(frame, image=self._preprocessor.apply(frame.image))

    def close(self) -> None:
        """See Camera."""
        self._camera.close()


@dataclass(frozen=True)
class _PreprocessedImages:
    images: FeedImages
    preprocessor: Preprocessor

    def read(self, index: int) -> NDArray[np.uint8]:
        return self.preprocessor.apply(self.images.read(index))

    def close(self) -> None:
        self.images.close()


def preprocessed_feed(feed: Feed, config: CameraConfig) -> Feed:
    """The feed with processed images; the feed itself if it was recorded so, or if nothing is configured.

    Its field of view is that of [camera], or as recorded, which a crop makes unknown. Raises ConfigError if the mask
    cannot be used.
    """
    is_set = config.fov_deg is not UNSET
    fov_deg = config.fov_deg if is_set else feed.header.fov_deg
    lens = msgspec.structs.asdict((config if is_set else feed.header).alone)
    if feed.header.preprocessing or not config.preprocessing:
        if not is_set:
            return feed
        return replace(feed, header=msgspec.structs.replace(feed.header, fov_deg=fov_deg, **lens))
    if config.fov_deg is UNSET and any(config.crop):
        fov_deg = None
    preprocessor = Preprocessor(config)
    width, height = preprocessor.size(feed.header.width, feed.header.height)
    changes = {"width": width, "height": height, "video": "", "preprocessing": config.preprocessing}
    header = msgspec.structs.replace(feed.header, fov_deg=fov_deg, **lens, **changes)
    return replace(feed, header=header, pictures=lambda: _PreprocessedImages(FeedImages(feed), preprocessor))
