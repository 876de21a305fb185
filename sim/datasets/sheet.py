"""What was understood of a recording, on one page: rate, length, gaps, the track from above, first and last picture."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

import edge
from edge.feed import Feed, FeedImages
from edge.geodesy import east_north
from sim.datasets.summary import summarize
from sim.evaluation import figures, report

NAME = "sheet.html"


def render(feed: Feed) -> str:
    """The page of one recording."""
    about = {"version": edge.__version__}
    return report.render_page(feed.header.name, about, [section(feed, "As it was understood")])


def section(feed: Feed, title: str) -> report.Section:
    """Its lines, its track, and its first and last picture."""
    table = report.Table("summary", "", ("", "found"), [list(line) for line in summarize(feed)])
    images, last = FeedImages(feed), len(feed.rows) - 1
    pair = [
        report.Picture.of(images.read(row), f"{name} picture, frame {row}")
        for name, row in (("first", 0), ("last", last))
    ]
    images.close()
    track = _track(feed)
    drawn = [report.Figure("track", "The track from above", figures.to_png(track))] if track else []
    return report.Section(title, tables=[table], figures=drawn, pictures=[pair])


def _track(feed: Feed) -> Figure | None:
    """None where no two frames have a position."""
    placed = [row for row in feed.rows if row.lat_deg is not None and row.lon_deg is not None]
    if len(placed) < 2:
        return None
    meters = east_north(
        np.array([row.lat_deg for row in placed], dtype=float), np.array([row.lon_deg for row in placed], dtype=float)
    )
    stamps_s = np.array([row.stamp_ns - placed[0].stamp_ns for row in placed]) / 1e9
    gaps_s = np.diff(stamps_s)
    gap = int(gaps_s.argmax())
    figure = Figure(figsize=(figures.WIDTH_IN, 4.6), layout="constrained")
    axes = figure.subplots()
    axes.plot(*meters.T, ".-", color=figures.BLUE, ms=3, lw=1)
    axes.plot(
        *meters[gap : gap + 2].T, color=figures.ORANGE, lw=3, label=f"longest gap, {np.diff(stamps_s)[gap]:.1f} s"
    )
    axes.plot(*meters[0], "o", color=figures.BLUE, ms=9, label="start")
    axes.set(xlabel="east, m", ylabel="north, m")
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(fontsize=8)
    return figure
