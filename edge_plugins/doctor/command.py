"""`lookback doctor`: check this computer, its devices, the autopilot and a config, and say what to do.

`--offline` checks the config with the model, the maps and the keys that it names, and no device.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

import msgspec

from edge.errors import EXIT_SETUP, LookbackError
from edge_plugins.doctor import autopilot, computer, setup
from edge_plugins.doctor.findings import DoctorContext, Finding, Found

MARKS: dict[str, str] = {"good": "ok  ", "note": "note", "bad": "BAD "}
Need: TypeAlias = Literal["devices", "config", "network", "maps", "autopilot"]


@dataclass(frozen=True)
class Check:
    """find: finds something out; an error that it raises is bad, and `remedy` says what to do ({map}: [map] path).

    needs: without one of these there is nothing to check. "devices": it does more than read files.
    """

    what: str
    needs: tuple[Need, ...]
    find: Callable[[DoctorContext], Iterable[Found]]
    remedy: str = ""


CHECKS = (
    Check("user", (), computer.act_as_service),
    Check("computer", ("devices",), computer.check_computer),
    Check("config", (), setup.check_config),
    Check("camera", ("devices",), computer.list_cameras),
    Check("serial port", ("devices",), computer.list_ports),
    Check("clock", ("devices",), computer.check_clock),
    Check("service", ("config",), computer.check_home_folders),
    Check("model", ("config",), setup.check_model, 'set [descriptor] model = "" for the shipped model'),
    Check("map", ("network",), setup.check_map, "record a drive, then: lookback map build FEED -o {map}"),
    Check("camera", ("maps",), setup.check_field_of_view),
    Check("motion", ("config",), setup.check_motion),
    Check("mapping", ("config",), computer.check_mapping),
    Check("link", ("config",), setup.check_links, "correct [telemetry]"),
    Check("camera", ("config", "devices"), computer.check_camera),
    Check("disk", ("config", "devices"), computer.check_disk),
    Check("autopilot", ("config", "devices"), autopilot.check_autopilot),
    Check("parameter", ("autopilot",), autopilot.check_parameters),
)
"""In this order, since some find what those after them need."""


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
    parser.set_defaults(run=_run, error=parser.error)


def examine(path: Path | None, seconds: float, dev: Path = Path("/dev"), *, offline: bool = False) -> Iterator[Finding]:
    """All findings, as they come; without a config only those about this computer.

    dev: where its devices are. offline: only what the config file and the files that it names say.
    """
    examined = DoctorContext(path, dev, seconds)
    for check in CHECKS:
        there = {name for name in ("config", "network", "maps", "autopilot") if getattr(examined, name) is not None}
        if set(check.needs) <= (there if offline else there | {"devices"}):
            try:
                for found in check.find(examined):
                    yield Finding(found[0], check.what, *found[1:])
            except LookbackError as error:
                yield Finding("bad", check.what, str(error), check.remedy.format(map=examined.settings.map.path))


def _run(args: argparse.Namespace) -> int:
    """Print the findings; 1 where something is wrong, 78 (EXIT_SETUP) where only files were checked."""
    if args.offline and args.config is None:
        args.error("name a config file")
    findings = []
    with without_log():
        for finding in examine(args.config, args.seconds, offline=args.offline):
            findings.append(finding)
            if not args.json:
                _print(finding)
    if args.json:
        print(msgspec.json.format(msgspec.json.encode(findings), indent=1).decode())
    count = sum(finding.level == "bad" for finding in findings)
    if args.config and not args.json:
        fix = f"{count} thing{'s' * (count > 1)} to fix, marked BAD, before `lookback run` can do all of its work"
        print(f"\n{fix if count else 'nothing to fix'}")
    return (EXIT_SETUP if args.offline else 1) if count else 0


def _print(finding: Finding) -> None:
    print(f"{MARKS[finding.level]}  {finding.what:<12}  {finding.words}")
    if finding.remedy:
        print(f"{'':20}-> {finding.remedy}")
    sys.stdout.flush()


@contextlib.contextmanager
def without_log() -> Iterator[None]:
    """What the daemon's parts log while they try again is said otherwise."""
    log = logging.getLogger("edge")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(level)
