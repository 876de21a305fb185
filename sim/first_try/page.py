"""The verdict as one HTML page that needs nothing beside it."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import replace

import av
import cv2
import numpy as np
from numpy.typing import NDArray

import edge
from edge.feed import FeedImages
from edge.keypoints.network import KeypointNetwork
from sim.calibration.command import Lines
from sim.datasets import sheet
from sim.datasets.alignment import Alignment
from sim.evaluation import figures, report
from sim.evaluation.figures import to_png
from sim.evaluation.matched_points import side_by_side
from sim.evaluation.metrics import precision_recall
from sim.evaluation.recognition import Recognition, RecognitionScore
from sim.first_try.verdict import SHORT_FRAMES, TryResult, Verdict
from sim.first_try.with_keypoints import WithKeypoints, errors_words, first_words
from sim.traverse import distances_m, driven_m

PAIRS = 4
"""Matched pairs on the page, spread over the believed frames."""
MOST_STRETCHES = 20
COLUMNS = "", "accepted, %", "the first", "precision", "recall", "error, m", "95 %, m"
FILM_S, FILM_FPS, FILM_PX = 20, 10, (320, 240)


def render(tried: TryResult, found: Verdict, rig: Lines, aligned: Mapping[str, Alignment | None]) -> str:
    """The page. rig: what was measured of the camera's offset. aligned: of videos over their tracks."""
    header = tried.maps.headers[0]
    about = {
        "version": edge.__version__,
        "map": f"{tried.maps.index.places} places",
        "model": f"{header.model.name}, sha256 {header.model.sha256}",
    }
    sections = [_pictures(tried), _where(tried, found)]
    if tried.keypoints is not None:
        sections.insert(1, _compared(tried.keypoints, tried.seen, tried.judged))
    if found.advice:
        rows: list[list[report.Cell]] = [[number, line] for number, line in enumerate(found.advice, start=1)]
        advice = report.Table("advice", "", ("", "The most important first"), rows)
        sections.insert(0, report.ReportSection("What to change", tables=[advice]))
    if rig:
        text = "Measured on this query, and in the config beside this page. Lines for another config:"
        table = report.Table(
            "rig", "", ("key", "m"), [[f"[{section}] {key}", f"{value:.1f}"] for (section, key), value in rig.items()]
        )
        sections.append(report.ReportSection("The camera's offset", text, tables=[table]))
    for role, feed in ("reference", tried.reference), ("query", tried.query):
        about_it = sheet.section(feed, f"The {role} as it was understood: {feed.header.name}", aligned.get(role))
        sections.append(replace(about_it, folded=True))
    return report.render_page(found.headline, about, sections, lead=found.facts)


def _compared(found: WithKeypoints, seen: Recognition, judged: RecognitionScore | None) -> report.ReportSection:
    """Both side by side."""
    rows: list[list[report.Cell]] = []
    for name, one, known in (("the sequence alone", found.alone, found.judged), ("with keypoints", seen, judged)):
        row: list[report.Cell] = [name, f"{100 * one.believed.mean():.0f}", first_words(one)]
        if known is not None and known.believed.any():
            errors_m = np.percentile(known.error_m[known.believed], (50, 95))
            row += [f"{known.precision:.3f}", f"{known.recall:.3f}", *(f"{error_m:.1f}" for error_m in errors_m)]
        rows.append([*row, *[""] * (len(COLUMNS) - len(row))])
    table = report.Table("keypoints", "", COLUMNS, rows)
    return report.ReportSection("The sequence alone, and with keypoints", errors_words(found, seen), tables=[table])


