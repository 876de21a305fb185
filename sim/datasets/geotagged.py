"""A folder of pictures with positions in their EXIF data: dashboard cameras, phones, drones, Mapillary exports.

Specified in EXIF 2.32 (CIPA DC-008), sections 4.6.5 and 4.6.6. Pictures come in the order of their times
(DateTimeOriginal with its fraction of a second, taken as UTC); those of one second without fractions, in the order of
their names, a nanosecond apart; and so those of a folder in which nothing has a time, `fps` a second. The field of view
is known where all have one FocalLengthIn35mmFilm. What Mapillary's tools write into ImageDescription replaces time and
position.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from PIL import ExifTags, Image, UnidentifiedImageError

from edge.errors import FeedError
from sim.datasets import ReadOptions, Traverse
from sim.datasets.field_of_view import of_film
from sim.datasets.pictures import PictureFiles, know_heif, list_pictures
from sim.datasets.track import TrackFix, row_at

log = logging.getLogger(__name__)

GPS = ExifTags.GPS
NOWHERE = TrackFix(0, math.nan, math.nan)
UNTIMED = -1
LYING = range(5, 9)
"""Orientations of pictures that are stored on their side, and shown upright."""
NOMINAL_FPS = 1.0


def open_traverse(path: Path, options: ReadOptions) -> Traverse:
    """The pictures of one folder; without times, in the order of their names. FeedError where only some have one."""
    names = list_pictures(path)
    said = [read_exif(path / name) for name in names]
    fixes, fovs_deg = [fix for fix, _ in said], {fov_deg for _, fov_deg in said}
    untimed = [name for name, fix in zip(names, fixes, strict=True) if fix.stamp_ns == UNTIMED]
    if untimed and len(untimed) < len(names):
        raise FeedError(
            f"{path / untimed[0]}: no DateTimeOriginal in its EXIF data, as {len(names) - len(untimed)} others have; a"
            " CSV file beside the pictures may give their times and positions (file,time,lat,lon)"
        )
    if untimed:
        fps = options.fps or NOMINAL_FPS
        fixes = [replace(fix, stamp_ns=round(index * 1e9 / fps)) for index, fix in enumerate(fixes)]
        log.warning("%s: no times in it: pictures in the order of their names, %g a second (--fps)", path.name, fps)
    placed = sorted(zip(fixes, names, strict=True), key=lambda item: item[0].stamp_ns)
    without = sum(math.isnan(fix.lat_deg) for fix, _ in placed)
    if without:
        log.warning("%s: %d of %d pictures have no GPS position", path.name, without, len(placed))
    rows, last_ns = [], -1
    for fix, name in placed:
        last_ns = max(fix.stamp_ns, last_ns + 1)
        rows.append(row_at(name, replace(fix, stamp_ns=last_ns)))
    pictures = PictureFiles([path / name for _, name in placed])
    notes = "" if not untimed else "times are nominal: in the order of the names"
    fov_deg = fovs_deg.pop() if len(fovs_deg) == 1 else None
    return Traverse(path.name, f"pictures in {path.name}", tuple(rows), pictures, notes=notes, fov_deg=fov_deg)


def read_exif(file: Path) -> tuple[TrackFix, float | None]:
    """Time and position of one picture, NaN where there is none, and its field of view. FeedError names the picture."""
    know_heif(file)
    try:
        with Image.open(file) as image:
            exif = image.getexif()
            own = exif.get_ifd(ExifTags.IFD.Exif)
            stamp_ns = _stamp_ns(exif, own)
            width, height = image.size[::-1] if exif.get(ExifTags.Base.Orientation) in LYING else image.size
            fov_deg = of_film(str(file), float(own.get(ExifTags.Base.FocalLengthIn35mmFilm) or 0), width, height)
            position = _position(exif.get_ifd(ExifTags.IFD.GPSInfo))
            said = _mapillary(str(exif.get(ExifTags.Base.ImageDescription, "")))
    except (OSError, UnidentifiedImageError) as error:
        raise FeedError(f"{file}: cannot read this picture: {error}") from None
    except (ArithmeticError, IndexError, SyntaxError, TypeError, ValueError):
        raise FeedError(f"{file}: its EXIF data are damaged") from None
    return replace(position, **{"stamp_ns": stamp_ns, **said}), fov_deg


def _mapillary(description: str) -> dict[str, Any]:
    """What Mapillary's tools say there (mapillary_tools, `ImageDescription`), by the fields of a fix."""
    if not description.startswith("{") or "MAPLatitude" not in description:
        return {}
    tags = json.loads(description)
    moment = datetime.strptime(tags.get("MAPCaptureTime"), "%Y_%m_%d_%H_%M_%S_%f").replace(tzinfo=timezone.utc)
    stamp_ns = int(moment.replace(microsecond=0).timestamp()) * 1_000_000_000 + moment.microsecond * 1000
    return {"lat_deg": float(tags["MAPLatitude"]), "lon_deg": float(tags.get("MAPLongitude")), "stamp_ns": stamp_ns}


def _stamp_ns(image: Mapping[int, Any], exif: Mapping[int, Any]) -> int:
    """Nanoseconds since 1970, if the clock that wrote the tag was on UTC; UNTIMED where there is none."""
    text = exif.get(ExifTags.Base.DateTimeOriginal) or image.get(ExifTags.Base.DateTime)
    if not text:
        return UNTIMED
    seconds = datetime.strptime(str(text).strip(), "%Y:%m:%d %H:%M:%S").replace(tzinfo=timezone.utc).timestamp()
    fraction = str(exif.get(ExifTags.Base.SubsecTimeOriginal, "")).strip() or "0"
    return int(seconds) * 1_000_000_000 + round(float(f"0.{fraction}") * 1e9)


def _position(gps: Mapping[int, Any]) -> TrackFix:
    if GPS.GPSLatitude not in gps or GPS.GPSLongitude not in gps:
        return NOWHERE
    alt_m = float(gps.get(GPS.GPSAltitude, math.nan))
    return TrackFix(
        0,
        _degrees(gps[GPS.GPSLatitude], str(gps.get(GPS.GPSLatitudeRef, "N"))),
        _degrees(gps[GPS.GPSLongitude], str(gps.get(GPS.GPSLongitudeRef, "E"))),
        alt_m=-alt_m if gps.get(GPS.GPSAltitudeRef) in {1, b"\x01"} else alt_m,
        # The direction of travel, and not that of the camera (GPSImgDirection).
        heading_deg=float(gps.get(GPS.GPSTrack, math.nan)) if gps.get(GPS.GPSTrackRef, "T") == "T" else math.nan,
    )


def _degrees(parts: tuple[Any, Any, Any], hemisphere: str) -> float:
    degrees, minutes, seconds = (float(part) for part in parts)
    value = degrees + minutes / 60 + seconds / 3600
    return -value if hemisphere.upper().startswith(("S", "W")) else value
