"""`lookback map coverage`: where earlier drives recognized the map."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from edge.__main__ import main
from edge.config import Config
from edge.journal.journal import Journal
from edge.journal.records import FrameUsed
from edge.reference_map import Drives, MapSet
from edge.telemetry.shadow import ShadowPosition
from edge_plugins.mapping.builder import Place
from sim.coverage import Conditions, Rehearsal, Sheet, aliases, passes
from sim.coverage.rehearsal import Way, by_keypoints
from sim.coverage.sheet import longest_gap, spans_of
from sim.evaluation.replay import as_line
from sim.world.scenario import LightName
from tests.map_of import map_of
from tests.sim.coverage.roads import road, walk

PLACES = 200


@pytest.fixture
def maps(tmp_path: Path) -> MapSet:
    """Two drives of 200 places, 2 m apart, the second 1 km further east."""
    raw = np.random.default_rng(1).random((PLACES, 2, 8), np.float32)
    places = [
        Place(row, -27.0 + row * 2 / 110_800, lon_deg, route_m=2.0 * row)
        for lon_deg in (153.0, 153.01)
        for row in range(PLACES)
    ]
    return MapSet.of(map_of(tmp_path / "map", np.tile(raw, (2, 1, 1)), places, starts=(0, PLACES), view="rear"))


def drive(
    believed: list[range], frames: range = range(PLACES), direction: Literal["forward", "reverse"] = "forward"
) -> list[FrameUsed]:
    """Frames at these places in a row; those in some ranges are believed, and others have a wrong match or none."""
    order = list(frames)[:: 1 if direction == "forward" else -1]
    out = []
    for index, place in enumerate(order):
        if any(place in one for one in believed):
            out.append(FrameUsed(index, index, accepted=True, place=place, direction=direction))
        else:
            out.append(FrameUsed(index, index, place=7 if index % 2 else None, direction=direction))
    return out


@pytest.mark.parametrize("direction", ["forward", "reverse"])
def test_frames_that_are_not_believed_count_where_they_were(
    maps: MapSet, direction: Literal["forward", "reverse"]
) -> None:
    drives = Drives(maps, 2.0)
    first = list(passes(drive([range(50, 100), range(150, 175)], direction=direction), maps, drives))
    second = list(passes(drive([range(0, 200)], direction=direction), maps, drives))
    found = Sheet.of(maps, drives, spans_of(maps, drives, 100.0), [], [first, second], 500.0).stretches
    assert [one.share for one in found] == [0.5, 1.0, 0.5, pytest.approx(0.75, abs=0.01), None, None, None, None]
    assert [(one.drives, one.believed_in) for one in found[:4]] == [(2, 1), (2, 2), (2, 1), (2, 2)]


def test_each_segment_has_its_own_frames(maps: MapSet) -> None:
    drives = Drives(maps, 2.0)
    first = drive([range(0, 100)], range(0, 110))
    second = drive([range(300, 350)], range(290, 350))
    found = list(passes([*first, *second], maps, drives))
    assert [(one.segment, len(one.along_m), int(one.believed.sum())) for one in found] == [(0, 110, 100), (1, 60, 50)]


def test_places_passed_without_a_frame_are_distance_too(maps: MapSet) -> None:
    drives = Drives(maps, 2.0)
    frames = [FrameUsed(0, 0, accepted=True, place=10, direction="forward"), FrameUsed(1, 1, missed=9)]
    (one,) = passes([*frames, FrameUsed(2, 2, accepted=True, place=30, direction="forward", missed=9)], maps, drives)
    assert one.along_m.tolist() == [20.0, 40.0, 60.0]


def write(path: Path, frames: list[FrameUsed]) -> str:
    path.write_text("".join(map(as_line, frames)), encoding="utf-8")
    return str(path)


def test_the_command(maps: MapSet, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    journals = [
        write(tmp_path / "a.jsonl", drive([range(0, 200)])),
        write(tmp_path / "b.jsonl", drive([range(0, 20), range(180, 200)])),
    ]
    output = tmp_path / "sheet.geojson"
    options = ["--rehearsals", "0", "--stretch-m", "200", "--within-m", "10", "--geojson", str(output)]
    assert main(["map", "coverage", str(maps.path), *journals, *options]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"{maps.path}: 2 earlier ones"
    expected = "drive 1,     0 to   200 m:  60 % of the frames; within 100 m 100 %; accepted on 2 of 2 earlier drives"
    assert lines[1].startswith(expected)
    assert lines[3].startswith("drive 2,     0 to   200 m: not driven")
    assert lines[5] == "longest gap: 2 m, up to 2 m of drive 1; 0 m of drift at 5 %"
    assert lines[6] == "drift always within 10 m: 50 % of the drives"
    features = json.loads(output.read_text())["features"]
    assert [one["properties"]["share"] for one in features] == [0.6, pytest.approx(0.6, abs=0.01), None, None]
    assert features[0]["geometry"]["coordinates"][0] == [153.0, -27.0]


def test_what_cannot_be_used_is_one_line(maps: MapSet, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def fails(journal: str, message: str, *options: str) -> None:
        assert main(["map", "coverage", str(maps.path), journal, *options]) != 0
        said = capsys.readouterr().err
        assert message in said
        assert said.count("\n") == 1

    fails(
        write(tmp_path / "empty.jsonl", []), "no frames in it; drive beside GPS, set [telemetry] journal_frames = true"
    )
    fails(str(tmp_path / "none.jsonl"), "cannot read it: No such file or directory")
    other = write(tmp_path / "other.jsonl", [FrameUsed(0, 0, accepted=True, place=900, direction="forward")])
    fails(other, "it has no place 900 of a single map; name the map driven on")
    fails(other, "--stretch-m: 0 is not at least 1", "--stretch-m", "0")
    nowhere = write(tmp_path / "nowhere.jsonl", drive([]))
    assert main(["map", "coverage", str(maps.path), nowhere, "--rehearsals", "0"]) == 0
    assert "longest gap: the whole route" in capsys.readouterr().out
    fails(nowhere, "--rehearsals: -1 is not 0 to 1000", "--rehearsals", "-1")
    fails(nowhere, "--within-m: 0 is not above 0", "--within-m", "0")
    assert main(["map", "coverage", str(maps.path), "--rehearsals", "0"]) != 0
    assert "name journals of earlier drives" in capsys.readouterr().err


def sheet_of(maps: MapSet, way: Way, light: LightName, rehearsals: int = 3) -> Sheet:
    drives = Drives(maps, 2.0)
    rehearsal = Rehearsal(maps, Config(), Conditions(way, light))
    passed = [rehearsal.drive(seed) for seed in range(rehearsals)]
    return Sheet.of(maps, drives, spans_of(maps, drives, 100.0), passed, [], 400.0)


@pytest.mark.parametrize(("way", "first"), [("home", -1), ("again", 0)])
def test_a_rehearsed_drive_is_recognized_after_its_first_stretch(tmp_path: Path, way: Way, first: int) -> None:
    maps = road(tmp_path / "map", [(0.0, walk(250, np.random.default_rng(2)))])
    sheet = sheet_of(maps, way, "day")
    shares = [one.share for one in sheet.stretches]
    others = shares[:-1] if first else shares[1:]
    assert 0 <= (shares[first] or 0.0) < 0.7
    assert min(share for share in others if share is not None) > 0.8
    assert sheet.gap is not None and 30 < sheet.gap.length_m < 200
    assert sheet.completed == 1.0


def test_less_light_is_less_coverage(tmp_path: Path) -> None:
    maps = road(tmp_path / "map", [(0.0, walk(200, np.random.default_rng(3)))])
    day, snow = (sheet_of(maps, "again", light) for light in ("day", "snow"))
    by_day, in_snow = ([one.share or 0.0 for one in sheet.stretches] for sheet in (day, snow))
    assert np.mean(by_day) > np.mean(in_snow) + 0.2


def test_an_unmapped_road_between_two_segments_is_part_of_the_gap(tmp_path: Path) -> None:
    raw = walk(300, np.random.default_rng(4))
    near = road(tmp_path / "near", [(0.0, raw[:100]), (498.0, raw[200:])])
    apart = road(tmp_path / "apart", [(0.0, raw[:100]), (5000.0, raw[200:])])
    for maps, least_m, most_m in ((near, 330.0, 600.0), (apart, 30.0, 250.0)):
        gap = sheet_of(maps, "again", "day").gap
        assert gap is not None and least_m < gap.length_m < most_m


def test_a_drive_that_ends_unrecognized_has_its_gap_there(maps: MapSet) -> None:
    drives = Drives(maps, 2.0)
    (one,) = passes(drive([range(0, 50)]), maps, drives)
    gap = longest_gap([one], maps)
    assert gap is not None and (gap.length_m, gap.from_m, gap.to_m) == pytest.approx((300.0, 98.0, 398.0))


def test_far_from_where_drives_enter_stretches_that_nobody_drove_have_one_share(tmp_path: Path) -> None:
    maps = road(tmp_path / "map", [(0.0, walk(300, np.random.default_rng(4)))])
    drives = Drives(maps, 2.0)
    spans = spans_of(maps, drives, 100.0)
    seen = [range(40, 60), range(110, 120), range(160, 210), range(250, 300)]
    rehearsed = list(passes(drive(seen, range(300)), maps, drives))
    shares = [one.share for one in Sheet.of(maps, drives, spans, [rehearsed], [], 400.0).stretches]
    assert shares[:2] == pytest.approx([0.2, 0.2], abs=0.21)
    assert len(set(shares[2:])) == 1 and shares[2] == pytest.approx(0.55, abs=0.1)
    driven = [one.share for one in Sheet.of(maps, drives, spans, [], [rehearsed], 400.0).stretches]
    assert len(set(driven[2:])) > 1, "what was driven is known"


def alike(path: Path, raw: NDArray[np.float32]) -> list[tuple[float, float]]:
    """Where stretches begin that resemble another one, and where that begins, m."""
    maps = road(path, [(0.0, raw)])
    drives = Drives(maps, 2.0)
    return [(one.stretch.from_m, one.other.from_m) for one in aliases(maps, drives, spans_of(maps, drives, 100.0))]


def test_stretches_that_resemble_each_other_are_named(tmp_path: Path) -> None:
    raw = walk(300, np.random.default_rng(5))
    raw[200:250] = raw[50:100] + 0.1 * walk(50, np.random.default_rng(6))
    assert alike(tmp_path / "map", raw) == [(100.0, 400.0), (400.0, 100.0)]


def test_a_street_that_repeats_itself_resembles_other_stretches_everywhere(tmp_path: Path) -> None:
    noise = 0.1 * walk(300, np.random.default_rng(6))
    assert len(alike(tmp_path / "map", np.resize(walk(27, np.random.default_rng(5)), noise.shape) + noise)) == 6


def test_the_command_predicts_from_the_map_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    maps = road(tmp_path / "map", [(0.0, walk(150, np.random.default_rng(7)))])
    options = ["--for", "again", "--light", "day", "--rehearsals", "2"]
    assert main(["map", "coverage", str(maps.path), *options]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"{maps.path}: 2 rehearsed drives again by day"
    assert len(lines) == 1 + 3 + 2 + 1
    assert lines[-1].startswith("No drive of a camera that looks ahead is in this map")
    assert re.fullmatch(r"longest gap: \d+ m, up to \d+ m of drive 1; .*", lines[-3]), "counted as people do"
    output = tmp_path / "sheet.geojson"
    assert main(["map", "coverage", str(maps.path), *options, "--geojson", str(output)]) == 0
    found = [one["properties"] for one in json.loads(output.read_text())["features"]]
    assert [(one["drive"], one["from_m"]) for one in found] == [(1, 0.0), (1, 100.0), (1, 200.0)]
    assert found[1]["share"] > 0.5
    assert [one["is_mean"] for one in found] == [False, False, True], "of the third no more is known"


def test_keypoints_begin_as_measured_and_anew_where_the_map_has_none_for_long() -> None:
    has_points = np.ones(600, dtype=bool)
    has_points[[*range(100, 150), *range(300, 420)]] = False
    along_m, rng = np.linspace(0.0, 1198.0, 600), np.random.default_rng(0)
    drives = [by_keypoints(has_points, along_m, (4.0, 42.0, 0.9), rng) for _ in range(200)]
    first_m = [along_m[found.argmax()] for found in drives]
    assert np.percentile(first_m, [50, 90]) == pytest.approx([4.0, 42.0], rel=0.5)
    found = np.mean(drives, axis=0)
    assert not found[~has_points].any()
    assert found[160:300].mean() == pytest.approx(0.9, abs=0.02), "100 m without points are crossed by odometer"
    assert 0.2 < found[420:430].mean() < 0.8 < found[560:].mean(), "240 m are not"


@pytest.mark.parametrize(
    ("light", "words"),
    [
        ("dusk", "simulated roads again by dusk: poses come to 6 m beside the lane at"),
        ("rain", "Without keypoints: home by rain they were not measured."),
    ],
)
def test_a_map_with_keypoints_is_predicted_with_them(
    write_traverse: Callable[..., Path],
    make_once: Callable[..., Path],
    light: str,
    words: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """It was "0 % of the frames" of a map on which `try` believed .92."""

    def build(folder: Path) -> None:
        out = write_traverse(folder / "out", range(60))
        assert main(["map", "build", str(out), "-o", str(folder / "with"), "--fov-deg", "75"]) == 0
        assert main(["map", "build", str(out), "-o", str(folder / "without"), "--no-keypoints"]) == 0

    folder, gaps_m = make_once("of_coverage", build), list[int]()
    way = ["--for", "again"] if light == "dusk" else ["--for", "home", "--view", "rear"]
    for name in ("with", "without"):
        capsys.readouterr()
        assert main(["map", "coverage", str(folder / name), *way, "--light", light, "--rehearsals", "2"]) == 0
        printed = capsys.readouterr().out
        assert (words in printed) == (name == "with") and ("eypoints" in printed) == (name == "with")
        gaps_m += map(int, re.findall(r"longest gap: (\d+) m", printed))
    assert gaps_m[1] >= 70 and (gaps_m[0] < 30 if light == "dusk" else gaps_m[0] == gaps_m[1])


def test_a_page_of_the_route(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib", reason="needs the extra `sim`")
    maps = road(tmp_path / "map", [(0.0, walk(PLACES, np.random.default_rng(8)))])
    command = ["map", "coverage", str(maps.path), write(tmp_path / "nowhere.jsonl", drive([])), "--rehearsals", "0"]
    assert main([*command, "--report", str(tmp_path / "route.html")]) == 0
    page = (tmp_path / "route.html").read_text(encoding="utf-8")
    assert "Not ready: home by night, with a camera that looks ahead, most drives recognize nothing." in page
    assert '<p class="lead">Longest gap: the whole route.</p>' in page and "No stretch looks like another." in page
    assert page.count("data:image/png") == 1
    capsys.readouterr()
    assert main([*command, "--report", "/none/route.html"]) != 0
    assert "/none/route.html: cannot write it: No such file" in capsys.readouterr().err


@pytest.mark.long  # it judges the figures of the prediction, on recordings; its parts are tested above
def test_a_real_corridor_is_predicted(shared: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The prediction knows the map alone; what is found is a second recording of the corridor."""
    corridor, journal = tmp_path / "corridor", tmp_path / "journal.jsonl"
    config = tmp_path / "config.toml"
    config.write_text('[sampling]\nby = "distance"\nspacing_m = 1.0\n[sequence]\nlength = 40\n')
    feeds, options = shared / "feeds", ["--config", str(config)]
    assert main(["map", "build", str(feeds / "corridor_reference"), "-o", str(corridor), *options]) == 0
    query = ["--map", str(corridor), "--all", "-o", str(journal), *options]
    assert main(["replay", str(feeds / "corridor_query"), *query]) == 0
    sheets = []
    for given in ([], [str(journal), "--rehearsals", "0"]):
        capsys.readouterr()
        command = ["map", "coverage", str(corridor), *given, "--for", "again", "--light", "day", "--stretch-m", "10"]
        assert main(command) == 0
        sheets.append(capsys.readouterr().out)
    predicted, found = ([int(share) for share in re.findall(r"(\d+) % of the frames", sheet)] for sheet in sheets)
    assert np.corrcoef(predicted, found)[0, 1] > 0.8
    gaps = [int(gap) for sheet in sheets for gap in re.findall(r"longest gap: (\d+) m", sheet)]
    assert 1 / 1.5 < gaps[0] / gaps[1] < 1.5


