"""The unit, as systemd itself judges it, and the files that it leans on."""

from __future__ import annotations

import configparser
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from edge.errors import EXIT_SETUP

SYSTEMD = Path(__file__).parents[2] / "systemd"
UNIT = SYSTEMD / "lookback.service"
CAMERA_UNIT = SYSTEMD / "lookback-camera@.service"
CAMERA_SOCKET = SYSTEMD / "lookback-camera.socket"
EXPOSURE_MAX = 2.0


@pytest.fixture(scope="module")
def analyze() -> str:
    tool = shutil.which("systemd-analyze")
    if tool is None:
        pytest.skip("needs systemd-analyze")
    return tool


def unit_values(key: str, file: Path = UNIT) -> list[str]:
    """Every word that a key is given, over all its lines."""
    lines = re.findall(rf"^{re.escape(key)}=(.*)$", file.read_text(), re.MULTILINE)
    return [word for line in lines for word in line.split()]


def verify(analyze: str, unit: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([analyze, "verify", str(unit)], capture_output=True, text=True, check=False)


@pytest.fixture
def installed_unit(tmp_path: Path) -> Path:
    """The unit with a program that is there: verify looks whether it could be started."""
    text = UNIT.read_text()
    assert text.count("/opt/lookback/bin/lookback") == 1
    unit = tmp_path / UNIT.name
    unit.write_text(text.replace("/opt/lookback/bin/lookback", sys.executable))
    return unit


def test_verify_says_nothing(analyze: str, installed_unit: Path) -> None:
    result = verify(analyze, installed_unit)
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")


def test_exposure(analyze: str) -> None:
    command = [analyze, "security", "--offline=true", "--no-pager", f"--threshold={EXPOSURE_MAX * 10:.0f}", str(UNIT)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    match = re.search(r"Overall exposure level for lookback\.service: ([\d.]+)", result.stdout)
    assert match is not None, result.stderr
    print(f"exposure {match[1]}")
    assert float(match[1]) <= EXPOSURE_MAX
    assert result.returncode == 0


def test_the_cameras_units_are_valid(analyze: str, tmp_path: Path) -> None:
    text = CAMERA_UNIT.read_text()
    assert text.count("/usr/bin/rpicam-vid") == 1
    (tmp_path / CAMERA_UNIT.name).write_text(text.replace("/usr/bin/rpicam-vid", sys.executable))
    shutil.copy(CAMERA_SOCKET, tmp_path)
    for name in (CAMERA_SOCKET.name, CAMERA_UNIT.name):
        result = verify(analyze, tmp_path / name)
        assert (result.returncode, result.stdout, result.stderr) == (0, "", ""), name


def test_the_cameras_unit_opens_what_the_service_does_not_and_no_more(analyze: str) -> None:
    devices = set(unit_values("DeviceAllow", CAMERA_UNIT)) - {"rw"}
    assert devices == {"char-video4linux", "char-media", "char-dma_heap"}
    assert not {"char-media", "char-dma_heap"} & set(unit_values("DeviceAllow"))
    command = [analyze, "security", "--offline=true", "--no-pager", str(CAMERA_UNIT)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    match = re.search(r"Overall exposure level for lookback-camera@\w*\.service: ([\d.]+)", result.stdout)
    assert match is not None, result.stderr
    assert float(match[1]) <= EXPOSURE_MAX


def test_only_the_service_may_connect_to_the_camera() -> None:
    assert unit_values("SocketGroup", CAMERA_SOCKET) == unit_values("Group")
    assert unit_values("SocketMode", CAMERA_SOCKET) == ["0660"]


def test_drivers_are_loaded_before_their_devices_are_allowed() -> None:
    """DeviceAllow=char-NAME is dropped without a word while nothing has registered NAME."""
    needed = {"char-ttyACM": "cdc_acm", "char-ttyUSB": "usbserial", "char-video4linux": "videodev"}
    allowed = unit_values("DeviceAllow")
    for device, module in needed.items():
        assert device in allowed
        assert f"modprobe@{module}.service" in unit_values("Wants")
        assert f"modprobe@{module}.service" in unit_values("After")


def test_built_in_ports_are_allowed() -> None:
    assert {"char-ttyAMA", "char-ttyTHS", "char-ttyS", "char-usb_device"} <= set(unit_values("DeviceAllow"))


def test_bad_configuration_does_not_restart() -> None:
    assert unit_values("RestartPreventExitStatus") == [str(EXIT_SETUP)]


def test_restarts_for_ever() -> None:
    assert unit_values("Restart") == ["on-failure"]
    assert unit_values("StartLimitIntervalSec") == ["0"]


def test_nothing_phones_home_and_one_thread_each() -> None:
    words = unit_values("Environment")
    assert {"ORT_DISABLE_TELEMETRY=1", "DEPTHAI_TELEMETRY=0"} <= set(words)
    assert {"OMP_NUM_THREADS=1", "OPENBLAS_NUM_THREADS=1"} <= set(words)


def test_all_of_proc_stays_readable() -> None:
    """ONNX Runtime finds an ARM processor's instructions in /proc/cpuinfo."""
    assert unit_values("ProcSubset") == []


def test_sysusers_makes_the_user_and_every_group(tmp_path: Path) -> None:
    tool = shutil.which("systemd-sysusers")
    if tool is None:
        pytest.skip("needs systemd-sysusers")
    (tmp_path / "etc").mkdir()
    subprocess.run([tool, f"--root={tmp_path}", str(SYSTEMD / "lookback.sysusers")], check=True)
    users = (tmp_path / "etc/passwd").read_text()
    groups = {line.partition(":")[0] for line in (tmp_path / "etc/group").read_text().splitlines()}
    assert re.search(r"^lookback:x:\d+:\d+:.*:/var/lib/lookback:/usr/sbin/nologin$", users, re.MULTILINE)
    assert {*unit_values("User"), *unit_values("Group"), *unit_values("SupplementaryGroups")} <= {"lookback", *groups}


def test_directories_and_modes_agree_with_tmpfiles() -> None:
    lines = [line.split() for line in (SYSTEMD / "lookback.tmpfiles").read_text().splitlines() if line[:1] == "d"]
    modes = {path: mode for _, path, mode, *_ in lines}
    assert modes == {
        f"/etc/{unit_values('ConfigurationDirectory')[0]}": unit_values("ConfigurationDirectoryMode")[0],
        f"/var/lib/{unit_values('StateDirectory')[0]}": unit_values("StateDirectoryMode")[0],
    }


def test_backoff_drop_in_is_a_unit_file() -> None:
    drop_in = configparser.ConfigParser()
    drop_in.optionxform = str  # type: ignore[assignment,method-assign]
    drop_in.read_string((SYSTEMD / "lookback-backoff.conf").read_text())
    assert set(drop_in["Service"]) == {"RestartSteps", "RestartMaxDelaySec"}
