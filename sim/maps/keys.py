"""Keys that sign maps. The secret one has mode 0600; the public one beside it, NAME.pub, goes onto the vehicle."""

from __future__ import annotations

import os
from pathlib import Path

from edge.errors import ConfigError, MapError
from edge.files import replacing
from edge.reference_map.map_folder import SIGNATURE, ed25519_keys, read_key_of, signed_bytes
from edge.reference_map.store import open_map
from sim.output import refusing


def make_key(path: Path) -> Path:
    """Write a new secret key at `path` and the public one beside it, whose path is returned. ConfigError."""
    key = ed25519_keys().Ed25519PrivateKey.generate()
    public = path.with_name(f"{path.name}.pub")
    try:
        for file, mode, value in (
            (path, 0o600, key.private_bytes_raw()),
            (public, 0o644, key.public_key().public_bytes_raw()),
        ):
            descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
            with os.fdopen(descriptor, "w", encoding="ascii") as stream:
                stream.write(f"{value.hex()}\n")
    except FileExistsError as error:
        raise ConfigError(f"{error.filename}: a key already exists here; name another file") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot write a key here: {error.strerror}") from None
    return public


def sign_map(path: Path, key_file: Path) -> None:
    """Check every byte of a map and sign it; ConfigError for the key, MapError for the map."""
    key = ed25519_keys().Ed25519PrivateKey.from_private_bytes(read_key_of(key_file, is_secret=True))
    header = open_map(path, every_file=True).header
    with refusing(MapError, f"{path / SIGNATURE}: cannot write it"), replacing(path / SIGNATURE) as stream:
        stream.write(f"{key.sign(signed_bytes(header)).hex()}\n".encode("ascii"))
