"""`lookback doctor` run by root: the rights that count are those of the service's user."""

from __future__ import annotations

import grp
import os
import pwd
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from edge.commands.diagnostic import Diagnostic, bad, note
from edge.config import Config, change_paths
from edge.path_access import HOME_FOLDERS

SHOW = ("systemctl", "show", "lookback.service", "--property=User,SupplementaryGroups,ExecStart")


def act_as_service(config: Path) -> Iterator[Diagnostic]:
    """Where root examines the config of the installed service: take its user and groups until the program ends."""
    unit = _show_unit() if os.geteuid() == 0 else {}
    starts = unit.get("ExecStart", "")
    # Another config, or another installation, belongs to whoever runs it.
    if f"path={sys.prefix}/bin/lookback " not in starts or f" {config.absolute()} " not in starts:
        return
    user, names = unit["User"], unit["SupplementaryGroups"].split()
    account = pwd.getpwnam(user)
    os.setgroups([account.pw_gid, *(grp.getgrnam(name).gr_gid for name in names)])
    os.setgid(account.pw_gid)
    os.setuid(account.pw_uid)
    yield note("user", f"checked with the rights of the service: user {user}, groups {' '.join(names)}")


def _show_unit() -> dict[str, str]:
    """Properties of the service's unit, with the administrator's changes; none where systemd does not run."""
    try:
        shown = subprocess.run(SHOW, capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return {}
    return dict(line.split("=", 1) for line in shown.splitlines())


def check_home_folders(config: Config) -> list[Diagnostic]:
    """Paths that a person can read and the service cannot, since its unit closes all home folders."""
    found: list[Diagnostic] = []

    def check(where: str, path: str) -> str:
        if any(Path(os.path.realpath(path)).is_relative_to(folder) for folder in HOME_FOLDERS):
            words = f"{where}: {path}: the service sees no home folders (ProtectHome=)"
            found.append(bad("service", words, "put data in /var/lib/lookback and keys in /etc/lookback"))
        return path

    change_paths(config, check)
    return found
