"""The README's pictures, small, from the run that the demo has just made: plots, matched pairs, and the live page."""

from __future__ import annotations

import logging
import shutil
import subprocess
import tempfile
from pathlib import Path

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from edge.feed import FeedImages, read_feed
from edge.reference_map.store import ReferenceMap
from sim.demo.report import cost_matrix, curves, route
from sim.demo.review import Review
from sim.demo.story import picture as story_picture
from sim.trial.rules import Run
from sim.vehicle.daemon_drive import DaemonDrive

DPI = 80
PAIR_HEIGHT_PX = 150
SHOT_S = 25.0
log = logging.getLogger(__name__)


def write_pictures(
    folder: Path, reference_map: ReferenceMap, lives: list[DaemonDrive], reviews: list[Review], story: Run
) -> list[Path]:
    """Write the story, plots of the last drive, and matched pairs of all drives; returns the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    plots = {"take_me_home": story_picture(story), "precision_recall": curves(lives, reviews)}
    plots["cost_matrix"] = cost_matrix(reference_map, reviews[-1])
    plots["route"] = route(reference_map, lives[-1], reviews[-1])
    written = [_save(plot, folder / f"{name}.png") for name, plot in plots.items()]
    written.append(folder / "pairs.jpg")
    cv2.imwrite(str(written[-1]), _pairs(reference_map, reviews), [cv2.IMWRITE_JPEG_QUALITY, 85])
    return written


def _save(plot: Figure, path: Path) -> Path:
    plot.savefig(path, format="png", dpi=DPI, bbox_inches="tight")
    return path


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
