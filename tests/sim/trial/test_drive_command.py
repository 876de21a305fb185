"""`lookback dev drive` on the list of a drive."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from edge.commands.parser import build_parser
from edge.config import Config
from edge.localization import AutopilotState, FixRequest, NoFix, PositionEstimator
from edge.localization.drive_file import DriveFile
from edge.localization.position_estimator import FixResult


def test_it_names_each_answer_that_differs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "list.drive"
    file = DriveFile(path, Config())
    drive = PositionEstimator(Config(), file.write)
    drive.update(1_000_000_000, AutopilotState(gps="healthy"))
    answer = drive.fix(2_000_000_000, FixRequest())
    assert isinstance(answer, NoFix)
    file.write(3_000_000_000, FixResult(FixRequest(), replace(answer, reason="too old")))
    file.close()
    words = ["dev", "drive", str(path)]
    args = build_parser(words).parse_args(words)
    assert args.run(args) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines == [
        "     2.00 s  the places do not agree yet  (then: too old)",
        "      2 times: the places do not agree yet",
        "1 of 2 answers differ from those of the drive",
    ]
