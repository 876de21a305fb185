"""`lookback map merge | delta | apply`: the drives of several vehicles, and what they recognized, in one folder.

Drives are known by the checksum of their header, and tallies by the name of their file, which only its own run writes.
So a merged folder has the same bytes in whatever order, and however often, folders are merged. A delta is a tar file of
what an earlier one, or a folder, lacks; the same folder gives the same bytes, so a broken transfer can be resumed.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from edge.errors import MapError
from edge.files import AtomicFolder, flush_to_disk, replacing
from edge.reference_map import MapHeader, maps_in, open_map, read_header
from edge.reference_map.learned import LearnedFolder
from edge.reference_map.map_folder import SIGNATURE, check_signature
from edge.reference_map.store import HEADER
from edge_plugins.layers.stored import KEEP_FILE
from edge_plugins.layers.tally import TALLIES, Tally, read_tally
from sim.maps.delta_file import INVENTORY, add, reading, unpack, writing

UNPACKED_FIRST = (HEADER, SIGNATURE, KEEP_FILE)
"""Of a map in a delta; all other files are those that its header lists."""


class Inventory(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Checksums of headers of the drives that a folder searches, and of its tallies by name."""

    drives: list[str]
    tallies: dict[str, str]


@dataclass(frozen=True)
class Delta:
    """What was written: how many drives and tallies, kilometers of those drives, bytes of the file."""

    drives: int
    tallies: int
    length_km: float
    size_bytes: int


def merge(folders: Sequence[Path], output: Path) -> int:
    """Write the union of some folders of maps at `output`; how many drives it has. MapError."""
    if output.exists():
        raise MapError(f"{output}: exists already; name another folder, or delete it")
    copies: defaultdict[str, list[Path]] = defaultdict(list)
    for folder in folders:
        for path in _maps(folder):
            copies[open_map(path, every_file=True).header.header_sha256].append(path)
    tallies = [file for folder in folders for file in _tallies(folder)]
    with AtomicFolder(output) as building:
        for sha256, name in _names({sha256: [path.name for path in paths] for sha256, paths in copies.items()}).items():
            _copy_drive(copies[sha256], building.path / name)
        _copy_tallies(tallies, building.path / TALLIES)
        building.put_in_place()
    return len(copies)


def write_delta(folder: Path, since: Path | None, output: Path) -> Delta:
    """Write what `since`, a folder or an earlier delta, lacks of the drives that a folder searches. MapError."""
    drives = {read_header(path).header_sha256: path for path in LearnedFolder(folder).searched(_maps(folder))}
    tallies = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in _tallies(folder)}
    has = _inventory_of(since) if since is not None else Inventory([], {})
    missing = [path for sha256, path in sorted(drives.items()) if sha256 not in has.drives]
    length_m = 0.0
    with writing(output) as tar:
        inventory = msgspec.json.encode(Inventory(sorted(drives), dict(sorted(tallies.items()))))
        add(tar, INVENTORY, inventory)
        for path in missing:
            one = open_map(path, every_file=True)
            length_m += sum(float(np.ptp(one.places["route_m"][s.start : s.end])) for s in one.header.segments)
            for name in sorted([HEADER, *one.header.files, *_marks(path)]):
                add(tar, f"{path.name}/{name}", path / name)
        changed = [name for name, sha256 in sorted(tallies.items()) if has.tallies.get(name) != sha256]
        for name in changed:
            add(tar, f"{TALLIES}/{name}", folder / TALLIES / name)
    return Delta(len(missing), len(changed), length_m / 1000, output.stat().st_size)


def apply(folder: Path, delta: Path, require_signature_by: Path | None = None) -> int:
    """Add the drives and tallies of a delta to a folder; how many drives are new. MapError, before anything is added.

    Headers, their signatures and the sizes that they state are checked before the files that they describe are
    unpacked; those of drives that are there already never are. Each drive comes whole, by one rename; after a crash the
    same command adds the others.
    """
    there = {read_header(path).header_sha256 for path in _maps(folder)}
    with AtomicFolder(folder / "delta") as building:
        sizes = unpack(delta, building.path, lambda place, name: place == TALLIES or name in UNPACKED_FIRST)
        with _named_by(delta, building.path):
            tallies = _tallies(building.path)
            _best(tallies)
            added = {}
            for name in sorted(set(sizes) - {TALLIES}):
                header = _checked_header(building.path / name, sizes[name], require_signature_by)
                if header.header_sha256 not in there:
                    added[name] = header.header_sha256
            unpack(delta, building.path, lambda place, name: place in added and name not in UNPACKED_FIRST)
            for name in added:
                open_map(building.path / name, every_file=True)
        for name, sha256 in added.items():
            path = building.path / name
            for file in (*path.iterdir(), path):
                flush_to_disk(file)
            path.rename(folder / (name if not (folder / name).exists() else f"{name}-{sha256[:8]}"))
        _copy_tallies(tallies, folder / TALLIES)
        flush_to_disk(folder)
    return len(added)


