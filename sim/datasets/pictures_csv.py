"""A folder of pictures and a CSV file with their times and, where known, positions: the layout of one's own recordings.

    drive/0001.jpg ...    drive/frames.csv    file,time,lat,lon,heading

The first line names the columns. Usual names are known (`NAMES`, whatever their case, units in brackets and a leading #
aside), and `columns` names others: time=t,lat=y. Without a column of files, names of pictures that are numbers are
their times, as in EuRoC, TUM and RobotCar, and the lines are positions of any moment; else each line is one picture, in
the order of the names. Times are ISO 8601, or numbers of seconds, milliseconds, microseconds or nanoseconds, of which
the unit is that in the column's name, or else follows from the number of digits of a Unix time.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from edge.errors import FeedError
from edge.feed import FeedRow
from edge.geodesy import PositionSource
from sim.datasets import ReadOptions, Traverse
from sim.datasets.field_of_view import of_euroc
from sim.datasets.pictures import PICTURE_SUFFIXES, PictureFiles, list_pictures
from sim.datasets.tables import TableRecord, parse_time_ns, read_records
from sim.datasets.track import Track, TrackFix, from_local

NAMES = {
    "time": ("stamp_ns", "timestamp", "time", "t", "stamp", "unix_time", "gps_time", "utc", "datetime", "date_time"),
    "lat": ("lat_deg", "lat", "latitude", "gps_lat", "gps_latitude"),
    "lon": ("lon_deg", "lon", "lng", "long", "longitude", "gps_lon", "gps_lng", "gps_longitude"),
    "x": ("x", "x_m", "east", "easting", "utm_e", "utm_east", "utm_x", "pos_x", "position_x", "tx", "local_x_m"),
    "y": ("y", "y_m", "north", "northing", "utm_n", "utm_north", "utm_y", "pos_y", "position_y", "ty", "local_y_m"),
    "zone": ("zone", "utm_zone"),
    "alt": ("alt_m", "alt", "altitude", "elevation", "ele", "height"),
    "heading": ("heading_deg", "heading", "yaw", "bearing", "course", "azimuth", "track"),
    "speed": ("speed_mps", "speed", "velocity"),
    "file": ("file", "filename", "file_name", "image", "image_name", "img", "picture", "frame", "path", "name"),
}
"""What a column is, by its usual names, the first that is there."""
UNITS_NS = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}
DIGITS_NS = ((1e17, 1), (1e14, 1_000), (1e11, 1_000_000), (0.0, 1_000_000_000))
"""A Unix time of our century from so much on is in that unit: 1.7e9 s, 1.7e12 ms, 1.7e15 us, 1.7e18 ns."""


def open_traverse(path: Path, options: ReadOptions) -> Traverse:
    """The pictures of one folder. FeedError names the CSV file, and the line or all that it lacks."""
    file = Path(options.positions) if options.positions else csv_in(path)
    records = read_records(file, (), "it gives the time and the position of each picture")
    columns = find_columns(file, tuple(records[0].values), options.columns)
    names = list_pictures(path)
    times = _TimeColumn(columns["time"], records) if "time" in columns else None
    if "file" in columns:
        known = set(names)
        at = {_picture_of(path, record, columns["file"], known): record for record in records}
        names = list(at)
        stamps_ns = _stamps_ns(file, list(at.values()), times, options.fps)
        fixes = _fixes(stamps_ns, list(at.values()), columns)
    elif times and all(Path(name).stem.replace(".", "", 1).isdigit() for name in names):
        unit_ns = _unit_ns(max(float(Path(name).stem) for name in names))
        stamps_ns = [_scaled(Path(name).stem, unit_ns) for name in names]
        fixes = _fixes([times.stamp_ns(record) for record in records], records, columns)
    elif len(records) == len(names):
        stamps_ns = _stamps_ns(file, records, times, options.fps)
        fixes = _fixes(stamps_ns, records, columns)
    else:
        raise FeedError(
            f"{file}: {len(records)} lines for the {len(names)} pictures in {path}, and no column of their names; name"
            " it with --columns file=NAME"
        )
    order = sorted(range(len(names)), key=lambda index: stamps_ns[index])
    names, stamps_ns = [names[index] for index in order], [stamps_ns[index] for index in order]
    if fixes:
        rows = Track(str(file), fixes).rows(str(path), names, stamps_ns)
    else:
        rows = tuple(FeedRow(name, stamp_ns) for name, stamp_ns in zip(names, stamps_ns, strict=True))
    found = ", ".join(column if column == what else f"{column} ({what})" for what, column in columns.items())
    fov_deg, lens = of_euroc(path)
    return Traverse(
        name=path.name,
        source=f"{path.name} and {file.name}",
        rows=rows,
        pictures=PictureFiles([path / name for name in names]),
        notes=f"columns of {file.name}: {found}",
        fov_deg=fov_deg,
        lens=lens,
    )


def positions_in(file: Path) -> Iterator[TrackFix]:
    """The positions of a CSV file that has their times. FeedError names the file, the line, and all that it lacks."""
    records = read_records(file, (), "it gives the time and the position of each moment")
    header = tuple(records[0].values)
    columns = {}
    with suppress(FeedError):  # which names an option that a video's track does not have
        columns = find_columns(file, header, None)
    if "time" not in columns or not {"lat", "x"} & columns.keys():
        raise FeedError(f"{file}: a track needs columns of time, lat and lon; its columns: {', '.join(header)}")
    times = _TimeColumn(columns["time"], records)
    yield from _fixes([times.stamp_ns(record) for record in records], records, columns)


def csv_in(path: Path) -> Path:
    """The one CSV file in a folder of pictures, or beside it. FeedError where there is none, or several."""
    found = sorted(path.glob("*.csv")) or sorted(path.parent.glob(f"{path.name}.csv"))
    if len(found) != 1:
        listed = ", ".join(file.name for file in found) or "none"
        raise FeedError(f"--positions: name the CSV file with the times of the pictures in {path}; in it: {listed}")
    return found[0]


def find_columns(file: Path, header: Sequence[str], given: str | None) -> dict[str, str]:
    """The column of each kind in NAMES that the first line has. FeedError names everything that is wrong at once."""
    plain = {_plain(column): column for column in reversed(header)}
    known = {
        kind: plain[next(name for name in names if name in plain)]
        for kind, names in NAMES.items()
        if not plain.keys().isdisjoint(names)
    }
    wrong = []
    for part in (given or "").split(",") if given else ():
        kind, _, column = (text.strip() for text in part.partition("="))
        if kind not in NAMES or column not in header:
            wrong.append(part)
        known[kind] = column
    if wrong:
        raise FeedError(
            f"--columns: {', '.join(wrong)}: not KIND=COLUMN with a kind of {', '.join(NAMES)} and a column of {file}:"
            f" {', '.join(header)}"
        )
    for one, other in (("x", "y"), ("y", "x")):
        if one in known and other not in known and not (given and one in given):
            del known[one]  # of another meaning
    halves = (("lat" in known) != ("lon" in known)) or (("x" in known) != ("y" in known))
    if halves or known.keys().isdisjoint({"time", "lat", "x", "file"}):
        wanted = ("time", "x", "y", "file") if "x" in known or "y" in known else ("time", "lat", "lon", "file")
        missing = [kind for kind in wanted if kind not in known]
        raise FeedError(
            f"{file}: no column for {', '.join(missing)} among {', '.join(header)}; name them:"
            f" --columns {','.join(f'{kind}=COLUMN' for kind in missing)}"
        )
    return known


def _plain(column: str) -> str:
    """A column's name without its case, unit and leading #: '#timestamp [ns]' is timestamp."""
    name = re.sub(r"[\[(].*", "", column.lower()).strip(" #\ufeff")
    name = re.sub(r"\W+", "_", name).strip("_")
    return name if name == "stamp_ns" else re.sub(r"_(ns|us|ms|s|sec|seconds|deg|degrees)$", "", name)