def _where(tried: TryResult, found: Verdict) -> report.ReportSection:
    """Where it was recognized: along the drive, from above, and place by place."""
    seen = tried.seen
    rows = [one.frame for one in seen.used]
    at, unit = distances_m(seen.feed, rows, driven_m(seen.feed))
    listed = sorted(found.stretches, key=lambda one: one.first - one.last)[:MOST_STRETCHES]
    table = report.Table(
        "stretches",
        "Where not, and why",
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
        drawn.insert(0, report.Figure("route", "The map's drive and the query, from above", to_png(plot)))
        curve = {"every confidence": precision_recall(judged.answers)}
        drawn.append(report.Figure("curve", "Precision and recall", figures.precision_recall_plot(curve)))
    if seen.costs.shape[1]:
        places = np.array([np.nan if one.place is None else one.place for one in seen.used], dtype=float)
        note = "A line that rises is the same way, one that falls is the way back; none is a road that differs"
        matrix = to_png(figures.cost_matrix(seen.costs, places, seen.believed))
        drawn.append(report.Figure("costs", "Each frame against each place", matrix, note))
    words, tables = ("", [table]) if listed else (f"No stretch of {SHORT_FRAMES} frames is missed.", [])
    return report.ReportSection("Where", words, tables=tables, figures=drawn)


def _pictures(tried: TryResult) -> report.ReportSection:
    """Believed frames beside their places; where there are none, the best matches."""
    seen, query, places = tried.seen, FeedImages(tried.seen.feed), FeedImages(tried.reference)
    rows = np.flatnonzero(seen.believed)
    title = "Accepted places"
    if not rows.size:
        rows = np.array([row for row, one in enumerate(seen.used) if one.map_row is not None], dtype=int)
        title = "Best matches, none of them accepted"
    chosen = rows[np.unique(np.linspace(0, len(rows) - 1, PAIRS).round().astype(int))] if rows.size else rows
    pairs, network = [], KeypointNetwork()
    for row in chosen:
        one = seen.used[row]
        assert one.map_row is not None
        error_m = "" if tried.judged is None else _error(tried, int(row))
        both = query.read(one.frame), places.read(one.map_row)
        here, there = f"query, frame {one.frame}", f"place {one.place}{error_m}, confidence {one.confidence:.2f}"
        if one.order == "same":
            pair, found = side_by_side(network, *both)
            words = f"{here}; {there}, {one.direction}: {found.inliers} inliers"
            pairs.append([report.Picture.of(pair, words)])
        else:  # keypoints say nothing of opposite views
            words = f"{there}, {one.direction}, from opposite views"
            pairs.append([report.Picture.of(both[0], here), report.Picture.of(both[1], words)])
    film = _film(tried, query, places)
    query.close()
    places.close()
    words = "left: the query; right: the place that is accepted, dark where none is"
    return report.ReportSection(title if pairs else "No place was matched", pictures=pairs, film=film, film_words=words)


def _film(tried: TryResult, query: FeedImages, places: FeedImages) -> bytes:
    """An MP4 of FILM_S, the query beside the places that it is believed to be."""
    used = tried.seen.used
    rows = np.unique(np.linspace(0, len(used) - 1, min(len(used), round(FILM_S * FILM_FPS))).round().astype(int))
    stream = io.BytesIO()
    with av.open(stream, "w", format="mp4") as container:
        track = container.add_stream("libx264", rate=FILM_FPS, options={"crf": "28"})
        track.width, track.height, track.pix_fmt = 2 * FILM_PX[0], FILM_PX[1], "yuv420p"
        for row in rows.tolist():
            one = used[row]
            beside = np.full((FILM_PX[1], FILM_PX[0], 3), 24, np.uint8)
            if one.accepted and one.map_row is not None:
                beside = _fitted(places.read(one.map_row))
            pair = np.hstack([_fitted(query.read(one.frame)), beside])
            container.mux(track.encode(av.VideoFrame.from_ndarray(pair, "bgr24")))
        container.mux(track.encode())
    return stream.getvalue()


def _fitted(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """An image in the middle of FILM_PX, whatever its shape."""
    scale = min(FILM_PX[0] / image.shape[1], FILM_PX[1] / image.shape[0])
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)[: FILM_PX[1], : FILM_PX[0]]
    top, left = (FILM_PX[1] - small.shape[0]) // 2, (FILM_PX[0] - small.shape[1]) // 2
    whole = np.full((FILM_PX[1], FILM_PX[0], 3), 24, np.uint8)
    whole[top : top + small.shape[0], left : left + small.shape[1]] = small
    return whole


def _error(tried: TryResult, row: int) -> str:
    assert tried.judged is not None
    at = np.flatnonzero(tried.judged.rows == row)
    return f", {tried.judged.error_m[at[0]]:.1f} m off" if at.size else ""