def _checked_header(path: Path, sizes: Mapping[str, int], require_signature_by: Path | None) -> MapHeader:
    """Of a map of which no other file is unpacked; sizes: the bytes of all its files. MapError."""
    if HEADER not in sizes:
        raise MapError(f"{path / HEADER}: missing; this is not a delta")
    header = read_header(path)
    if require_signature_by is not None:
        check_signature(path, header, require_signature_by)
    stated = {name: key.bytes for name, key in header.files.items()}
    if {name: size for name, size in sizes.items() if name not in UNPACKED_FIRST} != stated:
        raise MapError(f"{path / HEADER}: the files with it are not those, of those sizes, that it lists")
    return header


def _maps(folder: Path) -> list[Path]:
    if not folder.is_dir() or (folder / HEADER).exists():
        raise MapError(f"{folder}: not a folder of maps")
    return maps_in(folder)


def _tallies(folder: Path) -> list[Path]:
    return sorted((folder / TALLIES).glob("*.json"))


def _names(found: dict[str, list[str]]) -> dict[str, str]:
    """A name for each checksum, which depends on nothing but the checksums and names that are there."""
    by_base: defaultdict[str, list[str]] = defaultdict(list)
    for sha256, names in found.items():
        by_base[min(name.removesuffix(f"-{sha256[:8]}") for name in names)].append(sha256)
    return {
        sha256: base if number == 0 else f"{base}-{sha256[:8]}"
        for base, several in by_base.items()
        for number, sha256 in enumerate(sorted(several))
    }


def _marks(path: Path) -> list[str]:
    return [name for name in (SIGNATURE, KEEP_FILE) if (path / name).exists()]


def _copy_drive(copies: Sequence[Path], place: Path) -> None:
    """One of several copies of a drive, with the marks of all; of two signatures the first by its digits."""
    place.mkdir()
    header = read_header(copies[0])
    for name in header.files:
        shutil.copy2(copies[0] / name, place / name)
    shutil.copy2(min((path / HEADER for path in copies), key=lambda file: file.stat().st_mtime), place / HEADER)
    for name in {name for path in copies for name in _marks(path)}:
        files = [path / name for path in copies if (path / name).exists()]
        shutil.copy2(min(files, key=lambda file: file.read_bytes()), place / name)


def _copy_tallies(files: Sequence[Path], place: Path) -> None:
    """To a folder that may have some of them. MapError for one that is no tally."""
    if files:
        place.mkdir(exist_ok=True)
    there: list[Path] = []
    for file in sorted({place / file.name for file in files}):
        with contextlib.suppress(MapError):  # one that is damaged is replaced
            there += [file] if read_tally(file) else []
    for name, data in _best([*there, *files]).items():
        with replacing(place / name) as stream:
            stream.write(data)


def _best(files: Iterable[Path]) -> dict[str, bytes]:
    """Of files of one name the one that counted more: a run's counts only grow. MapError for one that is no tally."""
    best: dict[str, tuple[int, bytes]] = {}
    for file in files:
        best[file.name] = max(best.get(file.name, (-1, b"")), (_counted(read_tally(file)), file.read_bytes()))
    return {name: data for name, (_, data) in best.items()}


def _counted(tally: Tally) -> int:
    several = (*tally.recognized.values(), *tally.passed.values())
    return sum(sum(stretches.values()) for contexts in several for stretches in contexts.values())


def _inventory_of(since: Path) -> Inventory:
    if since.is_dir():
        tallies = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in _tallies(since)}
        return Inventory([read_header(path).header_sha256 for path in _maps(since)], tallies)
    with reading(since) as members:
        member, stream = next(iter(members), (None, None))
        if member is None or stream is None or member.name != INVENTORY:
            raise MapError(f"{since}: not a delta that `map delta` wrote")
        return msgspec.json.decode(stream.read(), type=Inventory)


@contextlib.contextmanager
def _named_by(delta: Path, place: Path) -> Iterator[None]:
    """Whoever reads what is wrong has the delta, and not the folder in which it was unpacked."""
    try:
        yield
    except MapError as error:
        raise MapError(str(error).replace(f"{place}{os.sep}", f"{delta}: ")) from None
