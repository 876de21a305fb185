"""What `make check` does not see of the demo: folders that are not its own."""

from __future__ import annotations

from pathlib import Path

import pytest


def test_a_folder_with_other_files_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from edge.__main__ import main

    (tmp_path / "thesis.txt").write_text("years of work")
    assert main(["demo", "-o", str(tmp_path)]) == 78
    assert "has files that are not of a demo" in capsys.readouterr().err
    assert (tmp_path / "thesis.txt").read_text() == "years of work"
