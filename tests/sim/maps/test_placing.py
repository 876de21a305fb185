"""Where `map learn` puts the layers of a road: by the weight of receivers, and by the places that they recognize."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs
from numpy.typing import NDArray

from edge.__main__ import main
from edge.geodesy import east_north
from edge.reference_map import Route, open_map_set
from edge.reference_map.learned import POSITIONS, LearnedFolder
from edge_plugins.home import HomeConfig
from edge_plugins.home.way_home import plan_way_home
from sim.maps.learning import Lesson, learn
from tests.plugins.layers.drives import MADE_S, SPACING_M, Driven, build


def learned(folder: Path) -> Lesson:
    lesson = learn(folder, layers=9)
    lesson.keep(LearnedFolder(folder))
    return lesson


def off_m(folder: Path, name: str) -> NDArray[np.float64]:
    """How far east and north (N, 2) of the truth a drive's places now are."""
    maps = open_map_set(folder)
    places = maps.maps[maps.names.index(name)].places
    off_m = east_north(places["lat_deg"], places["lon_deg"], (-27.0, 153.0))
    off_m[:, 1] -= SPACING_M * places["row"]
    return off_m


def test_positions_are_weighted_by_their_accuracy(tmp_path: Path) -> None:
    for name, sigma_m, east_m in (("rough", 5.0, 4.0), ("fine", 0.02, 0.0), ("rough too", 5.0, -3.0)):
        build(tmp_path / name, Driven(sigma_m=sigma_m, east_m=east_m))
    learned(tmp_path)
    assert np.abs(off_m(tmp_path, "rough")).max() < 0.7
    assert np.abs(off_m(tmp_path, "fine")).max() < 0.01
    sigmas_m = [float(one.places["position_sigma_m"].min()) for one in open_map_set(tmp_path).maps]
    assert sigmas_m == pytest.approx([0.02, 5.0, 5.0]), "none is more certain than its receiver was"


