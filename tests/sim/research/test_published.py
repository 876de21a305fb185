"""How much of the code is newer than what docs publish."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from sim.research import published


def test_the_commits_since_a_table_was_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def commit(path: str, text: str) -> None:
        file = tmp_path / path
        file.parent.mkdir(exist_ok=True)
        file.write_text(text)
        name = ("-c", "user.name=a", "-c", "user.email=a@b.c")
        for words in (("add", "-A"), (*name, "commit", "-qm", path)):
            subprocess.run(("git", *words), cwd=tmp_path, check=True)

    subprocess.run(("git", "init", "-q"), cwd=tmp_path, check=True)
    table = "# Roads\n\n`lookback dev roads` of version 0.3.0:\n\n| road |\n"
    commit("docs/roads.md", table)
    commit("edge/code.py", "")
    commit("README.md", "")
    commit("sim/code.py", "")
    commit("docs/roads.md", f"{table}\nof version 0.2.0 are words of a sentence.\n")
    published.main(tmp_path)
    assert capsys.readouterr().out == "docs/roads.md:3: version 0.3.0, 2 commits ago: lookback dev roads\n"


def test_every_table_that_a_command_made_is_known() -> None:
    """Two of nine were: those that named a version."""
    docs = Path(__file__).parents[3] / "docs"
    found = {(one.page, one.command.split(" -")[0][:24]) for one in published.published(docs)}
    assert {
        ("bench.md", "make bench"),
        ("tables/benchmark.md", "make benchmark"),
        ("flights.md", "lookback dev flights fli"),
        ("tables/integrity.md", "lookback dev sim fixes"),
        ("tables/integrity.md", "lookback dev ablate LIST"),
        ("tables/trial.md", "lookback dev sim fixes"),
    } <= found
    assert len(list(published.published(docs))) >= 8