def _picture_of(path: Path, record: TableRecord, column: str, names: Collection[str]) -> str:
    """The picture that a line names, with or without its folder and suffix. FeedError names the line."""
    name = Path(record.values[column].strip()).name
    found = (
        [name] if name in names else [f"{name}{suffix}" for suffix in PICTURE_SUFFIXES if f"{name}{suffix}" in names]
    )
    if not found:
        raise FeedError(f"{record.where}: {column}: no picture {record.values[column]!r} in {path}")
    return found[0]


class _TimeColumn:
    """A column of times, all of one unit."""

    def __init__(self, column: str, records: Sequence[TableRecord]) -> None:
        self._column = column
        unit = re.search(r"[_\[( ](ns|us|ms|s)\b", column.lower())
        numbers = [text for text in (record.values[column].strip() for record in records) if _is_number(text)]
        self._is_number = bool(numbers)
        self._unit_ns = UNITS_NS[unit[1]] if unit else _unit_ns(max(map(float, numbers), default=0.0))

    def stamp_ns(self, record: TableRecord) -> int:
        """FeedError names the line."""
        text = record.values[self._column].strip()
        if self._is_number:
            record.number(self._column)
            return _scaled(text, self._unit_ns)
        try:
            return parse_time_ns(text)
        except FeedError:
            raise FeedError(
                f"{record.where}: {self._column}: {text!r} is neither a number nor a time such as 2026-05-04T12:30:00Z"
            ) from None


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _unit_ns(number: float) -> int:
    return next(unit_ns for least, unit_ns in DIGITS_NS if number >= least)


def _scaled(text: str, unit_ns: int) -> int:
    """Nanoseconds of a number in that unit; whole ones do not lose digits in a float."""
    return int(text) * unit_ns if text.isdigit() else round(float(text) * unit_ns)


def _stamps_ns(file: Path, records: Sequence[TableRecord], times: _TimeColumn | None, fps: float | None) -> list[int]:
    if times:
        return [times.stamp_ns(record) for record in records]
    if fps is None or not fps > 0:
        raise FeedError(f"{file}: no column for time; name it with --columns time=COLUMN, or say --fps")
    return [round(index * 1e9 / fps) for index in range(len(records))]


def _fixes(stamps_ns: Sequence[int], records: Sequence[TableRecord], columns: Mapping[str, str]) -> list[TrackFix]:
    """A position for each line that has one."""
    pair = next((pair for pair in (("lat", "lon"), ("x", "y")) if pair[0] in columns), None)
    if pair is None:
        return []
    fixes = []
    for stamp_ns, record in zip(stamps_ns, records, strict=True):
        if all(record.values[columns[kind]].strip() for kind in pair):
            lat_deg, lon_deg = (record.number(columns[kind]) for kind in pair)
            zone = record.values.get(columns.get("zone", ""), "")
            source: PositionSource = "unknown"
            if pair == ("x", "y"):
                (lat_deg, lon_deg), source = from_local(lat_deg, lon_deg, zone), "unknown" if zone else "local"
            alt_m, heading_deg, speed_mps = (_number(record, columns.get(kind)) for kind in ("alt", "heading", "speed"))
            fixes.append(TrackFix(stamp_ns, lat_deg, lon_deg, alt_m, heading_deg, speed_mps, source=source))
    return fixes


def _number(record: TableRecord, column: str | None) -> float:
    """NaN where there is no such column, or no value in it."""
    return record.number(column) if column and record.values[column].strip() else math.nan
