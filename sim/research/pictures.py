"""README's pictures and the live page: `python -m sim.research.pictures docs/pictures`."""

from __future__ import annotations

import hashlib
import logging
import shutil
import subprocess
import sys
import time
import urllib.request
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.config import FIRST_NETWORK, DescriptorConfig, SamplingConfig
from edge.descriptor.model_file import ModelInfo
from edge.descriptor.network import Network
from edge.feed import read_feed
from edge_plugins.mapping.keypoint_rows import keypoints_key
from sim.maps.command import build_map
from sim.world.camera import open_renderer
from sim.world.recording import record_drive
from sim.world.scenario import Scenario

PAGE = "page_home_night.png"
PAGE_PX, PAGE_PORT, LINK_PORT = (1280, 760), 8699, 14597
UNDER_WAY_S = 40.0
"""After the daemon's start, at 10 m/s: well beyond the first 100 m, which are never recognized."""
OUT = Scenario(seed=7, length_m=400.0, view="rear")
HOME = Scenario(seed=7, length_m=400.0, direction="reverse", light="night", drive_seed=2, camera_ahead_m=6.0)
CONFIG = f"""\
[camera]
kind = "feed"
device = "home"
fov_deg = {OUT.fov_deg}
[descriptor]
model = "{FIRST_NETWORK}"
[map]
path = "map"
[gates]
risk = 1.0
[page]
port = {PAGE_PORT}
[rig]
ahead_reverse_same_m = 7.9
[telemetry]
connection = "udpin:127.0.0.1:{LINK_PORT}"
emit = "auto"
journal = "journal.jsonl"
"""
SHOT_S = 25.0
GRID = "grid.jpg"
AT_M, AHEAD_M = 120.0, 32.0
"""Where the rear camera of the grid's picture is, and how far behind it the front camera: they see the same trees."""
LEFT_BGR, RIGHT_BGR = (80, 160, 40), (190, 110, 30)
log = logging.getLogger(__name__)

ROOT = Path(__file__).parents[2]
MADE_OF = "made_of.json"
"""Beside the pictures: for each the checksum of what draws it, when it was made."""
DRAWN_BY = {
    PAGE: ("edge_plugins/page/page.html", "edge_plugins/page/snapshot.py"),
}
"""The sources that a picture's look depends on. What it shows is of the day when it was made."""


def checksum_of_sources(name: str) -> str:
    """Of the files that draw a picture, as they are now."""
    return hashlib.sha256(b"".join((ROOT / file).read_bytes() for file in DRAWN_BY[name])).hexdigest()[:16]


def note(folder: Path, name: str, checksum: str) -> None:
    """Write beside a picture the checksum of what it was made of."""
    file = folder / MADE_OF
    known = msgspec.json.decode(file.read_bytes(), type=dict[str, str]) if file.exists() else {}
    noted = dict(sorted({**known, name: checksum}.items()))
    file.write_bytes(msgspec.json.format(msgspec.json.encode(noted)) + b"\n")


def write_grid_picture(folder: Path) -> None:
    """What a rear and a front camera see of one place, with the columns that the grid compares, in their order."""
    info = Network.load(Path("grid")).info
    panels = []
    for view, route_m in (("rear", AT_M), ("front", AT_M - AHEAD_M)):
        scenario = msgspec.structs.replace(OUT, view=view)
        drive = scenario.drive()
        renderer = open_renderer(scenario, drive)
        time_s = drive.time_at_s(route_m)
        panels.append(_with_columns(renderer.render(drive.pose(time_s, 0.0), time_s), f"{view} camera", info))
        renderer.close()
    cv2.imwrite(str(folder / GRID), np.hstack([panels[0], np.full((len(panels[0]), 12, 3), 255, np.uint8), panels[1]]))


def _with_columns(picture: NDArray[np.uint8], name: str, info: ModelInfo) -> NDArray[np.uint8]:
    rows, columns = map(int, info.pool.split("x"))
    drawn = cv2.resize(picture, (480, 240), interpolation=cv2.INTER_AREA)
    height, width = 240 // rows, 480 // columns
    for region, color in zip(info.columns, (LEFT_BGR, RIGHT_BGR), strict=True):
        for order, column in enumerate(region):
            left = column * width
            for row in range(rows):
                cv2.rectangle(drawn, (left, row * height), (left + width - 1, (row + 1) * height - 1), color, 1)
            cv2.putText(drawn, str(order), (left + 22, 36), cv2.FONT_HERSHEY_SIMPLEX, 1.0, (255, 255, 255), 6)
            cv2.putText(drawn, str(order), (left + 22, 36), cv2.FONT_HERSHEY_SIMPLEX, 1.0, color, 2)
    cv2.putText(drawn, name, (6, 232), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (255, 255, 255), 2)
    return np.asarray(drawn, np.uint8)


