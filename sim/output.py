"""What a command reads, writes and needs; an error names the option, the file or the package, and what is wrong."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from edge.errors import ConfigError, SetupError, reason
from edge.extras import install_command


@contextmanager
def refusing(error_class: type[SetupError], what: str) -> Iterator[None]:
    """An OSError in the block becomes one of these errors: what could not be done, and why."""
    try:
        yield
    except OSError as error:
        raise error_class(f"{what}: {reason(error)}") from None


@contextmanager
def needing(what: str, extra: str, error_class: type[SetupError] = ConfigError) -> Iterator[None]:
    """An import in the block that fails becomes one of these errors: what needs the package, and how to add it."""
    try:
        yield
    except ModuleNotFoundError as error:
        package = str(error.name).partition(".")[0]
        raise error_class(f"{what} needs the package {package}: {install_command(extra)}") from None


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
