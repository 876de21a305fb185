"""The verdict as one HTML page that needs nothing beside it."""

from __future__ import annotations

import numpy as np

import edge
from edge.feed import FeedImages
from sim.calibration.command import Lines
from sim.datasets import sheet
from sim.evaluation import figures, report
from sim.evaluation.figures import to_png
from sim.first_try.verdict import Tried, Verdict, distances_m
from sim.traverse import driven_m

PAIRS = 8
"""Matched pairs on the page, spread over the believed frames."""
MOST_STRETCHES = 20


def render(tried: Tried, found: Verdict, rig: Lines) -> str:
    """The page. rig: what was measured of the camera's offset."""
    header = tried.maps.headers[0]
    about = {
        "version": edge.__version__,
        "map": f"{tried.maps.index.places} places",
        "model": f"{header.model.name}, sha256 {header.model.sha256}",
    }
    sections = [_where(tried, found), _pictures(tried)]
    if found.advice:
        rows: list[list[report.Cell]] = [[number, line] for number, line in enumerate(found.advice, start=1)]
        advice = report.Table("advice", "", ("", "The most important first"), rows)
        sections.insert(0, report.Section("What to change", tables=[advice]))
    if rig:
        text = "Measured on this query, and in the config beside this page. Lines for another config:"
        table = report.Table(
            "rig", "", ("key", "m"), [[f"[{section}] {key}", value] for (section, key), value in rig.items()]
        )
        sections.append(report.Section("The camera's offset", text, tables=[table]))
    for role, feed in ("reference", tried.reference), ("query", tried.query):
        sections.append(sheet.section(feed, f"The {role} as it was understood: {feed.path}"))
    return report.render_page(found.headline, about, sections, lead=found.facts)


def _where(tried: Tried, found: Verdict) -> report.Section:
    """Where it was recognized: along the drive, from above, and place by place."""
    seen = tried.seen
    rows = [one.frame for one in seen.used]
    at, unit = distances_m(seen.feed, rows, driven_m(seen.feed))
    listed = sorted(found.stretches, key=lambda one: one.first - one.last)[:MOST_STRETCHES]
    table = report.Table(
        "stretches",
        "Where not, and why" if listed else "Recognized everywhere",
        (f"from, {unit}", f"to, {unit}", "frames", "why"),
        [
            [f"{at[one.first]:.0f}", f"{at[one.last]:.0f}", one.last - one.first + 1, one.why]
            for one in sorted(listed, key=lambda one: one.first)
        ],
        "" if len(listed) == len(found.stretches) else f"The longest {len(listed)} of {len(found.stretches)}.",
    )
    confidence = np.array([np.nan if one.confidence is None else one.confidence for one in seen.used])
    least = tried.config.acceptance.confidence_from
    wrong = tried.is_wrong
    drawn = [
        report.Figure(
            "confidence",
            "Confidence along the drive",
            to_png(figures.confidence_plot(at, unit, confidence, seen.believed & ~wrong, wrong, least)),
        )
    ]
    judged = tried.judged
    if judged is not None:
        bad = judged.believed & ~judged.answers.correct
        plot = figures.route_plot(
            judged.places_m,
            judged.truth_m[judged.believed & ~bad],
            judged.truth_m[bad],
            judged.truth_m[~judged.believed],
            tried.tolerance_m,
        )
        drawn.append(report.Figure("route", "The query from above", to_png(plot)))
    if seen.costs.shape[1]:
        places = np.array([np.nan if one.place is None else one.place for one in seen.used], dtype=float)
        note = "A line that rises is the same way, one that falls is the way back; none is a road that differs"
        matrix = to_png(figures.cost_matrix(seen.costs, places, seen.believed))
        drawn.append(report.Figure("costs", "Each frame against each place", matrix, note))
    return report.Section("Where", tables=[table], figures=drawn)


def _pictures(tried: Tried) -> report.Section:
    """Believed frames beside their places; where there are none, the best matches."""
    seen, query, places = tried.seen, FeedImages(tried.seen.feed), FeedImages(tried.reference)
    rows = np.flatnonzero(seen.believed)
    title = "Believed places"
    if not rows.size:
        rows = np.array([row for row, one in enumerate(seen.used) if one.map_row is not None], dtype=int)
        title = "Best matches, none of them believed"
    chosen = rows[np.unique(np.linspace(0, len(rows) - 1, PAIRS).round().astype(int))] if rows.size else rows
    pairs = []
    for row in chosen:
        one = seen.used[row]
        assert one.map_row is not None
        error_m = "" if tried.judged is None else _error(tried, int(row))
        here = report.Picture.of(query.read(one.frame), f"query, frame {one.frame}")
        there = f"place {one.place}{error_m}, confidence {one.confidence:.2f}, {one.direction}"
        pairs.append([here, report.Picture.of(places.read(one.map_row), there)])
    query.close()
    places.close()
    return report.Section(title if pairs else "No place was matched", pictures=pairs)


def _error(tried: Tried, row: int) -> str:
    assert tried.judged is not None
    at = np.flatnonzero(tried.judged.rows == row)
    return f", {tried.judged.error_m[at[0]]:.1f} m off" if at.size else ""
