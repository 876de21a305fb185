"""`lookback map learn`: which drives over a road stay searched, and why; and that it never searches too little."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

import pytest

from edge.__main__ import main
from edge.errors import MapError
from edge.reference_map import open_map_set
from edge.reference_map.map_folder import RETIRED
from sim.maps.keys import make_key, sign_map
from sim.maps.newest import choose
from tests.plugins.layers.drives import MADE_S, Driven, build


@pytest.fixture(scope="module")
def eight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two drives of a rear camera and six of a front one, out; the newest is 7."""
    folder = tmp_path_factory.mktemp("eight")
    for number in range(8):
        build(folder / f"{number}", Driven(number % 3, "rear" if number < 2 else "front", made_s=MADE_S + number))
    return folder


@pytest.fixture
def folder(eight: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(eight, tmp_path / "maps"))


def searched(folder: Path) -> set[str]:
    return set(open_map_set(folder).names)


def chosen(folder: Path, layers: int) -> set[str]:
    choice = choose(folder, layers)
    return {choice.drives[number].path.name for number in choice.searched}


def test_the_newest_of_each_view_and_of_these_the_newest_are_searched(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["map", "learn", str(folder), "--dry-run"]) == 0
    assert "4 of 8 drives would be searched" in capsys.readouterr().out
    assert len(searched(folder)) == 8
    assert main(["map", "learn", str(folder)]) == 0
    assert "4 of 8 drives are searched" in capsys.readouterr().out
    assert searched(folder) == {"1", "5", "6", "7"}
    for command in ("list", "info"):
        assert main(["map", command, str(folder)]) == 0
        assert capsys.readouterr().out.count("retired") == 4
    assert main(["map", "learn", str(folder), "--layers", "8"]) == 0
    assert len(searched(folder)) == 8, "those that were retired are considered again"


@pytest.mark.parametrize(("layers", "names"), [(1, {"1", "7"}), (2, {"1", "7"}), (3, {"1", "6", "7"})])
def test_the_only_rear_drive_is_not_given_up_for_newer_front_ones(layers: int, names: set[str], folder: Path) -> None:
    assert chosen(folder, layers) == names


def test_each_view_in_each_direction_has_its_newest(tmp_path: Path) -> None:
    for number in range(3):
        build(tmp_path / f"out rear {number}", Driven(view="rear", made_s=MADE_S + number))
        build(tmp_path / f"out front {number}", Driven(made_s=MADE_S + 10 + number))
        build(tmp_path / f"home front {number}", Driven(back=True, made_s=MADE_S + 20 + number))
    assert chosen(tmp_path, 3) == {"out rear 2", "out front 2", "home front 2"}


def test_any_number_of_drives_is_searched_as_four_are(tmp_path: Path) -> None:
    for number in range(12):
        build(tmp_path / f"{number:02}", Driven(number % 5, made_s=MADE_S + number, end=40))
    assert chosen(tmp_path, 4) == {"08", "09", "10", "11"}


def test_a_drive_over_a_road_of_its_own_stays(folder: Path) -> None:
    build(folder / "on", Driven(made_s=MADE_S - 100, end=260))
    build(folder / "little on", Driven(made_s=MADE_S - 100, end=220))
    assert chosen(folder, 4) == {"1", "6", "7", "on"}


def test_a_drive_that_looks_back_serves_the_way_home_as_a_drive_home_does(tmp_path: Path) -> None:
    build(tmp_path / "out", Driven(view="rear", made_s=MADE_S))
    build(tmp_path / "home", Driven(back=True, made_s=MADE_S + 1))
    assert chosen(tmp_path, 1) == {"home"}


def test_drives_that_are_kept_or_signed_or_have_no_positions_stay(folder: Path, tmp_path: Path) -> None:
    make_key(tmp_path / "key")
    (folder / "3" / "keep").touch()
    sign_map(folder / "4", tmp_path / "key")
    build(folder / "nowhere", Driven(start=200, end=400, is_placed=False))
    assert chosen(folder, 1) == {"1", "3", "4", "nowhere"}
    for name in ("3", "4"):
        (folder / name / RETIRED).touch()
    assert {"3", "4"} <= searched(folder), "a mark alone does not retire them"


def test_wherever_it_is_interrupted_too_much_is_searched_and_never_too_little(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    choose(folder).mark()
    for name in ("5", "6", "7"):
        os.utime(folder / name / "map.json", (MADE_S - 9, MADE_S - 9))
    before, choice = searched(folder), choose(folder)
    after = {choice.drives[number].path.name for number in choice.searched}
    assert after != before

    def touch(path: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "touch", touch)
    with pytest.raises(MapError, match="cannot mark the map: No space left on device"):
        choice.mark()
    assert searched(folder) == before | after


def test_what_is_retired_is_better_than_no_map(folder: Path) -> None:
    choose(folder).mark()
    for name in searched(folder):
        shutil.rmtree(folder / name)
    assert searched(folder)


def test_bad_options_are_one_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["map", "learn", str(folder), "--layers", "0"]) == 78
    assert capsys.readouterr().err == "lookback: --layers: 0 is not 1 or more\n"


@pytest.mark.parametrize("path", ["maps/2", "nothing"])
def test_what_is_no_folder_of_maps_is_named(path: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["map", "learn", str(folder.parent / path)]) == 78
    assert path in capsys.readouterr().err
