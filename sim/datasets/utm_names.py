"""Pictures whose names say where they are, as VPR-datasets-downloader writes them.

    @utm_east@utm_north@zone_number@zone_letter@lat@lon@pano_id@tile@heading@pitch@roll@height@time@note@.jpg

Specified in the README of https://github.com/gmberton/VPR-datasets-downloader (G. Berton et al., CVPR 2022). All but
the first two may be empty. Degrees are used where there are any, else the meters, which also go to `local_x_m` and
`local_y_m` (in Nordland they are made up: 2.4 a frame). Pictures come in the order of time, then of pano_id; their
times are nominal, as the format's are of whole seconds at best and most often empty.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from edge.errors import FeedError
from edge.feed import FeedRow
from edge.geodesy import PositionSource
from sim.datasets import ReadOptions, Traverse
from sim.datasets.pictures import PictureFiles, list_pictures, natural_key
from sim.datasets.track import from_local

NOMINAL_FPS = 1.0
FIELDS = ("", "x", "y", "zone", "letter", "lat", "lon", "pano", "tile", "heading", "pitch", "roll", "height", "time")


def open_traverse(path: Path, options: ReadOptions) -> Traverse:
    """The pictures of one folder, such as images/test/queries. FeedError names the first that has no place."""
    said = {name: dict(zip(FIELDS, name.split("@"), strict=False)) for name in list_pictures(path)}
    names = sorted(said, key=lambda name: (said[name].get("time", ""), natural_key(said[name].get("pano", ""))))
    fps = options.fps or NOMINAL_FPS
    return Traverse(
        name=path.name,
        source=str(Path(*path.parts[-4:])),
        rows=tuple(_row(path / name, said[name], round(index * 1e9 / fps)) for index, name in enumerate(names)),
        pictures=PictureFiles([path / name for name in names]),
        notes="times are nominal; local_x_m and local_y_m are the UTM meters of the names",
    )


def _row(file: Path, said: Mapping[str, str], stamp_ns: int) -> FeedRow:
    """What the name of a picture says, by FIELDS. FeedError names the picture and the field."""

    def number(field: str) -> float | None:
        text = said.get(field) or "nan"
        try:
            return None if math.isnan(float(text)) else float(text)
        except ValueError:
            raise FeedError(f"{file}: {field} in this name is {text!r}, which is not a number") from None

    x_m, y_m, lat_deg, lon_deg, heading_deg = map(number, ("x", "y", "lat", "lon", "heading"))
    if said[""] or x_m is None or y_m is None:
        raise FeedError(f"{file}: this name does not begin with @utm_east@utm_north@")
    source: PositionSource = "unknown"
    if lat_deg is None or lon_deg is None:
        zone = said.get("zone", "") + said.get("letter", "")
        (lat_deg, lon_deg), source = from_local(x_m, y_m, zone), "unknown" if zone else "local"
    extra = {"local_x_m": f"{x_m:.2f}", "local_y_m": f"{y_m:.2f}"}
    at = {"lat_deg": lat_deg, "lon_deg": lon_deg, "heading_deg": heading_deg}
    return FeedRow(file.name, stamp_ns, **at, position_source=source, extra=extra)
