"""`lookback dev noises`: how far off measurements are on recorded drives, and the estimate that is made of them."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from edge import __version__
from edge.config import Config
from edge.errors import FeedError
from edge.geodesy import moved
from edge.localization import PositionEstimator
from edge.localization.drive_file import read_drive
from edge.localization.events import ImageProcessed, MapUpdate
from edge.localization.position_estimator import Entry, FixResult
from edge.localization.sequence_match import Georeferencer
from edge.reference_map import Route
from sim.research.trial import recorded_drive
from sim.research.trial.flight_score import off_truth
from sim.research.trial.recorded_drive import LINK, RecordedDrive
from sim.research.trial.table import put_between, side_by_side
from sim.trial.records import Array
from sim.vehicle.position_inputs import east_north_m

SECTION = "noises"
LEG_M = 25.0
"""Meters of the way over which a displacement is compared with the truth."""
FEWEST = 20
"""Measurements below which a group has no row."""
APART_M = 40.0
"""Meters of the way after which errors are compared, to show how long they stay."""
AXES = "along-track", "cross-track"
HEADER = "| what | drives | measured | rms | rms for the drive | alike 40 m apart | rms over its sigma |"


Noises = dict[str, list[tuple[float, float, float]]]
"""By kind of measurement on one drive, in its unit: how far off each is, its sigma or NaN, and the meters driven."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback dev noises`."""
    parser.add_argument("lists", type=Path, metavar="LISTS", help="output of `lookback dev flights`, with its lists")
    parser.add_argument("flights", nargs="+", type=Path, metavar="FOLDER", help="the recorded drives, for the truth")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="drives replayed side by side (default 1)")
    parser.add_argument("--page", type=Path, metavar="FILE", help="a page of docs, to write the table into")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    folders = [path.parent for given in args.flights for path in sorted(given.glob(f"**/{LINK}"))]
    drives = [folder for folder in folders if list((args.lists / folder.name).glob("*.drive"))]
    if not drives:
        raise FeedError(
            f"{args.lists}: no list of these drives; `lookback dev flights FOLDER -o {args.lists}` makes it"
        )
    text = table(list(side_by_side(partial(noises_of, args.lists), drives, args.jobs)))
    if args.page is not None:
        names = ", ".join(folder.name for folder in drives)
        made = f"`lookback dev noises LISTS FOLDER` of version {__version__}; {len(drives)} drives: {names}."
        put_between(SECTION, args.page, f"{made}\n\n{text}")
    print(text)
    return 0


def noises_of(lists: Path, folder: Path) -> Noises:
    """Of one drive, from the loss of GPS on."""
    truth, found = recorded_drive.read_drive(folder), Noises()
    for path in sorted((lists / folder.name).glob("*.drive")):
        compare(*read_drive(path), truth, found)
    return found


def compare(config: Config, entries: Iterable[tuple[int, Entry]], truth: RecordedDrive, found: Noises) -> None:
    """Add what the list of a drive has after the loss of GPS."""
    one = _Drive(config, truth, found)
    for t_ns, entry in entries:
        if not isinstance(entry, FixResult):
            one.estimator.update(t_ns, entry)
            if isinstance(entry, MapUpdate):
                one.search(entry)
            elif isinstance(entry, ImageProcessed):
                one.use(entry)


