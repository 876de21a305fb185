"""A video that holds its own positions, or several: the chapters of a GoPro, or the parts of one drive in a folder.

    GX010042.MP4                     GoPro (GPMF), CAMM, BlackVue: read by mapillary_tools
    2024_0101_120000_0001F.MP4       other dashcams: by mapillary_tools from what ExifTool finds, if it is installed

`camera` chooses among the videos of a folder by the end of their names: front, back, F, R. A rear camera is known by
such an end (`REAR`). Parts are put together without a gap. Positions of BlackVue, and those that ExifTool finds, count
from the first of them: where that came late after the start, they are late as well.
"""

from __future__ import annotations

import logging
import math
import re
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from edge.errors import FeedError
from edge.feed import FeedRow, View
from sim.datasets import ReadOptions, Traverse
from sim.datasets.boxes import contents
from sim.datasets.field_of_view import of_video
from sim.datasets.pictures import join_videos, video_files
from sim.datasets.track import Track, TrackFix

log = logging.getLogger(__name__)

SIGNS = (b"gpmd", b"camm", b"gps ", b"GPS ")
"""Kinds of tracks and boxes that hold positions: GoPro, CAMM, BlackVue, Novatek."""
REAR = re.compile(r"(-back|[_\d][A-Z]?R)$")
"""Ends of names of rear cameras: Tesla; 20240101_120000_NR (BlackVue), 0001R (VIOFO)."""


def open_traverse(path: Path, options: ReadOptions) -> Traverse:
    """The frames of the videos at their own positions; with a warning where there are none. FeedError."""
    files = video_files(path) if path.is_file() else _parts(path, options.camera)
    joined = join_videos(files)
    names, stamps_ns = joined.names, joined.stamps_ns
    fixes = [
        replace(fix, stamp_ns=start_ns + fix.stamp_ns)
        for file, start_ns in zip(files, joined.starts_ns, strict=True)
        for fix in _positions_in(file)
    ]
    if fixes:
        rows = Track(str(path), fixes).rows(str(path), names, stamps_ns)
    else:
        more = "" if _has_exiftool() else "; ExifTool, which knows more dashcams, is not installed"
        log.warning(
            "%s: no positions are found in it%s; used without, unless --positions names a track", path.name, more
        )
        rows = tuple(FeedRow(name, stamp_ns) for name, stamp_ns in zip(names, stamps_ns, strict=True))
    fov_deg, lens = of_video(files[0], joined.feeds[0].header.width, joined.feeds[0].header.height)
    view: View = "rear" if REAR.search(files[0].stem) else "front"
    notes = f"{len(files)} video(s), {len(fixes)} positions in them"
    return Traverse(path.stem, path.name, rows, joined.pictures, view, notes, fov_deg=fov_deg, lens=lens)


def _parts(folder: Path, camera: str | None) -> list[Path]:
    files = video_files(folder, camera or "")
    ends = {bool(REAR.search(file.stem)) for file in files}
    if len(ends) != 1:
        what = (
            "several cameras; choose one with `lookback import --camera`, as in --camera front"
            if ends
            else f"no {camera or ''} video"
        )
        raise FeedError(f"{folder}: {what}")
    return files


def holds_positions(file: Path) -> bool:
    """Whether a video seems to hold positions of its own, by the kinds of its tracks; needs no package."""
    return any(sign in content for _, content in contents(file) for sign in SIGNS)


def _positions_in(file: Path) -> Iterator[TrackFix]:
    """The positions that a video holds, stamped from its first frame on; none where there are none."""
    from mapillary_tools.exceptions import MapillaryDescriptionError, MapillaryVideoGPSNotFoundError
    from mapillary_tools.geotag.video_extractors.native import NativeVideoExtractor

    points: Sequence[Any] = []
    try:
        points = NativeVideoExtractor(file).extract().points
    except MapillaryVideoGPSNotFoundError:
        points = _exiftool_points(file)
    except MapillaryDescriptionError as error:
        log.warning("%s: %s", file, error)  # a track of positions without a fix: a garage, a tunnel
    for point in points:
        alt_m, heading_deg = (math.nan if value is None else value for value in (point.alt, point.angle))
        yield TrackFix(round(point.time * 1e9), point.lat, point.lon, alt_m, heading_deg, source="gps")


def _exiftool_points(file: Path) -> Sequence[Any]:
    """mapillary_tools' points of what ExifTool finds; none without ExifTool."""
    if not _has_exiftool():
        return []
    from mapillary_tools.exiftool_read_video import ExifToolReadVideo
    from mapillary_tools.exiftool_runner import ExiftoolRunner

    xml = ExiftoolRunner().extract_xml([file])
    found = next(iter(ElementTree.fromstring(xml)), None) if xml else None
    return [] if found is None else list(ExifToolReadVideo(ElementTree.ElementTree(found)).extract_gps_track())


def _has_exiftool() -> bool:
    return shutil.which("exiftool") is not None
