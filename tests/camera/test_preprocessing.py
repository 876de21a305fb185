from __future__ import annotations

from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from edge import open_map
from edge.__main__ import main
from edge.camera import open_camera
from edge.camera.preprocessing import FILL, Preprocessor, preprocessed_feed
from edge.config import CameraConfig, parse_config
from edge.errors import ConfigError, FrameError
from edge.feed import FeedImages, read_feed
from edge_plugins.recording.recorder import Recorder, begun_feed

HERE = Path("lookback.toml")


def configured(text: str, folder: Path = Path()) -> CameraConfig:
    return parse_config(f"[camera]\n{text}", folder / HERE).camera


@pytest.fixture
def image() -> NDArray[np.uint8]:
    return np.random.default_rng(3).integers(0, 255, (48, 64, 3), np.uint8)


@pytest.fixture
def bonnet(tmp_path: Path) -> Path:
    """Black in the lowest quarter."""
    mask = np.full((48, 64), 255, np.uint8)
    mask[36:] = 0
    cv2.imwrite(str(tmp_path / "bonnet.png"), mask)
    return tmp_path / "bonnet.png"


@pytest.mark.parametrize(
    ("flip", "slices"),
    [
        ("none", (slice(None), slice(None))),
        ("horizontal", (slice(None), slice(None, None, -1))),
        ("vertical", (slice(None, None, -1), slice(None))),
        ("both", (slice(None, None, -1), slice(None, None, -1))),
    ],
)
def test_flip(flip: str, slices: tuple[slice, slice], image: NDArray[np.uint8]) -> None:
    out = Preprocessor(configured(f'flip = "{flip}"')).apply(image)
    assert np.array_equal(out, image[slices])
    assert out.flags.c_contiguous


def test_crop_is_left_top_right_bottom_of_the_flipped_image(image: NDArray[np.uint8]) -> None:
    preprocessor = Preprocessor(configured('crop = [0.25, 0.5, 0.125, 0]\nflip = "horizontal"'))
    out = preprocessor.apply(image)
    assert np.array_equal(out, image[:, ::-1][24:48, 16:56])
    assert out.flags.c_contiguous
    assert preprocessor.size(64, 48) == (40, 24) == out.shape[1::-1]


def test_what_is_black_in_the_mask_becomes_gray(image: NDArray[np.uint8], bonnet: Path) -> None:
    before = image.copy()
    out = Preprocessor(configured('mask = "bonnet.png"', bonnet.parent)).apply(image)
    assert np.array_equal(out[:36], image[:36])
    assert (out[36:] == FILL).all()
    assert np.array_equal(image, before), "the camera's buffer is not written to"


def test_a_mask_of_the_same_shape_is_scaled_to_the_image(bonnet: Path) -> None:
    out = Preprocessor(configured('mask = "bonnet.png"', bonnet.parent)).apply(np.zeros((480, 640, 3), np.uint8))
    assert not out[:360].any()
    assert (out[360:] == FILL).all()


def test_a_mask_of_another_shape_is_a_bad_frame_that_names_the_key(image: NDArray[np.uint8], bonnet: Path) -> None:
    preprocessor = Preprocessor(configured('mask = "bonnet.png"\ncrop = [0, 0, 0, 0.5]', bonnet.parent))
    why = rf"^\[camera\] mask: {bonnet} has 64 x 48 pixels, which is not the shape of .* image, 64 x 24$"
    with pytest.raises(FrameError, match=why):
        preprocessor.apply(image)
    with pytest.raises(ConfigError, match=why):
        preprocessor.size(64, 48)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ('flip = "left"', r'\[camera\] flip: "left" is none of "both", "horizontal"'),
        ("crop = [0.1, 0.2]", r"\[camera\] crop: expected a list of length 4"),
        ("crop = [0.1, 0.2, -0.1, 0]", r"\[camera\] crop\[2\]: expected a number >= 0"),
        ("crop = [0.5, 0, 0.5, 0]", r"\[camera\] crop: left and right together, and top and bottom, can be 0.9 at"),
        ('crop = "all"', r"\[camera\] crop: expected a list"),
        ("mask = 3", r"\[camera\] mask: expected text in quotes"),
        ('mask = "a\\u0000b"', r"\[camera\] mask: has a null character"),
        ("latency_s = -1", r"\[camera\] latency_s: expected a number >= 0"),
    ],
)
def test_a_bad_value_is_one_line_with_the_key(text: str, why: str) -> None:
    with pytest.raises(ConfigError, match=rf"^lookback\.toml: {why}"):
        configured(text)


