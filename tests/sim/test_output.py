"""Where commands write: what they find there is kept, and what is wrong is one line that names --output."""

from __future__ import annotations

from pathlib import Path

import pytest

from edge.errors import ConfigError
from sim.output import make_folder


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match=r"--output: .*file/x: cannot write here: Not a directory"):
        make_folder(tmp_path / "file" / "x", "demo")


def test_only_the_folder_of_an_earlier_run_is_cleared(tmp_path: Path) -> None:
    make_folder(tmp_path / "try", "try")
    (tmp_path / "try" / "report.html").touch()
    for kept in (tmp_path / "try", tmp_path):
        with pytest.raises(ConfigError, match=r"has files that are not of a demo; name another folder"):
            make_folder(kept, "demo")
    make_folder(tmp_path / "try", "try")
    assert [path.name for path in (tmp_path / "try").iterdir()] == [".lookback-try"]
