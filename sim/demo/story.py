"""The demo's story: out by day with two cameras, GPS fails at the far end, home at night on the map just made."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from tqdm import tqdm

from edge.config import FIRST_NETWORK
from edge.descriptor.network import Network
from edge.errors import LookbackError
from edge.journal.records import PlaceFix
from sim.evaluation import report
from sim.evaluation.figures import to_png
from sim.journal import records_of
from sim.trial.draft import Draft, home_at_night
from sim.trial.records import ARRIVED_M, LANE_M, MOST_SIGMAS, TrialRun, TruthTrack, lane_off_m
from sim.trial.run import JOURNAL, TrialDrive, map_scenario
from sim.trial.simulation import UP_S
from sim.trial.views import RoadLibrary, RoadViews
from sim.vehicle.position_inputs import east_north_m
from sim.vehicle.protection import LIMIT_M

SEED, WORLD, LENGTH_M = 1, 21, 560.0
BAR = "{l_bar}{bar}| {n:.0f} of {total:.0f} m [{elapsed}<{remaining}]"
PAIRS = 3  # matched pictures in the report
STARTS_S = 1000.0 + UP_S
"""The simulated clock when the vehicle sets off."""
NO_LEVEL = (
    " No protection level was below that: it bounds the error at a risk of 0.001 an hour, and one mapped drive of this"
    " length has too few independent stretches for that (docs/integrity.md)."
)
GREEN, GRAY, RED, BLUE = "#2a8f4f", "#9aa3ad", "#c0392b", "#1f6fb4"


def laid() -> Draft:
    """The story before it is driven."""
    draft = home_at_night(SEED, LENGTH_M, WORLD)
    draft.keypoints = True
    return draft


def drive_story(folder: Path) -> TrialRun:
    """Drive it with the daemon and once more without, in simulated time; views and journal stay in `folder`.

    A bar counts the meters of the first one, on a terminal.
    """
    folder.mkdir(parents=True, exist_ok=True)
    draft = laid()
    # The daemon warns of the GPS loss that the story is about.
    logger = logging.getLogger("edge")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with (
            closing(RoadLibrary(Network.load(Path(FIRST_NETWORK)), folder / "views")) as library,
            tqdm(total=draft.legs[-1].to_m, unit="m", desc="driving", disable=None, bar_format=BAR) as bar,
        ):
            return TrialDrive(draft, SEED, folder, library).run(partial(_progress, bar, draft.legs[-1].to_m))
    finally:
        logger.setLevel(level)


def _progress(bar: Any, length_m: float, meters: float) -> None:
    """The bar on a terminal; elsewhere a line for each tenth of the way."""
    before = bar.n
    bar.update(meters)
    if bar.disable:
        bar.n = before + meters
        if int(10 * bar.n / length_m) > int(10 * before / length_m):
            print(f"driven {bar.n:.0f} of {length_m:.0f} m", flush=True)


def lost_at_m(run: TrialRun) -> float:
    """Meters driven when GPS failed."""
    return float(run.track.along_m[~run.track.gps][0])


def headline(run: TrialRun) -> str:
    """The one number: how far from its lane the vehicle drove without GPS."""
    return f"95 % within {lane_off_m(run.track):.1f} m of its lane; {lane_off_m(run.alone):.1f} m without Lookback"


def median_95(errors_m: Sequence[float] | NDArray[np.float64]) -> str:
    """Of some errors, in words; a dash where there is none."""
    return f"{np.median(errors_m):.1f} m / {np.percentile(errors_m, 95):.1f} m" if len(errors_m) else "–"


def sections_of(run: TrialRun) -> list[report.ReportSection]:
    """The story in the report: what happened, the map, the numbers."""
    text = (
        f"A vehicle drives {lost_at_m(run):.0f} m out by day. Its rear camera makes the map on the way. At the far"
        " end GPS fails. The vehicle turns around and drives home at night. Its autopilot steers by its own estimate;"
        " at the places that the front camera recognizes, Lookback sends it a position. Then the same drive without it."
    )
    lost_m, first_m = lost_at_m(run), run.first_after_m
    errors_m, sigma_m = run.sent.error_m, run.sent.sigma_m
    ours, alone = run.track, run.alone
    rows: list[list[report.Cell]] = [
        ["GPS failed after", f"{lost_m:.0f} m", f"{lost_m:.0f} m"],
        ["first position after the failure", f"{first_m:.0f} m further on", "none"],
        ["positions sent", f"{len(errors_m)}", "none"],
        ["their error, median / 95 %", median_95(errors_m), "–"],
        ["largest standard deviation sent", f"{sigma_m.max(initial=0.0):.1f} m", "–"],
        ["largest error, in standard deviations", f"{run.sent.sigmas.max(initial=0.0):.1f}", "–"],
        [f"protection level below {LIMIT_M:.0f} m", f"{100 * run.available:.0f} % of the way home", "never"],
        ["beside the lane without GPS, 95 %", f"{lane_off_m(ours):.1f} m", f"{lane_off_m(alone):.1f} m"],
        ["ended from where it should", f"{ours.end_off_m:.1f} m", f"{alone.end_off_m:.1f} m"],
    ]
    note = "Simulated; errors by the truth." + NO_LEVEL * (not run.available)
    table = report.Table("story", "", ("", "with Lookback", "without"), rows, note)
    figure = report.Figure("story_map", "True tracks", to_png(picture(run)))
    return [
        report.ReportSection("Take me home", text, figures=[figure]),
        report.ReportSection("Of the way home", tables=[table]),
    ]


def picture(run: TrialRun) -> Figure:
    """The true tracks from above, and beside it how far from its lane the vehicle was on the way home."""
    figure = Figure(figsize=(9.0, 4.6), layout="constrained")
    above, beside = figure.subplots(1, 2, width_ratios=(3, 2))
    lost_s = run.track.time_s[~run.track.gps][0]
    ours, alone = true_track(run, run.track), true_track(run, run.alone)
    out = run.track.time_s < lost_s
    above.plot(*ours[out].T, color=GRAY, lw=4, label="out by day, with GPS")
    above.plot(*alone[run.alone.time_s >= lost_s].T, color=RED, lw=1.5, label="home at night without Lookback")
    above.plot(*ours[~out].T, color=GREEN, lw=1.8, label="home at night with Lookback")
    sent_s = run.sent.time_s[run.sent.time_s >= lost_s]
    sent = np.stack([np.interp(sent_s, run.track.time_s, ours[:, axis]) for axis in (0, 1)], axis=1)
    above.plot(*sent.T, "o", color=BLUE, ms=3.5, label="here a position was sent")
    above.plot(*ours[~out][0], "x", color="black", ms=9, mew=2, label="GPS fails")
    above.set(xlabel="east, m", ylabel="north, m")
    above.set_aspect("equal", adjustable="datalim")
    lost_m = lost_at_m(run)
    for track, color in ((run.alone, RED), (run.track, GREEN)):
        lost = ~track.gps
        beside.plot(track.along_m[lost] - lost_m, track.cross_track_m[lost], color=color, lw=1.8)
    beside.axhline(0.0, color=GRAY, lw=1)
    beside.set(xlabel="driven without GPS, m", ylabel="left of the lane, m")
    figure.legend(loc="outside lower center", ncols=3, fontsize=9, frameon=False)
    return figure


def recognized(run: TrialRun, folder: Path) -> list[tuple[float, NDArray[np.float64]]]:
    """Places of the way home, from the journal in `folder`: seconds since it set off; meters east and north (2,)."""
    return [
        (one.stamp_ns / 1e9 - STARTS_S, np.array(east_north_m(one.lat_deg, one.lon_deg)))
        for one in records_of(folder / JOURNAL, PlaceFix)
        if one.lat_deg is not None and one.lon_deg is not None and one.direction == "reverse"
    ]


def picture_at(day: RoadViews, place_m: NDArray[np.float64]) -> NDArray[np.uint8]:
    """What the map's camera saw (H, W, 3) where its drive passed a place (2,)."""
    route_m = np.arange(0.0, day.drive.route.length_m)
    road_m = np.array([day.drive.route.at(at_m, 0.0)[:2] for at_m in route_m])
    return day.picture(float(route_m[np.hypot(*(road_m - place_m).T).argmin()]))