def test_a_mask_that_cannot_be_used_is_a_wrong_config(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "black.png"), np.zeros((48, 64), np.uint8))
    (tmp_path / "text.png").write_text("no picture")
    for name, why in {
        "none.png": "cannot read it: No such file",
        "text.png": "not a complete JPEG or PNG",
        "black.png": "it is all black",
    }.items():
        # Also before the device is looked for.
        with pytest.raises(ConfigError, match=rf"^\[camera\] mask: {tmp_path}/{name}: {why}"):
            open_camera(CameraConfig(device="/dev/video-none", mask=str(tmp_path / name)))


def test_every_camera_gives_processed_images(feed_path: Path) -> None:
    plain = FeedImages(read_feed(feed_path)).read(0)
    config = CameraConfig(kind="feed", device=str(feed_path), flip="both", crop=(0, 0.25, 0, 0))
    with closing(open_camera(config)) as camera:
        frame = camera.read()
    assert frame is not None
    assert np.array_equal(frame.image, plain[::-1, ::-1][12:])


def test_what_is_recorded_is_processed_and_is_not_processed_again(feed_path: Path, tmp_path: Path) -> None:
    config = CameraConfig(kind="feed", device=str(feed_path), flip="vertical", crop=(0.25, 0.25, 0, 0))
    recorder = Recorder(lambda frame: begun_feed(tmp_path / "copy", config, frame), 0.0)
    with closing(open_camera(config)) as camera, closing(recorder):
        frame = camera.read()
        assert frame is not None
        recorder.record(frame, None, None)
    recorded = read_feed(tmp_path / "copy")
    assert recorded.header.preprocessing == "flip vertical; crop 0.25 0.25 0 0"
    assert preprocessed_feed(recorded, config) is recorded
    assert FeedImages(recorded).read(0).shape == frame.image.shape
    other = CameraConfig(kind="feed", device=str(tmp_path / "copy"), flip="horizontal")
    with closing(open_camera(other)) as camera:
        again = camera.read()
        assert again is not None
        assert np.array_equal(again.image, FeedImages(recorded).read(0))
        recorded_with = "the feed was recorded with flip vertical; crop 0.25 0.25 0 0, and stays as it is"
        assert camera.differences == (f"asked for flip horizontal; {recorded_with}",)


def test_a_recording_that_is_not_processed_is_processed_when_it_is_read(feed_path: Path, video_path: Path) -> None:
    for path in (feed_path, video_path):
        feed = read_feed(path)
        processed = preprocessed_feed(feed, CameraConfig(crop=(0, 0, 0.5, 0)))
        assert (processed.header.width, processed.header.height) == (32, 48)
        with closing(FeedImages(feed)) as plain, closing(FeedImages(processed)) as images:
            assert np.array_equal(images.read(2), plain.read(2)[:, :32])


def test_a_map_is_built_from_processed_images(feed_path: Path, tmp_path: Path) -> None:
    (tmp_path / HERE).write_text("[camera]\ncrop = [0, 0, 0, 0.5]\n[sampling]\nby = 'frames'\n")
    output = tmp_path / "half.map"
    for at, image in enumerate(sorted((feed_path / "frames").iterdir())):  # as they are, they show nothing
        blocks = np.random.default_rng(at).integers(0, 255, (3, 4, 3), np.uint8)
        assert cv2.imwrite(str(image), blocks.repeat(16, axis=0).repeat(16, axis=1))
    assert main(["map", "build", str(feed_path), "-o", str(output), "--config", str(tmp_path / HERE)]) == 0
    thumbnail = cv2.imdecode(np.frombuffer(open_map(output).thumbnail(0), np.uint8), cv2.IMREAD_COLOR)
    assert thumbnail is not None
    assert thumbnail.shape == (24, 64, 3)
