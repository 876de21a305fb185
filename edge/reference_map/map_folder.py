"""Opening a map, or all maps of a folder, and a map of this drive that grows, as one set."""

from __future__ import annotations

import resource
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.errors import MapError
from edge.reference_map.growing_map import MapSoFar
from edge.reference_map.map_set import ExcludedMap, MapSet, name_of, of_folder, printable
from edge.reference_map.signature import check_signature
from edge.reference_map.store import HEADER, ReferenceMap, open_map, open_unverified

OTHER_FILES = 256
"""Files that the rest of the program may open besides one of each map."""


def open_map_set(
    path: Path,
    *,
    require_signature_by: Path | None = None,
    every_file: bool = False,
    newest: MapSoFar | None = None,
) -> MapSet:
    """Open the map at a path, or all maps of a folder. newest: of this drive, searched after all others, if any.

    Headers and sizes are checked here, the checksums of large files by a `ChecksumSchedule`; with `every_file` all of
    them here, which takes long. require_signature_by: a public key; maps that its owner has not signed are excluded.
    Raises MapError, and ConfigError for the key.
    """
    folders = _maps_in(path)
    _allow_open_files(path, len(folders))
    projections: dict[str, NDArray[np.float32]] = {}

    def open_one(folder: Path) -> ReferenceMap:
        one = open_map(folder, every_file=True) if every_file else open_unverified(folder, projections)
        if require_signature_by is not None:
            check_signature(folder, one.header, require_signature_by)
        return one

    if not folders and newest is None:
        return MapSet.of(open_one(path))
    if newest is not None and (path / HEADER).exists():
        folders = [path]
    maps: list[ReferenceMap] = []
    excluded = []
    for folder in folders:
        try:
            maps.append(open_one(folder))
        except MapError as error:
            excluded.append(ExcludedMap(name_of(folder), printable(str(error))))
    return of_folder(path, maps if newest is None else [*maps, newest], excluded)


def _maps_in(path: Path) -> list[Path]:
    """The maps of a folder, in the order of their names; none if it is a map itself."""
    try:
        if (path / HEADER).exists() or not path.is_dir():
            return []
        # What is hidden is still being built.
        return sorted(one for one in path.iterdir() if not one.name.startswith(".") and (one / HEADER).exists())
    except OSError as error:
        raise MapError(f"{error.filename}: cannot read it: {error.strerror}") from None


def _allow_open_files(path: Path, maps: int) -> None:
    """Each map is one open file for as long as the program runs. MapError if that is not allowed."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = maps + OTHER_FILES
    if soft == resource.RLIM_INFINITY or needed <= soft:
        return
    if hard != resource.RLIM_INFINITY and needed > hard:
        raise MapError(
            f"{path}: {maps} maps need {needed} open files, and this process may have {hard};"
            " raise the limit (LimitNOFILE= of the service, or `ulimit -Hn`), or make larger tiles"
        )
    resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))
