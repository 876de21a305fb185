"""The coverage sheet as one page of A4: the verdict, the route in meters, and what to expect along it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from edge.errors import ConfigError
from edge.geodesy import east_north_of
from sim.coverage.aliases import Alias
from sim.coverage.sheet import Gap, Sheet, Stretch
from sim.output import needing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

A4_INCHES = (8.27, 11.69)
LEVELS = ((0.8, "#0072B2", "over 80 % of the frames"), (0.4, "#E69F00", "40 to 80 %"), (0.0, "#D55E00", "less"))
"""Least share, color and words; of Okabe and Ito, whose colors differ for every kind of color vision."""
UNKNOWN, ALIKE = "#BBBBBB", "#CC79A7"
BARS_M = (10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000)
MOST_ALIKE = 6  # in words, of those that look alike
GOOD, POOR = 0.9, 0.5
"""Share of the drives whose drift stays within the limit, from which a route is ready, or a risk."""


def verdict(sheet: Sheet, conditions: str, within_m: float) -> str:
    """What the sheet says, in a sentence or two."""
    if sheet.gap is None:
        return f"Not ready: {conditions}, most drives recognize nothing."
    what = "Ready" if sheet.completed >= GOOD else "A risk" if sheet.completed >= POOR else "Not ready"
    known = [one for one in sheet.stretches if one.share is not None]
    lengths_m = [one.span.to_m - one.span.from_m for one in known]
    share = np.average([one.share or 0.0 for one in known], weights=lengths_m) if known else 0.0
    return (
        f"{what}: {conditions}, {100 * share:.0f} % of the frames are expected to be recognized, and on"
        f" {100 * sheet.completed:.0f} % of the drives the drift stays within {within_m:g}\u00a0m."
    )


def gap_in_words(gap: Gap | None, percent: float) -> str:
    """Where the longest gap is, and what it costs. percent: drift of the distance driven."""
    if gap is None:
        return "longest gap: the whole route"
    return (
        f"longest gap: {gap.length_m:.0f} m, up to {gap.to_m:.0f} m of drive {gap.segment + 1};"
        f" {percent / 100 * gap.length_m:.0f} m of drift at {percent:g} %"
    )


def write_sheet(
    path: Path,
    sheet: Sheet,
    lines: Sequence[Sequence[Sequence[float]]],
    found: Sequence[Alias],
    headline: str,
    words: Sequence[str],
    name: str,
    views: Sequence[tuple[str, bytes]] = (),
) -> None:
    """Write the page. lines: of each stretch, longitudes and latitudes in degrees. views: pictures of places (JPEG).

    name: of the map. SetupError without matplotlib.
    """
    with needing("--picture", "sim"):
        from matplotlib.figure import Figure
    figure = Figure(figsize=A4_INCHES)
    figure.text(0.08, 0.95, f"Where {name} will be recognized", fontsize=17, weight="bold", va="top")
    figure.text(0.08, 0.915, _wrapped(headline, 80), fontsize=11.5, va="top", linespacing=1.4)
    alike = {one.stretch: one.other for one in found}
    _draw_map(
        figure.add_axes((0.08, 0.47 if views else 0.37, 0.84, 0.36 if views else 0.46)),
        sheet,
        lines,
        [one.span in alike for one in sheet.stretches],
    )
    _draw_strip(figure.add_axes((0.08, 0.265, 0.84, 0.035)), sheet, [one.span in alike for one in sheet.stretches])
    for column, (words_of, jpeg) in enumerate(views):
        axes = figure.add_axes((0.08 + column * 0.84 / len(views), 0.35, 0.84 / len(views) - 0.01, 0.1))
        image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
        axes.imshow(np.asarray(image)[:, :, ::-1])
        axes.set_axis_off()
        axes.set_title(words_of, fontsize=8)
    pairs = [
        f"Looks like another stretch: drive {a.segment + 1}, {a.from_m:.0f} to {a.to_m:.0f} m,"
        f" and drive {b.segment + 1}, {b.from_m:.0f} to {b.to_m:.0f} m."
        for a, b in alike.items()
        if alike.get(b) != a or (a.segment, a.from_m) < (b.segment, b.from_m)
    ]
    more = [f"{len(pairs) - MOST_ALIKE} more look like another."] if len(pairs) > MOST_ALIKE else []
    rest = [*words, *(pairs[:MOST_ALIKE] or ["No stretch looks like another."]), *more]
    figure.text(0.08, 0.2, "\n".join(_wrapped(one, 95) for one in rest), fontsize=9.5, va="top", linespacing=1.5)
    try:
        figure.savefig(path)
    except (OSError, ValueError) as error:
        raise ConfigError(f"--picture {path}: cannot write it: {error}") from None


def _wrapped(text: str, columns: int) -> str:
    import textwrap

    return "\n".join(textwrap.wrap(text, columns))


def _color(one: Stretch) -> str:
    return UNKNOWN if one.share is None else next(color for least, color, _ in LEVELS if one.share >= least)


def _draw_map(axes: Axes, sheet: Sheet, lines: Sequence[Sequence[Sequence[float]]], is_alike: Sequence[bool]) -> None:
    """From above, in meters, north up."""
    points = [point for line in lines for point in line]
    axes.set_axis_off()
    if not points:
        axes.text(0.5, 0.5, "a map without positions", ha="center", transform=axes.transAxes)
        return
    origin = points[0][1], points[0][0]
    for one, line, alike in zip(sheet.stretches, lines, is_alike, strict=True):
        if not line:
            continue
        east_m, north_m = zip(*(east_north_of(lat, lon, origin) for lon, lat in line), strict=True)
        if alike:
            axes.plot(east_m, north_m, lw=10, color=ALIKE, solid_capstyle="butt")
        axes.plot(east_m, north_m, lw=4.5, color=_color(one), solid_capstyle="butt")
        gap = sheet.gap
        if gap is not None and gap.segment == one.span.segment and _overlaps(gap, one):
            axes.plot(east_m, north_m, lw=1.3, color="black", ls=(0, (2, 2)))
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
    axes.autoscale_view()
    axes.apply_aspect()
    axes.autoscale(enable=False)
    low, high = axes.get_xlim()
    bar_m = max((one for one in BARS_M if one <= (high - low) / 3), default=BARS_M[0])
    bottom, top = axes.get_ylim()
    at = low + 0.02 * (high - low), bottom + 0.02 * (top - bottom)
    axes.plot([at[0], at[0] + bar_m], [at[1]] * 2, color="black", lw=2)
    axes.text(at[0] + bar_m + 0.015 * (high - low), at[1], f"{bar_m} m, north is up", va="center", fontsize=9)


def _overlaps(gap: Gap, one: Stretch) -> bool:
    return gap.from_m < one.span.to_m and one.span.from_m < gap.to_m


def _draw_strip(axes: Axes, sheet: Sheet, is_alike: Sequence[bool]) -> None:
    """Along the distance, one drive of the map after another; the legend is above."""
    from matplotlib.patches import Patch

    at_m, gap = 0.0, sheet.gap
    for one, alike in zip(sheet.stretches, is_alike, strict=True):
        length_m = one.span.to_m - one.span.from_m
        edge = _color(one) if one.is_mean else "white"  # no borders where no difference is known
        axes.barh(0, length_m, left=at_m, height=1, color=_color(one), linewidth=0.4, edgecolor=edge)
        if alike:
            axes.barh(-0.35, length_m, left=at_m, height=0.3, color=ALIKE)
        if gap is not None and gap.segment == one.span.segment and _overlaps(gap, one):
            ends = (at_m + max(0.0, limit - one.span.from_m) for limit in (gap.from_m, min(gap.to_m, one.span.to_m)))
            axes.plot(list(ends), [0.75] * 2, color="black", lw=2.5, clip_on=False, solid_capstyle="butt")
        at_m += length_m
    axes.set_xlim(0, max(at_m, 1.0))
    axes.set_ylim(-0.5, 0.5)
    axes.set_yticks([])
    axes.set_xlabel("meters along the map's drives; black: the longest gap", fontsize=9)
    axes.tick_params(labelsize=8)
    patches = [Patch(color=color, label=words) for _, color, words in LEVELS]
    patches += [Patch(color=UNKNOWN, label="not known"), Patch(color=ALIKE, label="looks like another stretch")]
    axes.legend(handles=patches, ncols=5, loc="lower center", bbox_to_anchor=(0.5, 1.5), fontsize=8, frameon=False,
                handlelength=1.2, columnspacing=1.2)  # fmt: skip
