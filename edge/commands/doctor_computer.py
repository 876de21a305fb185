"""What `lookback doctor` finds on this computer: cameras, ports, permissions, clock, page and disk."""

from __future__ import annotations

import grp
import importlib.util
import os
import platform
import pwd
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

from serial.tools import list_ports

import edge
from edge.camera import open_camera
from edge.camera.picture_check import BLANK_DEVIATION
from edge.commands.diagnostic import Diagnostic, bad, good, note
from edge.config import CameraConfig, Config
from edge.errors import LookbackError
from edge.extras import install_command
from edge.mapping.quota import CLOCK_SET_UNIX_S

LEAST_FREE_MB = 500
OAK_VENDOR = "03e7"


def check_computer() -> Diagnostic:
    """Versions and processor."""
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    return good("computer", f"lookback {edge.__version__}, Python {platform.python_version()}, {machine}")


def check_cameras(dev: Path, config: CameraConfig | None) -> Iterator[Diagnostic]:
    """V4L2 devices that give images, by their stable names, and OAK cameras on USB."""
    nodes = sorted(dev.glob("v4l/by-id/*-index0")) or sorted(dev.glob("video*"))
    for node in nodes:
        yield _permissions("camera", node)
    oaks = [
        folder
        for folder in Path("/sys/bus/usb/devices").glob("*")
        if (folder / "idVendor").is_file() and (folder / "idVendor").read_text().strip() == OAK_VENDOR
    ]
    if oaks:
        yield good("camera", f"{len(oaks)} OAK device(s) on USB")
        if importlib.util.find_spec("depthai") is None:
            yield note("camera", "DepthAI is not installed", install_command("oak"))
    if not nodes and not oaks:
        none = "no V4L2 device and no OAK was found"
        if config is not None and config.kind not in ("v4l2", "oak"):
            yield good("camera", f'{none}, and [camera] kind = "{config.kind}" needs none')
        else:
            yield note("camera", none, "plug one in; a recorded feed and the simulator need none")


def check_ports(dev: Path) -> Iterator[Diagnostic]:
    """Serial ports, by their stable names."""
    ports = sorted({Path(port.device) for port in list_ports.comports()} | set(dev.glob("serial0")))
    stable = {name.resolve(): name for name in dev.glob("serial/by-id/*")}
    for port in ports:
        yield _permissions("serial port", stable.get(port, port))
    if not ports:
        yield note("serial port", "none was found", "plug the autopilot in, or use a connection over UDP")


def _permissions(what: str, device: Path) -> Diagnostic:
    if not device.exists():
        return note(what, f"{device}: a link to a device that is gone", "unplug the device and plug it in again")
    if os.access(device, os.R_OK | os.W_OK):
        return good(what, f"{device}: present and accessible")
    try:
        group = grp.getgrgid(device.stat().st_gid).gr_name
    except (OSError, KeyError):
        group = "its group"
    remedy = f"sudo usermod -aG {group} {_user()}, then log in again, or restart the service"
    return bad(what, f"{device}: no permission", remedy)


def _user() -> str:
    try:
        return pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return str(os.geteuid())


def check_clock() -> Iterator[Diagnostic]:
    """Whether the wall clock was ever set."""
    now_s = time.time()
    if now_s < CLOCK_SET_UNIX_S:
        today = time.strftime("%Y-%m-%d", time.gmtime(now_s))
        yield note(
            "clock", f"it says {today}", "set it (NTP, or a clock with a battery): the journal's times are wrong"
        )
    else:
        yield good("clock", time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime(now_s)))


def check_page(config: Config) -> Iterator[Diagnostic]:
    """Whether there will be a live page."""
    if config.page.port == 0:
        yield note("page", "the live page is off ([page] port = 0)")
    elif importlib.util.find_spec("starlette") is None or importlib.util.find_spec("uvicorn") is None:
        yield note("page", "no live page: its packages are not installed", install_command("page"))
    else:
        yield good("page", f"http://{config.page.bind}:{config.page.port} while `lookback run` runs")


def check_camera(config: CameraConfig) -> Iterator[Diagnostic]:
    """The configured camera, opened and read once."""
    where = f"[camera] {config.source}"
    try:
        camera = open_camera(config)
    except LookbackError as error:
        remedy = "name a device that is listed above, if there is one; stop any other program that uses it"
        if config.kind == "stream":
            remedy = "see docs/cameras.md for devices that are streams; a command must also work in a terminal"
        yield bad("camera", str(error), remedy)
        return
    try:
        frame = camera.read()
    except LookbackError as error:
        yield bad("camera", str(error), "try another cable or port, and stop any other program that uses it")
        return
    finally:
        camera.close()
    if frame is None:
        yield bad("camera", f"{where}: the feed has no frames", "record a feed with at least one frame")
        return
    height, width = frame.image.shape[:2]
    yield good("camera", f"{where}: {width} x {height} pixels")
    if frame.image.std() < BLANK_DEVIATION:
        yield note("camera", f"{where}: the image is all one shade", "take the lens cap off, or give it light")
    for difference in camera.differences:
        yield note("camera", difference, "set [camera] to what the device gives")


def check_disk(config: Config) -> Iterator[Diagnostic]:
    """Where the journal is written."""
    if not config.telemetry.journal:
        yield note("disk", '[telemetry] journal = "": no journal is written')
        return
    folder = next(one for one in Path(config.telemetry.journal).absolute().parents if one.exists())
    free_mb = shutil.disk_usage(folder).free / 1e6
    if not os.access(folder, os.W_OK):
        remedy = f"sudo chown {_user()} {folder}, or set [telemetry] journal to another folder"
        yield bad("disk", f"{folder}: the journal cannot be written here", remedy)
    elif free_mb < LEAST_FREE_MB:
        yield bad("disk", f"{folder}: {free_mb:.0f} MB left", "delete old feeds and journals")
    else:
        yield good("disk", f"{folder}: {free_mb / 1e3:.1f} GB left")
