"""`lookback doctor` run by root: it takes the rights of the service's user where it examines the service's config."""

from __future__ import annotations

import grp
import os
import subprocess
import sys
from pathlib import Path

import pytest

from edge.config import Config, MapConfig, TelemetryConfig
from edge_plugins.doctor.computer import check_home_folders
from edge_plugins.doctor.findings import DoctorContext

ACT = """
import os, sys
from pathlib import Path
from edge_plugins.doctor.computer import act_as_service
from edge_plugins.doctor.findings import DoctorContext
words = [words for _, words, _ in act_as_service(DoctorContext(Path(sys.argv[1]), Path("/dev"), 0.0))]
print(os.getuid(), sorted(os.getgroups()), words)
"""


def act(folder: Path, config: str, prefix: str = sys.prefix) -> str:
    """What becomes of a process of root, beside a systemctl that shows the unit of an installed service."""
    systemctl = folder / "systemctl"
    program = f"{prefix}/bin/lookback"
    command = f"{{ path={program} ; argv[]={program} run /etc/lookback.toml ; ignore_errors=no ; }}"
    shown = f"User=nobody\nSupplementaryGroups=video dialout\nExecStart={command}\n"
    systemctl.write_text(f"#!/bin/sh\ncat <<'SHOWN'\n{shown}SHOWN\n")
    systemctl.chmod(0o755)
    environment = {**os.environ, "PATH": f"{folder}:{os.environ['PATH']}"}
    acting = [sys.executable, "-c", ACT, config]
    return subprocess.run(acting, env=environment, capture_output=True, text=True, check=True).stdout.strip()


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, who may become another user")
def test_root_examines_the_services_config_as_its_user(tmp_path: Path) -> None:
    groups = sorted(grp.getgrnam(name).gr_gid for name in ("nogroup", "video", "dialout"))
    said = act(tmp_path, "/etc/lookback.toml")
    assert said.startswith(f"65534 {groups} [")
    assert "user nobody, groups video dialout" in said


def test_others_stay_who_they_are(tmp_path: Path) -> None:
    assert act(tmp_path, "/home/pi/mine.toml").split()[0] == str(os.getuid())
    assert act(tmp_path, "/etc/lookback.toml", prefix="/opt/elsewhere").split()[0] == str(os.getuid())


def test_home_folders_are_found() -> None:
    config = Config(map=MapConfig(path="/home/pi/street.map"), telemetry=TelemetryConfig(journal="/var/lib/x.jsonl"))
    assert check_home_folders(DoctorContext(None, Path("/dev"), 0.0, config=config)) == []
    ((level, words, _),) = check_home_folders(DoctorContext(None, Path("/dev"), 0.0, as_service=True, config=config))
    assert level == "bad"
    assert words.startswith("[map] path: /home/pi/street.map: ")
