"""`lookback doctor`: what is there, what is missing, and what to do about each finding."""

from __future__ import annotations

import argparse
import contextlib
import grp
import importlib.util
import logging
import os
import platform
import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
from serial.tools import list_ports

import edge
from edge.camera import open_camera
from edge.commands.diagnostic import Diagnostic, bad, good, note
from edge.commands.doctor_autopilot import check_autopilot
from edge.config import CameraConfig, Config, load_config
from edge.descriptor.network import Head, Network
from edge.errors import FrameError, LookbackError
from edge.recognizer import PlaceRecognizer
from edge.reference_map.map_set import MapSet, open_map_set
from edge.reference_map.store import open_unverified

LEAST_FREE_MB = 500
BUILT_UNIX_S = 1_763_000_000  # November 2025: a clock before it was never set
OAK_VENDOR = "03e7"
LOOKS: dict[str, str] = {"good": "ok  ", "note": "note", "bad": "BAD "}


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `lookback doctor` to the command line."""
    parser = commands.add_parser(
        "doctor",
        help="check this computer, its devices and the autopilot, and say what to do",
        description="Checks cameras, ports, rights, model, map, disk, clock and the autopilot. Exit code 1 if something"
        " has to be put right before `lookback run` can do all of its work. Stop the service first: a camera and a port"
        " have one user at a time.",
    )
    parser.add_argument("config", type=Path, nargs="?", metavar="CONFIG", help="what the daemon is to be run with")
    parser.add_argument("--json", action="store_true", help="the findings as one JSON list")
    parser.add_argument("--seconds", type=float, default=8.0, metavar="S", help="to wait for the autopilot (default 8)")
    parser.set_defaults(run=_run)


def examine(path: Path | None, seconds: float, dev: Path = Path("/dev")) -> Iterator[Diagnostic]:
    """All findings, as they come; without a config only what this computer has. dev: where its devices are."""
    yield _computer()
    config, finding = _config(path)
    yield finding
    yield from _cameras(dev, config.camera if config else None)
    yield from _ports(dev)
    yield from _clock()
    yield from _page(config or Config())
    if config is None:
        return
    yield from _recogniser(config)
    yield from _camera(config.camera)
    yield from _disk(config)
    yield from check_autopilot(config.telemetry, seconds)


def _computer() -> Diagnostic:
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    return good("computer", f"lookback {edge.__version__}, Python {platform.python_version()}, {machine}")


def _config(path: Path | None) -> tuple[Config | None, Diagnostic]:
    """The config, None where there is none or a wrong one, and what is to be said of it."""
    if path is None:
        words = "none was named, so no camera, map or autopilot is tried"
        return None, note(
            "config", words, "lookback doctor CONFIG; `lookback check --default > lookback.toml` makes one"
        )
    try:
        return load_config(path), good("config", f"{path}: every key is good")
    except LookbackError as error:
        remedy = "`lookback check --default` prints every key with its range; what this one asks for is not tried"
        return None, bad("config", str(error), remedy if path.exists() else "name the file that the daemon is run with")


def _cameras(dev: Path, config: CameraConfig | None) -> Iterator[Diagnostic]:
    """V4L2 devices that give pictures, by their stable names, and OAK cameras on USB."""
    nodes = sorted(dev.glob("v4l/by-id/*-index0")) or sorted(dev.glob("video*"))
    for node in nodes:
        yield _rights("camera", node)
    oaks = [
        folder
        for folder in Path("/sys/bus/usb/devices").glob("*")
        if (folder / "idVendor").is_file() and (folder / "idVendor").read_text().strip() == OAK_VENDOR
    ]
    if oaks:
        yield good("camera", f"{len(oaks)} OAK device(s) on USB")
        if importlib.util.find_spec("depthai") is None:
            yield note("camera", "DepthAI is not installed", "pip install 'lookback[oak]'")
    if not nodes and not oaks:
        none = "no V4L2 device and no OAK was found"
        if config is not None and config.kind not in ("v4l2", "oak"):
            yield good("camera", f'{none}, and [camera] kind = "{config.kind}" needs none')
        else:
            yield note("camera", none, "plug one in; a recorded feed and the simulator need none")


def _ports(dev: Path) -> Iterator[Diagnostic]:
    ports = sorted({Path(port.device) for port in list_ports.comports()} | set(dev.glob("serial0")))
    stable = {name.resolve(): name for name in dev.glob("serial/by-id/*")}
    for port in ports:
        yield _rights("serial port", stable.get(port, port))
    if not ports:
        yield note("serial port", "none was found", "plug the autopilot in, or use a connection over UDP")


def _rights(what: str, device: Path) -> Diagnostic:
    if not device.exists():
        return note(what, f"{device}: leads nowhere", "unplug the device and plug it in again")
    if os.access(device, os.R_OK | os.W_OK):
        return good(what, f"{device}: there, and may be used")
    try:
        group = grp.getgrgid(device.stat().st_gid).gr_name
    except (OSError, KeyError):
        group = "its group"
    return bad(what, f"{device}: not permitted", f"sudo usermod -aG {group} $USER, then log in again")


def _clock() -> Iterator[Diagnostic]:
    now_s = time.time()
    if now_s < BUILT_UNIX_S:
        today = time.strftime("%Y-%m-%d", time.gmtime(now_s))
        yield note(
            "clock", f"it says {today}", "set it (NTP, or a clock with a battery): the journal's times are wrong"
        )
    else:
        yield good("clock", time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime(now_s)))


def _page(config: Config) -> Iterator[Diagnostic]:
    if config.page.port == 0:
        yield note("page", "the live page is off ([page] port = 0)")
    elif importlib.util.find_spec("starlette") is None or importlib.util.find_spec("uvicorn") is None:
        yield note("page", "no live page: its packages are not installed", "pip install 'lookback[page]'")
    else:
        yield good("page", f"http://{config.page.bind}:{config.page.port} while `lookback run` runs")


def _recogniser(config: Config) -> Iterator[Diagnostic]:
    """Model and map, each of them, and whether they fit each other."""
    try:
        network = Network.load(Path(config.descriptor.model) if config.descriptor.model else None)
        head = Head.load(network)
        took_ms = _describe_ms(network)
        yield good("model", f"{network.info.name}: whole; two regions take {took_ms:.0f} ms here")
    except LookbackError as error:
        yield bad("model", str(error), 'leave [descriptor] model = "" for the one in the package')
        return
    try:
        left_out: list[str] = []
        atlas = open_map_set(Path(config.map.path), lambda name, why: left_out.append(why))
        atlas.check_every_file()
        PlaceRecognizer(network, head, atlas, config)
        yield good("map", f"{config.map.path}: {atlas}, all checksums hold")
    except LookbackError as error:
        yield bad("map", str(error), f"record a drive, then: lookback map build FEED -o {config.map.path}")
        return
    for why in left_out:
        yield note("map", f"{why}; left out", "the others are used; build or copy this one again")
    yield from _places(atlas, config)


def _places(atlas: MapSet, config: Config) -> Iterator[Diagnostic]:
    """What the maps' headers and places say of how well they will serve."""
    places, length = atlas.numbering.places, config.sequence.length
    if places < 2 * length:
        yield bad(
            "map", f"{places} places are too few for sequences of {length}", "drive further, or shorten [sequence]"
        )
    used = [index for index in range(len(atlas.headers)) if index not in atlas.left_out]
    otherwise = [index for index in used if atlas.headers[index].sampling != config.sampling]
    if otherwise:
        words = f"{atlas.spell(otherwise)}: sampled otherwise than [sampling] asks for"
        yield note("map", words, "sample a query as its map was sampled")
    blank = [index for index in used if np.isnan(open_unverified(atlas.folders[index])[0].places["lat_deg"]).any()]
    if blank:
        words = f"{atlas.spell(blank)}: some places have no position"
        yield note("map", words, "they can be recognised, but no position is told of them")
    large = [index for index in used if atlas.headers[index].places > config.map.places_per_frame]
    if large and atlas.is_folder:
        words = f"{atlas.spell(large)}: so large that opening one between two frames takes long"
        yield note("map", words, f"lookback map split MAP -o FOLDER --places {config.map.places_per_frame // 2}")


