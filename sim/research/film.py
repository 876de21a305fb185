"""README's moving picture: the camera at night, the place that it recognizes, and from above both vehicles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from edge.descriptor.network import Network
from sim.demo.story import laid, picture_at, recognized
from sim.trial.records import Run
from sim.trial.run import map_scenario
from sim.trial.views import RoadLibrary
from sim.trial.way import Way

FRAMES, FRAME_MS, QUALITY = 70, 200, 55
"""14 s for the way home, and less than 2 MB."""
PANEL_PX, GAP_PX, TEXT_PX = (320, 240), 6, 26
WINDOW_M, ROAD_M = 56.0, 7.0
BELIEVED_S = 3.0
"""A place that was recognized longer ago is not shown."""


def write_film(file: Path, story: Run, drive_folder: Path) -> None:
    """Write the way home, of a story whose drive left its journal and views in a folder."""
    first, *others = (Image.fromarray(frame[..., ::-1]) for frame in _frames(story, drive_folder))
    first.save(file, save_all=True, append_images=others, duration=FRAME_MS, loop=0, quality=QUALITY, method=6)


def _frames(story: Run, drive_folder: Path) -> Iterator[NDArray[np.uint8]]:
    draft = laid()
    ours, alone = story.track, story.alone
    lost = np.flatnonzero(~ours.gps)
    believed = recognized(story, drive_folder)
    network = Network.load()
    with closing(RoadLibrary(network, drive_folder / "views")) as library:
        night, day = library[draft.home], library[map_scenario(draft.home)]
        for row in lost[np.linspace(0, len(lost) - 1, FRAMES).astype(int)]:
            at_m, left_m = float(ours.along_m[row]), float(ours.left_m[row])
            alone_left_m = float(np.interp(at_m, alone.along_m, alone.left_m))
            here = night.picture(float(draft.way.route_m[int(at_m)]), left_m)
            place = [one for one in believed if 0 <= ours.time_s[row] - one[0] <= BELIEVED_S]
            found = picture_at(day, place[-1][1]) if place else np.full_like(here, 60)
            above = from_above(draft.way, at_m, left_m, alone_left_m)
            lines = (
                "the camera at night",
                "the place that it recognizes, by day" if place else "no place recognized yet",
                "green: with Lookback, red: without",
                f"{at_m - ours.along_m[lost[0]]:.0f} m driven without GPS. Beside the lane: {abs(left_m):.1f} m with"
                f" Lookback, {abs(alone_left_m):.1f} m without",
            )
            yield _composed((here, found, above), lines)


def from_above(way: Way, at_m: float, left_m: float, alone_left_m: float) -> NDArray[np.uint8]:
    """The road around the vehicle, north up, and both vehicles as far along it; to the scale of WINDOW_M."""
    width, height = PANEL_PX
    center = np.array(way.at(at_m)[:2])
    scale = width / WINDOW_M

    def pixels(points_m: NDArray[np.float64]) -> NDArray[np.int32]:
        shown = (points_m - center) * scale * (1.0, -1.0) + (width / 2, height / 2)
        return np.asarray(np.round(shown * 16), np.int32)

    image = np.full((height, width, 3), (118, 150, 122), np.uint8)
    near = np.arange(max(0.0, at_m - WINDOW_M), min(way.length_m - 1, at_m + WINDOW_M), 1.0)
    middle = pixels(np.array([way.at(one, -ROAD_M / 4)[:2] for one in near]))
    cv2.polylines(image, [middle], False, (96, 96, 96), round(ROAD_M * scale), cv2.LINE_AA, 4)
    cv2.polylines(image, [middle], False, (220, 220, 220), 1, cv2.LINE_AA, 4)
    for left, color in ((alone_left_m, (43, 57, 192)), (left_m, (79, 143, 42))):
        east_m, north_m, heading_rad = way.at(at_m, left)
        ahead = np.array([np.sin(heading_rad), np.cos(heading_rad)])
        aside = np.array([ahead[1], -ahead[0]])
        corners = [ahead * 3.2, ahead * 2.0 + aside * 1.4, -ahead * 3.0 + aside * 1.4]
        corners += [-ahead * 3.0 - aside * 1.4, ahead * 2.0 - aside * 1.4]
        outline = pixels(np.array([east_m, north_m]) + np.array(corners))
        cv2.fillPoly(image, [outline], color, cv2.LINE_AA, 4)
        cv2.polylines(image, [outline], True, (255, 255, 255), 1, cv2.LINE_AA, 4)
    return image


def _composed(panels: Sequence[NDArray[np.uint8]], lines: Sequence[str]) -> NDArray[np.uint8]:
    """Three panels with a line above each, and one below all."""
    width, height = PANEL_PX
    rows = [cv2.resize(panel, PANEL_PX, interpolation=cv2.INTER_AREA) for panel in panels]
    page = Image.new("RGB", (3 * width + 2 * GAP_PX, height + 2 * TEXT_PX), "white")
    draw = ImageDraw.Draw(page)
    font = ImageFont.truetype(Path(mpl.get_data_path()) / "fonts/ttf/DejaVuSans.ttf", TEXT_PX * 5 // 9)
    for number, (panel, line) in enumerate(zip(rows, lines, strict=False)):
        left = number * (width + GAP_PX)
        page.paste(Image.fromarray(np.asarray(panel, np.uint8)[..., ::-1]), (left, TEXT_PX))
        draw.text((left, TEXT_PX // 5), line, "black", font)
    draw.text((0, TEXT_PX + height + TEXT_PX // 5), lines[-1], "black", font)
    return np.asarray(page)[..., ::-1]
