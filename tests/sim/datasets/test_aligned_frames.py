"""Frames without positions of their own: University Campus style, Nordland, Gardens Point."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.feed import FeedImages, read_feed
from sim.compare.truth import errors_between, points_of
from sim.datasets import ReadOptions, open_dataset

WritePictures = Callable[[Path, list[str]], None]
WriteVideo = Callable[[Path, int, float], None]
IndexOf = Callable[[NDArray[np.uint8]], int]
Import = Callable[..., int]
Refused = Callable[..., None]


@pytest.fixture
def campus_path(tmp_path: Path, write_pictures: WritePictures) -> Path:
    """Forward by day, and back at another pace; the frames of both are 30 and 20, and the route is 60 m."""
    forward, back = tmp_path / "forward_day", tmp_path / "reverse_day"
    write_pictures(forward, [f"{i}.jpg" for i in range(30)])  # 9.jpg comes before 10.jpg
    write_pictures(back, [f"{i:05d}.png" for i in range(20)])
    (forward / "anchors.csv").write_text("frame,route_m\n0,0\n10,30\n29,60\n")
    (back / "anchors.csv").write_text("frame, route_m\n2, 60\n12, 40\n19, 5.0\n")
    return tmp_path


def test_campus_places_are_interpolated_between_the_anchors(campus_path: Path, index_of: IndexOf) -> None:
    traverse = open_dataset("campus", campus_path / "reverse_day", ReadOptions(fps=2.0))
    route = [float(row.extra["route_m"]) if row.extra else None for row in traverse.rows]
    assert route[:4] == [None, None, 60.0, 58.0]
    assert route[13:] == pytest.approx([35, 30, 25, 20, 15, 10, 5])
    assert [row.distance_m for row in traverse.rows[2:4]] == [0.0, 2.0]
    assert traverse.rows[19].distance_m == pytest.approx(55)
    assert traverse.rows[3].stamp_ns == 1_500_000_000
    assert index_of(open_dataset("campus", campus_path / "forward_day").pictures.read(9)) == 9


def test_campus_traverses_in_both_directions_have_one_truth(campus_path: Path, sim_import: Import) -> None:
    feeds = []
    for name in ("forward_day", "reverse_day"):
        sim_import("campus", campus_path / name, "-o", campus_path / "feeds" / name, "--spacing-m", 5)
        feeds.append(read_feed(campus_path / "feeds" / name))
    forward, back = feeds
    is_right = errors_between(*points_of("route_m", forward, back)) <= 20.0
    for query, row in enumerate(back.rows):
        near = [
            index
            for index, reference in enumerate(forward.rows)
            if abs(float(reference.extra["route_m"]) - float(row.extra["route_m"])) <= 20.0
        ]
        assert np.flatnonzero(is_right[query]).tolist() == near
    assert is_right[0, -1]
    assert is_right[-1, 0]


def test_campus_frames_may_be_a_video_with_the_anchors_beside_it(tmp_path: Path, write_video: WriteVideo) -> None:
    write_video(tmp_path / "walk.avi", 12, 4.0)
    (tmp_path / "walk.csv").write_text("frame,route_m\n0,0\n11,22\n")
    rows = open_dataset("campus", tmp_path / "walk.avi").rows
    assert [(row.stamp_ns, row.distance_m) for row in rows[:3]] == [(0, 0.0), (250_000_000, 2.0), (500_000_000, 4.0)]


@pytest.mark.parametrize(
    ("anchors", "message"),
    [
        ("frame,route_m\n0,0\n0,5\n", r"anchors\.csv: line 3: frame 0 is not after the line before"),
        ("frame,route_m\n0,0\n30,5\n", r"anchors\.csv: frame 30 is not among the 30 frames of .*forward_day"),
        ("frame,route_m\n-1,0\n29,5\n", r"anchors\.csv: frame -1 is not among the 30 frames"),
        ("frame,route_m\n0,0\n", r"anchors\.csv: one anchor, and two at least are needed"),
        ("frame,route_m\n0,0\n7.5,3\n", r"anchors\.csv: line 3: frame: '7\.5' is not a whole number"),
        ("frame,route_m\n0,0\n7,inf\n", r"anchors\.csv: line 3: route_m: 'inf' is not a number"),
        (None, r"anchors\.csv: cannot read it: No such file"),
    ],
)
def test_campus_anchors_that_cannot_be_are_named(
    campus_path: Path, anchors: str | None, message: str, refused: Refused
) -> None:
    file = campus_path / "forward_day/anchors.csv"
    file.unlink()
    if anchors is not None:
        file.write_text(anchors)
    refused("campus", campus_path / "forward_day", f"^{campus_path}/forward_day/{message}")


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
