"""A real recording whose answers were right once, and must stay as they are; README.md says how to accept others."""

from __future__ import annotations

from pathlib import Path

from edge.__main__ import main
from tests.golden.compare import first_difference


def test_the_answers_are_what_they_were(shared: Path, tmp_path: Path) -> None:
    feeds, every, now = shared / "feeds", ("--spacing-frames", "1"), tmp_path / "now.jsonl"
    (tmp_path / "fc6.toml").write_text('[descriptor]\nmodel = "fc6"\n')
    build = ["map", "build", str(feeds / "corridor_reference"), "-o", str(tmp_path / "map")]
    assert main([*build, "--config", str(tmp_path / "fc6.toml"), *every]) == 0
    replay = ["replay", str(feeds / "corridor_query"), "--map", str(tmp_path / "map"), "--sequence-length", "20"]
    assert main([*replay, *every, "--all", "-o", str(now)]) == 0
    expected = Path(__file__).with_name("corridor") / "expected.jsonl"
    assert first_difference(expected.read_text(encoding="utf-8"), now.read_text(encoding="utf-8")) is None
