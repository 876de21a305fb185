"""README's pictures and the live page: `python -m tests.docs.pictures` makes them anew."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import time
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
from tests.chromium import browser
from tests.common import ROOT

PICTURES = ROOT / "docs/pictures"
PAGE, GRID = "page_home_night.png", "grid.jpg"
PAGE_PX, PAGE_PORT, LINK_PORT = (1280, 760), 8699, 14597
UNDER_WAY_S, DRAWN_S = 40.0, 4.0
"""After the daemon's start, at 10 m/s: well beyond the first 100 m, which are never recognized; and for the page."""
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
AUTOPILOT = f"--udp 127.0.0.1:{LINK_PORT} --follow home --gps-lost-after 9 --firmware ardupilot-fused"
AT_M, AHEAD_M = 120.0, 32.0
"""Where the rear camera of the grid's picture is, and how far behind it the front camera: they see the same trees."""
LEFT_BGR, RIGHT_BGR = (80, 160, 40), (190, 110, 30)
MADE_OF = "made_of.txt"
"""Beside the pictures: the checksum of what drew that of the page, when it was made."""
DRAWN_BY = ("edge_plugins/page/page.html", "edge_plugins/page/snapshot.py")
"""The sources that its look depends on. What it shows is of the day when it was made."""


def checksum_of_sources() -> str:
    """Of the files that draw the page, as they are now."""
    return hashlib.sha256(b"".join((ROOT / file).read_bytes() for file in DRAWN_BY)).hexdigest()[:16] + "\n"


def write_grid_picture() -> None:
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
    gap = np.full((len(panels[0]), 12, 3), 255, np.uint8)
    cv2.imwrite(str(PICTURES / GRID), np.hstack([panels[0], gap, panels[1]]))


def _with_columns(picture: NDArray[np.uint8], name: str, info: ModelInfo) -> NDArray[np.uint8]:
    rows, columns = map(int, info.pool.split("x"))
    drawn = cv2.resize(picture, (480, 240), interpolation=cv2.INTER_AREA)
    height, width = 240 // rows, 480 // columns
    words = [(name, (6, 232), 0.7, (255, 255, 255))]
    for region, color in zip(info.columns, (LEFT_BGR, RIGHT_BGR), strict=True):
        for order, column in enumerate(region):
            left = column * width
            for row in range(rows):
                cv2.rectangle(drawn, (left, row * height), (left + width - 1, (row + 1) * height - 1), color, 1)
            cv2.putText(drawn, str(order), (left + 22, 36), cv2.FONT_HERSHEY_SIMPLEX, 1.0, (255, 255, 255), 6)
            words.append((str(order), (left + 22, 36), 1.0, color))
    for text, at, size, color in words:
        cv2.putText(drawn, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, color, 2)
    return np.asarray(drawn, np.uint8)


def write_page_picture() -> None:
    """Drive the road of OUT home by night, and photograph the daemon's page on the way."""
    with TemporaryDirectory() as passing:
        at = Path(passing)
        for name, scenario, fps in (("out", OUT, None), ("home", HOME, 10.0)):
            record_drive(scenario, at / name, fps=fps)
        key = partial(keypoints_key, fov_deg=OUT.fov_deg)
        made_as = DescriptorConfig(model=FIRST_NETWORK), SamplingConfig()
        build_map([read_feed(at / "out")], at / "map", *made_as, keypoints=key)
        (at / "lookback.toml").write_text(CONFIG, encoding="utf-8")
        with ExitStack() as running:
            driver = running.enter_context(browser(*PAGE_PX))
            for words in (f"dev sim autopilot {AUTOPILOT}", "run lookback.toml"):
                command = [sys.executable, "-m", "edge", *words.split()]
                process = subprocess.Popen(command, cwd=at, stdout=subprocess.DEVNULL)
                running.callback(process.wait)
                running.callback(process.terminate)
            time.sleep(UNDER_WAY_S)
            driver.get(f"http://127.0.0.1:{PAGE_PORT}/")
            time.sleep(DRAWN_S)
            driver.save_screenshot(str(PICTURES / PAGE))
    (PICTURES / MADE_OF).write_text(checksum_of_sources(), encoding="utf-8")


def write_report_pictures() -> None:
    """What `lookback try` and `map coverage` write of the same road, as a browser shows it."""
    with TemporaryDirectory() as passing:
        at = Path(passing)
        for name, scenario in (("out", OUT), ("home", HOME)):
            record_drive(scenario, at / name)
        coverage = ["map", "coverage", "try/map", "--light", "night", "--report", "coverage.html"]
        for command in (["try", "out", "home"], coverage):
            subprocess.run([sys.executable, "-m", "edge", *command], cwd=at, check=True)
        with browser(*PAGE_PX) as driver:
            for page in (at / "try/report.html", at / "coverage.html"):
                driver.get(page.as_uri())
                driver.save_screenshot(str(shot := page.with_suffix(".png")))
                shown = np.asarray(cv2.imread(str(shot)))
                cv2.imwrite(str(PICTURES / f"{page.stem}.webp"), shown, [cv2.IMWRITE_WEBP_QUALITY, 80])


if __name__ == "__main__":
    write_grid_picture()
    write_page_picture()
    write_report_pictures()