def pairs_of(run: TrialRun, folder: Path) -> report.ReportSection:
    """What the camera saw at night beside the places that were recognized; `folder` has the journal and the views."""
    draft, places = laid(), recognized(run, folder)
    pairs = []
    with closing(RoadLibrary(Network.load(Path(FIRST_NETWORK)), folder / "views")) as library:
        night, day = library[draft.home], library[map_scenario(draft.home)]
        for index in np.linspace(0, len(places) - 1, PAIRS).round().astype(int) if places else ():
            time_s, place_m = places[index]
            at_m = float(np.interp(time_s, run.track.time_s, run.track.along_m))
            left_m = float(np.interp(time_s, run.track.time_s, run.track.cross_track_m))
            here = night.picture(float(draft.way.route_m[int(at_m)]), left_m)
            driven = f"home at night, {at_m - lost_at_m(run):.0f} m after GPS failed"
            there = report.Picture.of(
                picture_at(day, place_m), "the place that it recognized, seen by day, looking back"
            )
            pairs.append([report.Picture.of(here, driven), there])
    return report.ReportSection("Recognized places", pictures=pairs)


def true_track(run: TrialRun, track: TruthTrack) -> NDArray[np.float64]:
    """East and north in meters, (N, 2), of a track of the story."""
    way = laid().way
    return np.array([way.at(a, left)[:2] for a, left in zip(track.along_m, track.cross_track_m, strict=True)])


def require_good(run: TrialRun) -> None:
    """LookbackError unless the vehicle came home in its lane and no position was beyond its claim (smoke test)."""
    found = {
        f"ended {run.track.end_off_m:.1f} m off": run.track.end_off_m <= ARRIVED_M,
        f"95 % of cross-track {lane_off_m(run.track):.1f} m": lane_off_m(run.track) <= LANE_M,
        f"a position {run.sent.sigmas.max(initial=0.0):.1f} sigma off": bool((run.sent.sigmas <= MOST_SIGMAS).all()),
        "no position": len(run.sent.time_s) > 0,
    }
    wrong = [what for what, is_good in found.items() if not is_good]
    if wrong:
        raise LookbackError(f"take me home: {', '.join(wrong)}: not good enough")
