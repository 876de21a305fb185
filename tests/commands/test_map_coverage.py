"""`lookback map coverage`: where earlier drives recognized the map."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from edge.__main__ import main
from edge.commands.map_coverage import passes, stretches
from edge.commands.replay import as_line
from edge.config import SamplingConfig
from edge.descriptor.normalize import normalize
from edge.journal.records import FrameUsed
from edge.reference_map import Drives, MapSet, open_map_set
from edge.reference_map.builder import MapBuilder, Place
from edge.reference_map.store import ModelKey, RegionsKey

PLACES = 200


@pytest.fixture
def maps(tmp_path: Path) -> MapSet:
    """Two drives of 200 places, 2 m apart, the second 1 km further east."""
    key = ModelKey("test", "0" * 64, "fc6", 8)
    raw = np.random.default_rng(1).random((PLACES, 2, 8), np.float32)
    with MapBuilder(tmp_path / "map", key, RegionsKey("left-right", 0.4, "set"), SamplingConfig()) as builder:
        for east_deg in (0.0, 0.01):
            builder.begin_segment("drive", "rear")
            for row in range(PLACES):
                builder.add(raw[row], Place(row, -27.0 + row * 2 / 110_800, 153.0 + east_deg, route_m=2.0 * row))
        builder.finish(normalize, "test")
    return open_map_set(tmp_path / "map")


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
    found = list(stretches(drives, [first, second], maps, 100.0))
    assert [one.share for one in found] == [0.5, 1.0, 0.5, pytest.approx(0.75, abs=0.01), None, None, None, None]
    assert [(one.drives, one.believed_in) for one in found[:4]] == [(2, 1), (2, 2), (2, 1), (2, 2)]
    assert first[0].longest_gap() == pytest.approx((198.0, 300.0))


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
    options = ["--stretch-m", "200", "--within-m", "10", "--geojson", str(output)]
    assert main(["map", "coverage", str(maps.path), *journals, *options]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "drive 0,     0 to   200 m:  60% of frames, 2 of 2"
    assert lines[2] == "drive 1,     0 to   200 m: not driven"
    assert lines[5].endswith("b.jsonl: longest gap 322 m, drive 0 from 38 to 360 m; 16 m of drift at 5 %")
    assert lines[6] == "drift always within 10 m: 1 of 2 drives"
    features = json.loads(output.read_text())["features"]
    assert [one["properties"]["share"] for one in features] == [0.6, pytest.approx(0.6, abs=0.01), None, None]
    assert features[0]["geometry"]["coordinates"][0] == [153.0, -27.0]


def test_what_cannot_be_used_is_one_line(maps: MapSet, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def fails(journal: str, message: str, *options: str) -> None:
        assert main(["map", "coverage", str(maps.path), journal, *options]) != 0
        said = capsys.readouterr().err
        assert message in said
        assert said.count("\n") == 1

    fails(write(tmp_path / "empty.jsonl", []), "no frames in it; set [telemetry] journal_frames = true")
    fails(str(tmp_path / "none.jsonl"), "cannot read it: No such file or directory")
    other = write(tmp_path / "other.jsonl", [FrameUsed(0, 0, accepted=True, place=900, direction="forward")])
    fails(other, "it has no place 900 of a single map; name the map driven on")
    fails(other, "--stretch-m: 0 is not at least 1", "--stretch-m", "0")
    nowhere = write(tmp_path / "nowhere.jsonl", drive([]))
    assert main(["map", "coverage", str(maps.path), nowhere]) == 0
    assert "nothing is believed on this map" in capsys.readouterr().out
