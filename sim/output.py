"""Where a command writes and reads; an error names the option or the file, and what is wrong with it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from edge.errors import ConfigError, SetupError, reason


@contextmanager
def refusing(error_class: type[SetupError], what: str) -> Iterator[None]:
    """An OSError in the block becomes one of these errors: what could not be done, and why."""
    try:
        yield
    except OSError as error:
        raise error_class(f"{what}: {reason(error)}") from None


def make_folder(folder: Path, kind: str) -> None:
    """An empty folder for a demo or a try; one of an earlier run of that kind is cleared, any other is kept."""
    marker = f".lookback-{kind}"
    with refusing(ConfigError, f"--output: {folder}: cannot write here"):
        if folder.exists() and (not folder.is_dir() or (any(folder.iterdir()) and not (folder / marker).exists())):
            raise ConfigError(f"--output: {folder} has files that are not of a {kind}; name another folder")
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        (folder / marker).touch()


@contextmanager
def writing(path: Path) -> Iterator[TextIO]:
    """The file, opened to write text into it."""
    with refusing(ConfigError, f"--output: {path}: cannot write it"), path.open("w", encoding="utf-8") as stream:
        yield stream
