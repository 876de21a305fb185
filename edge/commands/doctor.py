"""`lookback doctor`: check this computer, its devices, the autopilot and a config, and say what to do.

`--offline` checks the config with the model, the maps and the keys that it names, and no device.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec

from edge.camera import check_kind
from edge.commands.diagnostic import Diagnostic, bad, good, note
from edge.commands.doctor_autopilot import check_autopilot
from edge.commands.doctor_computer import (
    check_camera,
    check_cameras,
    check_clock,
    check_computer,
    check_disk,
    check_page,
    check_ports,
)
from edge.commands.doctor_service import act_as_service, check_home_folders
from edge.commands.doctor_setup import check_links, check_mapping, check_model_and_map
from edge.config import DEFAULT_TOML, Config, brought_up_to_date, load_config
from edge.errors import EXIT_SETUP, LookbackError
from edge.toml_file import read_text, toml_values

MARKS: dict[str, str] = {"good": "ok  ", "note": "note", "bad": "BAD "}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback doctor`."""
    parser.description = (
        "Checks cameras, ports, permissions, model, maps, disk, clock and the autopilot. Exit code 1 if"
        " something keeps `lookback run` from doing all of its work. Stop the service first: only one program at a time"
        " can use a camera or a port. Root checks the service's config with the rights of the service's user."
    )
    parser.add_argument("config", type=Path, nargs="?", metavar="CONFIG", help="the config file of `lookback run`")
    parser.add_argument("--json", action="store_true", help="print the findings as one JSON list")
    parser.add_argument(
        "--seconds", type=float, default=8.0, metavar="S", help="wait at most S seconds for the autopilot (default 8)"
    )
    parser.add_argument(
        "--offline", action="store_true", help="check no device, only the files; exit code 78 if one is wrong"
    )
    parser.add_argument("--default", action="store_true", help="print the default config, with comments")
    parser.set_defaults(run=_run, error=parser.error)


def _run(args: argparse.Namespace) -> int:
    if not args.default:
        return diagnose(args)
    print(DEFAULT_TOML.read_text(encoding="utf-8"), end="")
    return 0


def examine(
    path: Path | None, seconds: float, dev: Path = Path("/dev"), *, offline: bool = False
) -> Iterator[Diagnostic]:
    """All findings, as they come; without a config only those about this computer.

    dev: where its devices are. offline: only what the config file and the files that it names say.
    """
    acting = list(act_as_service(path)) if path else []
    yield from acting
    config, findings = _config(path)
    if not offline:
        yield check_computer()
    yield from findings
    if not offline:
        yield from check_cameras(dev, config.camera if config else None)
        yield from check_ports(dev)
        yield from check_clock()
        yield from check_page(config or Config())
    if config is None:
        return
    if acting:
        yield from check_home_folders(config)
    yield from check_model_and_map(config)
    yield from check_mapping(config)
    yield from check_links(config.telemetry)
    if not offline:
        yield from check_camera(config.camera)
        yield from check_disk(config)
        yield from check_autopilot(config.telemetry, config.gates, seconds)


def _config(path: Path | None) -> tuple[Config | None, list[Diagnostic]]:
    """The config, None where there is none or a wrong one, and the findings about it."""
    if path is None:
        words = "no config file was named, so no camera, map or autopilot is checked"
        remedy = "lookback doctor CONFIG; `lookback doctor --default > lookback.toml` writes one to start from"
        return None, [note("config", words, remedy)]
    try:
        config = load_config(path)
        check_kind(config.camera)
        _, outdated = brought_up_to_date(toml_values(read_text(path), path))
    except LookbackError as error:
        remedy = "`lookback doctor --default` prints every key with its range"
        remedy = remedy if path.exists() else "name the config file of `lookback run`"
        return None, [bad("config", mistake, remedy) for mistake in str(error).splitlines()]
    return config, [
        good("config", f"{path}: every key is valid"),
        *(note("config", one, f"edit {path}") for one in outdated),
    ]


def diagnose(args: argparse.Namespace) -> int:
    """Print the findings; 1 where something is wrong, 78 (EXIT_SETUP) where only files were checked."""
    if args.offline and args.config is None:
        args.error("name a config file")
    findings = []
    with _without_log():
        for finding in examine(args.config, args.seconds, offline=args.offline):
            findings.append(finding)
            if not args.json:
                _print(finding)
    if args.json:
        print(msgspec.json.format(msgspec.json.encode(findings), indent=1).decode())
    count = sum(finding.level == "bad" for finding in findings)
    if args.config and not args.json:
        print(f"\n{_summary(count)}")
    return (EXIT_SETUP if args.offline else 1) if count else 0


def _summary(count: int) -> str:
    if count == 0:
        return "nothing to fix"
    return f"{count} thing{'s' * (count > 1)} to fix, marked BAD, before `lookback run` can do all of its work"


def _print(finding: Diagnostic) -> None:
    print(f"{MARKS[finding.level]}  {finding.what:<12}  {finding.words}")
    if finding.remedy:
        print(f"{'':20}-> {finding.remedy}")
    sys.stdout.flush()


@contextlib.contextmanager
def _without_log() -> Iterator[None]:
    """What the daemon's parts log while they try again is a finding here."""
    log = logging.getLogger("edge")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(level)
