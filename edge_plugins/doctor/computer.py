"""What `lookback doctor` finds on this computer: cameras, ports, permissions, clock and disk.

Run by root for the installed service's config, it takes the rights of the service's user: those count.
"""

from __future__ import annotations

import grp
import importlib.util
import os
import platform
import pwd
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from serial.tools.list_ports import comports

import edge
from edge.camera import open_camera
from edge.camera.picture_check import PictureFaultDetector
from edge.config import change_paths
from edge.errors import LookbackError
from edge.extras import install_command
from edge.files import HOME_FOLDERS
from edge_plugins.doctor.findings import DoctorContext, Found, bad, good, note
from edge_plugins.layers.stored import CLOCK_SET_UNIX_S
from edge_plugins.mapping import MappingConfig

LEAST_FREE_MB = 500
OAK_VENDOR = "03e7"
SHOW = ("systemctl", "show", "lookback.service", "--property=User,SupplementaryGroups,ExecStart")


def act_as_service(examined: DoctorContext) -> Iterator[Found]:
    """Where root examines the config of the installed service: take its user and groups until the program ends."""
    unit = _show_unit() if os.geteuid() == 0 and examined.path else {}
    starts = unit.get("ExecStart", "")
    # Another config, or another installation, belongs to whoever runs it.
    if f"path={sys.prefix}/bin/lookback " not in starts or f" {(examined.path or Path()).absolute()} " not in starts:
        return
    user, names = unit["User"], unit["SupplementaryGroups"].split()
    account = pwd.getpwnam(user)
    os.setgroups([account.pw_gid, *(grp.getgrnam(name).gr_gid for name in names)])
    os.setgid(account.pw_gid)
    os.setuid(account.pw_uid)
    examined.as_service = True
    yield note(f"checked with the rights of the service: user {user}, groups {' '.join(names)}")


def _show_unit() -> dict[str, str]:
    """Properties of the service's unit, with the administrator's changes; none where systemd does not run."""
    try:
        shown = subprocess.run(SHOW, capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return {}
    return dict(line.split("=", 1) for line in shown.splitlines())


def check_home_folders(examined: DoctorContext) -> list[Found]:
    """Paths that a person can read and the service cannot, since its unit closes all home folders."""
    found: list[Found] = []

    def check(where: str, path: str) -> str:
        if any(Path(os.path.realpath(path)).is_relative_to(folder) for folder in HOME_FOLDERS):
            words = f"{where}: {path}: the service sees no home folders (ProtectHome=)"
            found.append(bad(words, "put data in /var/lib/lookback and keys in /etc/lookback"))
        return path

    if examined.as_service:
        change_paths(examined.settings, check)
    return found


def check_computer(examined: DoctorContext) -> Iterator[Found]:
    """Versions and processor."""
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    yield good(f"lookback {edge.__version__}, Python {platform.python_version()}, {machine}")


def list_cameras(examined: DoctorContext) -> Iterator[Found]:
    """V4L2 devices that give images, by their stable names, and OAK cameras on USB."""
    nodes = sorted(examined.dev.glob("v4l/by-id/*-index0")) or sorted(examined.dev.glob("video*"))
    yield from map(_permissions, nodes)
    vendors = Path("/sys/bus/usb/devices").glob("*/idVendor")
    oaks = sum(file.read_text().strip() == OAK_VENDOR for file in vendors)
    if oaks:
        yield good(f"{oaks} OAK device(s) on USB")
        if importlib.util.find_spec("depthai") is None:
            yield note("DepthAI is not installed", install_command("oak"))
    if not nodes and not oaks:
        none, kind = "no V4L2 device and no OAK was found", examined.settings.camera.kind
        if kind not in ("v4l2", "oak"):
            yield good(f'{none}, and [camera] kind = "{kind}" needs none')
        else:
            yield note(none, "plug one in; a recorded feed and the simulator need none")


def list_ports(examined: DoctorContext) -> Iterator[Found]:
    """Serial ports, by their stable names."""
    ports = sorted({Path(port.device) for port in comports()} | set(examined.dev.glob("serial0")))
    stable = {name.resolve(): name for name in examined.dev.glob("serial/by-id/*")}
    yield from (_permissions(stable.get(port, port)) for port in ports)
    if not ports:
        yield note("none was found", "plug the autopilot in, or use a connection over UDP")


def _permissions(device: Path) -> Found:
    if not device.exists():
        return note(f"{device}: a link to a device that is gone", "unplug the device and plug it in again")
    if os.access(device, os.R_OK | os.W_OK):
        return good(f"{device}: present and accessible")
    try:
        group = grp.getgrgid(device.stat().st_gid).gr_name
    except (OSError, KeyError):
        group = "its group"
    remedy = f"sudo usermod -aG {group} {_user()}, then log in again, or restart the service"
    return bad(f"{device}: no permission", remedy)


def _user() -> str:
    try:
        return pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return str(os.geteuid())


def check_clock(examined: DoctorContext) -> Iterator[Found]:
    """Whether the wall clock was ever set."""
    now_s = time.time()
    now = time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime(now_s))
    if now_s < CLOCK_SET_UNIX_S:
        yield note(f"it says {now}", "set it (NTP, or a clock with a battery): the journal's times are wrong")
    else:
        yield good(now)


