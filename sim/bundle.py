"""`lookback bundle`: one file of a drive that went wrong, to send to somebody, without secrets and pictures.

bundle.json   when and by what it was made, the packages, and what is missing and why
config.toml   the settings: secrets as ***, addresses without user and query
doctor.json   what `lookback doctor --offline` finds
journal.jsonl, journal.jsonl.1, ...   the events
drive.list    what [telemetry] drive wrote: `lookback dev drive BUNDLE` replays it
log.txt       of the service, or of --log
maps/         all but their pictures: descriptors and positions
"""

from __future__ import annotations

import argparse
import platform
import re
import subprocess
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime, timezone
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

import msgspec
import tomli_w

import edge
from edge.config import Config, load_config, without_secrets
from edge.errors import ConfigError, FeedError
from edge.reference_map.store import THUMBNAILS
from edge.toml_file import toml_values
from edge_plugins.doctor.command import examine
from edge_plugins.mapping.place_log import files_of, logs_in
from sim.output import refusing

LIST = "drive.list"
MOST_PACKED, LEAST_BYTES = 100, 1_000_000
"""Times that a list may be larger than in the bundle, where it takes at least so many bytes; lines take a tenth."""
SECRET_KEY = re.compile(r"token|key$|pass|secret")
HIDDEN = "***"
SHORTEST = 8
"""Letters of a secret, which is replaced wherever it stands: a shorter one is a word."""
LOG_COMMAND = ("journalctl", "--unit=lookback", "--since=-2days", "--no-pager", "--output=short-iso")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback bundle`."""
    parser.description = (
        "Collect a drive that went wrong in one file: config, versions, journal, the list of the drive, log, maps and"
        " the doctor's findings. It has no passwords, tokens or pictures. Look into it before you send it: it says"
        " where the vehicle was."
    )
    parser.add_argument("config", type=Path, metavar="CONFIG", help="the config file of `lookback run`")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE", help="the bundle, a new .zip file")
    parser.add_argument("--log", type=Path, metavar="FILE", help="what was printed (default: that of the service)")
    parser.add_argument("--pictures", action="store_true", help="with the small pictures of the maps")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    config = load_config(args.config)
    hide = Hiding(toml_values(args.config.read_text(encoding="utf-8"), args.config))
    if args.output.exists():
        raise ConfigError(f"--output: {args.output}: exists already; name another file")
    with (
        refusing(ConfigError, f"--output: {args.output}: cannot write it"),
        zipfile.ZipFile(args.output, "x", zipfile.ZIP_DEFLATED) as bundle,
    ):
        missing = _fill(bundle, args, config, hide)
        packages = sorted(f"{one.metadata['Name']} {one.version}" for one in distributions())
        about = {
            "format": 1,
            "made": datetime.now(timezone.utc).isoformat(timespec="seconds"),
            "lookback": edge.__version__,
            "python": platform.python_version(),
            "system": platform.platform(),
            "missing": missing,
            "packages": packages,
        }
        bundle.writestr("bundle.json", msgspec.json.format(msgspec.json.encode(about), indent=1))
        size_mb = sum(one.compress_size for one in bundle.infolist()) / 1e6
    for name, why in missing.items():
        print(f"without {name}: {why}")
    print(f"{args.output}: {size_mb:.1f} MB; it says where the vehicle was")
    return 0


def _fill(bundle: zipfile.ZipFile, args: argparse.Namespace, config: Config, hide: Hiding) -> dict[str, str]:
    """Write all but bundle.json; returns what is missing, and why."""
    missing: dict[str, str] = {}
    bundle.writestr("config.toml", tomli_w.dumps(hide.values))
    found = [msgspec.to_builtins(one) for one in examine(args.config, 0.0, offline=True)]
    bundle.writestr("doctor.json", hide(msgspec.json.format(msgspec.json.encode(found), indent=1).decode()))
    journal, drive = Path(config.telemetry.journal), Path(config.telemetry.drive)
    files = [journal, *sorted(journal.parent.glob(f"{journal.name}.[0-9]*"))] if config.telemetry.journal else []
    written = [file for file in files if file.is_file()]
    for file in written:
        bundle.writestr(
            f"journal.jsonl{file.name.removeprefix(journal.name)}", hide(file.read_text("utf-8", "replace"))
        )
    if not written:
        missing["the journal"] = f"{journal}: no such file" if files else '[telemetry] journal is ""'
    if drive.is_file():
        bundle.write(drive, LIST)
    else:
        missing["the list of the drive"] = (
            f"{drive}: no such file" if config.telemetry.drive else '[telemetry] drive is "": set it for the next drive'
        )
    try:
        log = args.log.read_text("utf-8", "replace") if args.log else _service_log()
        bundle.writestr("log.txt", hide(log))
    except (OSError, subprocess.CalledProcessError) as error:
        missing["the log"] = f"{error}; name it with --log"
    folder = Path(config.map.path)
    for file in _map_files(folder, pictures=args.pictures):
        bundle.write(file, Path("maps", folder.name, file.relative_to(folder)))
    if not (folder.is_dir() and config.map.path):
        missing["the map"] = f"{folder}: no such folder"
    return missing


def _service_log() -> str:
    done = subprocess.run(LOG_COMMAND, capture_output=True, text=True, check=True, errors="replace")
    return done.stdout


def _map_files(folder: Path, *, pictures: bool) -> Iterator[Path]:
    files = (file for file in sorted(folder.rglob("*")) if file.is_file()) if folder.is_dir() else iter(())
    # The file of a map that is still driven has its pictures among its places.
    kept = set() if pictures or not folder.is_dir() else {one for file in logs_in(folder) for one in files_of(file)}
    yield from (file for file in files if pictures or (file.name != THUMBNAILS and file not in kept))


@dataclass
class Hiding:
    """Replaces what only the owner may know: what secret keys of the config hold, wherever it stands, addresses too."""

    config: dict[str, Any]
    values: dict[str, Any] = field(init=False)
    _secrets: set[str] = field(init=False, default_factory=set)

    def __post_init__(self) -> None:
        self._collect(self.config, "")
        self.values = self._shown(self.config, "")

    def __call__(self, text: str) -> str:
        """The text with *** in place of secrets."""
        text = without_secrets(text)
        for secret in self._secrets:
            text = text.replace(secret, HIDDEN)
        return text

    def _collect(self, value: Any, key: str) -> None:
        for name, one in value.items() if isinstance(value, dict) else ():
            self._collect(one, name)
        for one in value if isinstance(value, list) else ():
            self._collect(one, key)
        if isinstance(value, str) and len(value) >= SHORTEST and SECRET_KEY.search(key):
            self._secrets.add(value)

    def _shown(self, value: Any, key: str) -> Any:
        if isinstance(value, dict):
            return {name: self._shown(one, name) for name, one in value.items()}
        if isinstance(value, list):
            return [self._shown(one, key) for one in value]
        return self(value) if isinstance(value, str) else value


def drive_list(file: Path, folder: Path) -> Path:
    """The list of a drive: the file itself, or that of a bundle, unpacked into the folder. FeedError without one."""
    if not zipfile.is_zipfile(file):
        return file
    with zipfile.ZipFile(file) as bundle:
        if LIST not in bundle.namelist():
            raise FeedError(f"{file}: no {LIST} in it; [telemetry] drive names the file that a drive is listed in")
        packed = bundle.getinfo(LIST)
        if packed.file_size > MOST_PACKED * max(packed.compress_size, LEAST_BYTES):
            raise FeedError(f"{file}: {LIST} would unpack to {packed.file_size / 1e6:.0f} MB, too many for its size")
        try:
            return Path(bundle.extract(LIST, folder))
        except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as failure:
            raise FeedError(f"{file}: {LIST} in it is damaged: {failure}; copy the bundle again") from None
