"""Frames without positions of their own: Nordland, Gardens Point."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.feed import FeedImages, read_feed
from sim.compare.truth import errors_between, points_of
from sim.datasets import ReadOptions, open_dataset

WritePictures = Callable[[Path, list[str]], None]
WriteVideo = Callable[[Path, int, float], None]
IndexOf = Callable[[NDArray[np.uint8]], int]
Import = Callable[..., int]
Refused = Callable[..., None]


def test_nordland_seasons_are_the_same_frame_by_frame(
    tmp_path: Path, write_pictures: WritePictures, sim_import: Import, index_of: IndexOf
) -> None:
    names = [f"images-{i:05d}.png" for i in range(1, 21)]
    write_pictures(tmp_path / "summer", names)
    write_pictures(tmp_path / "winter", [name for name in names if name != "images-00004.png"])
    (tmp_path / "cleanImageNames.txt").write_text("\n".join([*names[:10], *names[14:]]) + "\n")
    for season in ("summer", "winter"):
        sim_import(
            "nordland",
            tmp_path / season,
            "-o",
            tmp_path / f"feeds/{season}",
            "--names",
            tmp_path / "cleanImageNames.txt",
        )
    summer, winter = read_feed(tmp_path / "feeds/summer"), read_feed(tmp_path / "feeds/winter")
    assert (len(summer.rows), len(winter.rows)) == (16, 15)
    assert index_of(FeedImages(summer).read(10)) == 14
    is_right = errors_between(*points_of("rows", summer, winter)) <= 1
    # Row 3 of the winter is frame 5, row 9 is frame 15: the first after the tunnel.
    assert [summer.rows[row].extra["source_frame"] for row in np.flatnonzero(is_right[3])] == ["4", "5", "6"]
    assert [summer.rows[row].extra["source_frame"] for row in np.flatnonzero(is_right[9])] == ["15", "16"]


def test_nordland_may_be_a_video(tmp_path: Path, write_video: WriteVideo, index_of: IndexOf, refused: Refused) -> None:
    write_video(tmp_path / "winter.avi", 9, 25.0)
    traverse = open_dataset("nordland", tmp_path / "winter.avi")
    assert [row.extra["source_frame"] for row in traverse.rows] == [str(i) for i in range(9)]
    assert traverse.rows[8].stamp_ns == 320_000_000
    assert index_of(traverse.pictures.read(6)) == 6
    refused("nordland", tmp_path / "winter.avi", "--names: .*is a video", ReadOptions(names=tmp_path / "list.txt"))


def test_gardens_point_walks(tmp_path: Path, write_pictures: WritePictures, sim_import: Import) -> None:
    for walk in ("day_left", "night_right"):
        write_pictures(tmp_path / walk, [f"Image{i:03d}.jpg" for i in range(12)])
        sim_import("gardens-point", tmp_path / walk, "-o", tmp_path / f"feeds/{walk}", "--spacing-frames", 2)
    day, night = (read_feed(tmp_path / f"feeds/{walk}") for walk in ("day_left", "night_right"))
    assert [row.extra["source_file"] for row in night.rows][:2] == ["Image000.jpg", "Image002.jpg"]
    errors = errors_between(*points_of("rows", day, night))
    assert np.flatnonzero(errors[3] <= 2).tolist() == [2, 3, 4]


def test_frames_that_are_not_there_are_named(tmp_path: Path, write_pictures: WritePictures, refused: Refused) -> None:
    (tmp_path / "empty").mkdir()
    write_pictures(tmp_path / "full", ["1.png"])
    (tmp_path / "list.txt").write_text("other.png\n")
    refused("gardens-point", tmp_path / "nowhere", f"^{tmp_path}/nowhere: no such file or folder$")
    refused("gardens-point", tmp_path / "empty", f"^{tmp_path}/empty: no pictures in this folder$")
    refused("nordland", tmp_path / "list.txt", r"list\.txt: cannot read this folder: Not a directory")
    names = ReadOptions(names=tmp_path / "list.txt")
    refused("nordland", tmp_path / "full", r"list\.txt: names none of the pictures in .*full, such as 1\.png", names)
    refused("gardens-point", tmp_path / "full", "--fps: -1 is not above 0", ReadOptions(fps=-1.0))
