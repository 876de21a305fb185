"""The places of an earlier drive become an ordinary map: the same bytes that `lookback map build` would write."""

from __future__ import annotations

import logging
from pathlib import Path

from edge.errors import MapError
from edge.layers import source_of
from edge.mapping.place_log import OpenLog
from edge.reference_map import MapBuilder

SUFFIX = ".growing"
FEWEST_PLACES = 20
"""A drive of fewer places is no map: nothing can be recognized on it."""
log = logging.getLogger(__name__)


def log_of(map_path: Path) -> Path:
    """The file in which a map is made; hidden, so that it is no map of its folder yet."""
    return map_path.with_name(f".{map_path.name}{SUFFIX}")


def map_of(file: Path) -> Path:
    """The map that a file of places will become."""
    return file.with_name(file.name[1 : -len(SUFFIX)])


def logs_in(folder: Path) -> list[Path]:
    """Files of places of all drives that are not maps yet, the oldest first."""
    return sorted(folder.glob(f".*{SUFFIX}"))


def complete(file: OpenLog) -> Path | None:
    """Make the map of an earlier drive and remove its file; None where the drive has too few places for one.

    A crash leaves the file, the map, or both; the next start goes on. MapError if the map cannot be written.
    """
    path = map_of(file.path)
    if len(file.places_at) < FEWEST_PLACES:
        log.info("%s: %d places are too few for a map; removed", file.path, len(file.places_at))
        file.path.unlink(missing_ok=True)
        return None
    if not path.exists():
        _build(file, path)
        log.info("%s: a map of %d places was made of the drive", path, len(file.places_at))
    file.path.unlink(missing_ok=True)
    return path


def _build(file: OpenLog, path: Path) -> None:
    header = file.header
    with MapBuilder(path, header.model, header.regions, header.sampling) as builder:
        for first, end, drive in file.segments():
            builder.begin_segment(source_of(path), drive.view)
            for row in range(first, end):
                try:
                    passed = file.place(row)
                    builder.add(file.raw_of(passed), passed.place)
                except OSError as error:
                    raise MapError(f"{file.path}: cannot read it: {error.strerror}") from None
        builder.finish()
