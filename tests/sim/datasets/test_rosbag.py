"""ROS 1 and ROS 2 recordings, written by rosbags' own writers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from edge.errors import FrameError
from edge.feed import read_feed
from sim.datasets import ReadOptions, open_dataset
from sim.datasets.rosbag import to_bgr

Degrees = Callable[[float, float], tuple[float, float]]
IndexOf = Callable[[NDArray[np.uint8]], int]
Refused = Callable[..., None]
Write = Callable[[str, str, int, Any], None]

STORES = {"ros1": get_typestore(Stores.ROS1_NOETIC), "ros2": get_typestore(Stores.ROS2_HUMBLE)}
FORMATS = ["drive.bag", "drive", "drive.mcap", "drive.db3"]
START_NS = 1_714_557_600_000_000_000


@contextmanager
def recording(path: Path) -> Iterator[tuple[Any, Write]]:
    """The message types of a new recording, and a function that writes a message: topic, type, ns, message."""
    version = "ros1" if path.suffix == ".bag" else "ros2"
    store, connections = STORES[version], {}
    folder = path.with_name(f"{path.name}-folder") if path.suffix in {".mcap", ".db3"} else path
    plugin = StoragePlugin.SQLITE3 if path.suffix == ".db3" else StoragePlugin.MCAP
    with Writer1(path) if version == "ros1" else Writer2(folder, version=9, storage_plugin=plugin) as writer:

        def write(topic: str, kind: str, stamp_ns: int, message: Any) -> None:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            serialize = store.serialize_ros1 if version == "ros1" else store.serialize_cdr
            # Recorded 3 ms after it was taken, as over a network.
            writer.write(connections[topic], stamp_ns + 3_000_000, serialize(message, kind))

        yield Messages(store.types, version), write
    if folder != path:
        next(folder.glob(f"*{path.suffix}")).rename(path)


class Messages:
    """Makes the three kinds of message."""

    def __init__(self, types: Any, version: str) -> None:
        self._types = types
        self._sequence = {"seq": 0} if version == "ros1" else {}

    def _header(self, stamp_ns: int) -> Any:
        stamp = self._types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
        return self._types["std_msgs/msg/Header"](stamp=stamp, frame_id="", **self._sequence)

    def image(self, stamp_ns: int, pixels: NDArray[np.uint8], encoding: str, step: int) -> Any:
        height, width = pixels.shape[:2]
        lines = np.full((height, step), 255, np.uint8)  # a driver's lines may be longer than the picture
        lines[:, : pixels[0].size] = pixels.reshape(height, -1)
        kind = self._types["sensor_msgs/msg/Image"]
        return kind(self._header(stamp_ns), height, width, encoding, 0, step, lines.ravel())

    def compressed(self, stamp_ns: int, pixels: NDArray[np.uint8]) -> Any:
        data = cv2.imencode(".jpg", pixels)[1].ravel()
        return self._types["sensor_msgs/msg/CompressedImage"](self._header(stamp_ns), "jpeg", data)

    def info(self, stamp_ns: int, focal_px: float) -> Any:
        """Of pictures twice as wide as those that come with it, as of a driver that scales them."""
        names = "kdrp" if not self._sequence else "KDRP"
        k = np.array([focal_px, 0, 32, 0, focal_px, 24, 0, 0, 1.0])
        matrices = dict(
            zip(names, (k, np.array([-0.3, 0.1, 0.0, 0.0, 0.0]), np.eye(3).ravel(), np.zeros(12)), strict=True)
        )
        region = self._types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        about = {"height": 48, "width": 64, "distortion_model": "plumb_bob", "binning_x": 0, "binning_y": 0}
        kind = self._types["sensor_msgs/msg/CameraInfo"]
        return kind(header=self._header(stamp_ns), roi=region, **about, **matrices)

    def fix(self, stamp_ns: int, lat_deg: float, lon_deg: float, status: int = 0) -> Any:
        kind = self._types["sensor_msgs/msg/NavSatFix"]
        status_message = self._types["sensor_msgs/msg/NavSatStatus"](status, 1)
        return kind(self._header(stamp_ns), status_message, lat_deg, lon_deg, 110.5, np.zeros(9), 0)


def write_drive(path: Path, degrees_at: Degrees) -> None:
    """Two seconds north at 4 m/s: a front camera (rgb8), a rear one (compressed), a receiver that begins without."""
    with recording(path) as (messages, write):
        for i in range(20):
            stamp_ns = START_NS + i * 100_000_000
            pixels = np.full((24, 32, 3), 10 + 6 * i, np.uint8)
            pixels[:, :, 0] += 2  # a little more red, so that its place can be told from blue's
            write("/front", "sensor_msgs/msg/Image", stamp_ns, messages.image(stamp_ns, pixels, "rgb8", 100))
            rear = messages.compressed(stamp_ns, np.full((24, 32, 3), 10 + 6 * i, np.uint8))
            write("/rear/compressed", "sensor_msgs/msg/CompressedImage", stamp_ns, rear)
            write("/rear/camera_info", "sensor_msgs/msg/CameraInfo", stamp_ns, messages.info(stamp_ns, 40.0))
            if i % 2 == 0:
                place = degrees_at(0.0, 0.4 * i)
                fix = (
                    messages.fix(stamp_ns, *place) if i else messages.fix(stamp_ns, *degrees_at(900.0, 0.0), status=-1)
                )
                write("/gps", "sensor_msgs/msg/NavSatFix", stamp_ns, fix)


@pytest.mark.parametrize("name", FORMATS)
def test_each_format_gives_pictures_at_their_positions(
    tmp_path: Path, degrees_at: Degrees, index_of: IndexOf, name: str
) -> None:
    write_drive(tmp_path / name, degrees_at)
    for camera in ("/front", "/rear/compressed"):
        traverse = open_dataset("rosbag", tmp_path / name, ReadOptions(camera=camera))
        assert [row.stamp_ns for row in traverse.rows] == [START_NS + i * 100_000_000 for i in range(20)]
        assert traverse.fov_deg == (77.32 if camera == "/rear/compressed" else None)
        assert traverse.lens.distortion[:2] == ((-0.3, 0.1) if camera == "/rear/compressed" else ())
        assert [row.lat_deg is None for row in traverse.rows] == [True] * 2 + [False] * 17 + [True]
        assert (traverse.rows[9].lat_deg, traverse.rows[9].lon_deg) == pytest.approx(degrees_at(0.0, 3.6), abs=1e-8)
        assert traverse.rows[9].alt_m == 110.5
        for index in (0, 1, 7, 3):  # in order, ahead and back
            assert index_of(traverse.pictures.read(index)) == index
        if camera == "/front":
            assert traverse.pictures.read(5)[20, 20].tolist() == [40, 40, 42]
        with pytest.raises(FrameError, match="no picture 20"):
            traverse.pictures.read(20)
        traverse.pictures.close()


def test_a_bag_becomes_a_feed(tmp_path: Path, degrees_at: Degrees, sim_import: Callable[..., int]) -> None:
    write_drive(tmp_path / "drive.mcap", degrees_at)
    arguments = ("--camera", "/rear/compressed", "--view", "rear", "--spacing-m", 2)
    sim_import("rosbag", tmp_path / "drive.mcap", "-o", tmp_path / "feed", *arguments)
    feed = read_feed(tmp_path / "feed")
    assert [row.extra["source_frame"] for row in feed.rows] == ["2", "7", "12", "17"]
    assert [row.distance_m for row in feed.rows] == pytest.approx([0, 2, 4, 6], abs=1e-3)
    assert (feed.header.width, feed.header.height, feed.header.view) == (32, 24, "rear")


def test_topics_that_cannot_be_chosen_are_listed(tmp_path: Path, degrees_at: Degrees, refused: Refused) -> None:
    path = tmp_path / "drive.bag"
    write_drive(path, degrees_at)
    refused("rosbag", path, r"^/.*drive\.bag: --camera: name one topic of .*; found: /front, /rear/compressed$")
    refused("rosbag", path, r"--camera: .*found: /front", ReadOptions(camera="/left"))
    refused("rosbag", path, r"--positions: .*found: /gps$", ReadOptions(camera="/front", positions="/fix"))


def test_a_bag_without_positions_and_a_damaged_one_are_named(
    tmp_path: Path, degrees_at: Degrees, refused: Refused
) -> None:
    with recording(tmp_path / "blind.mcap") as (messages, write):
        write("/front", "sensor_msgs/msg/Image", 1, messages.image(1, np.zeros((2, 2), np.uint8), "mono8", 2))
    refused("rosbag", tmp_path / "blind.mcap", r"blind\.mcap: --positions: .*found: none$")
    for name in ("drive.bag", "drive.mcap", "drive.db3"):
        write_drive(tmp_path / name, degrees_at)
        whole = (tmp_path / name).read_bytes()
        (tmp_path / name).write_bytes(whole[: len(whole) // 2])
        refused("rosbag", tmp_path / name, rf"^{tmp_path}/{name}: cannot read this recording: ")
    (tmp_path / "drive.txt").write_text("")
    refused("rosbag", tmp_path / "drive.txt", r"drive\.txt: cannot read this recording: ")


@pytest.mark.parametrize(
    ("encoding", "pixel"),
    [("bgr8", [1, 2, 3]), ("rgb8", [3, 2, 1]), ("bgra8", [1, 2, 3, 255]), ("rgba8", [3, 2, 1, 255]), ("mono8", [2])],
)
def test_encodings(encoding: str, pixel: list[int]) -> None:
    messages = Messages(STORES["ros2"].types, "ros2")
    pixels = np.full((4, 6, len(pixel)), pixel, np.uint8)
    expected = [1, 2, 3] if len(pixel) > 1 else [2, 2, 2]
    image = to_bgr("here", messages.image(0, pixels, encoding, 6 * len(pixel)))
    assert image.reshape(-1, 3).tolist() == [expected] * 24


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_encodings_by_the_letters_of_their_pattern(pattern: str) -> None:
    level = {"r": 200, "g": 120, "b": 40}
    tile = np.array([level[letter] for letter in pattern], np.uint8).reshape(2, 2)
    messages = Messages(STORES["ros2"].types, "ros2")
    image = to_bgr("here", messages.image(0, np.tile(tile, (6, 6)), f"bayer_{pattern}8", 12))
    assert image[2:-2, 2:-2].reshape(-1, 3).tolist() == [[40, 120, 200]] * 64


def test_pictures_that_cannot_be_are_frame_errors() -> None:
    messages = Messages(STORES["ros2"].types, "ros2")
    depth = messages.image(0, np.zeros((4, 6), np.uint8), "16UC1", 12)
    with pytest.raises(FrameError, match=r"^here: encoding '16UC1' is not one of bgr8, rgb8"):
        to_bgr("here", depth)
    short = messages.image(0, np.zeros((4, 6), np.uint8), "mono8", 6)
    short.data = short.data[:20]
    with pytest.raises(FrameError, match=r"^here: 20 bytes are not enough for 6 x 4"):
        to_bgr("here", short)
    torn = messages.compressed(0, np.zeros((4, 6, 3), np.uint8))
    torn.data = torn.data[:100]
    with pytest.raises(FrameError, match=r"^here: not a complete JPEG or PNG image"):
        to_bgr("here", torn)
