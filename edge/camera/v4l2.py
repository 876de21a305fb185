"""A V4L2 camera (USB, CSI) through OpenCV.

Name the device by its stable path (`ls /dev/v4l/by-id`): /dev/video numbers change from boot to boot.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import itertools
import math
import os
import re
import struct
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, Protocol, TypeAlias

import cv2
import numpy as np

from edge.camera.frame import Setting, differences
from edge.config import CameraConfig
from edge.errors import CameraLost, ConfigError, FrameError
from edge.feed import Frame

# linux/videodev2.h: struct v4l2_capability is driver[16], card[32], bus_info[32], version, capabilities,
# device_caps, reserved[3]; VIDIOC_QUERYCAP is _IOR('V', 0, struct v4l2_capability).
_CAPABILITY: Final = struct.Struct("16s32s32sIII12x")
_VIDIOC_QUERYCAP: Final = 2 << 30 | _CAPABILITY.size << 16 | ord("V") << 8
_CAN_CAPTURE: Final = 0x1 | 0x1000  # V4L2_CAP_VIDEO_CAPTURE, single or multi-planar
# struct v4l2_fmtdesc is index, type, flags, description[32], pixelformat, mbus_code, reserved[3].
_FORMAT: Final = struct.Struct("III32s4s16x")
_VIDIOC_ENUM_FMT: Final = 3 << 30 | _FORMAT.size << 16 | ord("V") << 8 | 2
_CAPTURE_TYPES: Final = 1, 9  # V4L2_BUF_TYPE_VIDEO_CAPTURE, and the multi-planar one
_LISTS_ALL_FORMATS: Final = ("rp1-cfe",)
"""CSI receivers (Raspberry Pi 5) that list every format, whatever the sensor gives."""
_BAYER: Final = re.compile(r"BA81|BYR2|GBRG|GRBG|RGGB|(BG|GB|GR|BA|BD|RG)1[0246]|[pab][BGgR][ACE][8ACE]")

Ioctl: TypeAlias = Callable[[int, int, bytes], bytes]

_OLDEST_BUFFER_NS: Final = 10 * 1_000_000_000  # a larger difference means another clock


class Settings(Protocol):
    """The part of cv2.VideoCapture that reads settings."""

    def get(self, propId: int, /) -> float:  # noqa: N803 - OpenCV's name
        """Value of a CAP_PROP."""


class V4l2Camera:
    """Opens a device, requests the configured format, and compares it with what the device reports."""

    def __init__(
        self, config: CameraConfig, open_capture: Callable[[CameraConfig], cv2.VideoCapture] | None = None
    ) -> None:
        """Open `config.device` with `open_capture`, by default `open_device`.

        Raises ConfigError if the device is not a camera or permission is denied, CameraLost if it is missing.
        """
        self._device = config.device
        self._capture = (open_capture or open_device)(config)
        apply_settings(config, self._capture)
        self.differences = settings_differences(config, self._capture)
        self.read_timeout_s = float(math.ceil(config.stall_timeout_s))
        self._index = 0

    def read(self) -> Frame | None:
        """Block until the next frame, at most `stall_timeout_s` (in whole seconds); never None."""
        if not self._capture.grab():
            raise CameraLost(f"{self._device}: no frame; it was unplugged, stopped, or is used by another program")
        stamp_ns = monotonic_stamp_ns(self._capture.get(cv2.CAP_PROP_POS_MSEC), time.monotonic_ns(), time.time_ns())
        index, self._index = self._index, self._index + 1
        try:
            ok, image = self._capture.retrieve()
        except cv2.error:
            ok, image = False, None
        if not ok or image is None or image.size == 0:
            raise FrameError(f"{self._device}: frame {index} cannot be decoded; is the cable or the hub good?")
        return Frame(np.ascontiguousarray(image, dtype=np.uint8), stamp_ns, index)

    def close(self) -> None:
        """Release the device; more than once is harmless."""
        self._capture.release()


def open_device(config: CameraConfig) -> cv2.VideoCapture:
    """Open a V4L2 device in OpenCV, to be read within `stall_timeout_s`; ConfigError or CameraLost."""
    check_is_camera(config.device)
    # By default OpenCV waits 10 s for a dead camera. It reads this variable once, at the first wait.
    os.environ["OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT"] = str(math.ceil(config.stall_timeout_s))
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # we raise errors instead of its warnings
    capture = cv2.VideoCapture(config.device, cv2.CAP_V4L2)
    if not capture.isOpened():
        raise CameraLost(f"{config.device}: OpenCV cannot open it; is another program using this camera?")
    return capture


def check_is_camera(device: str) -> None:
    """Ask the driver whether a node can capture video; OpenCV does not say why it cannot open one.

    ConfigError: it is not a camera (UVC cameras have a second node that gives metadata only), or permission is denied.
    CameraLost: it is missing.
    """
    try:
        descriptor = os.open(device, os.O_RDWR | os.O_NONBLOCK)
    except OSError as error:
        raise open_error(device, error) from None
    try:
        answer = fcntl.ioctl(descriptor, _VIDIOC_QUERYCAP, bytes(_CAPABILITY.size))
        formats = capture_formats(descriptor)
    except OSError as error:
        if error.errno in {errno.ENODEV, errno.EIO}:
            raise CameraLost(f"{device}: the camera does not answer: {error.strerror}") from None
        raise ConfigError(f"[camera] device: {device} is not a V4L2 camera; see `ls /dev/v4l/by-id`") from None
    finally:
        os.close(descriptor)
    driver, card, _, _, _, device_caps = _CAPABILITY.unpack(answer)
    if gives_raw_data(driver.rstrip(b"\0").decode(errors="replace"), formats):
        raise ConfigError(
            f'[camera] device: {device} gives the raw data of a CSI sensor, not images; use kind = "stream" and'
            ' device = "exec:rpicam-vid ..." (Raspberry Pi) or "exec:gst-launch-1.0 -q nvarguscamerasrc ..."'
            " (Jetson), see docs/cameras.md"
        )
    if not device_caps & _CAN_CAPTURE:
        name = card.rstrip(b"\0").decode(errors="replace")
        raise ConfigError(f"[camera] device: {device} ({name}) gives no images; use the camera's other node")


def capture_formats(descriptor: int, ioctl: Ioctl = fcntl.ioctl) -> tuple[str, ...]:
    """The pixel formats that a node can give, as four characters each."""
    formats: list[str] = []
    for kind in _CAPTURE_TYPES:
        # It ends with an error behind the last one.
        with contextlib.suppress(OSError):
            for index in itertools.count():
                answer = ioctl(descriptor, _VIDIOC_ENUM_FMT, _FORMAT.pack(index, kind, 0, b"", b""))
                formats.append(_FORMAT.unpack(answer)[4].decode("latin-1"))
    return tuple(formats)


def gives_raw_data(driver: str, formats: Sequence[str]) -> bool:
    """Whether a node gives what an image sensor sends: one color for each pixel, dark and without white balance."""
    return driver in _LISTS_ALL_FORMATS or (bool(formats) and all(map(_BAYER.fullmatch, formats)))


def open_error(device: str, error: OSError) -> ConfigError | CameraLost:
    """ConfigError for a node that is not a usable camera, CameraLost for a camera that may come back."""
    if error.errno in {errno.EACCES, errno.EPERM}:
        # At boot the node exists a moment before udev sets its group: try again.
        if Path(device).exists() and Path(device).stat().st_gid == 0:
            return CameraLost(f"{device}: no permission, it belongs to the group root; waiting for udev")
        return ConfigError(f"[camera] device: {device}: no permission; add the user to the group `video`")
    if error.errno in {errno.EISDIR, errno.ENOTDIR, errno.EROFS}:
        return ConfigError(f"[camera] device: {device} is not a V4L2 camera; see `ls /dev/v4l/by-id`")
    return CameraLost(f"{device}: {error.strerror}; is the camera plugged in? See `ls /dev/v4l/by-id`")


def apply_settings(config: CameraConfig, capture: cv2.VideoCapture) -> None:
    """Request the configured format; the order matters, because each setting limits the next in the driver."""
    capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*config.fourcc))
    capture.set(cv2.CAP_PROP_FRAME_WIDTH, config.width)
    capture.set(cv2.CAP_PROP_FRAME_HEIGHT, config.height)
    capture.set(cv2.CAP_PROP_FPS, config.fps)
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)


def settings_differences(config: CameraConfig, settings: Settings) -> tuple[str, ...]:
    """Read the settings back; one line for each that differs from the config."""
    fourcc = int(settings.get(cv2.CAP_PROP_FOURCC)) & 0xFFFFFFFF
    given: dict[str, Setting] = {
        "fourcc": fourcc.to_bytes(4, "little").decode("latin-1"),
        "width": int(settings.get(cv2.CAP_PROP_FRAME_WIDTH)),
        "height": int(settings.get(cv2.CAP_PROP_FRAME_HEIGHT)),
        "fps": settings.get(cv2.CAP_PROP_FPS),
    }
    return differences({key: getattr(config, key) for key in given}, given)


def monotonic_stamp_ns(position_ms: float, monotonic_ns: int, realtime_ns: int) -> int:
    """The driver's buffer time on CLOCK_MONOTONIC, in ns.

    position_ms: CAP_PROP_POS_MSEC, which for V4L2 is the buffer's timestamp. Nearly all drivers use
    CLOCK_MONOTONIC; uvcvideo can be set to CLOCK_REALTIME; a few give none: then the result is `monotonic_ns`.
    """
    stamp_ns = round(position_ms * 1e6)
    if abs(stamp_ns - monotonic_ns) < _OLDEST_BUFFER_NS:
        return stamp_ns
    if abs(stamp_ns - realtime_ns) < _OLDEST_BUFFER_NS:
        return stamp_ns - realtime_ns + monotonic_ns
    return monotonic_ns
