"""`lookback calibrate camera` on simulated drives with cameras and lenses other than the recording says."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

pytest.importorskip("panda3d")

from edge.commands.parser import build_parser
from edge.config import Lens, load_config
from edge.errors import FeedError
from edge.feed import FeedHeader, FeedImages, FeedRow, read_feed
from edge.feed.writer import FeedWriter
from edge.keypoints import CameraModel
from sim.world.recording import record_drive
from sim.world.scenario import Scenario

BENDS = Scenario(seed=9601, length_m=200.0, drive_seed=11)
SAID_DEG = 80.0
WIDE_DEG = 112.0
"""Of pictures that have all that a lens with such a k1 shows."""


def drive(folder: Path, fov_deg: float, k1: float) -> None:
    """A recording by such a camera that says SAID_DEG."""
    if not k1:
        record_drive(msgspec.structs.replace(BENDS, fov_deg=fov_deg), folder)
        said = folder / "feed.toml"
        said.write_text(said.read_text().replace(f"fov_deg = {fov_deg}", f"fov_deg = {SAID_DEG}"))
        return
    wide = msgspec.structs.replace(BENDS, fov_deg=WIDE_DEG, width=560, height=420)
    record_drive(wide, folder / "wide")
    feed, size = read_feed(folder / "wide"), (BENDS.width, BENDS.height)
    of_lens = CameraModel(*size, fov_deg, Lens(distortion=(k1, 0.0, 0.0, 0.0)))
    whole = CameraModel(wide.width, wide.height, WIDE_DEG)
    pixels = np.stack(np.meshgrid(*map(np.arange, size)), axis=-1).astype(np.float64)
    across, down = np.moveaxis(of_lens.directions(pixels) * whole.focal_px + whole.middle, -1, 0).astype(np.float32)
    images, header = FeedImages(feed), msgspec.structs.replace(feed.header, width=size[0], height=size[1])
    with FeedWriter(folder / "bent", msgspec.structs.replace(header, fov_deg=SAID_DEG)) as writer:
        for index, row in enumerate(feed.rows):
            picture = cv2.remap(images.read(index), across, down, cv2.INTER_LINEAR)
            writer.write(np.asarray(picture, np.uint8), dataclasses.replace(row, file="", extra={}))


def calibrate(*words: object) -> int:
    argv = ["calibrate", "camera", *map(str, words)]
    args = build_parser(argv).parse_args(argv)
    found: int = args.run(args)
    return found


@pytest.mark.parametrize(
    ("fov_deg", "k1"),
    [
        (88.0, 0.0),
        pytest.param(70.0, 0.0, marks=pytest.mark.long),
        pytest.param(80.0, -0.15, marks=pytest.mark.long),
    ],
)
def test_a_drive_shows_its_camera_and_the_lines_go_into_the_config(
    fov_deg: float,
    k1: float,
    make_once: Callable[[str, Callable[[Path], object]], Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = make_once(f"camera_{fov_deg:g}_{k1:g}", lambda path: drive(path, fov_deg, k1))
    config = tmp_path / "lookback.toml"
    config.write_text("[sampling] # so far\n")
    assert calibrate(folder / "bent" if k1 else folder, "--write", config) == 0
    printed, found = capsys.readouterr().out, load_config(config).camera
    fov_sigma_deg, k1_sigma = (
        float(after.split()[0].rstrip(",")) for after in printed.partition("\n")[0].split("±")[1:]
    )
    assert found.fov_deg == pytest.approx(fov_deg, abs=3 * fov_sigma_deg)
    assert fov_sigma_deg < 1.7 and k1_sigma >= 0.03, "as far off as it was on drives of a pinhole"
    assert (found.distortion or (0.0,))[0] == pytest.approx(k1, abs=3 * k1_sigma)
    assert bool(found.distortion) == bool(k1)
    assert f"[camera]\nfov_deg = {found.fov_deg:g}\ndistortion = [" in printed


def parked(folder: Path, header: FeedHeader, *, meters: float, heading_deg: float | None = 0.0) -> Path:
    """A recording of gray pictures, meters apart, straight ahead."""
    with FeedWriter(folder, header) as writer:
        for at in range(120):
            row = FeedRow("", at, distance_m=at * meters, heading_deg=heading_deg)
            writer.write(np.full((48, 64, 3), 128, np.uint8), row)
    return folder


def test_what_shows_no_camera_is_one_line(tmp_path: Path) -> None:
    header = FeedHeader("gray", "front", 64, 48)
    with pytest.raises(
        FeedError, match=r"blind: the field of view stays unknown, to \d+ %; record a drive with more bends"
    ):
        calibrate(parked(tmp_path / "blind", header, meters=1.0))
    with pytest.raises(FeedError, match=r"short/frames.csv: 60 m are too short; 300 m with bends show a camera"):
        calibrate(parked(tmp_path / "short", header, meters=0.5))
    with pytest.raises(FeedError, match=r"frames.csv: the camera needs turns: heading_deg, or positions, in most rows"):
        calibrate(parked(tmp_path / "astray", header, meters=1.0, heading_deg=None))
    fisheye = msgspec.structs.replace(header, lens="fisheye", distortion=(0.1, 0.0, 0.0, 0.0))
    with pytest.raises(FeedError, match=r"fisheye has four factors, which a drive does not show; use a chessboard"):
        calibrate(parked(tmp_path / "fisheye", fisheye, meters=1.0))
    rows = tmp_path / "short" / "frames.csv"
    rows.write_text(
        "file,stamp_ns\n" + "".join(",".join(row.split(",")[:2]) + "\n" for row in rows.read_text().splitlines()[1:])
    )
    with pytest.raises(FeedError, match=r"frames.csv: the camera needs the way: distance_m in every row, or positions"):
        calibrate(tmp_path / "short")


def test_a_map_is_needed_for_all_else(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in ((), (tmp_path, tmp_path)):
        with pytest.raises(SystemExit):
            calibrate(*words)
        assert "--map is required, except as `lookback calibrate camera FEED`" in capsys.readouterr().err
