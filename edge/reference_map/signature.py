"""Who made a map: an Ed25519 signature over its header, and so over every byte, since the header has all checksums.

`map.json.sig` lies in the map's folder: 128 hexadecimal digits. A key is a file of 64 hexadecimal digits. Building,
extending or replacing a map makes a new folder without a signature: what was signed is what is there.
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import msgspec

from edge.errors import ConfigError, MapError
from edge.extras import install_command
from edge.files import read_key
from edge.reference_map.store import HEADER, MapHeader, encode_header, plain_size

SIGNATURE = f"{HEADER}.sig"
SIGNATURE_BYTES = 64


def is_signed(path: Path) -> bool:
    """Whether there is a signature of a map, by whomever."""
    return (path / SIGNATURE).exists()


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
    try:
        from cryptography.hazmat.primitives.asymmetric import ed25519
    except ImportError:
        raise ConfigError(f"signed maps need the package cryptography: {install_command('signing')}") from None
    return ed25519
