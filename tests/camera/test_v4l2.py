from __future__ import annotations

import errno
import os
import struct
import time
from pathlib import Path

import cv2
import pytest

from edge.camera import open_camera
from edge.camera.v4l2 import (
    V4l2Camera,
    apply_settings,
    capture_formats,
    gives_raw_data,
    monotonic_stamp_ns,
    open_error,
    settings_differences,
)
from edge.config import CameraConfig
from edge.errors import CameraLost, ConfigError
from tests.common import S


def test_a_device_that_is_not_there_is_lost_until_it_is_plugged_in() -> None:
    with pytest.raises(CameraLost, match=r"/dev/video-none: No such file or directory; is the camera plugged in\?"):
        open_camera(CameraConfig(device="/dev/video-none"))


def test_a_node_that_is_no_camera_is_a_wrong_config(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    for device in ("/dev/null", str(file), str(tmp_path), os.ttyname(os.openpty()[1])):
        with pytest.raises(ConfigError, match=rf"\[camera\] device: {device} is not a V4L2 camera; see `ls"):
            open_camera(CameraConfig(device=device))


def test_settings_are_read_back_and_each_that_differs_is_said(video_path: Path) -> None:
    capture = cv2.VideoCapture(str(video_path))
    same = CameraConfig(width=64, height=48, fps=20.1, fourcc="MJPG")  # within what drivers round
    assert settings_differences(same, capture) == ()
    other = CameraConfig(width=640, height=480, fps=29.97, fourcc="YUYV")
    # A video file takes no settings: a device that ignores what it is asked.
    apply_settings(other, capture)
    assert settings_differences(other, capture) == (
        "fourcc: asked for YUYV, device gives MJPG",
        "width: asked for 640, device gives 64",
        "height: asked for 480, device gives 48",
        "fps: asked for 29.97, device gives 20",
    )
    capture.release()


def test_frames_are_stamped_and_counted_until_no_more_come_and_the_camera_is_lost(video_path: Path) -> None:
    # The same OpenCV class on a file in the device's place; what an unplugged device gives is what a file's end gives.
    config = CameraConfig(device=str(video_path), width=64, height=48, fps=20.0)
    camera = V4l2Camera(config, lambda config: cv2.VideoCapture(config.device))
    assert camera.differences == ()
    last_ns = time.monotonic_ns()
    for index in range(12):
        frame = camera.read()
        assert frame is not None
        assert frame.index == index == round((float(frame.image.mean()) - 20) / 16)
        assert frame.image.shape == (48, 64, 3)
        assert last_ns < frame.stamp_ns <= time.monotonic_ns()
        last_ns = frame.stamp_ns
    with pytest.raises(CameraLost, match=r"drive\.avi: no frame; it was unplugged, stopped, or is used by another"):
        camera.read()
    camera.close()
    camera.close()


@pytest.mark.parametrize(
    ("position_ms", "stamp_ns"),
    [
        (5_000_123.456, 5000_123_456_000),  # CLOCK_MONOTONIC, as nearly all drivers
        (1_800_000_000_000.0 - 30, 5000_200_000_000 - 30_000_000),  # CLOCK_REALTIME, 30 ms ago
        (0.0, 5000_200_000_000),  # none: now
        (4_000_000.0, 5000_200_000_000),  # of another clock: now
    ],
)
def test_a_buffers_time_comes_out_on_the_monotonic_clock(position_ms: float, stamp_ns: int) -> None:
    assert monotonic_stamp_ns(position_ms, 5000_200_000_000, 1_800_000_000 * S) == pytest.approx(stamp_ns, abs=1000)


def test_a_node_that_udev_has_not_handed_over_yet_is_tried_again(tmp_path: Path) -> None:
    node = tmp_path / "video0"
    node.touch()
    refused = PermissionError(errno.EACCES, "Permission denied")
    of_root = node.stat().st_gid == 0
    assert isinstance(open_error(str(node), refused), CameraLost if of_root else ConfigError)
    assert isinstance(open_error(str(tmp_path / "gone"), refused), ConfigError)


@pytest.mark.parametrize(
    ("driver", "formats", "raw"),
    [
        ("unicam", ("pBAA", "BG10"), True),  # Raspberry Pi 4, IMX219
        ("unicam", ("UYVY", "YUYV"), False),  # the same receiver behind an HDMI adapter
        ("rp1-cfe", ("YUYV", "RGB3", "pRAA"), True),
        ("tegra-video", ("RG10",), True),
        ("uvcvideo", ("MJPG", "YUYV"), False),
        ("uvcvideo", (), False),
    ],
)
def test_the_raw_data_of_a_csi_sensor_is_no_image(driver: str, formats: tuple[str, ...], raw: bool) -> None:
    assert gives_raw_data(driver, formats) is raw


def test_formats_are_listed_as_the_kernel_gives_them() -> None:
    listed = {1: [b"RG10", b"BA81"], 9: []}

    def ioctl(descriptor: int, request: int, data: bytes) -> bytes:
        assert (descriptor, request) == (3, 0xC0405602)  # VIDIOC_ENUM_FMT of <linux/videodev2.h>
        index, kind = struct.unpack_from("II", data)
        if index >= len(listed[kind]):
            raise OSError(errno.EINVAL, "Invalid argument")
        return struct.pack("III32s4sI12x", index, kind, 0, b"10-bit Bayer", listed[kind][index], 0)

    assert capture_formats(3, ioctl) == ("RG10", "BA81")
