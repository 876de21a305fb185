"""`lookback dev ablate` on the list of a drive."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from edge.commands.parser import build_parser
from edge.errors import FeedError
from edge.localization import tracker
from edge.localization.drive_file import DriveFile
from sim.research.trial.ablate_command import CONSTANTS, AblationAnswers, table
from tests.golden.harness import HERE
from tests.localization.route_bench import Bench
from tests.localization.route_course import Course, Stretch

EXCERPT = HERE / "drives" / "ardupilot_night"
GATE, LEAVES = "no reset is needed", "tracker.STOOD_NS"


def run(*words: str) -> int:
    parsed = build_parser(["dev", "ablate", *words]).parse_args(["dev", "ablate", *words])
    return int(parsed.run(parsed))


def test_each_row_is_the_same_drive_without_one_thing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bench = Bench(Course(stretches=(Stretch(0.0, 300.0),), road_m=300.0), 2, tmp_path)
    bench.run()
    (tmp_path / EXCERPT.name).mkdir()
    file = DriveFile(tmp_path / EXCERPT.name / "00.drive", bench.config)
    for t_ns, entry in bench.events:
        file.write(t_ns, entry)
    file.close()
    before = tracker.STOOD_NS
    without = [word for name in (GATE, "too old", LEAVES) for word in ("--without", name)]
    assert run(str(tmp_path), str(EXCERPT.parent), *without) == 0
    assert before == tracker.STOOD_NS
    lines = capsys.readouterr().out.splitlines()
    counts = {row[1].strip(): int(row[2]) for row in (line.split("|") for line in lines[4:-2])}
    assert lines[0] == "1 drives:" and lines[-1] == f"The same without: {GATE}; too old; `{LEAVES}`."
    assert set(counts) == {"nothing"} and counts["nothing"] > 0, "what only needs no reset is a position as well"


def test_what_hardly_changes_is_named_and_has_no_row() -> None:
    drives = [{"": 200, "too old": 200, "standing": 199, GATE: 190}]
    found = table(
        [{name: AblationAnswers([(1.0, 1.0, 0.0, 0.0)] * count, []) for name, count in one.items()} for one in drives]
    )
    assert [row.split(" | ")[0] for row in found.splitlines()[4:-4]] == ["| nothing", f"| {GATE}"]
    assert found.endswith("nothing else, without: standing.\n\nThe same without: too old.")


def test_without_lists_it_says_what_makes_them(tmp_path: Path) -> None:
    with pytest.raises(FeedError, match="`lookback dev flights FOLDER -o"):
        run(str(tmp_path), str(EXCERPT.parent))


def test_the_page_names_each_constant_and_none_that_is_gone() -> None:
    text = (Path(__file__).parents[4] / "docs/tables/integrity.md").read_text(encoding="utf-8")
    section = text.partition("<!-- ablation: begin -->")[2].partition("<!-- ablation: end -->")[0]
    named = set(re.findall(r"`([a-z_]+\.[A-Za-z_0-9]+)`", section))
    assert named == CONSTANTS.keys(), "`make flights` writes the section anew"