@pytest.fixture(scope="module")
def four(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Drives of receivers that are 1 m wrong."""
    folder, rng = tmp_path_factory.mktemp("four"), np.random.default_rng(4)
    for number in range(4):
        build(folder / f"{number}", Driven(east_m=rng.normal(0, 1.0), end=150, made_s=MADE_S + number))
    learned(folder)
    return folder


@pytest.mark.parametrize(
    ("shifted", "is_named", "most_m"),
    [
        (Driven(east_m=15.0), True, 0.01),
        (Driven(east_m=40.0, off_from=75), True, 0.01),
        (Driven(east_m=6.0), False, 0.5),
    ],
)
def test_a_shifted_or_spoofed_recording_moves_no_other(
    shifted: Driven, is_named: bool, most_m: float, four: Path, tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(four, tmp_path / "maps"))
    build(folder / "shifted", replace(shifted, end=150))
    lesson = learned(folder)
    named = [lesson.drives[number].path.name for number, why in lesson.choice.retired.items() if "from where" in why]
    assert named == ["shifted"] * is_named
    for number in range(4):
        moved_m = off_m(folder, f"{number}") - off_m(four, f"{number}")
        assert np.abs(moved_m).max() <= most_m


def test_a_drive_without_gps_lies_where_it_recognizes_places_and_counts_as_that_recording(tmp_path: Path) -> None:
    build(tmp_path / "gps", Driven(0, east_m=2.0, sigma_m=1.5))
    build(tmp_path / "none", Driven(0, start=20, end=180, is_placed=False))
    lesson = learned(tmp_path)
    assert lesson.learned.newer.keys() == {open_map_set(tmp_path).headers[1].header_sha256}, "it moves no other"
    maps = open_map_set(tmp_path)
    placed = maps.maps[1].places
    found_m = east_north(placed["lat_deg"], placed["lon_deg"], (-27.0, 153.0))
    known = ~np.isnan(found_m[:, 0])
    assert known.mean() > 0.95
    assert (
        np.abs(found_m - np.stack([2.0 + 0 * placed["row"], SPACING_M * (20 + placed["row"])], axis=1))[known].max() < 2
    )
    assert placed["position_sigma_m"][known].min() > 1.5
    assert maps.index.recording(1) == maps.index.recording(0) == "drive of gps"
    (file,) = (tmp_path / POSITIONS).iterdir()
    file.write_bytes(file.read_bytes()[:-8])
    assert np.isnan(open_map_set(tmp_path).maps[1].places["lat_deg"]).all(), "damaged: as recorded"


def test_a_drive_that_is_placed_is_a_layer_as_others_are(tmp_path: Path) -> None:
    for number in range(3):
        build(tmp_path / f"{number}", Driven(0, is_placed=number != 1, made_s=MADE_S + number))
    assert {number: learn(tmp_path, layers=1).choice.retired.get(number, "") for number in (0, 1)} == {
        0: "others serve its road",
        1: "others serve its road",
    }


def test_a_drive_over_another_road_is_placed_nowhere(tmp_path: Path) -> None:
    build(tmp_path / "gps", Driven(0))
    build(tmp_path / "none", Driven(0, start=200, end=400, is_placed=False))
    assert not learned(tmp_path).learned.newer


def test_the_way_home_and_the_referee_use_the_newest_positions(tmp_path: Path) -> None:
    for name, sigma_m, east_m in (("0", 5.0, 4.0), ("1", 0.02, 0.0)):
        build(tmp_path / name, Driven(sigma_m=sigma_m, east_m=east_m))
    learned(tmp_path)
    maps = open_map_set(tmp_path)
    way = plan_way_home(maps, None, HomeConfig(), drive=1)
    assert max(abs(lon_deg - 153.0) for _, lon_deg in way.positions_deg) * 99_000 < 0.7
    position = Route(maps).position(100, 0.0)
    assert position is not None
    assert abs(position.lon_deg - 153.0) * 99_000 < 0.7
    LearnedFolder(tmp_path).undo()
    assert off_m(tmp_path, "0")[:, 0] == pytest.approx(4.0, abs=0.01)


def test_signed_positions_stay_as_they_were_signed(tmp_path: Path) -> None:
    pytest.importorskip("cryptography", reason="needs the extra `signing`")
    from sim.maps.keys import make_key, sign_map

    make_key(tmp_path / "key")
    for name, sigma_m, east_m in (("0", 5.0, 4.0), ("1", 0.02, 0.0)):
        build(tmp_path / "maps" / name, Driven(sigma_m=sigma_m, east_m=east_m))
    learned(tmp_path / "maps")
    for name in "01":
        sign_map(tmp_path / "maps" / name, tmp_path / "key")
    unmoved = open_map_set(tmp_path / "maps", require_signature_by=tmp_path / "key.pub").maps[0].places
    assert east_north(unmoved["lat_deg"], unmoved["lon_deg"], (-27.0, 153.0))[:, 0] == pytest.approx(4.0, abs=0.01)
    assert not learn(tmp_path / "maps").learned.newer


def test_positions_are_exported_as_they_now_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("gpxpy", reason="needs the extra `desk`")
    import gpxpy

    folder = tmp_path / "maps"
    for name, sigma_m, east_m in (("0", 5.0, 4.0), ("1", 0.02, 0.0)):
        build(folder / name, Driven(sigma_m=sigma_m, east_m=east_m))
    lesson = learned(folder)
    sha256 = lesson.drives[0].header.header_sha256
    LearnedFolder(folder).add(structs.replace(lesson.learned, stale={sha256: [(50, 100)]}), {})
    wanted = [tuple(place) for place in open_map_set(folder).places[["lat_deg", "lon_deg"]].tolist()]
    for suffix in ("geojson", "gpx", "kml", "csv"):
        assert main(["map", "export", str(folder), "-o", str(tmp_path / f"x.{suffix}")]) == 0
    features = json.loads((tmp_path / "x.geojson").read_text())["features"]
    assert [(lat, lon) for one in features for lon, lat in one["geometry"]["coordinates"]] == wanted
    assert [one["properties"]["is_stale"] for one in features] == [False, True, False, False]
    with (tmp_path / "x.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [(float(row["lat_deg"]), float(row["lon_deg"])) for row in rows] == wanted
    assert sum(int(row["is_stale"]) for row in rows) == 50
    tracks = gpxpy.parse((tmp_path / "x.gpx").read_text()).tracks
    assert [len(one.segments[0].points) for one in tracks] == [200, 200]
    assert tracks[0].segments[0].points[7].latitude == pytest.approx(wanted[7][0], abs=1e-9)
    assert (tmp_path / "x.kml").read_text().count("<LineString") == 2
    build(tmp_path / "none", Driven(is_placed=False))
    for what, output in (("none", "x.csv"), ("maps", "x.doc"), ("maps", "none/there.csv/x.csv")):
        assert main(["map", "export", str(tmp_path / what), "-o", str(tmp_path / output)]) == 78
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
