"""The two text files of a feed, parsed and checked: the header `feed.toml` and the rows `frames.csv`."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal

import msgspec

from edge.config import FieldOfView, Lens
from edge.errors import FeedError, LookbackError
from edge.geodesy import POSITION_SOURCES, PositionSource
from edge.toml_file import Line, read_text, read_toml

View = Literal["front", "rear"]
Pixels = Annotated[int, msgspec.Meta(ge=1, le=16384)]


class FeedHeader(Lens, frozen=True):
    """`feed.toml`; keys that are not listed here are ignored.

    preprocessing: the flip, crop and mask that the images were recorded with; "" for images as the camera gave them.
    odometer: whether distance_m and heading_deg were measured, and not computed from the positions.
    time_sigma_s: one standard deviation of what all stamps have in common against the positions' own times, as of a
    video that was laid over a track: all positions are off by that much travel, to one side. None: not known.
    fov_deg: horizontal field of view of the images, after the preprocessing, without what their lens bends. None: not
    known.
    heading_is_course: whether heading_deg is the course of the positions, as `sim.traverse.with_course` has it.
    origin: the name of the recording whose origin its local positions have too; "" for one of its own.
    """

    name: Line
    view: View
    width: Pixels
    height: Pixels
    source: Line = ""
    notes: str = ""
    video: Line = ""
    preprocessing: Line = ""
    odometer: bool = False
    time_sigma_s: Annotated[float, msgspec.Meta(ge=0)] | None = None
    fov_deg: FieldOfView | None = None
    heading_is_course: bool = False
    origin: Line = ""


def read_header(file: Path) -> FeedHeader:
    """Read and check `feed.toml`; FeedError names it, and the key."""
    if not file.exists():
        raise FeedError(
            f'{file}: no such file; it needs name = "...", view = "front" or "rear", width and height in pixels.'
            " `lookback import` writes it for pictures with a CSV file or with positions in their EXIF data"
        )
    header = read_toml(file, FeedHeader, FeedError)
    if header.video and not stays_inside(header.video):
        raise FeedError(f"{file}: video: {header.video!r} is outside the feed's folder")
    return header


MEASURES = ("lat_deg", "lon_deg", "alt_m", "heading_deg", "speed_mps", "distance_m", "position_sigma_m")
SOURCE = "position_source"
LIMITS = {"lat_deg": 90.0, "lon_deg": 180.0}


@dataclass(frozen=True)
class FeedRow:
    """One row of `frames.csv`; what is not known is None. `extra` has the further columns as text.

    The position is that at `stamp_ns`; position_sigma_m: one standard deviation of its distance from the truth.
    """

    file: str
    stamp_ns: int
    lat_deg: float | None = None
    lon_deg: float | None = None
    alt_m: float | None = None
    heading_deg: float | None = None
    speed_mps: float | None = None
    distance_m: float | None = None
    position_sigma_m: float | None = None
    position_source: PositionSource = "unknown"
    extra: Mapping[str, str] = field(default_factory=dict)


def read_rows(file: Path) -> tuple[FeedRow, ...]:
    """Read and check `frames.csv`; FeedError names the line and the column.

    Stamps strictly increase, and distances never fall.
    """
    rows: list[FeedRow] = []
    furthest_m = -math.inf
    reader = csv.DictReader(io.StringIO(read_text(file, FeedError), newline=""))
    try:
        missing = {"file", "stamp_ns"} - set(reader.fieldnames or ())
        if missing:
            raise FeedError(f"{file}: no column {' and no column '.join(sorted(missing))} in its first line")
        for values in reader:
            where = f"{file}: line {reader.line_num}"
            row = _parse_row(where, values)
            if rows and row.stamp_ns <= rows[-1].stamp_ns:
                raise FeedError(
                    f"{where}: stamp_ns {row.stamp_ns} is not after {rows[-1].stamp_ns}, that of the row before"
                )
            furthest_m = _check_distance(where, row, furthest_m)
            rows.append(row)
    except csv.Error as error:
        raise FeedError(f"{file}: {error}") from None
    if not rows:
        raise FeedError(f"{file}: no frames in it")
    return tuple(rows)


def _check_distance(where: str, row: FeedRow, furthest_m: float) -> float:
    """The distance driven up to this row; FeedError if it is less than that of an earlier row."""
    if row.distance_m is None:
        return furthest_m
    if row.distance_m < furthest_m:
        raise FeedError(
            f"{where}: distance_m {row.distance_m:g} is less than {furthest_m:g} of an earlier row; a distance that "
            "starts again belongs in a feed of its own"
        )
    return row.distance_m


def _parse_row(where: str, values: Mapping[str | None, str | None]) -> FeedRow:
    """One CSV row as a FeedRow; an empty measure is None."""
    if None in values:
        raise FeedError(f"{where}: more values than the first line has columns")
    texts = {key: text for key, text in values.items() if key is not None and text is not None}
    if len(texts) < len(values):
        raise FeedError(
            f"{where}: only {len(texts)} of {len(values)} values; if the file is cut short, delete the line"
        )
    if not texts["file"]:
        raise FeedError(f"{where}: file is empty")
    if not stays_inside(texts["file"]):
        raise FeedError(f"{where}: file: {texts['file']!r} is outside the feed's folder")
    extra = {key: text for key, text in texts.items() if key not in {"file", "stamp_ns", *MEASURES, SOURCE}}
    measures = {column: _parse_measure(where, column, texts.get(column)) for column in MEASURES}
    if measures["position_sigma_m"] is not None and measures["position_sigma_m"] <= 0:
        raise FeedError(f"{where}: position_sigma_m: {measures['position_sigma_m']:g} is not above 0")
    source = _parse_source(where, texts.get(SOURCE))
    return FeedRow(
        texts["file"], _parse_stamp(where, texts["stamp_ns"]), **measures, position_source=source, extra=extra
    )


def _parse_stamp(where: str, text: str) -> int:
    try:
        stamp_ns = int(text)
    except ValueError:
        raise FeedError(f"{where}: stamp_ns: {text!r} is not a whole number") from None
    if abs(stamp_ns) >= 2**63:
        raise FeedError(f"{where}: stamp_ns: {text} is more than 64 bits hold")
    return stamp_ns


def _parse_source(where: str, text: str | None) -> PositionSource:
    for source in POSITION_SOURCES:
        if source == (text or "unknown"):
            return source
    raise FeedError(f"{where}: {SOURCE}: {text!r} is none of {', '.join(POSITION_SOURCES)}")


def _parse_measure(where: str, column: str, text: str | None) -> float | None:
    if not text:
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FeedError(f"{where}: {column}: {text!r} is not a number")
    check_degrees(where, column, value)
    return value


def check_degrees(where: str, column: str, value: float | None) -> None:
    """FeedError for a latitude or a longitude that is not on the earth; None is not known."""
    limit = LIMITS.get(column, math.inf)
    if value is not None and abs(value) > limit:
        raise FeedError(f"{where}: {column}: {value:g} is not between {-limit:g} and {limit:g} degrees")


def stays_inside(name: str) -> bool:
    """Whether a path that a feed gives is relative and does not climb; feeds are handed around between people."""
    parts = PurePosixPath(name)
    return not parts.is_absolute() and ".." not in parts.parts and name.isprintable()


def file_inside(folder: Path, name: str, error_class: type[LookbackError] = FeedError) -> Path:
    """A file of a feed; an error for a link that leads out of it, or a pipe, which would be waited for without end."""
    file = folder / name
    if file.exists() and not (file.is_file() and Path(os.path.realpath(file)).is_relative_to(os.path.realpath(folder))):
        raise error_class(f"{file}: not a regular file of this feed; replace a link by what it leads to")
    return file
