"""What a command reads, writes and needs; an error names the option, the file or the package, and what is wrong."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TextIO

import msgspec

from edge.config import ConfigStruct
from edge.errors import ConfigError, SetupError, reason
from edge.extras import install_command


def checked_option(config: ConfigStruct, option: str, **changes: object) -> ConfigStruct:
    """A section with some keys replaced by a command's option; ConfigError names the option."""
    try:
        return msgspec.convert({**msgspec.structs.asdict(config), **changes}, type(config))
    except msgspec.ValidationError as error:
        what = str(error).partition(" - at ")[0]
        raise ConfigError(f"{option}: {what[:1].lower() + what[1:]}") from None


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


@contextmanager
def calling(path: Path, called: Path) -> Iterator[None]:
    """An error in the block calls a temporary folder by the path that it would have had."""
    try:
        yield
    except SetupError as error:
        raise type(error)(str(error).replace(str(path), str(called))) from None


@contextmanager
def replacing(folder: Path, kind: str) -> Iterator[Path]:
    """A new folder for a demo or a try; where all goes well, it takes the place of the one of an earlier run.

    Files that others put there stay; so do ours that were changed since, with ".old" after their names. Yields a folder
    of the same name beside it.
    """
    made = folder / f".lookback-{kind}"
    with refusing(ConfigError, f"--output: {folder}: cannot write here"):
        ours = _listed(made)
        if folder.exists() and (not folder.is_dir() or (any(folder.iterdir()) and not ours)):
            raise ConfigError(f"--output: {folder} has files that are not of a {kind}; name another folder")
        if not folder.parent.exists():
            folder.parent.mkdir(parents=True)
        beside = TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent)
    with beside as temporary:
        new = Path(temporary) / folder.name
        new.mkdir()
        yield new
        with refusing(ConfigError, f"--output: {folder}: cannot write here"):
            for name, changed_ns in ours.items():
                if (folder / name).is_file() and (folder / name).stat().st_mtime_ns == changed_ns:
                    (folder / name).unlink()
            names = [str(file.relative_to(new)) for file in sorted(new.rglob("*")) if file.is_file()]
            for name in names:
                _move(new / name, folder / name)
            lines = (f"{(folder / name).stat().st_mtime_ns} {name}\n" for name in names)
            made.write_text("".join(lines), encoding="utf-8")
            for one in sorted((one for one in folder.rglob("*") if one.is_dir()), reverse=True):
                if not any(one.iterdir()):
                    one.rmdir()


def _listed(made: Path) -> dict[str, int]:
    """What an earlier run wrote, by its names in the folder, and when each was changed last."""
    lines = made.read_text(encoding="utf-8").splitlines() if made.is_file() else []
    return {name: int(changed_ns) for changed_ns, _, name in (line.partition(" ") for line in lines)}


def _move(file: Path, to: Path) -> None:
    """Move a file to where it belongs; one that is there already is somebody's own, and gets another name."""
    to.parent.mkdir(parents=True, exist_ok=True)
    if to.exists():
        names = (to.with_name(f"{to.name}.old{number or ''}") for number in count())
        to.rename(next(name for name in names if not name.exists()))
    file.replace(to)


@contextmanager
def writing(path: Path) -> Iterator[TextIO]:
    """The file, opened to write text into it."""
    with refusing(ConfigError, f"--output: {path}: cannot write it"), path.open("w", encoding="utf-8") as stream:
        yield stream
