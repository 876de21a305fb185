"""A page of a road: a verdict, the road from above, and how far each stretch of it is to be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import edge
from edge.errors import ConfigError
from edge.geodesy import east_north_of
from sim.coverage.aliases import Alias
from sim.coverage.sheet import Gap, Sheet, SheetSpan
from sim.output import needing, refusing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEVELS = ((0.8, "#0072B2", "over 80 % of the frames"), (0.4, "#E69F00", "40 to 80 %"), (0.0, "#D55E00", "less"))
"""Least share, color and words; of Okabe and Ito, whose colors differ for every kind of color vision."""
UNKNOWN, ALIKE = "#BBBBBB", "#CC79A7"
LATERAL = 0.006  # of the extent of the road, to the right of it
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


@dataclass(frozen=True)
class Band:
    """A stretch as it is drawn. line: longitudes and latitudes in degrees. gap_m: the part of it in the longest gap.

    is_mean: whether no more than a mean is known of it. is_one_way: whether it is drawn to the right of the road.
    """

    line: Sequence[Sequence[float]]
    length_m: float
    color: str
    is_alike: bool = False
    gap_m: tuple[float, float] | None = None
    is_mean: bool = False
    is_one_way: bool = False


def write_sheet(
    path: Path,
    sheet: Sheet,
    lines: Sequence[Sequence[Sequence[float]]],
    found: Sequence[Alias],
    words: Sequence[str],
    name: str,
    views: Sequence[tuple[str, bytes]] = (),
) -> None:
    """Write what to expect of a map. lines: of each stretch, longitudes and latitudes in degrees.

    name: of the map. views: words and pictures of places (JPEG). SetupError without matplotlib.
    """
    alike = {one.stretch: one.other for one in found}
    bands = [
        Band(line, one.span.to_m - one.span.from_m, _color(one), one.span in alike, _gap_m(sheet.gap, one), one.is_mean)
        for one, line in zip(sheet.stretches, lines, strict=True)
    ]
    pairs = [
        f"Looks like another stretch: drive {a.segment + 1}, {a.from_m:.0f} to {a.to_m:.0f} m,"
        f" and drive {b.segment + 1}, {b.from_m:.0f} to {b.to_m:.0f} m."
        for a, b in alike.items()
        if alike.get(b) != a or (a.segment, a.from_m) < (b.segment, b.from_m)
    ]
    legend = [*((color, of_color) for _, color, of_color in LEVELS), (UNKNOWN, "not known")]
    label = "meters along the map's drives; black: the longest gap"
    said = [*words, *(pairs or ["No stretch looks like another."])]
    panels = [("The map's drives", bands)]
    write_page(
        path, f"Where {name} will be recognized", said, panels, [*legend, (ALIKE, "like another stretch")], label, views
    )


def write_page(
    path: Path,
    title: str,
    words: Sequence[str],
    panels: Sequence[tuple[str, Sequence[Band]]],
    legend: Sequence[tuple[str, str]],
    label: str,
    views: Sequence[tuple[str, bytes]] = (),
) -> None:
    """Write a page. panels: roads, each with a name. legend: colors and words. label: below the strips.

    SetupError without matplotlib.
    """
    with needing("--report", "sim"):
        from matplotlib.figure import Figure
        from matplotlib.patches import Patch

        from sim.evaluation import report
        from sim.evaluation.figures import WIDTH_IN, to_png
    drawn = []
    for name, bands in panels:
        figure = Figure(figsize=(WIDTH_IN, 6.4), layout="constrained")
        above, strip = figure.subplots(2, height_ratios=(12, 1))
        _draw_map(above, bands)
        _draw_strip(strip, bands)
        strip.set_xlabel(label, fontsize=9)
        handles = [Patch(color=color, label=of_color) for color, of_color in legend]
        figure.legend(handles=handles, ncols=3, loc="outside upper center", fontsize=8, frameon=False)
        drawn.append(report.Figure("road", name, to_png(figure)))
    pictures = [report.Picture(jpeg, of_place) for of_place, jpeg in views]
    section = report.ReportSection("From above", figures=drawn, pictures=[pictures] if pictures else [])
    page = report.render_page(title, {"version": edge.__version__}, [section], words)
    with refusing(ConfigError, f"--report {path}: cannot write it"):
        path.write_text(page, encoding="utf-8")


def _color(one: SheetSpan) -> str:
    return UNKNOWN if one.share is None else next(color for least, color, _ in LEVELS if one.share >= least)


def _gap_m(gap: Gap | None, one: SheetSpan) -> tuple[float, float] | None:
    """The part of a stretch that lies in a gap, from where the stretch begins."""
    span = one.span
    if gap is None or gap.segment != span.segment or not (gap.from_m < span.to_m and span.from_m < gap.to_m):
        return None
    return max(0.0, gap.from_m - span.from_m), min(gap.to_m, span.to_m) - span.from_m


def _draw_map(axes: Axes, bands: Sequence[Band]) -> None:
    """From above, in meters, north up."""
    points = [point for one in bands for point in one.line]
    if not points:
        axes.set_axis_off()
        axes.text(0.5, 0.5, "a map without positions", ha="center", transform=axes.transAxes)
        return
    origin = points[0][1], points[0][0]
    lines = [np.array([east_north_of(lat, lon, origin) for lon, lat in one.line]).reshape(-1, 2) for one in bands]
    extent_m = float(np.ptp(np.concatenate(lines), axis=0).max())
    for one, line in zip(bands, lines, strict=True):
        if not len(line):
            continue
        if one.is_one_way and len(line) > 1:
            ahead = np.gradient(line, axis=0)
            right = np.column_stack([ahead[:, 1], -ahead[:, 0]])
            line = line + LATERAL * extent_m * right / np.maximum(np.hypot(*right.T), 1e-9)[:, None]  # noqa: PLW2901
        east_m, north_m = line.T
        if one.is_alike:
            axes.plot(east_m, north_m, lw=10, color=ALIKE, solid_capstyle="butt")
        axes.plot(east_m, north_m, lw=4.5, color=one.color, solid_capstyle="butt")
        if one.gap_m is not None:
            axes.plot(east_m, north_m, lw=1.3, color="black", ls=(0, (2, 2)))
    axes.set(xlabel="east, m", ylabel="north, m")
    axes.set_aspect("equal", adjustable="datalim")


def _draw_strip(axes: Axes, bands: Sequence[Band]) -> None:
    """Along the distance, one stretch after another."""
    at_m = 0.0
    for one in bands:
        edge = one.color if one.is_mean else "white"  # no borders where no difference is known
        axes.barh(0, one.length_m, left=at_m, height=1, color=one.color, linewidth=0.4, edgecolor=edge)
        if one.is_alike:
            axes.barh(-0.35, one.length_m, left=at_m, height=0.3, color=ALIKE)
        if one.gap_m is not None:
            ends = [at_m + end for end in one.gap_m]
            axes.plot(ends, [0.75] * 2, color="black", lw=2.5, clip_on=False, solid_capstyle="butt")
        at_m += one.length_m
    axes.set_xlim(0, max(at_m, 1.0))
    axes.set_ylim(-0.5, 0.5)
    axes.set_yticks([])
    axes.tick_params(labelsize=8)