def _describe_ms(network: Network) -> float:
    size = network.info.input_size
    images = np.zeros((2, size, size, 3), dtype=np.uint8)
    network.describe(images)
    started_s = time.perf_counter()
    network.describe(images)
    return (time.perf_counter() - started_s) * 1e3


def _camera(config: CameraConfig) -> Iterator[Diagnostic]:
    """The configured camera, opened and read once."""
    where = f"[camera] {config.kind} {config.device}"
    try:
        camera = open_camera(config)
    except LookbackError as error:
        yield bad("camera", str(error), "name a device that is listed above, if one is; stop whatever else uses it")
        return
    try:
        frame = camera.read()
    except (LookbackError, FrameError) as error:
        yield bad("camera", str(error), "try another cable or port, and stop whatever else uses it")
        return
    finally:
        camera.close()
    if frame is None:
        yield bad("camera", f"{where}: it has no frame", "record a feed with at least one frame")
        return
    height, width = frame.image.shape[:2]
    yield good("camera", f"{where}: {width} x {height} pixels")
    if frame.image.std() < 2:
        yield note("camera", f"{where}: the picture is all one shade", "take the cap off, and let light in")
    for difference in camera.differences:
        yield note("camera", difference, "put into [camera] what the device gives")


def _disk(config: Config) -> Iterator[Diagnostic]:
    if not config.telemetry.journal:
        yield note("disk", '[telemetry] journal = "": nothing is kept of what happened')
        return
    folder = next(one for one in Path(config.telemetry.journal).absolute().parents if one.exists())
    free_mb = shutil.disk_usage(folder).free / 1e6
    if not os.access(folder, os.W_OK):
        yield bad(
            "disk",
            f"{folder}: the journal cannot be written here",
            f"sudo chown $USER {folder}, or move [telemetry] journal",
        )
    elif free_mb < LEAST_FREE_MB:
        yield bad("disk", f"{folder}: {free_mb:.0f} MB left", "make room: old feeds and journals first")
    else:
        yield good("disk", f"{folder}: {free_mb / 1e3:.1f} GB left")


def _run(args: argparse.Namespace) -> int:
    findings = []
    with _unlogged():
        for finding in examine(args.config, args.seconds):
            findings.append(finding)
            if not args.json:
                _print(finding)
    if args.json:
        print(msgspec.json.format(msgspec.json.encode(findings), indent=1).decode())
    count = sum(finding.level == "bad" for finding in findings)
    if args.config and not args.json:
        what = "nothing" if not count else "1 thing, marked BAD," if count == 1 else f"{count} things, marked BAD,"
        print(f"\n{what} to put right before `lookback run` can do all of its work")
    return 1 if count else 0


def _print(finding: Diagnostic) -> None:
    print(f"{LOOKS[finding.level]}  {finding.what:<12}  {finding.words}")
    if finding.remedy:
        print(f"{'':20}-> {finding.remedy}")
    sys.stdout.flush()


@contextlib.contextmanager
def _unlogged() -> Iterator[None]:
    """What the parts say to the log while they try again is a finding here."""
    log = logging.getLogger("edge")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(level)
