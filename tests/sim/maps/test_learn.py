"""`lookback map learn`: which drives over a road stay searched, and why; and that nothing of it can go half-way."""

from __future__ import annotations

import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from edge.__main__ import main
from edge.config import Config
from edge.reference_map import open_map, open_map_set
from edge.reference_map.learned import LEARNED_FILE
from edge.sequence import Travel
from edge.sequence_matcher import SequenceMatcher
from edge_plugins.layers.stored import StoredMap
from edge_plugins.layers.tally import read_tallies
from edge_plugins.page.snapshot import map_view
from sim.maps.keys import is_signed_with, make_key, sign_map
from sim.maps.learning import learn
from sim.maps.use import HALF_LIFE
from tests.plugins.layers.drives import MADE_S, Driven, build, count

GAP = [row for row in range(200) if not 40 <= row < 160]


@pytest.fixture(scope="module")
def eight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two drives of a rear camera and six of a front one, in three lights; the newest is 7."""
    folder = tmp_path_factory.mktemp("eight")
    for number in range(8):
        build(folder / f"{number}", Driven(number % 3, "rear" if number < 2 else "front", made_s=MADE_S + number))
    return folder


@pytest.fixture
def folder(eight: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(eight, tmp_path / "maps"))


def searched(folder: Path) -> set[str]:
    return set(open_map_set(folder).names)


def test_four_of_eight_drives_are_searched_one_of_them_looking_back(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["map", "learn", str(folder), "--dry-run"]) == 0
    assert "would be searched" in capsys.readouterr().out
    assert len(searched(folder)) == 8
    assert main(["map", "learn", str(folder)]) == 0
    out = capsys.readouterr().out
    assert "4 of 8 drives are searched" in out
    left = searched(folder)
    assert len(left) == 4
    assert left & {"0", "1"}
    assert "7" in left, "it is new"
    for command in ("list", "info"):
        assert main(["map", command, str(folder)]) == 0
        assert capsys.readouterr().out.count("retired") == 4
    assert main(["map", "learn", str(folder)]) == 0
    assert searched(folder) == left, "nothing has changed since"
    assert main(["map", "learn", str(folder), "--undo"]) == 0
    assert len(searched(folder)) == 8
    assert main(["map", "learn", str(folder), "--undo"]) == 78


def test_layers_are_of_lights_unlike_each_other(folder: Path) -> None:
    chosen = learn(folder, layers=5).choice.searched
    assert {number % 3 for number in chosen if number >= 2} == {0, 1, 2}


def test_the_only_rear_drive_stays_whatever_the_front_ones_are_good_for(folder: Path) -> None:
    shutil.rmtree(folder / "1")
    for number in range(2, 8):
        count(folder, str(number), range(200), MADE_S + 100 + number, gray=20 * number)
    assert "0" in {path.path.name for path in _searched(folder, 2)}


def test_what_is_recognized_stays_and_what_is_not_goes(folder: Path) -> None:
    for run in range(3):
        count(folder, "2", range(200), MADE_S + 100 + run, gray=20)
        count(folder, "5", range(200), MADE_S + 200 + run, gray=120)
    names = {one.path.name for one in _searched(folder, 3)}
    assert {"2", "5"} < names
    assert len(names & {"0", "1"}) == 1
    assert len(names) == 3, "7 has been driven on, and was good for nothing"


def test_any_number_of_drives_is_searched_as_four_are(tmp_path: Path) -> None:
    for number in range(12):
        build(tmp_path / f"{number:02}", Driven(number % 5, made_s=MADE_S + number, end=40))
    assert len(learn(tmp_path).choice.searched) == 4


def test_a_drive_over_a_road_of_its_own_stays(folder: Path) -> None:
    build(folder / "on", Driven(made_s=MADE_S - 100, end=260))
    build(folder / "little on", Driven(made_s=MADE_S - 100, end=220))
    chosen = {one.path.name for one in _searched(folder, 4)}
    assert "on" in chosen
    assert "little on" not in chosen


def test_a_drive_that_looks_back_serves_the_way_home_as_a_drive_home_does(tmp_path: Path) -> None:
    build(tmp_path / "out", Driven(view="rear", made_s=MADE_S))
    build(tmp_path / "home", Driven(back=True, made_s=MADE_S + 1))
    assert len(learn(tmp_path, layers=1).choice.searched) == 1


def test_drives_that_may_not_be_retired_stay(folder: Path, tmp_path: Path) -> None:
    key = tmp_path / "key"
    make_key(key)
    (folder / "3" / "keep").touch()
    sign_map(folder / "4", key)
    build(folder / "nowhere", Driven(start=200, end=400, is_placed=False))
    stay = {one.path.name for one in _searched(folder, 1)}
    assert {"3", "4", "nowhere"} <= stay
    with_key = learn(folder, 1, is_ours=partial(is_signed_with, key_file=key))
    assert "4" in with_key.learned.retired
    make_key(tmp_path / "other")
    assert "4" not in learn(folder, 1, is_ours=partial(is_signed_with, key_file=tmp_path / "other")).learned.retired


def test_a_drive_that_was_recorded_beside_the_road_is_named_and_not_searched(tmp_path: Path) -> None:
    for number in range(3):
        build(tmp_path / f"{number}", Driven(0, east_m=15.0 * (number == 2), made_s=MADE_S + number))
    learned = learn(tmp_path)
    assert learned.choice.retired == {2: "15 m from where two or more other drives were"}
    (tmp_path / "2" / "keep").touch()
    assert not learn(tmp_path).choice.retired


@pytest.fixture
def rebuilt(tmp_path: Path) -> Path:
    """Three drives of a light passed places 50 to 149 of an old drive unrecognized, which were recognized before."""
    for name, light in (("old", 0), ("older", 1)):
        build(tmp_path / name, Driven(light, made_s=MADE_S))
    count(tmp_path, "old", range(200), MADE_S + 10)
    for run in range(3):
        count(tmp_path, "old", GAP, MADE_S + 20 + run)
    return tmp_path


def test_a_stretch_that_is_no_longer_there_is_no_layer_where_a_new_one_is(rebuilt: Path) -> None:
    build(rebuilt / "new", Driven(0, made_s=MADE_S + 5, start=0, end=200))
    lesson = learn(rebuilt, 1)
    names = [one.path.name for one in lesson.drives]
    assert "no longer there" in lesson.choice.retired[names.index("old")]
    assert "no longer there" not in str(learn(rebuilt, 1, stale_after=4).choice)
    count(rebuilt, "old", range(200), MADE_S + 40)
    assert "no longer there" not in str(learn(rebuilt, 1).choice), "it was recognized again"


def test_what_is_no_longer_there_is_shown_and_votes_no_more(rebuilt: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive_over(rebuilt, {"old"}, range(100, 140))
    assert main(["map", "learn", str(rebuilt)]) == 0
    assert "   100  searched" in capsys.readouterr().out
    assert main(["map", "info", str(rebuilt)]) == 0
    assert "stale     old: places 50 to 149 are passed" in capsys.readouterr().out
    assert [len(line) for line in map_view(open_map_set(rebuilt)).stale] == [100]
    drive_over(rebuilt, {"older"}, range(100, 140))
    count(rebuilt, "old", GAP, MADE_S + 50)
    (missed,) = read_tallies(rebuilt)[-1].passed.values()
    assert missed == {"front forward bright": {}}, "what is not searched is not missed"
    for run in range(HALF_LIFE):
        count(rebuilt, "older", range(10), MADE_S + 60 + run)
    assert main(["map", "learn", str(rebuilt)]) == 0
    drive_over(rebuilt, {"old"}, range(100, 140))


def test_the_layers_are_drawn(rebuilt: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib", reason="needs the extra `sim`")
    file = rebuilt / "layers.svg"
    assert main(["map", "learn", str(rebuilt), "--dry-run", "--picture", str(file)]) == 0
    drawn = file.read_text()
    for words in ("old (front)", "older (front)", "no longer there", "first to look this way"):
        assert words in drawn
    capsys.readouterr()
    assert main(["map", "learn", str(rebuilt), "--dry-run", "--picture", str(rebuilt / "none/x.svg")]) == 78
    assert "--picture" in capsys.readouterr().err
    assert len(open_map_set(rebuilt).names) == 2, "a dry run"


def drive_over(folder: Path, names: set[str], rows: range) -> None:
    """Drive again as the old map was driven; the maps of the lines that end at the last rows."""
    maps = open_map_set(folder)
    matcher = SequenceMatcher(maps, Config())
    raw = open_map(folder / "old").raw()
    matches = [matcher.push(raw[row].astype(np.float32), Travel(2.0 * row)) for row in range(rows.stop)]
    found = [match for match in matches[rows.start :] if match is not None]
    assert {maps.names[maps.index.map_of(match.place_index)] for match in found} == names


def test_neither_one_night_nor_a_detour_makes_anything_stale(tmp_path: Path) -> None:
    build(tmp_path / "old", Driven(0, made_s=MADE_S))
    build(tmp_path / "new", Driven(0, made_s=MADE_S + 5))
    count(tmp_path, "old", range(200), MADE_S + 10)
    for run in range(3):
        count(tmp_path, "old", GAP, MADE_S + 20 + run, gray=10)
        count(tmp_path, "old", GAP, MADE_S + 30 + run, detour_m=150.0)
    assert not learn(tmp_path, 1).learned.stale
    for run in range(3):
        count(tmp_path, "old", GAP, MADE_S + 40 + run)
    assert learn(tmp_path, 1).learned.stale, "it is by day, along the road"


def test_another_map_of_a_retired_name_is_searched_and_a_damaged_file_retires_nothing(folder: Path) -> None:
    main(["map", "learn", str(folder)])
    (gone,) = sorted({"2", "3", "4", "5", "6"} - searched(folder))[:1]
    shutil.rmtree(folder / gone)
    build(folder / gone, Driven(9))
    assert gone in searched(folder)
    for name in searched(folder):
        shutil.rmtree(folder / name)
    assert searched(folder), "what is retired is better than no map"
    (folder / LEARNED_FILE).write_bytes(b"[{")
    assert searched(folder)


@pytest.mark.parametrize("arguments", [["--layers", "0"], ["--stale-after", "0"], ["--key", "missing"]])
def test_bad_options_are_one_line(arguments: list[str], folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sign_with = folder.parent / "key"
    make_key(sign_with)
    sign_map(folder / "2", sign_with)
    assert main(["map", "learn", str(folder), *arguments]) == 78
    assert arguments[0] in (err := capsys.readouterr().err) or "missing" in err
    assert len(err.strip().splitlines()) == 1


@pytest.mark.parametrize("path", ["maps/2", "nothing"])
def test_what_is_no_folder_of_maps_is_named(path: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["map", "learn", str(folder.parent / path)]) == 78
    assert path in capsys.readouterr().err


def _searched(folder: Path, layers: int) -> list[StoredMap]:
    learned = learn(folder, layers)
    return [learned.drives[number] for number in learned.choice.searched]
