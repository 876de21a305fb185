"""`lookback dev bench`: with the packages of a vehicle, and what it reads from a board's sensors."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from sim.bench.board import HEADER, BoardRun, board_name, hottest_c, row, throttling

DESK = "faiss,onnx,torch,panda3d,matplotlib,jinja2"
WITHOUT = (
    "import sys; sys.modules.update(dict.fromkeys(sys.argv.pop(1).split(','))); from edge.__main__ import main; main()"
)


def test_it_runs_with_what_a_vehicle_has(tmp_path: Path) -> None:
    words = ["dev", "bench", "--seconds", "0.1", "--places", "200", "--folder", str(tmp_path)]
    command = [sys.executable, "-c", WITHOUT, DESK, *words]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    header, line, *rows = result.stdout.splitlines()
    assert f"{header}\n{line}" == HEADER
    cells = [row.strip("| ").split(" | ") for row in rows]
    assert [row[-11] for row in cells] == ["grid", "fc6"]
    assert all(float(row[-9]) > 0 for row in cells)
    assert "Please paste" in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_stages_say_what_they_need() -> None:
    command = [sys.executable, "-c", WITHOUT, DESK, "dev", "bench", "--stages"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    (line,) = result.stderr.splitlines()
    assert "--stages needs the package" in line and "bench]" in line


def sensors(folder: Path, temperatures: list[str], cooling: dict[str, int]) -> Path:
    for number, text in enumerate(temperatures):
        (folder / f"thermal_zone{number}").mkdir()
        (folder / f"thermal_zone{number}/temp").write_text(text)
    for number, (kind, state) in enumerate(cooling.items()):
        (folder / f"cooling_device{number}").mkdir()
        (folder / f"cooling_device{number}/type").write_text(f"{kind}\n")
        (folder / f"cooling_device{number}/cur_state").write_text(f"{state}\n")
    return folder


def test_the_hottest_sensor_counts(tmp_path: Path) -> None:
    assert hottest_c(sensors(tmp_path, ["45000\n", "61500\n", "off"], {})) == [61.5]
    assert hottest_c(tmp_path / "none") == []


@pytest.mark.parametrize(
    ("flags", "cooling", "found"),
    [
        ("0", {"pwm-fan": 3, "cpufreq-cpu0": 0}, set()),
        ("50005", {}, {"under-voltage", "throttled"}),  # the upper half says what has happened since boot
        ("8", {"cpufreq-cpu0": 2}, {"temperature limit", "kernel limits the processor"}),
    ],
)
def test_throttling(flags: str, cooling: dict[str, int], found: set[str], tmp_path: Path) -> None:
    (tmp_path / "get_throttled").write_text(f"{flags}\n")
    assert throttling(tmp_path / "get_throttled", sensors(tmp_path, [], cooling)) == found


def test_times_that_grow_count_as_throttled() -> None:
    frames = [{"network": 10.0 + number, "search": 1.0} for number in range(20)]
    cells = row("a board", "grid", BoardRun(frames, [70.0, 81.0], frozenset())).strip("| ").split(" | ")
    assert cells[:2] == ["a board", "grid"]
    assert cells[3] == "19.5"
    assert cells[-3:] == ["+128 %", "81 °C", "yes, by the times"]


def test_a_board_names_itself(tmp_path: Path) -> None:
    (tmp_path / "model").write_bytes(b"Raspberry Pi 5 Model B Rev 1.0\0")
    assert board_name(tmp_path / "model").startswith("Raspberry Pi 5 Model B Rev 1.0: ")
