"""Which maps are deleted when the disk's share is full.

Only maps that live mapping made are ever deleted, by the name that they were given; never one that is signed, or that
has a file `keep` in its folder (`lookback map keep`), nor one without which a stretch has no layer left. Retired drives
go first, then the one that was recognized, or made, longest ago.
"""

from __future__ import annotations

import contextlib
import logging
import shutil
from pathlib import Path

from edge.errors import MapError
from edge.layers import NEEDED, read_tallies, stored_maps, stretches
from edge.reference_map import open_map_set

DELETED = ".being-deleted"
ROWS_APART = 5
"""Rows of a drive that are looked at, 10 m apart: a stretch is 25 m, and the daemon's start waits for this."""
log = logging.getLogger(__name__)


def delete_oldest(folder: Path, quota_bytes: float) -> list[Path]:
    """Delete maps of drives until all maps of the folder together take at most `quota_bytes`; those deleted."""
    for left_over in folder.glob(f".*{DELETED}"):
        shutil.rmtree(left_over, ignore_errors=True)
    maps = stored_maps(folder, [])
    total = sum(one.size_bytes for one in maps)
    if total <= quota_bytes:
        return []
    maps = stored_maps(folder, read_tallies(folder))
    may_go = [one for one in maps if one.is_from_drive and not (one.is_kept or one.is_signed)]
    road = _layers_of_road(folder)
    deleted: list[Path] = []
    for one in sorted(may_go, key=lambda one: (not one.is_retired, one.needed_unix_s)):
        if total <= quota_bytes:
            break
        own = [layers for layers in road if one.path in layers]
        if sum(len(layers) == 1 for layers in own) >= min(NEEDED, len(own)) > 0:
            continue
        try:
            # By one rename first: half a map must never be found.
            gone = one.path.with_name(f".{one.path.name}{DELETED}")
            one.path.rename(gone)
            shutil.rmtree(gone)
        except OSError as error:
            log.warning("%s: cannot delete it: %s", one.path, error.strerror)
            continue
        log.info("%s: deleted, since the maps take more than [mapping] quota_mb", one.path)
        deleted.append(one.path)
        total -= one.size_bytes
        for layers in own:
            layers.discard(one.path)
    if total > quota_bytes:
        log.warning("%s: its maps take %.0f MB, more than [mapping] quota_mb; none may be deleted", folder, total / 1e6)
    return deleted


def _layers_of_road(folder: Path) -> list[set[Path]]:
    """The maps of each stretch; none where no map of the folder can be used."""
    with contextlib.suppress(MapError):
        maps = open_map_set(folder, as_recorded=True).maps
        return [{maps[number].path for number in one.rows} for one in stretches(maps, ROWS_APART)]
    return []
