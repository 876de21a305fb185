"""Opening a map, or all maps of a folder, and a map of this drive that grows, as one set; and who made a map.

That is said by an Ed25519 signature over its header, and so over every byte, since the header has all checksums.
`map.json.sig` lies in the map's folder: 128 hexadecimal digits. A key is a file of 64 hexadecimal digits. Building,
extending or replacing a map makes a new folder without a signature: what was signed is what is there.
"""

from __future__ import annotations

import resource
from pathlib import Path
from types import ModuleType

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.errors import MapError
from edge.extras import import_extra
from edge.files import read_key
from edge.reference_map.map_set import ExcludedMap, MapSet, name_of, printable
from edge.reference_map.map_so_far import PartialMap
from edge.reference_map.store import (
    HEADER,
    MapHeader,
    ReferenceMap,
    encode_header,
    open_map,
    open_unverified,
    plain_size,
)

FILES_OF_A_MAP = 2
"""That stay open, since they are mapped: descriptors and keypoints."""
OTHER_FILES = 256
"""Files that the rest of the program may open besides."""
SIGNATURE = f"{HEADER}.sig"
SIGNATURE_BYTES = 64
KEEP, RETIRED = "keep", "retired"
"""Marks: empty files in the folder of a map."""


def open_map_set(
    path: Path,
    *,
    require_signature_by: Path | None = None,
    every_file: bool = False,
    newest: PartialMap | None = None,
    with_retired: bool = False,
) -> MapSet:
    """Open the map at a path, or the maps of a folder that are searched: those that are not `is_retired`.

    newest: of this drive, searched after all others, if any. with_retired: all maps of the folder.

    Headers and sizes are checked here, the checksums of large files by a `ChecksumSchedule`; with `every_file` all of
    them here, which takes long. require_signature_by: a public key; maps that its owner has not signed are excluded.
    Raises MapError, and ConfigError for the key.
    """
    folders = maps_in(path)
    if not with_retired:  # if all are, those that replaced them are gone
        folders = [folder for folder in folders if not is_retired(folder)] or folders
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
    return MapSet.of(maps if newest is None else [*maps, newest], path, excluded)


def maps_in(path: Path) -> list[Path]:
    """The maps of a folder, in the order of their names; none if it is a map itself."""
    try:
        if (path / HEADER).exists() or not path.is_dir():
            return []
        # What is hidden is still being built.
        return sorted(one for one in path.iterdir() if not one.name.startswith(".") and (one / HEADER).exists())
    except OSError as error:
        raise MapError(f"{error.filename}: cannot read it: {error.strerror}") from None


def _allow_open_files(path: Path, maps: int) -> None:
    """Each map is FILES_OF_A_MAP open files for as long as the program runs. MapError if that is not allowed."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = FILES_OF_A_MAP * maps + OTHER_FILES
    if soft == resource.RLIM_INFINITY or needed <= soft:
        return
    if hard != resource.RLIM_INFINITY and needed > hard:
        raise MapError(
            f"{path}: {maps} maps need {needed} open files, and this process may have {hard};"
            " raise the limit (LimitNOFILE= of the service, or `ulimit -Hn`), or make larger tiles"
        )
    resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))


def is_signed(path: Path) -> bool:
    """Whether there is a signature of a map, by whomever."""
    return (path / SIGNATURE).exists()


def is_kept(path: Path) -> bool:
    """Whether a person has marked a map (`lookback map keep`)."""
    return (path / KEEP).exists()


def is_retired(path: Path) -> bool:
    """Whether a map of a folder is not searched, since others of its road are (`lookback map learn`)."""
    return (path / RETIRED).exists() and not is_signed(path) and not is_kept(path)


def check_signature(path: Path, header: MapHeader, key_file: Path) -> None:
    """MapError unless a map is signed by the owner of the public key; ConfigError for the key.

    header: of the map at `path`, as it was read.
    """
    where = "[map] require_signature_by"
    ed25519 = ed25519_keys()
    from cryptography.exceptions import InvalidSignature

    key = ed25519.Ed25519PublicKey.from_public_bytes(read_key_of(key_file, is_secret=False))
    file = path / SIGNATURE
    try:
        if file.exists() and plain_size(file) > 4 * SIGNATURE_BYTES:
            raise ValueError("too large")
        signature = file.read_bytes()[: 4 * SIGNATURE_BYTES].decode("ascii")
        key.verify(bytes.fromhex(signature), signed_bytes(header))
    except FileNotFoundError:
        raise MapError(f"{path}: not signed, and {where} asks for it; use `lookback map sign`") from None
    except OSError as error:
        raise MapError(f"{file}: cannot read it: {error.strerror}") from None
    except (InvalidSignature, ValueError):
        raise MapError(f"{path}: its signature is not that of {key_file}, which {where} names") from None


def signed_bytes(header: MapHeader) -> bytes:
    """The bytes of `map.json`, which opening has held against the header: no second look at the file."""
    return encode_header(msgspec.structs.replace(header, header_sha256=""))


def read_key_of(file: Path, *, is_secret: bool) -> bytes:
    """The bytes of a key's file; ConfigError."""
    return read_key(file, str(file), is_secret=is_secret, remedy="; make one with `map keygen`")


def ed25519_keys() -> ModuleType:
    """Loaded only where a map is signed, or must be."""
    module = "cryptography.hazmat.primitives.asymmetric.ed25519"
    return import_extra(module, "signing", "signed maps need the package cryptography")
