"""Who made a map: an Ed25519 signature over its header, and so over every byte, since the header has all checksums.

`map.json.sig` lies in the map's folder: 128 hexadecimal digits. A key is a file of 64 hexadecimal digits; the secret
one has mode 0600, the public one beside it is called NAME.pub and goes onto the vehicle. Building, extending or
replacing a map makes a new folder without a signature: what was signed is what is there.
"""

from __future__ import annotations

import os
from pathlib import Path
from types import ModuleType

import msgspec

from edge.errors import ConfigError, MapError
from edge.extras import install_command
from edge.files import read_key, replacing
from edge.reference_map.store import HEADER, MapHeader, encode_header, open_map, plain_size

SIGNATURE = f"{HEADER}.sig"
SIGNATURE_BYTES = 64


def make_key(path: Path) -> Path:
    """Write a new secret key at `path` and the public one beside it, whose path is returned. ConfigError."""
    key = _ed25519().Ed25519PrivateKey.generate()
    public = path.with_name(f"{path.name}.pub")
    try:
        for file, mode, value in ((path, 0o600, key.private_bytes_raw()), (public, 0o644, _raw(key))):
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
    key = _ed25519().Ed25519PrivateKey.from_private_bytes(_read_key(key_file, is_secret=True))
    header = open_map(path, every_file=True).header
    try:
        with replacing(path / SIGNATURE) as stream:
            stream.write(f"{key.sign(_signed_bytes(header)).hex()}\n".encode("ascii"))
    except OSError as error:
        raise MapError(f"{path / SIGNATURE}: cannot write it: {error.strerror}") from None


def is_signed(path: Path) -> bool:
    """Whether there is a signature of a map, by whomever."""
    return (path / SIGNATURE).exists()


def check_signature(path: Path, header: MapHeader, key_file: Path) -> None:
    """MapError unless a map is signed by the owner of the public key; ConfigError for the key.

    header: of the map at `path`, as it was read.
    """
    where = "[map] require_signature_by"
    ed25519 = _ed25519()
    from cryptography.exceptions import InvalidSignature

    key = ed25519.Ed25519PublicKey.from_public_bytes(_read_key(key_file, is_secret=False))
    file = path / SIGNATURE
    try:
        if file.exists() and plain_size(file) > 4 * SIGNATURE_BYTES:
            raise ValueError("too large")
        signature = file.read_bytes()[: 4 * SIGNATURE_BYTES].decode("ascii")
        key.verify(bytes.fromhex(signature), _signed_bytes(header))
    except FileNotFoundError:
        raise MapError(f"{path}: not signed, and {where} asks for it; use `lookback map sign`") from None
    except OSError as error:
        raise MapError(f"{file}: cannot read it: {error.strerror}") from None
    except (InvalidSignature, ValueError):
        raise MapError(f"{path}: its signature is not that of {key_file}, which {where} names") from None


def _signed_bytes(header: MapHeader) -> bytes:
    """The bytes of `map.json`, which opening has held against the header: no second look at the file."""
    return encode_header(msgspec.structs.replace(header, header_sha256=""))


def _read_key(file: Path, *, is_secret: bool) -> bytes:
    return read_key(file, str(file), is_secret=is_secret, remedy="; make one with `map keygen`")


def _ed25519() -> ModuleType:
    """Loaded only where a map is signed, or must be."""
    try:
        from cryptography.hazmat.primitives.asymmetric import ed25519
    except ImportError:
        raise ConfigError(f"signed maps need the package cryptography: {install_command('signing')}") from None
    return ed25519


def _raw(key: object) -> bytes:
    public: bytes = key.public_key().public_bytes_raw()  # type: ignore[attr-defined]
    return public
