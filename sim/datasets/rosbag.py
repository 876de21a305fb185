"""Recordings of ROS 1 (.bag), ROS 2 (folder, .db3, .mcap): pictures and positions.

Pictures are sensor_msgs/Image or CompressedImage, positions sensor_msgs/NavSatFix, both with the stamps of their
headers, and the field of view is that of a sensor_msgs/CameraInfo beside the pictures (all in
https://github.com/ros2/common_interfaces). Where a recording has several such topics, `camera` and `positions` name
one. Read with rosbags, which needs no ROS.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_typestore

from edge.config import PINHOLE, Lens
from edge.errors import FeedError, FrameError
from edge.feed import decode_picture
from sim.datasets import ONE_CLOCK_S, ReadOptions, Traverse
from sim.datasets.field_of_view import lens_of, of_focal_length
from sim.datasets.pictures import PicturesInOrder
from sim.datasets.track import Track, TrackFix

IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
POSITIONS = ("sensor_msgs/msg/NavSatFix",)
INFOS = ("sensor_msgs/msg/CameraInfo",)
NO_FIX = -1  # NavSatStatus.STATUS_NO_FIX

# sensor_msgs/image_encodings.hpp: channels, and OpenCV's conversion to BGR. ROS names a Bayer pattern by its first
# row's pixels, then its second's.
ENCODINGS = {
    "bgr8": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
    "mono8": (1, cv2.COLOR_GRAY2BGR),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2BGR),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2BGR),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2BGR),
}


def open_traverse(path: Path, options: ReadOptions) -> Traverse:
    """One camera's pictures at the positions of one receiver. FeedError lists the topics where it cannot choose."""
    with _open(path) as reader:
        camera = _choose(path, reader.connections, IMAGES, options.camera, "--camera")
        receiver = _choose(path, reader.connections, POSITIONS, options.positions, "--positions")
        info = _info_of(camera, reader.connections)
    track = Track(f"{path}: {receiver}", _fixes(path, receiver))
    stamps_ns = [_stamp_ns(message) for message in _messages(path, camera)]
    fov_deg, lens = (None, PINHOLE) if info is None else _view_of(path, info)
    return Traverse(
        name=path.stem,
        source=f"{path.name} {camera}",
        rows=track.rows(f"{path}: {camera}", [f"{camera}#{index}" for index in range(len(stamps_ns))], stamps_ns),
        pictures=PicturesInOrder(f"{path}: {camera}", partial(_messages, path, camera), to_bgr),
        notes=f"positions from {receiver}",
        fov_deg=fov_deg,
        lens=lens,
        time_sigma_s=ONE_CLOCK_S,
    )


def to_bgr(where: str, message: Any) -> NDArray[np.uint8]:
    """An Image or CompressedImage as (H, W, 3) uint8 BGR; FrameError, which begins with `where`."""
    if not hasattr(message, "encoding"):
        return decode_picture(where, np.asarray(message.data, dtype=np.uint8))
    if message.encoding not in ENCODINGS:
        raise FrameError(f"{where}: encoding {message.encoding!r} is not one of {', '.join(ENCODINGS)}")
    channels, conversion = ENCODINGS[message.encoding]
    row_bytes = message.width * channels
    if message.step < row_bytes or message.data.size < message.height * message.step:
        raise FrameError(f"{where}: {message.data.size} bytes are not enough for {message.width} x {message.height}")
    lines = message.data[: message.height * message.step].reshape(message.height, message.step)
    image = lines[:, :row_bytes].reshape(message.height, message.width, channels)
    return np.asarray(image if conversion is None else cv2.cvtColor(np.ascontiguousarray(image), conversion))


@contextmanager
def _open(path: Path) -> Iterator[AnyReader]:
    """The recording; FeedError, which names it, for any error in it."""
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            yield reader
    except FeedError:
        raise
    except Exception as error:  # the library raises any exception for a damaged file
        raise FeedError(f"{path}: cannot read this recording: {error}") from None


def _choose(
    path: Path, connections: Sequence[Connection], types: Sequence[str], wanted: str | None, option: str
) -> str:
    topics = sorted({connection.topic for connection in connections if connection.msgtype in types})
    if wanted in topics or (wanted is None and len(topics) == 1):
        return wanted or topics[0]
    found = ", ".join(topics) or "none"
    raise FeedError(f"{path}: {option}: name one topic of {' or '.join(types)}; found: {found}")


def _info_of(camera: str, connections: Sequence[Connection]) -> str | None:
    """The topic of the calibration beside a camera's: camera_info of its name, as image_transport has it."""
    there = {connection.topic for connection in connections if connection.msgtype in INFOS}
    above = [camera.rsplit("/", depth)[0] for depth in range(1, camera.count("/") + 1)]  # /compressed comes behind it
    return next((topic for topic in (f"{name}/camera_info" for name in above) if topic in there), None)


def _view_of(path: Path, topic: str) -> tuple[float | None, Lens]:
    """Field of view and lens by the first calibration."""
    message = next(iter(_messages(path, topic)), None)
    if message is None:
        return None, PINHOLE
    where = f"{path}: {topic}"
    matrix, bent = (message.K, message.D) if hasattr(message, "K") else (message.k, message.d)  # ROS 1, ROS 2
    found = of_focal_length(where, float(matrix[0]), message.width)
    # Pictures that ROS has straightened are on a topic of that name.
    return found, PINHOLE if "rect" in topic else lens_of(where, message.distortion_model, bent)


def _messages(path: Path, topic: str) -> Iterator[Any]:
    with _open(path) as reader:
        connections = [connection for connection in reader.connections if connection.topic == topic]
        for connection, _, data in reader.messages(connections):
            yield reader.deserialize(data, connection.msgtype)


def _fixes(path: Path, topic: str) -> Iterator[TrackFix]:
    for message in _messages(path, topic):
        if message.status.status > NO_FIX and math.isfinite(message.latitude + message.longitude):
            sigma_m = math.sqrt(message.position_covariance[0] + message.position_covariance[4]) or math.nan
            position = message.latitude, message.longitude, message.altitude
            yield TrackFix(_stamp_ns(message), *position, sigma_m=sigma_m, source="gps")


def _stamp_ns(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
