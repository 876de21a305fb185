"""Published recordings as feeds.

Each kind of recording is a module with `open_traverse(path, options)`, whose docstring names the specification of the
layout; `open_dataset` finds it by name.

    a recording in its own layout -> Traverse -> importing.write_feed -> a feed, as the simulator writes it

A further layout is a module and a line in `KINDS`.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from edge.config import PINHOLE, CameraConfig, Lens
from edge.errors import FeedError
from edge.feed import FeedRow, Pictures, View
from sim.datasets.alignment import Alignment
from sim.output import checked_option, needing

TruthKind = Literal["positions", "rows", "route_m"]
log = logging.getLogger(__name__)


ONE_CLOCK_S = 0.1
"""Of stamps that one computer gave to pictures and positions: exposure, and the receiver's own delay."""


@dataclass(frozen=True)
class Traverse:
    """One drive of a data set: rows as a feed has them, one for every picture, and the pictures.

    rows: `file` names the picture; unknown values are None. `extra` has `local_x_m` and `local_y_m` where a data set
    has meters and no degrees; `source_frame` where pictures of the same place have the same number in all traverses.
    """

    name: str
    source: str
    rows: tuple[FeedRow, ...]
    pictures: Pictures
    view: View = "front"
    notes: str = ""
    alignment: Alignment | None = None
    """Of a video over its track, where the two have clocks of their own."""
    time_sigma_s: float | None = None
    """See `FeedHeader`, where there is no alignment."""
    fov_deg: float | None = None
    """Horizontal field of view of the pictures, where the recording says it."""
    lens: Lens = PINHOLE


@dataclass(frozen=True)
class ReadOptions:
    """Options of reading; each kind has some of them, see `KINDS`. None is the kind's own default."""

    camera: str | None = None
    """Which camera (RobotCar: stereo/left; KITTI: image_2), end of names (video) or topic (ROS)."""
    positions: str | None = None
    """Which positions: a file (a log, a CSV file, poses), a topic, or gps | ins (RobotCar)."""
    names: Path | None = None
    """A text file that lists the pictures to use, one name a line."""
    fps: float | None = None
    """Pictures a second, where the layout has no times."""
    offset_s: float | None = None
    """Seconds from the track's first position to the video's first frame."""
    start_time: str | None = None
    """When the video's first frame was taken: ISO 8601, instead of offset_s."""
    columns: str | None = None
    """Columns of a CSV file by what they are: time=t,lat=y,lon=x,heading=course,file=name."""
    crop_bottom: int | None = None
    """Rows of pixels to cut off below, where the vehicle itself is seen."""
    view: View | None = None
    """Direction of the camera; the default is front, or that of the camera's name."""
    fov_deg: float | None = None
    """Horizontal field of view of the pictures, in place of what the recording says."""

    def given(self) -> set[str]:
        """Names of the options that are not None."""
        return {option.name for option in fields(self) if getattr(self, option.name) is not None}


@dataclass(frozen=True)
class DatasetKind:
    """One layout: its reader, its options, and the usual ground truth."""

    module: str
    what: str
    truth: TruthKind
    tolerance: float
    """Meters; frames if truth is "rows"."""
    options: frozenset[str]


OF_ALL = ("view", "fov_deg")
"""Options that each kind has."""
USUAL_FOV = "a phone 65, upright 40; a GoPro in Linear 86; webcams 60 to 78"
"""Horizontal fields of view in degrees, for who has to say one."""


def _kind(
    module: str, what: str, *options: str, truth: TruthKind = "positions", tolerance: float = 25.0
) -> DatasetKind:
    return DatasetKind(f"sim.datasets.{module}", what, truth, tolerance, frozenset({*OF_ALL, *options}))


KINDS: Mapping[str, DatasetKind] = MappingProxyType(
    {
        "robotcar": _kind(
            "robotcar", "Oxford RobotCar: folder of one traverse", "camera", "positions", "crop_bottom", tolerance=40.0
        ),
        "nordland": _kind(
            "equal_index", "Nordland: a season's frames or video", "names", "fps", truth="rows", tolerance=10.0
        ),
        "gardens-point": _kind(
            "equal_index", "Gardens Point: day_left, ...", "names", "fps", truth="rows", tolerance=2.0
        ),
        "kitti": _kind("kitti", "KITTI odometry: sequences/NN", "camera", "positions", tolerance=10.0),
        "comma2k19": _kind("comma", "comma2k19: folder of one segment"),
        "fred": _kind("fred", "FRED: folder of one sequence", "camera"),
        "geotagged": _kind("geotagged", "folder of pictures, with EXIF positions or without", "fps"),
        "pictures": _kind("pictures_csv", "folder of pictures and a CSV file", "positions", "columns", "fps"),
        "video-log": _kind("video_log", "video, and its log or track", "positions", "offset_s", "start_time"),
        "video": _kind("video", "video or a folder of its parts: GoPro, dashcam", "camera"),
        "rosbag": _kind("rosbag", "ROS 1 or 2 bag, or MCAP", "camera", "positions"),
    }
)
OWN = frozenset({"geotagged", "pictures", "video-log", "video", "rosbag"})
"""Recordings of one's own, which do not say where the camera looked."""
ASSUMED_FRONT = "the camera is assumed to look ahead; --view rear, if it looked back"


def check_files(path: Path) -> None:
    """FeedError for a pipe or a device in a recording, which would be waited for without end."""
    for folder, _, names in os.walk(path):
        for file in (Path(folder, name) for name in names):
            if file.exists() and not file.is_file():
                raise FeedError(f"{file}: not a regular file; remove it from the recording")


def open_dataset(kind: str, path: Path, options: ReadOptions | None = None) -> Traverse:
    """Open one traverse of a data set.

    FeedError names the file, the line or the option if anything is missing, malformed, or cannot be put together;
    ConfigError a field of view that is out of range.
    """
    options = options or ReadOptions()
    if options.fov_deg is not None:
        checked_option(CameraConfig(), "--fov-deg", fov_deg=options.fov_deg)
    if kind not in KINDS:
        raise FeedError(f"{kind}: no such kind of data set; it is one of {', '.join(sorted(KINDS))}")
    unused = sorted(options.given() - KINDS[kind].options)
    if unused:
        raise FeedError(f"--{unused[0].replace('_', '-')}: is no option of {kind}")
    if not path.exists():
        raise FeedError(f"{path}: no such file or folder")
    check_files(path)
    with needing(f"{kind}:", "import", FeedError):
        # Imported here: each reader needs another library. An absolute path: readers name a traverse after its folder.
        traverse: Traverse = import_module(KINDS[kind].module).open_traverse(path.absolute(), options)
    if options.fov_deg is not None:
        if traverse.lens.bends:
            log.warning("%s: --fov-deg %g replaces its own lens, as if that bent no lines", path, options.fov_deg)
        traverse = replace(traverse, fov_deg=options.fov_deg, lens=PINHOLE)
    if options.view is not None:
        return replace(traverse, view=options.view)
    if kind in OWN and traverse.view == "front":
        return replace(traverse, notes="; ".join(filter(None, (traverse.notes, ASSUMED_FRONT))))
    return traverse
