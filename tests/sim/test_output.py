"""Where commands write: what they find there is kept, and what is wrong is one line that names --output."""

from __future__ import annotations

from pathlib import Path

import pytest

from edge.errors import ConfigError, FeedError
from sim.output import replacing


def write(folder: Path, kind: str, **texts: str) -> None:
    with replacing(folder, kind) as new:
        for name, text in texts.items():
            (new / name).parent.mkdir(exist_ok=True)
            (new / name).write_text(text)


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match=r"--output: .*file/x: cannot write here: Not a directory"):
        write(tmp_path / "file" / "x", "demo")


def test_only_what_an_earlier_run_wrote_is_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "try"
    write(folder, "try", report="first", config="ours")
    (folder / "notes.txt").write_text("mine")
    for kept in (folder, tmp_path):
        with pytest.raises(ConfigError, match=r"has files that are not of a demo; name another folder"):
            write(kept, "demo")
    (folder / "config").write_text("changed by hand")
    write(folder, "try", report="second", config="ours again")
    texts = {one.name: one.read_text() for one in folder.iterdir() if not one.name.startswith(".")}
    assert texts == {
        "report": "second",
        "config": "ours again",
        "config.old": "changed by hand",
        "notes.txt": "mine",
    }


def test_a_run_that_fails_leaves_the_earlier_one(tmp_path: Path) -> None:
    folder = tmp_path / "try"
    write(folder, "try", report="first", gone="first")
    with pytest.raises(FeedError), replacing(folder, "try") as new:
        (new / "report").write_text("half")
        raise FeedError("no such file")
    assert (folder / "report").read_text() == "first"
    assert [one.name for one in tmp_path.iterdir()] == ["try"], "nothing is left beside it"
    write(folder, "try", report="second")
    assert sorted(one.name for one in folder.iterdir()) == [".lookback-try", "report"]
