"""Where a command writes; ConfigError names --output, and what is wrong with it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from edge.errors import ConfigError


def make_folder(folder: Path, kind: str) -> None:
    """An empty folder for a demo or a try; one of an earlier run of that kind is cleared, any other is kept."""
    marker = f".lookback-{kind}"
    try:
        if folder.exists() and (not folder.is_dir() or (any(folder.iterdir()) and not (folder / marker).exists())):
            raise ConfigError(f"--output: {folder} has files that are not of a {kind}; name another folder")
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        (folder / marker).touch()
    except OSError as error:
        raise ConfigError(f"--output: {folder}: cannot write here: {error.strerror}") from None


@contextmanager
def writing(path: Path) -> Iterator[TextIO]:
    """The file, opened to write text into it."""
    try:
        with path.open("w", encoding="utf-8") as stream:
            yield stream
    except OSError as error:
        raise ConfigError(f"--output: {path}: cannot write it: {error.strerror}") from None
