"""The horizontal field of view that a recording says, as degrees of a camera without distortion: of its focal length.

KITTI     calib.txt: the projection matrix of the camera
EuRoC     sensor.yaml beside the pictures: intrinsics and resolution
ROS       sensor_msgs/CameraInfo of the camera's topic
EXIF      FocalLengthIn35mmFilm (CIPA DCG-001: of the same diagonal as 36 x 24 mm)
iPhone    com.apple.quicktime.camera.focal_length.35mm_equivalent of a video
GoPro     GPMF (github.com/gopro/gpmf-parser): VFOV, the lens, and ZFOV, the diagonal in degrees; HERO8 and later

A GoPro's lenses other than Linear bend straight lines, nearly as an equidistant fisheye does: distances from the middle
are proportional to angles. None was measured here.
"""

from __future__ import annotations

import logging
import math
import re
import struct
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Literal

from edge.config import PINHOLE, CameraConfig, Lens
from edge.errors import ConfigError
from sim.datasets.boxes import content_of
from sim.datasets.tables import read_text
from sim.output import checked_option

log = logging.getLogger(__name__)

FILM_DIAGONAL_MM = math.hypot(36, 24)
APPLE = "com.apple.quicktime.camera.focal_length.35mm_equivalent"
LINEAR, EQUIDISTANT = b"L", Lens(lens="fisheye", distortion=(0.0, 0.0, 0.0, 0.0))
EUROC = "intrinsics", "resolution", "distortion_coefficients"
MODELS: Mapping[str, Literal["pinhole", "fisheye"]] = {
    **dict.fromkeys(("radial-tangential", "radtan", "plumb_bob"), "pinhole"),
    "equidistant": "fisheye",
}


def of_focal_length(where: str, focal_px: float, width: float) -> float | None:
    """By a focal length in pixels of pictures so wide; None where none was said, and, with a warning, out of range.

    where: what says it.
    """
    if not (math.isfinite(focal_px) and focal_px > 0):
        return None
    fov_deg = math.degrees(2 * math.atan(width / 2 / focal_px))
    try:
        checked_option(CameraConfig(), "", fov_deg=fov_deg)
    except ConfigError:
        log.warning("%s: a field of view of %.0f degrees is not used: 30 to 120 are known here", where, fov_deg)
        return None
    return round(fov_deg, 2)


def of_film(where: str, focal_mm: float, width: int, height: int) -> float | None:
    """By a focal length that a picture of the same diagonal on 35 mm film would need. See `of_focal_length`."""
    return of_focal_length(where, focal_mm * math.hypot(width, height) / FILM_DIAGONAL_MM, width)


def of_kitti(file: Path, camera: str, width: int) -> float | None:
    """By the matrix P0 to P3 of image_0 to image_3. FeedError for a file that is none."""
    if not file.exists():
        return None
    found = re.search(rf"^P{re.escape(camera[-1:])}:\s*(\S+)", read_text(file, "it comes with the sequence"), re.M)
    return None if found is None else of_focal_length(str(file), _number(found[1]), width)


def of_euroc(pictures: Path) -> tuple[float | None, Lens]:
    """By the sensor.yaml in a folder of pictures, or beside it; and what its lens bends."""
    for file in (pictures / "sensor.yaml", pictures.parent / "sensor.yaml"):
        if file.is_file():
            text = read_text(file, "it describes the camera")
            found = dict(re.findall(r"^(\w+):\s*\[?([^\]#\n]*)", text, re.M))
            focal, size, bent = (found.get(key, "").split(",") for key in EUROC)
            lens = lens_of(str(file), found.get("distortion_model", "").strip(), map(_number, filter(str.strip, bent)))
            return of_focal_length(str(file), _number(focal[0]), _number(size[0])), lens
    return None, PINHOLE


def lens_of(where: str, model: str, distortion: Iterable[float]) -> Lens:
    """By the names that Kalibr, EuRoC and ROS have for OpenCV's models; a pinhole, with a warning, for another one."""
    factors = tuple(map(float, distortion))
    if not any(factors):
        return PINHOLE
    try:
        return Lens(lens=MODELS[model], distortion=factors)
    except (KeyError, ValueError):
        log.warning(
            "%s: a lens of the model %r with %d factors is not known here; not used", where, model, len(factors)
        )
        return PINHOLE


def of_video(file: Path, width: int, height: int) -> tuple[float | None, Lens]:
    """By the metadata of an iPhone or of a GoPro, and the lens; with a warning where that bends straight lines."""
    settings = content_of(file, b"moov")
    lens, diagonal = _klv(settings, b"VFOVc"), _klv(settings, b"ZFOVf")
    if len(diagonal) >= 4 and 0 < (diagonal_deg := struct.unpack(">f", diagonal[:4])[0]) < 180:
        half_rad, is_linear = math.radians(diagonal_deg / 2), lens[:1] == LINEAR
        focal_px = math.hypot(width, height) / 2 / (math.tan(half_rad) if is_linear else half_rad)
        if not is_linear:
            named = lens[:1].decode("ascii", "replace") or "?"
            words = "%s: its lens (%s) bends straight lines: taken as an equidistant fisheye; Linear is exact"
            log.warning(words, file, named)
        return of_focal_length(str(file), focal_px, width), PINHOLE if is_linear else EQUIDISTANT
    return of_film(str(file), _apple_mm(file) if APPLE.encode() in settings else math.nan, width, height), PINHOLE


def _apple_mm(file: Path) -> float:
    with suppress(ModuleNotFoundError):
        import av

        with suppress(av.FFmpegError), av.open(str(file)) as video:
            for said in (video.metadata, *(stream.metadata for stream in video.streams)):
                if APPLE in said:
                    return _number(said[APPLE])
    return math.nan


def _klv(content: bytes, begins: bytes) -> bytes:
    """The data of a GPMF element, by its key and type; empty where there is none."""
    at = content.find(begins)
    if at < 0 or len(content) < at + 8:
        return b""
    size, count = struct.unpack_from(">BH", content, at + 5)
    return content[at + 8 : at + 8 + size * count]


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
