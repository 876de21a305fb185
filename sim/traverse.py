"""A feed as the places of a traverse: the frames that the sampling chooses, with the distance driven so far.

What the daemon knows of its vehicle without a place, its course and whether it has turned around, follows from the
positions here. A dead reckoning position is not given: by its positions a recording is judged.
"""

from __future__ import annotations

import logging
import math
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from edge.camera.picture_check import PictureFaultDetector
from edge.config import Config, DescriptorConfig, SamplingConfig
from edge.descriptor.model_file import network_of_map
from edge.errors import FeedError, FrameError
from edge.feed.format import FeedRow
from edge.feed.reader import Feed, FeedImages, Frame
from edge.feed.sampling import Sampler
from edge.geodesy import east_north
from edge.localization.dead_reckoning import Odometry, TurnAround
from edge.recognition.recognizer import PlaceRecognizer
from edge.reference_map import MapHeader
from edge.sequence import MotionPrior, PlaceMatch

COURSE_M = 5.0
"""As positions once a second are some meters apart. Twice as far, a turn of 8 m radius is cut by up to 12 degrees."""
USUAL_MOST = 90.0  # percent of the steps of a drive that are not faster
log = logging.getLogger(__name__)


def is_local(feed: Feed) -> bool:
    """Whether its positions are meters from an origin of their own."""
    rows = feed.rows
    return any(one.position_source == "local" or (one.lat_deg is None and one.extra.get("local_x_m")) for one in rows)


def check_origins(query: Feed, others: Collection[str], *, are_local: bool) -> None:
    """FeedError where local positions would be compared with those of other recordings, by name, that are elsewhere."""
    own = query.header.origin or query.header.name
    if not any(row.lat_deg is not None or row.extra.get("local_x_m") for row in query.rows):
        return  # there is nothing to compare
    if is_local(query) != are_local or (are_local and own not in others):
        raise FeedError(
            f"{query.path / 'feed.toml'}: positions in meters from an origin of their own are compared only with those"
            f' from the same one. If it is that of {", ".join(sorted(others))}, set origin = "{min(others)}"'
        )


@dataclass(frozen=True)
class TraverseFrame:
    """One chosen frame, its row of the feed, meters driven since the first row (None where unknown).

    missed: places passed before it without a frame of the feed. course_rad: of the newest frames, None where that is
    not known. has_turned: whether it now drives back where it came from, see `TurnAround`. was_blind: whether the
    camera showed nothing before it for so long that the daemon begins anew.
    """

    frame: Frame
    row: FeedRow
    distance_m: float | None
    missed: int = 0
    course_rad: float | None = None
    has_turned: bool = False
    was_blind: bool = False

    def match(self, recognizer: PlaceRecognizer) -> PlaceMatch | None:
        """What the daemon would recognize; frames come in order."""
        if self.was_blind:
            recognizer.reset()
        if self.has_turned:
            recognizer.begin_way_back()
        travel = MotionPrior(self.distance_m, self.missed, course_rad=self.course_rad)
        return recognizer.observe(self.frame.image, self.frame.stamp_ns, travel)


def config_as_mapped(header: MapHeader) -> Config:
    """The default settings with network, width of the regions and sampling as a map has them."""
    descriptor = DescriptorConfig(model=network_of_map(header.model.name), region_width=header.regions.width)
    return Config(descriptor=descriptor, sampling=header.sampling)


def traverse(
    feed: Feed, sampling: SamplingConfig, *, must_have_distance: bool = False, faults: Counter[str] | None = None
) -> Iterator[TraverseFrame]:
    """The chosen frames in order, without those whose images show nothing or do not move while the vehicle does.

    Unreadable images are skipped, each with a line in the log. faults: counts the others by what the daemon says.

    FeedError if `must_have_distance` and neither distance_m nor positions are in every row.
    """
    distances_m = driven_m(feed)
    if distances_m is None and must_have_distance:
        raise FeedError(
            f"{feed.path}: no distance_m and no positions in every row, so frames cannot be chosen by"
            " distance; use --spacing-frames or --interval-s"
        )
    sampler, turn_around, ground_m = Sampler(sampling), TurnAround(), _ground_m(feed)
    detector, was_blind, speeds_mps = PictureFaultDetector(Config().gates.min_speed_mps), False, _speeds_mps(feed)
    with closing(FeedImages(feed)) as images:
        for index, row in enumerate(feed.rows):
            try:
                image = images.read(index)
            except FrameError as error:
                log.warning("%s; skipped", error)
                continue
            fault = detector.check(image, row.stamp_ns, speeds_mps[index])
            if fault is not None:
                was_blind |= fault.sure
                if faults is not None:
                    faults[fault.what] += 1
                continue
            distance_m = distances_m[index] if distances_m else None
            if sampler.is_place(row.stamp_ns, distance_m):
                east_m, north_m = ground_m[index]
                where = None if math.isnan(east_m) else Odometry(0, east_m, north_m)
                turned = turn_around.add(where)
                frame = Frame(image, row.stamp_ns, index)
                yield TraverseFrame(frame, row, distance_m, sampler.missed, turn_around.course_rad, turned, was_blind)
                was_blind = False


