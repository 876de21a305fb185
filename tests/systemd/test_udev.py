"""The udev rules: read line by line, and applied to devices as the kernel describes them."""

from __future__ import annotations

import fnmatch
import re
import shutil
import subprocess
from pathlib import Path

import pytest

SYSTEMD = Path(__file__).parents[2] / "systemd"
RULES = SYSTEMD / "70-lookback.rules"
UNIT = (SYSTEMD / "lookback.service").read_text()
TERM = re.compile(r'([A-Z]+(?:\{[A-Za-z_]+\})?)(==|!=|\+=|:=|=)"([^"]*)"')

OAK_UNBOOTED = {"SUBSYSTEM": "usb", "ENV{DEVTYPE}": "usb_device", "ATTR{idVendor}": "03e7", "ATTR{idProduct}": "2485"}
OAK_BOOTED = OAK_UNBOOTED | {"ATTR{idProduct}": "f63b"}


def tty(vendor: str, product: str, interface: str = "00") -> dict[str, str]:
    return {
        "SUBSYSTEM": "tty",
        "ATTRS{idVendor}": vendor,
        "ATTRS{idProduct}": product,
        "ENV{ID_USB_INTERFACE_NUM}": interface,
    }


def terms(line: str) -> list[tuple[str, str, str]]:
    """Key, operator and value of each term; asserts that there is nothing else on the line."""
    found = TERM.findall(line)
    assert ", ".join(f'{key}{operator}"{value}"' for key, operator, value in found) == line
    return found


def apply(device: dict[str, str]) -> dict[str, str]:
    """What udev would set: the part of its language that the file uses, as udev(7) has it."""
    device, result = dict(device), dict[str, str]()
    jump_to = None
    for line in RULES.read_text().splitlines():
        if not line or line.startswith("#"):
            continue
        rule = terms(line)
        if jump_to is not None and ("LABEL", "=", jump_to) not in rule:
            continue
        jump_to = None
        for key, operator, value in rule:
            if operator in {"==", "!="}:
                matches = any(fnmatch.fnmatchcase(device.get(key, ""), one) for one in value.split("|"))
                if matches != (operator == "=="):
                    break
            elif key == "GOTO":
                jump_to = value
            elif key != "LABEL":
                device[key] = result[key] = value
    return result


@pytest.mark.parametrize("device", [OAK_UNBOOTED, OAK_BOOTED], ids=["unbooted", "booted"])
def test_an_oak_may_be_used_before_and_after_it_boots(device: dict[str, str]) -> None:
    result = apply(device)
    assert (result["GROUP"], result["MODE"]) == ("plugdev", "0660")


def test_groups_are_those_of_the_service() -> None:
    (groups,) = re.findall(r"^SupplementaryGroups=(.*)$", UNIT, re.MULTILINE)
    named = set(re.findall(r'GROUP="(\w+)"', RULES.read_text()))
    assert named <= set(groups.split())


@pytest.mark.parametrize(
    ("vendor", "product"),
    [("1209", "5740"), ("1209", "5741"), ("26ac", "0032"), ("3162", "004b"), ("3185", "0035"), ("2dae", "1058")],
    ids=["ardupilot", "ardupilot-two-ports", "pixhawk-4", "holybro", "fmu-v6x", "cube-orange-plus"],
)
def test_autopilots_have_a_name_and_no_modem_manager(vendor: str, product: str) -> None:
    result = apply(tty(vendor, product))
    assert result["SYMLINK"] == "lookback-autopilot"
    assert result["ENV{ID_MM_DEVICE_IGNORE}"] == "1"


def test_an_autopilots_can_port_is_not_its_mavlink_port() -> None:
    result = apply(tty("1209", "5741", interface="02"))
    assert "SYMLINK" not in result
    assert result["ENV{ID_MM_DEVICE_IGNORE}"] == "1"


@pytest.mark.parametrize(
    "device",
    [
        tty("0403", "6001"),
        tty("1209", "0001"),
        {"SUBSYSTEM": "usb", "ENV{DEVTYPE}": "usb_device", "ATTR{idVendor}": "8087", "ATTR{idProduct}": "0026"},
        {"SUBSYSTEM": "video4linux", "ATTRS{idVendor}": "26ac"},
    ],
    ids=["serial adapter", "other pid.codes device", "other usb device", "not a serial port"],
)
def test_other_devices_are_left_alone(device: dict[str, str]) -> None:
    assert apply(device) == {}


def test_order_among_the_systems_rules() -> None:
    """After 60-serial.rules, which imports ID_USB_INTERFACE_NUM; before 73-seat-late.rules, which reads uaccess."""
    assert 60 < int(RULES.name.partition("-")[0]) < 73


def test_udevadm_verify() -> None:
    tool = shutil.which("udevadm")
    if tool is None:
        pytest.skip("needs udevadm")
    if "verify" not in subprocess.run([tool, "--help"], capture_output=True, text=True, check=False).stdout:
        pytest.skip("needs udevadm of systemd 254 or later")
    result = subprocess.run(
        [tool, "verify", "--resolve-names=never", str(RULES)], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stdout + result.stderr
