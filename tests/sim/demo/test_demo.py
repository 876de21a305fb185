"""What `make check` does not see of the demo: folders that are not its own, and a daemon that fails."""

from __future__ import annotations

from pathlib import Path

import pytest

from edge.config import Config, MapConfig, PageConfig
from edge.errors import LookbackError
from sim.vehicle.daemon_drive import start_daemon_drive
from sim.world.scenario import Scenario


def test_a_folder_with_other_files_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from edge.__main__ import main

    (tmp_path / "thesis.txt").write_text("years of work")
    assert main(["demo", "-o", str(tmp_path)]) == 78
    assert "has files that are not of a demo" in capsys.readouterr().err
    assert (tmp_path / "thesis.txt").read_text() == "years of work"


def test_a_daemon_that_fails_is_told_with_its_last_line(tmp_path: Path) -> None:
    settings = Config(map=MapConfig(path=str(tmp_path / "no.map")), page=PageConfig(port=0))
    with (
        start_daemon_drive("drive", Scenario(length_m=200.0), tmp_path / "drive", settings) as live,
        pytest.raises(LookbackError, match=r"drive: the daemon ended with 78: .*no\.map: no such map"),
    ):
        live.wait_for_end()
