"""What a start makes of the drives of earlier runs: maps, the same bytes that `lookback map build` would write."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from edge.errors import MapError
from edge.reference_map.keypoint_records import record_of
from edge_plugins.layers.stored import delete_oldest, source_of
from edge_plugins.mapping import MappingConfig
from edge_plugins.mapping.builder import MapBuilder
from edge_plugins.mapping.keypoint_rows import NO_KEYPOINTS
from edge_plugins.mapping.place_log import OpenLog, files_of, logs_in, map_of

SLOWEST_S = 0.01
"""For a place of an earlier drive, on a small computer with a slow card; it took 0.0003 s on a desk's."""
FEWEST_PLACES = 20
"""A drive of fewer places is no map: nothing can be recognized on it."""
log = logging.getLogger(__name__)


def finish_earlier(
    config: MappingConfig, before_long: Callable[[float], object], resumes: Callable[[OpenLog], bool]
) -> None:
    """Make maps of the drives of a folder, the newest first, but of one that `resumes` goes on with. OSError.

    The disk's share is kept.
    """
    folder, quota_bytes = Path(config.folder), config.quota_mb * 1e6
    delete_oldest(folder, quota_bytes)
    for file in reversed(logs_in(folder)):
        try:
            found = OpenLog(file)
            before_long(SLOWEST_S * len(found.rows))
            if not resumes(found):
                with closing(found):
                    complete(found)
        except MapError as error:
            log.warning("%s", error)
    delete_oldest(folder, quota_bytes)


def complete(file: OpenLog) -> None:
    """Make the map of an earlier drive, unless it has too few places for one, and remove its file.

    A crash leaves the file, the map, or both; the next start goes on. MapError if the map cannot be written.
    """
    path, places = map_of(file.path), len(file.rows)
    if places < FEWEST_PLACES:
        log.info("%s: %d places are too few for a map; removed", file.path, places)
    elif not path.exists():
        _build(file, path)
        log.info("%s: a map of %d places was made of the drive", path, places)
    file.close()
    for one in files_of(file.path):
        one.unlink(missing_ok=True)


def _build(file: OpenLog, path: Path) -> None:
    header, key = file.header, file.header.keypoints
    key_of = None if key is None else lambda height, width: key
    with MapBuilder(path, header.model, header.regions, header.sampling, keypoints=key_of) as builder:
        for first, end, view in file.segments():
            builder.begin_segment(source_of(path), view, has_odometer=True, whole_sigma_m=0.0)
            for row in range(first, end):
                try:
                    passed = file.place(row)
                    builder.add(file.raw_of(passed), passed.place)
                    if builder.keypoints and key:
                        points = file.points(row)
                        record = record_of(NO_KEYPOINTS, key) if points is None else points.record
                        builder.keypoints.add_record(record, key, points.mount if points else None)
                    if not passed.is_vouched:
                        builder.doubt()
                except OSError as error:
                    raise MapError(f"{file.path}: cannot read it: {error.strerror}") from None
        builder.finish()