def write_page_picture(folder: Path) -> None:
    """Drive the road of OUT home by night, and photograph the daemon's page on the way."""
    with TemporaryDirectory() as passing:
        at = Path(passing)
        for name, scenario, fps in (("out", OUT, None), ("home", HOME, 10.0)):
            record_drive(scenario, at / name, fps=fps)
        made_as, key = (
            (DescriptorConfig(model=FIRST_NETWORK), SamplingConfig()),
            partial(keypoints_key, fov_deg=OUT.fov_deg),
        )
        build_map([read_feed(at / "out")], at / "map", *made_as, keypoints=key)
        (at / "lookback.toml").write_text(CONFIG, encoding="utf-8")
        lookback = [sys.executable, "-m", "edge"]
        following = [
            "dev",
            "sim",
            "autopilot",
            "--udp",
            f"127.0.0.1:{LINK_PORT}",
            "--follow",
            "home",
            "--gps-lost-after",
            "9",
        ]
        following += ["--firmware", "ardupilot-fused"]
        with ExitStack() as running:
            for command in (following, ["run", "lookback.toml"]):
                process = subprocess.Popen([*lookback, *command], cwd=at, stdout=subprocess.DEVNULL)
                running.callback(process.wait)
                running.callback(process.terminate)
            time.sleep(UNDER_WAY_S)
            if photograph_page(f"http://127.0.0.1:{PAGE_PORT}/", folder / PAGE, *PAGE_PX):
                note(folder, PAGE, checksum_of_sources(PAGE))


def write_report_pictures(folder: Path) -> None:
    """What `lookback try` and `map coverage` write of the same road, as a browser shows it."""
    with TemporaryDirectory() as passing:
        at = Path(passing)
        for name, scenario in (("out", OUT), ("home", HOME)):
            record_drive(scenario, at / name)
        coverage = ["map", "coverage", "try/map", "--light", "night", "--report", "coverage.html"]
        for command in (["try", "out", "home"], coverage):
            subprocess.run([sys.executable, "-m", "edge", *command], cwd=at, check=True)
        for page in (at / "try/report.html", at / "coverage.html"):
            if photograph_page(page.as_uri(), shot := page.with_suffix(".png"), *PAGE_PX):
                shown = np.asarray(cv2.imread(str(shot)))
                cv2.imwrite(str(folder / f"{page.stem}.webp"), shown, [cv2.IMWRITE_WEBP_QUALITY, 80])


def photograph_page(url: str, path: Path, width: int, height: int) -> bool:
    """The live page as a browser shows it; False, and a line in the log, without Chromium or without an answer."""
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        log.warning("no picture of the live page: Chromium is not installed")
        return False
    try:
        urllib.request.urlopen(url, timeout=SHOT_S).close()
    except OSError as error:  # Chromium would photograph a page of its own that says so
        log.warning("no picture of the live page: %s does not answer: %s", url, error)
        return False
    path.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as profile:
        shot = Path(profile) / path.name  # where Chromium writes none, an older picture must not pass for it
        command = [
            browser,
            *("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--disable-quic"),
            *("--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"),
            f"--user-data-dir={profile}",
            f"--window-size={width},{height}",
            # Virtual time for the page to load and draw; it stops while requests are pending.
            "--virtual-time-budget=4000",
            f"--screenshot={shot}",
            url,
        ]
        try:
            subprocess.run(command, check=True, capture_output=True, timeout=SHOT_S)
        except (subprocess.TimeoutExpired, subprocess.CalledProcessError) as error:
            log.warning("no picture of the live page: %s", error)
            return False
        if not shot.exists():
            log.warning("no picture of the live page: %s does not answer", url)
            return False
        shutil.move(shot, path)
    return True


if __name__ == "__main__":
    pictures = Path(sys.argv[1])
    pictures.mkdir(parents=True, exist_ok=True)
    write_grid_picture(pictures)
    write_page_picture(pictures)
    write_report_pictures(pictures)