class _Drive:
    """Compares what a drive's list says with the truth."""

    def __init__(self, config: Config, truth: RecordedDrive, found: Noises) -> None:
        self.estimator = PositionEstimator(config)
        self.georeferencer: Georeferencer | None = None
        self._config, self._truth, self._found, self._at_m = config, truth, found, 0.0
        self._firmware = "PX4" if truth.name.startswith("px4") else "ArduPilot"
        self._leg: tuple[float, Array, int, float | None] | None = None

    def search(self, maps: MapUpdate) -> None:
        """Matches are of these from now on."""
        if maps.has_grown and self.georeferencer is not None:
            self.georeferencer.route.grow(maps.map_set)
        else:
            self.georeferencer = Georeferencer(Route(maps.map_set), self._config)

    def use(self, frame: ImageProcessed) -> None:
        """After the estimator has used it."""
        at_s, motion = frame.stamp_ns / 1e9, frame.motion
        if self.georeferencer is None or motion is None:
            self._leg = None
            if self.georeferencer is not None:
                self.georeferencer.clear()
            return
        moved_m = np.array([motion.east_m, motion.north_m])
        doubtful_m = motion.doubtful_east_m, motion.doubtful_north_m
        if frame.in_line:
            self.georeferencer.add(np.array([*moved_m, *doubtful_m, at_s]))
        if at_s <= self._truth.gps_lost_s:
            return
        self._at_m = self._truth.driven_m(at_s)
        self._use_leg(frame, at_s, moved_m, motion.odometry_epoch)
        self._use_match(self.georeferencer, frame, at_s)
        place = self.estimator.state.position
        if place is not None and place.stamp_ns == frame.stamp_ns and place.lat_deg is not None:
            _, *off_m = off_truth(self._truth, east_north_m(place.lat_deg, place.lon_deg or 0.0), at_s)
            for name, one_m, sigma_m in zip(AXES, off_m, (place.sigma_along_m, place.sigma_cross_track_m), strict=True):
                self._add(f"{self._firmware}: estimate {name}, m", one_m, sigma_m)

    def _add(self, kind: str, off: float, sigma: float = math.nan) -> None:
        self._found.setdefault(kind, []).append((off, sigma, self._at_m))

    def _use_leg(self, frame: ImageProcessed, at_s: float, moved_m: Array, leg: int) -> None:
        """Heading and length of a displacement, and by how much gyros drift meanwhile."""
        gyros = None if frame.without_gps is None or frame.without_gps.gyros is None else frame.without_gps.gyros
        compass_rad = None if gyros is None else gyros.compass_rad
        if self._leg is None or self._leg[2] != leg:
            self._leg = at_s, moved_m, leg, compass_rad
            return
        then_s, then_m, _, then_rad = self._leg
        true_m = self._truth.true_m(at_s) - self._truth.true_m(then_s)
        length_m = float(np.hypot(*true_m))
        if length_m < LEG_M:
            return
        step_m = moved_m - then_m
        turned = math.remainder(math.atan2(*step_m) - math.atan2(*true_m), math.tau)
        self._add(f"{self._firmware}: heading of the velocity, degrees", math.degrees(turned))
        self._add(f"{self._firmware}: scale of the velocity, %", 100 * (length_m / float(np.hypot(*step_m)) - 1))
        if compass_rad is not None and then_rad is not None:
            true_deg = self._truth.heading_deg(at_s) - self._truth.heading_deg(then_s)
            off_deg = math.remainder(math.degrees(compass_rad - then_rad) - true_deg, 360.0)
            self._add(f"{self._firmware}: gyros, degrees a second", off_deg / (at_s - then_s))
        self._leg = at_s, moved_m, leg, compass_rad

    def _use_match(self, georeferencer: Georeferencer, frame: ImageProcessed, at_s: float) -> None:
        """A keypoint pose by its covariance and the map's, and a sequence match along-track, at its midpoint."""
        match = frame.match
        if match is None or not match.accepted:
            return
        seen = self._truth.seen(at_s, "front")
        where = f"{seen.light}, {'home' if seen.direction == 'reverse' else 'again'}"
        pose, matched = georeferencer.pose_measurement(match), georeferencer.of(match)
        if pose is not None and pose.pose is not None:
            map_m = math.hypot(pose.errors.map_m, math.sqrt(float(np.trace(pose.errors.whole)) / 2))
            spread = pose.pose.covariance + map_m**2 * np.eye(2)
            for name, off_m in zip(AXES, self._off(georeferencer, pose.pose.position_m, at_s), strict=True):
                self._add(f"keypoint poses {name}, {where}, m", off_m, math.sqrt(float(np.trace(spread)) / 2))
        if matched is not None:
            middle_s = at_s - float(matched.midpoint.since_m[4])
            along_m = self._off(georeferencer, matched.midpoint.place_m, middle_s)[0]
            errors = matched.errors
            sigma_m = math.hypot(errors.stays_m, matched.sigma_factor * errors.changes_m, errors.map_m)
            self._add(f"sequence matches along-track, {where}, m", along_m, sigma_m)

    def _off(self, georeferencer: Georeferencer, position_m: Array, at_s: float) -> tuple[float, float]:
        """Along-track and cross-track error of local meters."""
        assert georeferencer.origin is not None
        where = moved(*georeferencer.origin, float(position_m[0]), float(position_m[1]))
        return off_truth(self._truth, east_north_m(*where), at_s)[1:]


def table(drives: Sequence[Noises]) -> str:
    """A row for each kind: rms, of the drives' means, correlation after APART_M, and rms in standard deviations."""
    rows = [HEADER, "|---" * HEADER.count(" | ") + "|---|"]
    for kind in sorted({kind for one in drives for kind in one}):
        of = [np.array(one[kind]) for one in drives if kind in one]
        off, sigmas, _ = np.concatenate(of).T
        if len(off) < FEWEST:
            continue
        stays = _rms(np.array([one[:, 0].mean() for one in of]))
        ratios = off / sigmas
        within = "-" if np.isnan(ratios).any() else f"{_rms(ratios):.2f}"
        numbers = f"{_rms(off):.2f} | {stays:.2f} | {_alike(of)} | {within}"
        rows.append(f"| {kind} | {len(of)} | {len(off)} | {numbers} |")
    return "\n".join(rows)


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2)))


def _alike(drives: Sequence[Array]) -> str:
    """Correlation of errors APART_M apart, about 0."""
    pairs = []
    for off, _, at_m in (one.T for one in drives):
        after = np.searchsorted(at_m, at_m + APART_M)
        known = after < len(at_m)
        known[known] &= at_m[after[known]] - at_m[known] < 2 * APART_M
        pairs.append(np.stack([off[known], off[after[known]]]))
    first, second = np.concatenate(pairs, axis=1)
    scale = math.sqrt(float(np.sum(first**2)) * float(np.sum(second**2))) if len(first) >= FEWEST else 0.0
    return f"{float(first @ second) / scale:.2f}" if scale else "-"