def check_camera(examined: DoctorContext) -> Iterator[Found]:
    """The configured camera, opened and read once."""
    config = examined.settings.camera
    where = f"[camera] {config.source}"
    if os.geteuid() == 0 and config.kind == "stream" and config.device.startswith("exec:"):
        as_whom = "run doctor for the service's own config, or as the user that Lookback runs as"
        yield note(f"{where}: not tried, since root would run its command", as_whom)
        return
    remedy = "name a device that is listed above, if there is one; stop any other program that uses it"
    if config.kind == "stream":
        remedy = "see docs/cameras.md for devices that are streams; a command must also work in a terminal"
    try:
        with closing(open_camera(config)) as camera:
            remedy = "try another cable or port, and stop any other program that uses it"
            frame = camera.read()
    except LookbackError as error:
        yield bad(str(error), remedy)
        return
    if frame is None:
        yield bad(f"{where}: the feed has no frames", "record a feed with at least one frame")
        return
    height, width = frame.image.shape[:2]
    yield good(f"{where}: {width} x {height} pixels")
    fault = PictureFaultDetector().check(frame.image, frame.stamp_ns, None)
    if fault is not None:
        yield note(f"{where}: {fault.what}", "clean the lens, give it light, or turn it away from the sun")
    for difference in camera.differences:
        yield note(difference, "set [camera] to what the device gives")


def check_disk(examined: DoctorContext) -> Iterator[Found]:
    """Where the journal is written."""
    journal = examined.settings.telemetry.journal
    if journal:
        yield _room(Path(journal).absolute().parent, LEAST_FREE_MB, "delete old feeds and journals")
    else:
        yield note('[telemetry] journal = "": no journal is written')


def check_mapping(examined: DoctorContext) -> Iterator[Found]:
    """Whether drives can become maps: the folder can be written, and has room."""
    config, mapping = examined.settings, examined.settings.of(MappingConfig)
    if not mapping.folder:
        return
    folder = Path(mapping.folder).absolute()
    yield _room(folder, mapping.min_free_mb, "make room, or lower [mapping] min_free_mb")
    if Path(config.map.path).resolve() != folder.resolve():
        words = "[mapping] folder is not [map] path: a finished map is searched only where the configuration names it"
        yield note(words, "name the same folder in both, unless you want this")


def _room(folder: Path, least_mb: float, remedy: str) -> Found:
    """Whether a folder, or that in which it will be made, can be written and has more than `least_mb` left."""
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    free_mb = shutil.disk_usage(existing).free / 1e6
    if not os.access(existing, os.W_OK):
        return bad(f"{existing}: this user may not write there", f"sudo chown {_user()} {existing}, or name another")
    if free_mb <= least_mb:
        return bad(f"{folder}: {free_mb:.0f} MB are free, and it takes more than {least_mb:.0f}", remedy)
    return good(f"{folder}: {free_mb / 1e3:.1f} GB are free")
