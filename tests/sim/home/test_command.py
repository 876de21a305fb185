"""`lookback home`: what it prints and writes, and uploads to an autopilot."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from edge.__main__ import main
from edge.telemetry import open_link
from sim import geodetic
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.command import straight_line
from tests.plugins.home.test_way_home import straight
from tests.udp_port import free_port

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
    assert "refused: the vehicle is 50 m from the drive; max_start_m is 20\n" in capsys.readouterr().out
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
        (["--upload", "com1"], "--upload: 'com1' is not serial:DEVICE:BAUD"),
        (["--upload", "udp:127.0.0.1:14550", "--from", "1,2"], "--from: the autopilot reports the position itself"),
    ],
)
def test_a_wrong_option_is_one_line(
    map_along: MapAlong, capsys: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    assert main(["home", str(map_along(straight(300.0))), *options]) == 78
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.fixture
def autopilot() -> Iterator[tuple[str, SimulatedAutopilot]]:
    """A simulated autopilot in a thread, which stands with GPS at the origin, and the connection to it."""
    port = free_port()
    link, stop = open_link(f"udp:127.0.0.1:{port}"), threading.Event()
    made = SimulatedAutopilot(link, straight_line(0.0, 180.0, time.monotonic()))
    thread = threading.Thread(target=made.run, args=(stop,))
    thread.start()
    yield f"udpin:127.0.0.1:{port}", made
    stop.set()
    thread.join()
    link.close()


def test_it_uploads_without_a_daemon(
    map_along: MapAlong, autopilot: tuple[str, SimulatedAutopilot], capsys: pytest.CaptureFixture[str]
) -> None:
    connection, vehicle = autopilot
    path = map_along(straight(300.0, 0.0, (0.0, -250.0)))
    assert main(["home", str(path), "--upload", connection, "--speed-mps", "2"]) == 0
    assert "uploaded and verified: 250 m back along drive 1" in capsys.readouterr().out
    assert vehicle.mission.waypoints_deg[-1] == pytest.approx(geodetic(0.0, -250.0), abs=2e-7)


def test_it_uploads_nothing_that_is_refused(
    map_along: MapAlong, autopilot: tuple[str, SimulatedAutopilot], capsys: pytest.CaptureFixture[str]
) -> None:
    connection, vehicle = autopilot
    assert main(["home", str(map_along(straight(300.0, 0.0, (100.0, 0.0)))), "--upload", connection]) == 1
    assert "no way home: the vehicle is 100 m from the drive" in capsys.readouterr().out
    assert vehicle.mission.items == []
