"""The demo's report: one HTML page that needs no network, with all pictures inside."""

from __future__ import annotations

import base64
import io
import logging
from dataclasses import dataclass
from pathlib import Path

import cv2
import jinja2
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import edge
from edge.camera.feed import FeedImages, read_feed
from edge.config import AcceptanceConfig, RigConfig, SequenceConfig
from edge.reference_map.route import east_north
from edge.reference_map.store import ReferenceMap
from sim.demo.live import LiveDrive
from sim.demo.review import TOLERANCE_M, Review
from sim.evaluation.metrics import precision_recall

mpl.use("svg")
logging.getLogger("matplotlib").setLevel(logging.WARNING)  # it talks about its font cache
BLUE, ORANGE, GREY, RED = "#1f6fb4", "#e6820e", "#9aa3ad", "#c0392b"


@dataclass(frozen=True)
class Pair:
    """A frame beside the place that it was taken for; pictures as data URIs."""

    query: str
    reference: str
    words: str


@dataclass(frozen=True)
class DriveSection:
    """What the page shows of one drive."""

    name: str
    light: str
    direction: str
    frames: int
    fixes: int
    median_m: str
    worst_m: str
    precision: str
    recall: str
    stages_ms: dict[str, float]
    pairs: list[Pair]
    cost_matrix: str
    route: str


def write_report(
    path: Path, reference_map: ReferenceMap, rig: RigConfig, lives: list[LiveDrive], reviews: list[Review]
) -> Path:
    """Write the page for all drives and return its path."""
    templates = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=jinja2.StrictUndefined
    )
    page = templates.get_template("report.html.j2").render(
        version=edge.__version__,
        header=reference_map.header,
        rig=rig,
        sequence=SequenceConfig(),
        acceptance=AcceptanceConfig(),
        tolerance_m=TOLERANCE_M,
        sections=[_section(reference_map, live, review) for live, review in zip(lives, reviews, strict=True)],
        curve=_svg(curves(lives, reviews)),
    )
    path.write_text(page, encoding="utf-8")
    return path


def _section(reference_map: ReferenceMap, live: LiveDrive, review: Review) -> DriveSection:
    errors_m = np.array([fix.error_m for fix in live.fixes] or [np.nan])
    return DriveSection(
        name=live.name.replace("_", " "),
        light=live.scenario.light,
        direction=live.scenario.direction,
        frames=len(review.seen),
        fixes=len(live.fixes),
        median_m=f"{np.median(errors_m):.1f}",
        worst_m=f"{np.percentile(errors_m, 95):.1f}",
        precision=f"{review.precision:.3f}",
        recall=f"{review.recall:.3f}",
        stages_ms=live.stages_ms(),
        pairs=_pairs(reference_map, review),
        cost_matrix=_svg(cost_matrix(reference_map, review)),
        route=_svg(route(reference_map, live, review)),
    )


def _pairs(reference_map: ReferenceMap, review: Review) -> list[Pair]:
    feed = read_feed(reference_map.path.with_suffix(""))  # the demo keeps the feed beside the map made of it
    images = FeedImages(feed)
    pairs = []
    for row, picture in review.pictures.items():
        seen = review.seen[row]
        if seen.map_row is not None:
            words = (
                f"at {review.route_m[row]:.0f} m taken for place {seen.place}: {review.error_m[row]:.1f} m off, "
                f"uniqueness {seen.uniqueness:.2f}, {seen.direction}, {seen.order} order, {seen.category}"
            )
            pairs.append(Pair(_jpeg(picture), _jpeg(images.read(seen.map_row)), words))
    return pairs


def cost_matrix(reference_map: ReferenceMap, review: Review) -> Figure:
    """The whole matrix, the matches, and the line of one accepted match through it."""
    figure = Figure(figsize=(6.4, 5.2), layout="constrained")
    axes = figure.subplots()
    shown = axes.imshow(review.costs.T, origin="lower", aspect="auto", cmap="viridis", vmin=0.6, vmax=1.1)
    figure.colorbar(shown, label="cosine distance")
    places = np.array([np.nan if seen.place is None else seen.place for seen in review.seen], dtype=float)
    rows = np.arange(len(places))
    axes.plot(rows[~review.accepted], places[~review.accepted], ".", color="white", ms=3, label="best, not believed")
    axes.plot(rows[review.accepted], places[review.accepted], ".", color=ORANGE, ms=4, label="believed")
    chosen = [row for row, match in enumerate(review.matches) if match is not None and match.accepted]
    if chosen:
        row = chosen[len(chosen) // 2]
        match = review.matches[row]
        assert match is not None
        ages = np.arange(SequenceConfig().length)
        step = match.slope if match.direction == "forward" else -match.slope
        axes.plot(row - ages, match.place - step * ages, color=RED, lw=2, label="the line behind one of them")
    axes.set(xlabel="frame of this drive", ylabel="place of the map", ylim=(0, reference_map.header.places))
    axes.legend(loc="upper left", fontsize=8, facecolor=GREY)
    return figure


def route(reference_map: ReferenceMap, live: LiveDrive, review: Review) -> Figure:
    """The map's route from above, with the fixes."""
    figure = Figure(figsize=(6.4, 5.2), layout="constrained")
    axes = figure.subplots()
    places = reference_map.places
    fixed = [seen for seen in review.seen if seen.emitted and seen.lat_deg is not None]
    lat = np.concatenate([places["lat_deg"], [seen.lat_deg for seen in fixed]]).astype(float)
    lon = np.concatenate([places["lon_deg"], [seen.lon_deg for seen in fixed]]).astype(float)
    metres = east_north(lat, lon)
    count = len(places)
    axes.plot(*metres[:count].T, color=GREY, lw=3, label="the map's route")
    right = np.array(
        [error <= TOLERANCE_M for seen, error in zip(review.seen, review.error_m, strict=True) if seen in fixed]
    )
    axes.plot(*metres[count:][right].T, "o", color=BLUE, ms=5, label="fix")
    axes.plot(*metres[count:][~right].T, "x", color=RED, ms=7, label=f"fix over {TOLERANCE_M:.0f} m off")
    axes.set(xlabel="east, m", ylabel="north, m", aspect="equal", title=live.name.replace("_", " "))
    axes.legend(fontsize=8)
    return figure


def curves(lives: list[LiveDrive], reviews: list[Review]) -> Figure:
    """Precision and recall of all drives, and the threshold in use."""
    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    axes = figure.subplots()
    for live, review, colour in zip(lives, reviews, (ORANGE, BLUE), strict=True):
        curve = precision_recall(review.answers)
        axes.plot(curve.recall_of_places, curve.precision, color=colour, label=live.name.replace("_", " "))
        axes.plot(review.recall, review.precision, "o", color=colour)
    axes.set(xlabel="recall (of all frames)", ylabel="precision", xlim=(0, 1), ylim=(0, 1.02))
    axes.legend(loc="lower left")
    return figure


def _svg(figure: Figure) -> str:
    """The figure as a data URI; pictures inside it are PNG, so that a matrix does not become a path a cell."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", dpi=120)
    return "data:image/svg+xml;base64," + base64.b64encode(buffer.getvalue()).decode()


def _jpeg(image: NDArray[np.uint8]) -> str:
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()
    return "data:image/jpeg;base64," + base64.b64encode(data).decode()
