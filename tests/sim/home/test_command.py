"""`lookback home` and `lookback route`: what they print and write."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from edge.__main__ import main
from sim import geodetic
from tests.plugins.home.test_way_home import straight

MapAlong = Callable[..., Path]


def test_it_prints_the_way_and_writes_nothing(
    map_along: MapAlong, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    before = set(map_along(straight(300.0)).parent.rglob("*"))
    assert main(["home", str(tmp_path / "map")]) == 0
    out = capsys.readouterr().out
    assert out == "way home  300 m back along drive 1 (drive_0), 2 waypoints for 151 places\n"
    assert set(tmp_path.rglob("*")) == before


def test_a_way_that_is_refused_is_not_written(
    map_along: MapAlong, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    lat_deg, lon_deg = geodetic(50.0, 150.0)
    file = tmp_path / "home.plan"
    arguments = ["home", str(map_along(straight(300.0))), f"--from={lat_deg},{lon_deg}", "-o", str(file)]
    assert main(arguments) == 1
    assert "refused: the vehicle is 50 m from where the way begins; max_start_m is 20\n" in capsys.readouterr().out
    assert not file.exists()
    assert main([*arguments, "--max-start-m", "60"]) == 0
    home = json.loads(file.read_text())["mission"]["plannedHomePosition"]
    assert home[:2] == pytest.approx(geodetic(0.0, 0.0), abs=1e-7)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--from", "12"], "--from: '12' is not LAT,LON in degrees"),
        (["--from", "nan,7"], "--from: 'nan,7' is not LAT,LON in degrees"),
        (["--from", "91,7"], "--from: '91,7' is not LAT,LON in degrees"),
        (["--drive", "2"], "no drive 2; it has 1"),
        (["--drive", "0"], "no drive 0"),
        (["-o", "home.kml"], "home.kml: not a name that ends in"),
        (["--tolerance-m", "0"], "--tolerance-m: expected"),
        (["--turning-radius-m", "nan"], "--turning-radius-m: "),
        (["--left-m", "nan"], "--left-m: "),
    ],
)
def test_a_wrong_option_is_one_line(
    map_along: MapAlong, capsys: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    assert main(["home", str(map_along(straight(300.0))), *options]) == 78
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_a_route_is_printed_and_written_and_the_drives_are_named(
    map_along: MapAlong, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path, file = str(map_along(straight(300.0), straight(100.0, 90.0, (0.0, 150.0)))), tmp_path / "round.geojson"
    assert main(["route", path]) == 0
    assert main(["route", path, "--from", "1:20", "--via", "1:100", "--to", "2:end", "-o", str(file)]) == 0
    assert capsys.readouterr().out == (
        "drive 1 (drive_0): 300 m\n"
        "drive 2 (drive_1): 100 m\n"
        "route     230 m along drive 1 (drive_0) and along drive 2 (drive_1), 3 waypoints for 118 places\n"
        "warning: from 130 m to 130 m: from drive 1 (drive_0) onto drive 2 (drive_1), which no drive shows\n"
        f"written   {file}\n"
    )
    assert json.loads(file.read_text())["features"][-1]["properties"]["name"].startswith("route, along drive 1")
    assert main(["route", path, "--from", "1:20"]) == 78
    assert capsys.readouterr().err == "lookback: a route needs both --from and --to\n"
