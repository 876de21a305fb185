"""What was understood of a recording, on one page: rate, length, gaps, the track from above, first and last picture."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

import edge
from edge.feed import Feed, FeedImages
from edge.geodesy import east_north
from sim.datasets.alignment import STEP_S, Alignment
from sim.datasets.summary import summarize
from sim.evaluation import figures, report

NAME = "sheet.html"


def render(feed: Feed, alignment: Alignment | None = None) -> str:
    """The page of one recording. alignment: of its video over its track, as it was found."""
    about = {"version": edge.__version__}
    return report.render_page(feed.header.name, about, [section(feed, "As it was understood", alignment)])


def section(feed: Feed, title: str, alignment: Alignment | None = None) -> report.ReportSection:
    """Its lines, its track, how its video lies over it, and its first and last picture."""
    table = report.Table("summary", "", ("", "found"), [list(line) for line in summarize(feed)])
    images, last = FeedImages(feed), len(feed.rows) - 1
    pair = [
        report.Picture.of(images.read(row), f"{name} picture, frame {row}")
        for name, row in (("first", 0), ("last", last))
    ]
    images.close()
    track = _track(feed)
    drawn = [report.Figure("track", "The track from above", figures.to_png(track))] if track else []
    if alignment is not None and alignment.pictures is not None:
        drawn.append(report.Figure("alignment", alignment.how, figures.to_png(_aligned(alignment))))
    return report.ReportSection(title, tables=[table], figures=drawn, pictures=[pair])


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


def _aligned(found: Alignment) -> Figure:
    """What the pictures and the track show of the same moments, and how likely other starts are."""
    figure = Figure(figsize=(figures.WIDTH_IN, 5.2), layout="constrained")
    turn, speed, starts = figure.subplots(3)
    for axes, name, words in ((turn, "turn", "turning right"), (speed, "speed", "speed")):
        for motion, color, whose in ((found.track, figures.GRAY, "track"), (found.pictures, figures.BLUE, "pictures")):
            if motion is not None:
                line = getattr(motion, name)
                later_s = found.offset_s if whose == "pictures" else 0.0
                at_s = motion.start_s + later_s + STEP_S * np.arange(len(line))
                axes.plot(
                    at_s, (line - np.nanmean(line)) / max(np.nanstd(line), 1e-9), color=color, lw=1.2, label=whose
                )
        axes.set(ylabel=words, yticks=[])
    turn.legend(fontsize=8, ncols=2, loc="upper right")
    speed.set_xlabel("seconds from the track's first position")
    if found.tried_s is not None and found.likelihood is not None:
        starts.plot(found.tried_s, np.maximum(found.likelihood, -40), color=figures.BLUE, lw=1.2)
        starts.axvline(found.offset_s, color=figures.ORANGE, lw=1)
    starts.set(xlabel="start of the video, in seconds from the track's first position", ylabel="log-likelihood")
    return figure
