"""Oxford RobotCar: one traverse as its downloads unpack.

    2014-12-09-13-21-02/stereo.timestamps       a line a picture: microseconds since 1970, number of the download
    2014-12-09-13-21-02/stereo/left/<us>.png    raw Bayer pictures, 1280 x 960; mono_rear/<us>.png, 1024 x 1024
    2014-12-09-13-21-02/gps/ins.csv, gps.csv    positions at 50 and 5 Hz, with a first line that names the columns

Specified in https://robotcar-dataset.robots.ox.ac.uk/documentation and its SDK (robotcar-dataset-sdk, python/image.py
has the Bayer patterns: gbrg for stereo, rggb for the mono cameras). W. Maddern et al., IJRR 2017. Downloads come in
parts, so pictures in the list of times that are not in the folder are skipped.

The SDK's lens model is not applied, as the paper does not mention it: pictures stay as the lens made them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.errors import FeedError
from edge.feed import View
from sim.datasets import ONE_CLOCK_S, ReadOptions, Traverse
from sim.datasets.pictures import PictureFiles
from sim.datasets.tables import TableRecord, read_numbers, read_records
from sim.datasets.track import Track, TrackFix

# NovAtel's words for a filter that has not found itself yet; all other solutions are kept.
UNALIGNED = frozenset({"INS_INACTIVE", "INS_ALIGNING"})
DOWNLOAD = "it is part of the data set's download of this traverse"


@dataclass(frozen=True)
class RobotCarCamera:
    """One of the car's cameras.

    bayer: OpenCV's conversion, named as in the SDK by the first two rows. crop_bottom: rows where the car itself is
    seen, a sixth of the picture; neither SDK nor paper gives a number.
    """

    times: str
    bayer: int
    crop_bottom: int
    view: View


STEREO = RobotCarCamera("stereo.timestamps", cv2.COLOR_BayerGBRG2BGR, 160, "front")
CAMERAS = {
    "stereo/left": STEREO,
    "stereo/centre": STEREO,
    "stereo/right": STEREO,
    "mono_rear": RobotCarCamera("mono_rear.timestamps", cv2.COLOR_BayerRGGB2BGR, 170, "rear"),
}


def open_traverse(path: Path, options: ReadOptions) -> Traverse:
    """One camera's pictures; `camera` is stereo/left by default, `positions` ins, gps, or a CSV file such as rtk.csv.

    FeedError names what is missing.
    """
    name = options.camera or "stereo/left"
    if name not in CAMERAS:
        raise FeedError(f"--camera: {name!r} is no camera of RobotCar; it is one of {', '.join(CAMERAS)}")
    camera = CAMERAS[name]
    stamps_us = _stamps_there(path, path / name, camera)
    files = [f"{name}/{stamp_us}.png" for stamp_us in stamps_us]
    crop_bottom = camera.crop_bottom if options.crop_bottom is None else options.crop_bottom

    def develop(raw: NDArray[np.uint8]) -> NDArray[np.uint8]:
        image = cv2.cvtColor(raw, camera.bayer) if raw.ndim == 2 else raw
        if crop_bottom >= image.shape[0]:
            raise FeedError(f"--crop-bottom: {crop_bottom} rows of {image.shape[0]} leave nothing")
        return np.asarray(image[: image.shape[0] - crop_bottom], dtype=np.uint8)

    rows = _track(path, options.positions or "ins").rows(str(path / name), files, [us * 1000 for us in stamps_us])
    pictures = PictureFiles([path / file for file in files], develop, cv2.IMREAD_UNCHANGED)
    about = f"{path.name}-{name.replace('/', '-')}", f"Oxford RobotCar {path.name} {name}"
    notes = f"demosaicked, lowest {crop_bottom} rows cut off"
    return Traverse(*about, rows, pictures, camera.view, notes, time_sigma_s=ONE_CLOCK_S)


def _stamps_there(path: Path, folder: Path, camera: RobotCarCamera) -> list[int]:
    """Times in microseconds of the pictures that are both listed and there."""
    listed = read_numbers(path / camera.times, 2, DOWNLOAD)[:, 0].astype(np.int64)
    if not folder.is_dir():
        raise FeedError(f"{folder}: no such folder; {DOWNLOAD}")
    there = {file.stem for file in folder.glob("*.png")}
    stamps_us = [int(stamp_us) for stamp_us in listed if str(stamp_us) in there]
    if not stamps_us:
        raise FeedError(f"{folder}: none of the {len(listed)} pictures that {camera.times} lists")
    return stamps_us


def _track(path: Path, positions: str) -> Track:
    file = path / "gps" / f"{positions}.csv" if positions in {"ins", "gps"} else Path(positions)
    hint = "it is in the data set's gps download; --positions takes ins, gps, or a CSV file"
    records = read_records(file, ("timestamp", "latitude", "longitude"), hint)
    return Track(str(file), _fixes(records))


def _fixes(records: list[TableRecord]) -> Iterator[TrackFix]:
    for record in records:
        if record.values.get("ins_status") in UNALIGNED:
            continue
        yaw_rad, north_mps = record.number_if_there("yaw"), record.number_if_there("velocity_north")
        yield TrackFix(
            stamp_ns=record.integer("timestamp") * 1000,
            lat_deg=record.number("latitude"),
            lon_deg=record.number("longitude"),
            alt_m=record.number_if_there("altitude"),
            heading_deg=math.degrees(yaw_rad) % 360.0,
            speed_mps=math.hypot(north_mps, record.number_if_there("velocity_east")),
        )
