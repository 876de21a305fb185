"""The layers of a road as a picture: each drive a strip along it, in the light of its pictures, and what is gone."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.errors import ConfigError, FrameError, MapError, SetupError
from edge.extras import install_command
from edge.feed import decode_picture
from edge.geodesy import east_north, first_known
from edge.reference_map import ReferenceMap, open_map_set
from edge_plugins.layers.road import REACH_M
from sim.maps.learning import Lesson

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STEP_M = 25.0
"""Of the road, one light each: as long as a stretch of `stretches`."""
INCHES_WIDE, ROAD_INCHES, DRIVE_INCHES, REST_INCHES = 9.0, 2.0, 0.34, 1.1
GONE = "#D55E00"  # of Okabe and Ito, as on the coverage sheet
Floats = NDArray[np.float64]


def write_layers(path: Path, folder: Path, lesson: Lesson) -> None:
    """Write the picture of what was learned of a folder. SetupError without matplotlib; MapError without positions."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise SetupError(f"--picture needs matplotlib: {install_command('sim')}") from None
    maps = open_map_set(folder, as_recorded=True).maps
    drives = [maps[[one.path for one in maps].index(drive.path)] for drive in lesson.drives]
    known = [first_known(one.places["lat_deg"], one.places["lon_deg"]) for one in drives]
    origin = next((one for one in known if one is not None), None)
    if origin is None:
        raise MapError(f"{folder}: none of its places has a position, so there is no road to draw")
    ground = [east_north(one.places["lat_deg"], one.places["lon_deg"], origin) for one in drives]
    road_m = max(ground, key=_length_m)
    road_m = road_m[np.isfinite(road_m[:, 0])]
    tall = ROAD_INCHES + DRIVE_INCHES * len(drives) + REST_INCHES
    figure = Figure(figsize=(INCHES_WIDE, tall))
    strips = figure.add_axes((0.2, 0.55 / tall, 0.44, DRIVE_INCHES * len(drives) / tall))
    above = figure.add_axes((0.05, 1 - (ROAD_INCHES + 0.1) / tall, 0.9, ROAD_INCHES / tall))
    stale = [lesson.learned.stale.get(one.header.header_sha256, []) for one in drives]
    _draw_road(above, road_m, [at[a:b] for at, pieces in zip(ground, stale, strict=True) for a, b in pieces])
    _draw_strips(strips, lesson, drives, [_along_m(at, road_m) for at in ground], stale)
    try:
        figure.savefig(path, dpi=110)
    except (OSError, ValueError) as error:
        raise ConfigError(f"--picture {path}: cannot write it: {error}") from None


def _length_m(at_m: Floats) -> float:
    return float(np.nansum(np.hypot(*np.diff(at_m, axis=0).T)))


def _along_m(at_m: Floats, road_m: Floats) -> Floats:
    """Meters (N,) along the road of each place, NaN for one that is not near it."""
    driven_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(road_m, axis=0).T))])
    along_m = np.full(len(at_m), np.nan)
    for row in np.flatnonzero(np.isfinite(at_m[:, 0])):
        away_m = np.hypot(*(road_m - at_m[row]).T)
        nearest = int(away_m.argmin())
        if away_m[nearest] <= REACH_M:
            along_m[row] = driven_m[nearest]
    return along_m


def _draw_road(axes: Axes, road_m: Floats, gone: Sequence[Floats]) -> None:
    axes.set_axis_off()
    axes.set_aspect("equal", adjustable="datalim")
    longest = road_m[-1] - road_m[0]
    turn = np.arctan2(longest[1], longest[0])
    turned = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])  # its ends lie left and right
    axes.plot(*(road_m @ turned).T, color="#999999", lw=7, solid_capstyle="butt")
    for piece in gone:
        axes.plot(*(piece @ turned).T, color=GONE, lw=3, solid_capstyle="butt")


def _draw_strips(
    axes: Axes,
    lesson: Lesson,
    drives: Sequence[ReferenceMap],
    along_m: Sequence[Floats],
    stale: Sequence[Sequence[tuple[int, int]]],
) -> None:
    from matplotlib.patches import Patch

    for line, (one, at_m, pieces) in enumerate(zip(drives, along_m, stale, strict=True)):
        is_searched = line in lesson.choice.searched
        for first in np.arange(0.0, max(np.nanmax(at_m, initial=0.0), STEP_M), STEP_M):
            rows = np.flatnonzero((at_m >= first) & (at_m < first + STEP_M))
            if rows.size:
                color = _light(one, rows)
                axes.barh(
                    line,
                    STEP_M,
                    left=first,
                    height=0.7 if is_searched else 0.25,
                    color=color,
                    edgecolor="#777777",
                    lw=0.3,
                )
        for a, b in pieces:
            gone_m = at_m[a:b][np.isfinite(at_m[a:b])]
            if gone_m.size:
                axes.barh(
                    line,
                    np.ptp(gone_m),
                    left=gone_m.min(),
                    height=0.7,
                    color="none",
                    edgecolor=GONE,
                    hatch="////",
                    lw=1,
                )
        why = {**lesson.choice.searched, **lesson.choice.retired}[line]
        axes.text(1.02, line, why, transform=axes.get_yaxis_transform(), va="center", fontsize=8)
    views = ["/".join(sorted({segment.view for segment in one.header.segments})) for one in drives]
    axes.set_yticks(range(len(drives)), [f"{one.path.name} ({view})" for one, view in zip(drives, views, strict=True)])
    axes.invert_yaxis()
    axes.tick_params(labelsize=8, left=False)
    axes.set_xlabel("meters along the road; tall: searched, low: retired; as light as the pictures", fontsize=8)
    axes.spines[["top", "right", "left"]].set_visible(False)
    if any(stale):
        patch = Patch(facecolor="none", edgecolor=GONE, hatch="////", label="no longer there")
        axes.legend(handles=[patch], loc="lower right", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False)


def _light(one: ReferenceMap, rows: NDArray[np.intp]) -> str | tuple[float, float, float]:
    """The mean gray of a picture of some places; white with no picture."""
    try:
        picture = decode_picture("", one.thumbnail(int(rows[len(rows) // 2])), cv2.IMREAD_GRAYSCALE)
    except FrameError:
        return 1.0, 1.0, 1.0
    level = min(1.0, float(picture.mean()) / 160.0)  # 160: a picture of snow by day
    return level, level, level