def _speeds_mps(feed: Feed) -> list[float]:
    """At each row since the one before; 0 where nothing says that the vehicle moves."""
    stamps_s, driven = [row.stamp_ns / 1e9 for row in feed.rows], driven_m(feed)
    if driven is None or len(driven) < 2:
        return [0.0] * len(feed.rows)
    return [0.0, *(np.diff(driven) / np.maximum(np.diff(stamps_s), 1e-3)).tolist()]


def _ground_m(feed: Feed) -> list[list[float]]:
    """Meters east and north of each row, NaN where it has no position."""
    degrees = [(row.lat_deg, row.lon_deg) for row in feed.rows]
    found: list[list[float]] = east_north(*np.array(degrees, dtype=np.float64).reshape(-1, 2).T).tolist()
    return found


def with_course(feed: Feed) -> Feed:
    """The feed; where under half of its positions have a heading, with their course as all headings.

    A row's course is the way from COURSE_M before to COURSE_M behind it. It is unknown where that is less than half as
    far as was driven: the vehicle stood, and its positions wandered. It is wrong by half a turn where it backed up.
    """
    ground_m = np.array(_ground_m(feed))
    known = np.flatnonzero(np.isfinite(ground_m[:, 0]))
    headed = sum(feed.rows[row].heading_deg is not None for row in known.tolist())
    if len(known) < 2 or 2 * headed >= len(known) or feed.header.heading_is_course:
        return feed
    at_m = ground_m[known]
    along_m = np.concatenate([[0.0], np.hypot(*np.diff(at_m, axis=0).T).cumsum()])
    ends_m = np.stack([along_m - COURSE_M, along_m + COURSE_M]).clip(0, along_m[-1])
    moved_m = np.diff([[np.interp(one, along_m, axis) for axis in at_m.T] for one in ends_m], axis=0)[0]
    goes = 2 * np.hypot(*moved_m) > np.diff(ends_m, axis=0)[0]
    rows = [replace(row, heading_deg=None) for row in feed.rows]
    for row, course_deg in zip(known[goes].tolist(), np.degrees(np.arctan2(*moved_m[:, goes])).tolist(), strict=True):
        rows[row] = replace(rows[row], heading_deg=course_deg % 360)
    return replace(feed, rows=tuple(rows), header=structs.replace(feed.header, heading_is_course=True))


def has_odometer(feed: Feed) -> bool:
    """Whether `driven_m` and the headings were measured: a row that lacks its distance has one by the positions."""
    header = feed.header
    return header.odometer and not header.heading_is_course and all(row.distance_m is not None for row in feed.rows)


def whole_sigma_m(feed: Feed) -> float | None:
    """What all positions are off by together along the drive, by the times of its pictures; None where not known.

    One standard deviation, at the speed that is exceeded in a tenth of the steps.
    """
    sigma_s, distances_m = feed.header.time_sigma_s, driven_m(feed)
    if not sigma_s or distances_m is None or len(feed.rows) < 2:
        return sigma_s
    steps_s = np.diff([row.stamp_ns for row in feed.rows]) / 1e9
    return round(sigma_s * float(np.percentile(np.diff(distances_m) / steps_s, USUAL_MOST)), 2)


def driven_m(feed: Feed) -> list[float] | None:
    """Meters driven at each row: as recorded, else summed up between positions, else None."""
    recorded = [row.distance_m for row in feed.rows if row.distance_m is not None]
    if len(recorded) == len(feed.rows):
        return recorded
    positions = [(row.lat_deg, row.lon_deg) for row in feed.rows if row.lat_deg is not None and row.lon_deg is not None]
    if len(positions) < len(feed.rows):
        return None
    steps = np.diff(east_north(*np.array(positions).T), axis=0)
    return [0.0, *np.hypot(*steps.T).cumsum().tolist()]


def distances_m(feed: Feed, rows: Sequence[int], driven: Sequence[float] | None) -> tuple[NDArray[np.float64], str]:
    """Meters driven, else seconds, at some rows of a feed, and the unit."""
    if driven is not None:
        return np.array([driven[row] for row in rows]), "m"
    return np.array([(feed.rows[row].stamp_ns - feed.rows[0].stamp_ns) / 1e9 for row in rows]), "s"
