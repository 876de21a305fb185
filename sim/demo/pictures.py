"""The README's pictures, small, from the run that the demo has just made: a plot, matched pairs, and the live page."""

from __future__ import annotations

import hashlib
import logging
import shutil
import subprocess
import tempfile
from pathlib import Path

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.feed import FeedImages, read_feed
from edge.reference_map.store import ReferenceMap
from sim.demo.review import Review
from sim.demo.story import picture as story_picture
from sim.trial.rules import Run

DPI = 80
PAIR_HEIGHT_PX = 150
SHOT_S = 25.0
log = logging.getLogger(__name__)

ROOT = Path(__file__).parents[2]
MADE_OF = "made_of.json"
"""Beside the pictures: for each the checksum of what draws it, when it was made."""
DRAWN_BY = {
    "take_me_home.png": ("sim/demo/story.py",),
    "pairs.jpg": ("sim/demo/pictures.py",),
    "page_again_dusk.png": ("edge/page/page.html", "edge/page/snapshot.py"),
}
"""The sources that a picture's look depends on. What it shows is of the day when it was made."""


def write_pictures(folder: Path, reference_map: ReferenceMap, reviews: list[Review], story: Run) -> None:
    """Write the story and matched pairs of all drives."""
    folder.mkdir(parents=True, exist_ok=True)
    story_picture(story).savefig(folder / "take_me_home.png", format="png", dpi=DPI, bbox_inches="tight")
    cv2.imwrite(str(folder / "pairs.jpg"), _pairs(reference_map, reviews), [cv2.IMWRITE_JPEG_QUALITY, 85])
    for name in ("take_me_home.png", "pairs.jpg"):
        note_sources(folder, name)


def checksum_of_sources(name: str) -> str:
    """Of the files that draw a picture, as they are now."""
    return hashlib.sha256(b"".join((ROOT / file).read_bytes() for file in DRAWN_BY[name])).hexdigest()[:16]


def note_sources(folder: Path, name: str) -> None:
    """Write beside a picture what has just drawn it."""
    file = folder / MADE_OF
    known = msgspec.json.decode(file.read_bytes(), type=dict[str, str]) if file.exists() else {}
    noted = dict(sorted({**known, name: checksum_of_sources(name)}.items()))
    file.write_bytes(msgspec.json.format(msgspec.json.encode(noted)) + b"\n")


def _pairs(reference_map: ReferenceMap, reviews: list[Review]) -> NDArray[np.uint8]:
    """A row for each drive: each query picture beside the place that it was matched to."""
    images = FeedImages(read_feed(reference_map.path.with_suffix("")))
    rows = []
    for review in reviews:
        row: list[NDArray[np.uint8]] = []
        for frame, picture in review.pictures.items():
            map_row = review.seen[frame].map_row
            if map_row is not None:
                row += [np.hstack([_small(picture), _small(images.read(map_row))]), _gap(PAIR_HEIGHT_PX, 8)]
        if row:
            rows.append(np.hstack(row[:-1]))
    width = max((row.shape[1] for row in rows), default=8)
    padded = [np.hstack([row, _gap(PAIR_HEIGHT_PX, width - row.shape[1])]) for row in rows]
    return np.vstack([part for row in padded for part in (row, _gap(8, width))][:-1] or [_gap(8, 8)])


def _small(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    width = round(image.shape[1] * PAIR_HEIGHT_PX / image.shape[0])
    return np.asarray(cv2.resize(image, (width, PAIR_HEIGHT_PX), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _gap(height: int, width: int) -> NDArray[np.uint8]:
    return np.full((height, width, 3), 255, np.uint8)


def photograph_page(url: str, path: Path, width: int, height: int) -> bool:
    """The live page as a browser shows it; False, and a line in the log, where there is no Chromium."""
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        log.warning("no picture of the live page: Chromium is not installed")
        return False
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as profile:
        command = [
            browser,
            *("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--disable-quic"),
            *("--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"),
            f"--user-data-dir={profile}",
            f"--window-size={width},{height}",
            # Virtual time for the page to load and draw; it stops while requests are pending.
            "--virtual-time-budget=4000",
            f"--screenshot={path}",
            url,
        ]
        try:
            subprocess.run(command, check=True, capture_output=True, timeout=SHOT_S)
        except (subprocess.TimeoutExpired, subprocess.CalledProcessError) as error:
            log.warning("no picture of the live page: %s", error)
            return False
    return path.exists()
