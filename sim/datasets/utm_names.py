"""Pictures whose names say where they are, as VPR-datasets-downloader writes them.

    @utm_east@utm_north@zone_number@zone_letter@lat@lon@pano_id@tile@heading@pitch@roll@height@time@note@.jpg

Specified in the README of https://github.com/gmberton/VPR-datasets-downloader (G. Berton et al., CVPR 2022). All but
the first two may be empty. The meters go to `local_x_m` and `local_y_m`, the degrees where there are any (in Nordland
there are none, and its meters are made up: 2.4 a frame). Pictures come in the order of time, then of pano_id; their
times are nominal, as the format's are of whole seconds at best and most often empty.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from edge.errors import FeedError
from edge.feed import FeedRow
from sim.datasets import ReadOptions, Traverse
from sim.datasets.pictures import PictureFiles, list_pictures, natural_key

NOMINAL_FPS = 1.0
FIELDS = ("", "x", "y", "zone", "letter", "lat", "lon", "pano", "tile", "heading", "pitch", "roll", "height", "time")


@dataclass(frozen=True)
class NamedPlace:
    """What one name says; NaN is not known."""

    file: str
    x_m: float
    y_m: float
    lat_deg: float
    lon_deg: float
    heading_deg: float
    pano: str
    time: str


def parse_name(folder: Path, name: str) -> NamedPlace:
    """Take a name apart; FeedError names the picture and the field."""
    values = dict(zip(FIELDS, name.split("@"), strict=False))

    def number(field: str) -> float:
        text = values.get(field, "")
        try:
            return float(text) if text else math.nan
        except ValueError:
            raise FeedError(f"{folder / name}: {field} in this name is {text!r}, which is not a number") from None

    place = NamedPlace(
        name,
        number("x"),
        number("y"),
        number("lat"),
        number("lon"),
        number("heading"),
        values.get("pano", ""),
        values.get("time", ""),
    )
    if not name.startswith("@") or math.isnan(place.x_m + place.y_m):
        raise FeedError(f"{folder / name}: this name does not begin with @utm_east@utm_north@")
    return place


def open_traverse(path: Path, options: ReadOptions) -> Traverse:
    """The pictures of one folder, such as images/test/queries. FeedError names the first that has no place."""
    places = [parse_name(path, name) for name in list_pictures(path)]
    places.sort(key=lambda place: (place.time, natural_key(place.pano)))
    fps = options.fps or NOMINAL_FPS
    return Traverse(
        name=path.name,
        view=options.view or "front",
        source=str(Path(*path.parts[-4:])),
        rows=tuple(_row(place, round(index * 1e9 / fps)) for index, place in enumerate(places)),
        pictures=PictureFiles([path / place.file for place in places]),
        notes="times are nominal; local_x_m and local_y_m are the UTM meters of the names",
    )


def _row(place: NamedPlace, stamp_ns: int) -> FeedRow:
    has_degrees = not math.isnan(place.lat_deg + place.lon_deg)
    return FeedRow(
        place.file,
        stamp_ns,
        lat_deg=place.lat_deg if has_degrees else None,
        lon_deg=place.lon_deg if has_degrees else None,
        heading_deg=None if math.isnan(place.heading_deg) else place.heading_deg,
        extra={"local_x_m": f"{place.x_m:.2f}", "local_y_m": f"{place.y_m:.2f}"},
    )
