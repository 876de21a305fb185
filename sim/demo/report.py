"""The demo's report: one HTML page that needs no network, with all pictures inside."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import edge
from edge.config import AcceptanceConfig, RigConfig, SequenceConfig
from edge.feed import FeedImages, read_feed
from edge.geodesy import east_north
from edge.reference_map.store import ReferenceMap
from sim.demo.review import Review, median_95, stages_ms
from sim.demo.story import headline, sections_of
from sim.evaluation import figures, report
from sim.evaluation.figures import to_png
from sim.evaluation.metrics import TOLERANCE_M, precision_recall
from sim.trial.rules import Run
from sim.vehicle.daemon_drive import DaemonDrive
from sim.vehicle.protection import LIMIT_M


def write_report(
    path: Path,
    reference_map: ReferenceMap,
    rig: RigConfig,
    lives: list[DaemonDrive],
    reviews: list[Review],
    story: Run,
) -> Path:
    """Write the page for all drives and return its path."""
    header = reference_map.header
    about = {
        "version": edge.__version__,
        "map": f"{header.places} places",
        "model": f"{header.model.name}, sha256 {header.model.sha256}",
    }
    sections = [
        *sections_of(story),
        _overview(reference_map, rig, lives, reviews),
        *(_section(reference_map, live, review) for live, review in zip(lives, reviews, strict=True)),
        report.Section("Precision and recall", figures=[_curves(lives, reviews)]),
    ]
    path.write_text(report.render_page(headline(story), about, sections), encoding="utf-8")
    return path


def _overview(
    reference_map: ReferenceMap, rig: RigConfig, lives: Sequence[DaemonDrive], reviews: Sequence[Review]
) -> report.Section:
    text = (
        "A vehicle drove out along a street by day with a camera that looks back, and a map was made of"
        f" {reference_map.header.places} places. Then it drove with a camera that looks ahead, GPS failing soon: the"
        " same way again at dusk, and home at night. Lookback ran as a process of its own and sent place fixes to a"
        " simulated autopilot over a serial line."
    )
    note = (
        f"Sequences of {SequenceConfig().length} frames, confidence from {AcceptanceConfig().confidence_min} on. The"
        f" matched place lies {rig.ahead_forward_swapped_m:.0f} m ahead of the vehicle when it drives the same way, and"
        f" {rig.ahead_reverse_same_m:.0f} m on the way home: measured on two short drives with GPS, since a front and a"
        " rear camera see the same thing at different times."
    )
    by_drive = [_numbers(live, review) for live, review in zip(lives, reviews, strict=True)]
    rows = [[label, *(numbers[label] for numbers in by_drive)] for label in by_drive[0]]
    columns = ("", *(_name(live) for live in lives))
    return report.Section("The drives", text, tables=[report.Table("drives", "In numbers", columns, rows, note)])


def _name(live: DaemonDrive) -> str:
    return live.name.replace("_", " ")


def _numbers(live: DaemonDrive, review: Review) -> dict[str, report.Cell]:
    """The column of one drive, by row."""
    return {
        "light, direction along the map": f"{live.scenario.light}, {live.scenario.direction}",
        "frames used": len(review.seen),
        "positions that reached the autopilot": len(live.fixes),
        "their error, median / 95 %": median_95([fix.error_m for fix in live.fixes]),
        f"protection level below {LIMIT_M:.0f} m, of the time without GPS": f"{live.available:.0%}",
        f"precision: believed frames within {TOLERANCE_M:.0f} m": f"{review.precision:.3f}",
        "recall: believed and right, of all frames": f"{review.recall:.2f}",
        **{f"time of a frame by the clock: {stage}": f"{ms:.2f} ms" for stage, ms in stages_ms(live).items()},
    }


def _section(reference_map: ReferenceMap, live: DaemonDrive, review: Review) -> report.Section:
    plot = to_png(route(reference_map, review))
    drawn = [report.Figure(f"{live.name}_route", "The route from above, with the positions sent", plot)]
    return report.Section(_name(live), figures=drawn, pictures=_pairs(reference_map, review))


def _curves(lives: list[DaemonDrive], reviews: list[Review]) -> report.Figure:
    found = {_name(live): precision_recall(review.answers) for live, review in zip(lives, reviews, strict=True)}
    plot = figures.precision_recall_plot(found, least=0.9)
    return report.Figure("precision_recall", "Every confidence", plot, "Over all used frames, the warm-up included.")


def _pairs(reference_map: ReferenceMap, review: Review) -> list[list[report.Picture]]:
    """Frames beside the places that they were matched to."""
    feed = read_feed(reference_map.path.with_suffix(""))  # the demo keeps the feed beside the map made of it
    images = FeedImages(feed)
    pairs = []
    for row, picture in review.pictures.items():
        seen = review.seen[row]
        if seen.map_row is not None:
            matched_to = (
                f"matched to place {seen.place}: {review.error_m[row]:.1f} m off, confidence {seen.confidence:.2f},"
                f" {seen.direction}"
            )
            here = report.Picture.of(picture, f"at {review.route_m[row]:.0f} m")
            pairs.append([here, report.Picture.of(images.read(seen.map_row), matched_to)])
    return pairs


def route(reference_map: ReferenceMap, review: Review) -> Figure:
    """The map's route from above, with the fixes."""
    places = reference_map.places
    fixed = [
        (seen, error_m)
        for seen, error_m in zip(review.seen, review.error_m, strict=True)
        if seen.emitted and seen.lat_deg is not None
    ]
    lat = np.concatenate([places["lat_deg"], [seen.lat_deg for seen, _ in fixed]]).astype(float)
    lon = np.concatenate([places["lon_deg"], [seen.lon_deg for seen, _ in fixed]]).astype(float)
    road_m, fixes_m = np.split(east_north(lat, lon), [len(places)])
    right = np.array([error_m <= TOLERANCE_M for _, error_m in fixed], dtype=bool)
    return figures.route_plot(road_m, fixes_m[right], fixes_m[~right], np.zeros((0, 2)), TOLERANCE_M)
