"""Exports, read again by the libraries and by the rules that others read them with."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path

import msgspec
import pytest

pytest.importorskip("gpxpy")
pytest.importorskip("simplekml")

import gpxpy

from edge.__main__ import main
from edge.journal.journal import Journal
from edge.journal.records import FrameUsed, PlaceFix, StateChanged
from sim.evaluation.replay import as_line

FRAME = FrameUsed(5, 9_000_000_000, accepted=True, place=3, uniqueness=1.2, lat_deg=-27.0, lon_deg=153.0)
EVENT = PlaceFix(10_000_000_000, 4, -27.001, 153.0, 180.0, 3.0, 1.0, "forward", "same", 1.3)


@pytest.fixture
def journal(tmp_path: Path) -> Path:
    """A journal with one event, one believed frame, and what is not to be exported."""
    path = tmp_path / "drive.jsonl"
    journal = Journal(path, unix_time_s=lambda: 1_700_000_000.25)
    doubted = msgspec.structs.replace(FRAME, accepted=False)
    unknown = msgspec.structs.replace(FRAME, lat_deg=None, lon_deg=None)
    for frame in (FRAME, doubted, unknown, FrameUsed(6, 9_100_000_000)):
        journal.write(frame)
    journal.write(StateChanged("on the map"))
    journal.write(EVENT)
    journal.close()
    return path


def export(journal: Path, name: str, *options: str) -> str:
    output = journal.with_name(name)
    assert main(["export", str(journal), "-o", str(output), *options]) == 0
    return output.read_text(encoding="utf-8")


def test_geojson(journal: Path) -> None:
    point, line = json.loads(export(journal, "drive.geojson"))["features"]
    assert point["geometry"] == {"type": "Point", "coordinates": [153.0, -27.001]}
    assert point["properties"]["place"] == 4 and "category" not in point["properties"]
    assert point["properties"]["time"] == "2023-11-14T22:13:20.250000+00:00"
    assert line["geometry"]["coordinates"] == [[153.0, -27.0], [153.0, -27.001]]


def test_gpx(journal: Path) -> None:
    gpx = gpxpy.parse(export(journal, "drive.gpx"))
    (waypoint,) = gpx.waypoints
    assert waypoint.time is not None
    assert (waypoint.name, waypoint.latitude, waypoint.time.year) == ("place 4", -27.001, 2023)
    assert waypoint.description == "forward, uniqueness 1.3"
    assert [point.latitude for point in gpx.tracks[0].segments[0].points] == [-27.0, -27.001]


def test_kml(journal: Path) -> None:
    root = ET.fromstring(export(journal, "drive.kml"))
    spaces = {"kml": "http://www.opengis.net/kml/2.2"}
    assert [one.text for one in root.findall(".//kml:Placemark/kml:name", spaces)] == ["place 4", "drive"]
    assert root.findall(".//kml:Point/kml:coordinates", spaces)[0].text == "153.0,-27.001,0.0"


def test_tum(journal: Path) -> None:
    first, last = (line.split() for line in export(journal, "drive.tum").splitlines())
    assert len(first) == len(last) == 8
    assert float(last[0]) == pytest.approx(1_700_000_000.25)
    assert float(last[2]) == pytest.approx(-110.8, abs=0.1)  # meters north
    assert [float(value) for value in last[6:]] == pytest.approx([-0.7071, 0.7071], abs=1e-3)  # looks south


def test_events_only_and_lines_of_replay(journal: Path, tmp_path: Path) -> None:
    assert len(json.loads(export(journal, "events.geojson", "--events-only"))["features"]) == 1
    lines = tmp_path / "replay.jsonl"
    emitted = msgspec.structs.replace(FRAME, emitted=True)
    lines.write_text(as_line(FRAME) + as_line(emitted))
    assert len(json.loads(export(lines, "replay.geojson"))["features"]) == 2


def test_mistakes_are_one_line(journal: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, told in (
        ([str(journal), "-o", "x.shp"], "--output: x.shp: use a name that ends in one of .geojson, .gpx, .kml, .tum"),
        ([str(tmp_path / "none"), "-o", "x.gpx"], "none: cannot read it: No such file"),
        ([str(journal), "-o", str(tmp_path / "no/x.gpx")], "x.gpx: cannot write it: No such file"),
    ):
        assert main(["export", *arguments]) == 78
        assert told in capsys.readouterr().err
    (tmp_path / "empty").write_text('{"event":"state"}\n')
    assert main(["export", str(tmp_path / "empty"), "-o", "x.gpx"]) == 78
    assert "no place with a position in it" in capsys.readouterr().err