def test_drives_beside_gps_that_went_this_way_in_this_light_replace_the_rehearsals(
    maps: MapSet, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three by day that publish on the second half of the first drive; one back, which is of another way."""
    noon_s = datetime(2026, 6, 1, 2, 0, tzinfo=timezone.utc).timestamp()
    places = maps.places[:PLACES]
    for number in range(4):
        journal = Journal(tmp_path / f"{number}.jsonl", unix_time_s=partial(float, noon_s + 86_400 * number))
        order = places[::-1] if number == 3 else places
        for row, place in enumerate(order[::4]):
            at = float(place["lat_deg"]), float(place["lon_deg"])
            one = ShadowPosition(row * 10**9, 8.0, 8.0 * row, "off the map", *at, 0.5, "rtk_fixed")
            if row >= 25:
                one = msgspec.structs.replace(one, withheld="", lat_deg=at[0], lon_deg=at[1], heading_deg=0.0)
                one = msgspec.structs.replace(one, sigma_along_m=2.0, sigma_cross_track_m=2.0)
            journal.write(one)
        journal.close()
    journals = [str(tmp_path / f"{number}.jsonl") for number in range(4)]
    words = ["map", "coverage", str(maps.path), *journals, "--rehearsals", "2", "--for", "again", "--light", "day"]
    assert main([*words, "--stretch-m", "200"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("and 3 earlier ones")
    assert [line.split("m: ")[1].split(" of the")[0].strip() for line in lines[1:3]] == ["0 %", "100 %"]
    assert "accepted on 3 of 3 earlier drives" in lines[2]
