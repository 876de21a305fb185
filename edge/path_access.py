"""Whether this user, in its sandbox, can reach the paths of a config, before anything is opened."""

from __future__ import annotations

import os
from pathlib import Path

from edge.errors import ConfigError

HOME_FOLDERS = ("/home", "/root", "/run/user")
"""What ProtectHome=yes in the service's unit closes."""


def check_access(where: str, path: str) -> str:
    """The path. ConfigError if this user may not enter a folder on the way to it, where nothing can be seen at all.

    Nor may it lead to what is neither file nor folder: a named pipe would be read without end.
    """
    real = Path(os.path.realpath(path))  # Path.resolve raises at a loop of links
    for folder in (*reversed(real.parents), real):
        if os.path.isdir(folder) and not os.access(folder, os.X_OK):  # noqa: PTH112  # Path.is_dir raises
            raise ConfigError(f"{where}: {path}: this user may not enter {folder}; {_what_to_do(folder)}")
    if real.exists() and not os.access(real, os.R_OK):
        raise ConfigError(f"{where}: {path}: this user may not read it; {_what_to_do(real)}")
    is_expected = where == "[telemetry] journal" or (where == "[home] socket" and real.is_socket())
    if real.exists() and not (real.is_file() or real.is_dir() or is_expected):
        raise ConfigError(f"{where}: {path}: neither a file nor a folder")
    return path


def _what_to_do(closed: Path) -> str:
    if str(closed) not in HOME_FOLDERS:
        return "change its owner or its mode"
    return "the service sees no home folders (ProtectHome=): put data in /var/lib/lookback and keys in /etc/lookback"
