"""Drives along a mapped road without pictures: matches with the errors that were measured, and a drifting autopilot.

A drive is simulated at 10 Hz. Matches come from the truth, as the recognizer would give them: a line through the last
frames that were on the map, wrong by a constant bias and by an error that changes over CORRELATED_M, and for a while
also after the vehicle has left the mapped road. The autopilot is the simulated one of `sim.vehicle`: its wheels and its
heading are wrong, it forgets by each reset, as EKF3 does, or fuses a stream of positions, as PX4. The position
estimator gets the events that the daemon would send it, at the same moments, and is asked as the daemon asks; `events`
is their list.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from edge.config import CameraConfig, Config, RigConfig, SequenceConfig
from edge.geodesy import VehiclePosition, east_north_of, moved
from edge.localization import (
    GPS_SIGMA_M,
    DeadReckoning,
    Fix,
    FixRequest,
    GpsFix,
    OdometerCalibration,
    OdometryUpdate,
    PlaceFix,
    ProtectionLevel,
)
from edge.localization.decide import NOT_NEEDED
from edge.localization.events import ImageProcessed
from edge.localization.position_estimator import Entry
from edge.sequence import KeyframeMatch, PlaceMatch
from edge.sequence.consensus import probability
from edge.telemetry.acknowledgements import FixTransmission
from sim import Pose
from sim.vehicle.estimator import Estimator, OdometryErrors, VelocitySource
from sim.vehicle.firmware import FIRMWARES
from tests.localization.events_of import StandIn
from tests.localization.route_course import HOME, SPACING_M, Course, Points, build_maps, lap_line, road_line

STEP_S, LENGTH = 0.1, 40
OPPOSITE_M, SAME_M, STAYS_M = 8.0, 2.5, (2.5, 1.5)
"""Errors of matches along the road where the cameras look opposite ways, as on these drives but those with poses, and
where they look the same way: one standard deviation of what changes, and of what stays. docs/evaluation.md measures
them."""
REVERSE_AHEAD_M = 3.0
"""Of the camera on a drive that the map has the other way: its own mounting and the map's."""
CORRELATED_M, GPS_M, LANE_M = 50.0, 72.0, 0.7
STEERS_S = 1.0
"""In which a driver is where he steers to: faster, the velocity would change as that of no vehicle does."""
OFF_ROAD_M = 9.0  # further from the lane nothing is recognized
POSE_EVERY, POSE_SIGMAS = 4, (0.3, 0.3, math.radians(0.6))  # as on the way home: docs/keypoints.md
TURN_RADIUS_M = 8.0
ARRIVES = 2  # steps from an exposure to the answer to its frame
STREAM_S = 0.2
"""Between the positions of a stream."""
RESETS = FixRequest("exposure", 5.0, is_reset=True)
STREAM = FixRequest("now", 1.0)
Move = tuple[float, Points | None, float]
"""Meters along the road, where the vehicle is if that is not on it, and its signed speed."""


class Bounded(NamedTuple):
    """A position whose place is certain enough: errors along and across, and its protection level."""

    at_m: float
    along_m: float
    cross_track_m: float
    level_along_m: float
    level_cross_track_m: float

    @property
    def is_exceeded(self) -> bool:
        """Whether an error is above its level."""
        return self.along_m > self.level_along_m or self.cross_track_m > self.level_cross_track_m


@dataclass
class Result:
    """What was sent, or was not needed: error over sigma of each, and the meters driven until then.

    off_m: their errors. own_m, alone_m: the autopilot's own error each second, with and without what was sent.
    bounded: see `Bounded`.
    """

    sigmas: list[float] = field(default_factory=list)
    off_m: list[float] = field(default_factory=list)
    known_at_m: list[float] = field(default_factory=list)
    own_m: list[float] = field(default_factory=list)
    alone_m: list[float] = field(default_factory=list)
    bounded: list[Bounded] = field(default_factory=list)


def rng_of(seed: int) -> np.random.Generator:
    """Chance on a drive: first its road is drawn."""
    return np.random.default_rng([seed, 3])


class Bench(StandIn):
    """One seeded drive."""

    def __init__(self, course: Course, seed: int, folder: Path, *, is_stream: bool = False) -> None:
        """is_stream: the autopilot gets a stream of positions, as PX4, and no resets, as ArduPilot."""
        self.course, self.rng, self.is_stream = course, rng_of(seed), is_stream
        rng = self.rng
        if course.laps > 1:
            self.line, self.heading = lap_line(course.road_m, course.laps)
        else:
            self.line, self.heading = road_line(course.road_m, rng)
        sigma_m = course.stretches[0].sigma_m / math.sqrt(2)
        shift = course.map_off_m or tuple(rng.normal(0.0, sigma_m, 2))  # of the map, by the GPS that made it
        stretches = tuple(
            replace(s, east_m=s.east_m + shift[0], north_m=s.north_m + shift[1]) for s in course.stretches
        )
        maps, self.segments = build_maps(folder / f"map{seed}", self.line, self.heading, stretches)
        rig = RigConfig(
            sigma_along_m=SAME_M, sigma_cross_track_m=2.5, look_sigma_m=0.05, look_ahead_reverse_m=REVERSE_AHEAD_M
        )
        camera = CameraConfig(view="rear" if course.poses else "front")
        config = Config(camera=camera, rig=rig, sequence=SequenceConfig(length=LENGTH))
        self.events: list[tuple[int, Entry]] = []
        super().__init__(maps, config, lambda t_ns, entry: self.events.append((t_ns, entry)))
        self.reckoning, self.shown = DeadReckoning(), OdometerCalibration()
        scale = 1 + (rng.normal(0.0, 0.03) if course.scale is None else course.scale)
        heading_deg = rng.normal(0.0, 1.5) if course.heading_deg is None else course.heading_deg
        source: VelocitySource = "velocity sensor" if is_stream else "wheels"
        self.errors = OdometryErrors(source, 1 / scale, heading_deg=-heading_deg)
        self.changes_m, stays_m = (SAME_M, STAYS_M[1]) if course.poses else (OPPOSITE_M, STAYS_M[0])
        self.bias_m = rng.uniform(-1.73, 1.73) * stays_m
        self.wander_m = rng.normal(0.0, self.changes_m)
        self.lane_m = rng.normal(0.0, LANE_M) if course.lane_m is None else course.lane_m
        self.history: list[tuple[int, float] | None] = []
        self.result = Result()
        self.step = 0
        self.lane = self.aims_m = self.sampled_m = self.driven_m = self.steered_m = 0.0
        self.frames: deque[tuple[int, ImageProcessed]] = deque()  # that have not arrived, and the step at which they do
        self.truths: dict[int, Points] = {}  # at each exposure
        self.sent: FixTransmission | None = None
        self.bounded_ns = self.judged_ns = 0
        self.alias_now = False
        self.since_pose = 0

    def run(self) -> Result:
        """The whole drive."""
        self.t_ns = 1000 * 10**9
        self.truth, self.turn_rad = self._point(0.0, 0.0), 0.0
        self.pose = Pose(self.truth[0], self.truth[1], math.degrees(self._heading(0.0)), 0.0, 0.0)
        noise = FIRMWARES["px4" if self.is_stream else "ardupilot"].noise
        self.own_estimate, self.alone = (Estimator(self.pose, self.t_ns / 1e9, self.errors, noise) for _ in range(2))
        off_m = self.rng.normal(0.0, 1.0 if self.course.gps else 20.0, 2).tolist()
        for one in (self.own_estimate, self.alone):
            one.shift(*off_m)
        for s, at, speed_mps in self._moves():
            before, self.truth = self.truth, self._truth(s, at)
            if (self.truth != before).any():  # against the road; a vehicle that reverses looks the way it came
                east_m, north_m = self.truth - before
                self.turn_rad = math.remainder(math.atan2(east_m, north_m) - self._heading(s), math.pi)
            self.driven_m += abs(speed_mps) * STEP_S
            self._step(self.truth - before, speed_mps, s)
        return self.result

    def _moves(self) -> Iterator[Move]:
        """The drive, step by step."""
        course, total = self.course, len(self.line) - 2
        s, step = 0.0, course.speed_mps * STEP_S
        while s < min(total, course.off_at_m):
            yield s, None, course.speed_mps
            s += step
        if not math.isfinite(course.off_at_m):
            return
        off = {"turn": self._turn, "stop": self._stop, "reverse": self._reverse, "ferry": self._ferry}
        s = yield from off[course.off_how.split()[0]](s, float(course.off_how.split()[1]))
        while s < total:
            yield s, None, course.speed_mps
            s += step

    def _turn(self, s: float, degrees: float) -> Generator[Move, None, float]:
        """Off the road to the right by an angle, for 300 m."""
        point, heading, turned, step = self._point(s, 0.0), self._heading(s), 0.0, self.course.speed_mps * STEP_S
        for _ in range(round(300 / step)):
            if abs(turned) < abs(math.radians(degrees)):
                turned += math.copysign(step / TURN_RADIUS_M, degrees)
            point = point + step * np.array([math.sin(heading + turned), math.cos(heading + turned)])
            yield s, point, self.course.speed_mps
        return len(self.line)

    def _stop(self, s: float, seconds: float) -> Generator[Move, None, float]:
        for _ in range(round(seconds / STEP_S)):
            yield s, None, 0.0
        return s

    def _reverse(self, s: float, speed_mps: float) -> Generator[Move, None, float]:
        """Back by 120 m."""
        for back_m in np.arange(0.0, 120.0, speed_mps * STEP_S):
            yield s - back_m, None, -speed_mps
        return s - 120.0

    def _ferry(self, s: float, far_m: float) -> Generator[Move, None, float]:
        """Standing on a ferry for 12 s, and on from there on an unknown road."""
        point, away = self._point(s, 0.0), np.array([far_m, 0.0])
        for share in np.linspace(0.0, 1.0, 120):
            yield s, point + share * away, 0.0
        for further_m in np.arange(0.0, min(400.0, len(self.line) - 2 - s), self.course.speed_mps * STEP_S):
            yield s + further_m, self._point(s + further_m, 0.0) + away, self.course.speed_mps
        return len(self.line)

    def _point(self, s: float, right_m: float) -> Points:
        at = min(int(s), len(self.line) - 2)
        share = s - at
        point = self.line[at] + share * (self.line[at + 1] - self.line[at])
        heading = self._heading(s)
        found: Points = point + right_m * np.array([math.cos(heading), -math.sin(heading)])
        return found

    def _heading(self, s: float) -> float:
        """Between two meters it turns evenly: in steps, a vehicle beside the road would leap in a bend."""
        at = min(int(s), len(self.heading) - 2)
        turns = math.remainder(float(self.heading[at + 1] - self.heading[at]), math.tau)
        return float(self.heading[at]) + (s - at) * turns

    def _truth(self, s: float, at: Points | None) -> Points:
        if at is not None:
            self.on_road, self.right_m = False, 0.0
            return at
        self.on_road = True
        kept = math.exp(-0.8 / 100)
        self.aims_m = kept * self.aims_m + math.sqrt(1 - kept**2) * self.rng.normal(0.0, 0.7)
        self.lane += (self.aims_m - self.lane) * STEP_S / STEERS_S
        right_m = self.lane_m + self.lane
        if self.course.steers:
            # It keeps its own estimate on the lane, so the vehicle is off by what the estimate is wrong across.
            heading = self._heading(s)
            error_m = self.own_estimate.east_m - self.pose.east_m, self.own_estimate.north_m - self.pose.north_m
            cross_track_m = error_m[0] * math.cos(heading) - error_m[1] * math.sin(heading)
            self.steered_m += 0.03 * (-cross_track_m - self.steered_m)
            right_m += self.steered_m
        self.right_m = right_m
        return self._point(s, right_m)

    def _step(self, step: Points, speed_mps: float, s: float) -> None:
        self.step += 1
        self.t_ns = 1000 * 10**9 + round(self.step * STEP_S * 1e9)
        gps = self.course.gps and self.driven_m < GPS_M
        self._move(step, speed_mps, gps=gps)
        self.motion = self.reckoning.displacement(self.t_ns)
        reckoned = {"speed_mps": self.reckoning.speed_mps(self.t_ns), "driven_m": self.reckoning.driven_m(self.t_ns)}
        of_own = {"position": self.position, "scale": self.shown.scale, **reckoned}
        self.report(has_gps=gps, drives_itself=self.course.steers, **of_own)
        self._expose(s, gps=gps)
        if self.frames and self.step >= self.frames[0][0]:
            self.drive.update(self.t_ns, self.frames.popleft()[1])
        if self._is_due():
            self._ask()
        if self.step % 10 == 0 and not gps:
            self.result.own_m.append(self.own_estimate.error_m)
            self.result.alone_m.append(self.alone.error_m)

    def _move(self, step: Points, speed_mps: float, *, gps: bool) -> None:
        """On by a step (2,), which a vehicle that is carried does not measure."""
        stands = speed_mps == 0.0
        moved_m = 0.0 if stands else math.copysign(float(np.hypot(*step)), speed_mps)
        heading_deg = self.pose.heading_deg if stands else math.degrees(math.atan2(*(step * np.sign(speed_mps))))
        driven_m = self.pose.distance_m + abs(moved_m)
        self.pose = Pose(self.truth[0], self.truth[1], heading_deg, moved_m / STEP_S, driven_m)
        found_m = tuple((self.truth + self.rng.normal(0, 0.3, 2)).tolist()) if gps else None
        for one in (self.own_estimate, self.alone):
            one.update(self.pose, self.t_ns / 1e9, found_m)
        self.reckoning.add_velocity(self.t_ns, *self.own_estimate.velocity_mps)
        self.reckoning.add_speed(self.t_ns, self.pose.speed_mps * self.errors.scale, 0)
        self.shown.add_meters(self.t_ns, self.reckoning.total_m or 0.0, self.reckoning.total_m)
        if gps:
            position = self.position
            self.shown.add_fix(self.t_ns, (position.lat_deg, position.lon_deg))

    @property
    def position(self) -> VehiclePosition:
        east_mps, north_mps = self.own_estimate.velocity_mps
        place = moved(*HOME, self.own_estimate.east_m, self.own_estimate.north_m)
        heading_deg, speed_mps = self.own_estimate.heading_deg, math.hypot(east_mps, north_mps)
        return VehiclePosition(self.t_ns, *place, 0.0, heading_deg, speed_mps, north_mps, east_mps)

    def _expose(self, s: float, *, gps: bool) -> None:
        """A frame, where the vehicle is at a new place."""
        distance_m = self.reckoning.distance_m(self.t_ns) or 0.0
        places = math.floor((distance_m - self.sampled_m) / SPACING_M)
        if places < 1:
            return
        self.sampled_m += SPACING_M * places
        self.truths[self.t_ns] = self.truth
        own, self.frame = self.position, {"missed": places - 1}
        fix = GpsFix(own.lat_deg, own.lon_deg, GPS_SIGMA_M) if gps else None
        self.frames.append((self.step + ARRIVES, self.exposed(self._match(s), fix)))

    def _match(self, s: float) -> PlaceMatch | None:
        """The best line through the last frames, as the recognizer would find it."""
        kept = math.exp(-SPACING_M / CORRELATED_M)
        self.wander_m = kept * self.wander_m + math.sqrt(1 - kept**2) * self.rng.normal(0.0, self.changes_m)
        shown = self._shown(s - self.course.late_s * self.course.speed_mps)
        self.history.append(shown)
        del self.history[:-LENGTH]
        last = next((item for item in reversed(self.history) if item is not None), None)
        if last is None:
            return None
        number = last[0]
        frames = [(k, item[1]) for k, item in enumerate(self.history) if item is not None and item[0] == number]
        if len(frames) < LENGTH // 2:
            return None
        k, along = np.array(frames).T
        middle, middle_m = float(k.mean()), float(along.mean())
        slope = float((k - middle) @ (along - middle_m) / ((k - middle) @ (k - middle)))  # least squares
        slope = float(np.clip(slope / SPACING_M, 0.82, 1.2)) * SPACING_M
        end_m = middle_m + slope * (len(self.history) - 1 - middle)
        end_m += self.bias_m + self.wander_m + self.rng.normal(0.0, 0.7)
        first, _, _, places = self.segments[number]
        row = int(np.clip(round(end_m / SPACING_M), 0, places - 1))
        share = len(frames) / LENGTH
        alias, slope = self.alias_now, round(slope / SPACING_M * 50) / 50
        agreement = 0.5 + 0.17 * self.rng.random() if alias else 0.45 + 0.45 * share
        return PlaceMatch(
            first + row, first + row, "forward", "same" if self.course.poses else "swapped",
            slope, 0.5, 1.2, sharpness=0.2, accepted=agreement >= 0.6, confidence=probability(agreement),
            seen=self._seen(shown) if self.course.poses else None,
        )  # fmt: skip

    def _seen(self, shown: tuple[int, float] | None) -> KeyframeMatch | None:
        """By one frame in POSE_EVERY: where the camera is, which looks back as the map's did."""
        self.since_pose += 1
        if shown is None or self.since_pose < POSE_EVERY:
            return None
        self.since_pose, (number, along_m) = 0, shown
        s = self.segments[number][1] + along_m
        if self.course.pose_segments != (0,):
            number = int(self.rng.choice(self.course.pose_segments))
        first, begins_m, last_m, places = self.segments[number]
        row = min(round(abs(s - begins_m) / SPACING_M), places - 1)
        row_m = begins_m + math.copysign(row * SPACING_M, last_m - begins_m)
        back_m = row_m - s - (REVERSE_AHEAD_M if last_m < begins_m else 0.0)
        right_m, ahead_m = self.rng.normal((-self.right_m, back_m), POSE_SIGMAS[0])
        covariance = np.diag(np.square(POSE_SIGMAS))
        turn_rad = self.turn_rad + self.rng.normal(0.0, POSE_SIGMAS[2])
        return KeyframeMatch(first + row + self.course.late_rows, right_m, ahead_m, turn_rad, covariance, 40, 0.9)

    def _shown(self, s: float) -> tuple[int, float] | None:
        """Segment and meters along it of what a frame shows; None for what is not on the map."""
        course = self.course
        self.alias_now = course.alias[0] <= s < course.alias[1]
        if self.alias_now:
            return 0, course.alias_from_m + s - course.alias[0]
        if not self.on_road or abs(self.right_m) > OFF_ROAD_M:
            return None
        if course.laps > 1:
            s %= course.road_m
        for number, (_, begins_m, ends_m, _) in enumerate(self.segments):
            if begins_m <= s <= ends_m:
                return number, s - begins_m
        return None

    def _is_due(self) -> bool:
        period_s = STREAM_S if self.is_stream else self.config.gates.min_interval_s
        last_ns = max(self.judged_ns, 0 if self.sent is None else self.sent.at_ns)
        return self.t_ns - last_ns >= round(period_s * 1e9)

    def _ask(self) -> None:
        if self.is_stream:
            self.drive.update(self.t_ns, OdometryUpdate(self.motion))
        answer = self.drive.fix(self.t_ns, STREAM if self.is_stream else RESETS)
        place = answer.place if isinstance(answer, Fix) else answer.fix
        if place is None or (self.sent is not None and place.stamp_ns == self.sent.place.stamp_ns):
            return
        off_m = _meters(place) - (self.truth if self.is_stream else self.truths[place.stamp_ns])
        if answer.level is not None and place.stamp_ns != self.bounded_ns:
            self.bounded_ns = place.stamp_ns
            self._bound(place, off_m, answer.level)
        if isinstance(answer, Fix):
            self._send(answer, float(np.hypot(*off_m)))
        elif answer.reason == NOT_NEEDED:
            self.judged_ns = self.t_ns
            self._score(place, float(np.hypot(*off_m)))

    def _bound(self, place: PlaceFix, off_m: Points, level: ProtectionLevel) -> None:
        (east_m, north_m), heading_rad = off_m, math.radians(place.heading_deg or 0.0)
        sin, cos = math.sin(heading_rad), math.cos(heading_rad)
        errors_m = abs(east_m * sin + north_m * cos), abs(north_m * sin - east_m * cos)
        self.result.bounded.append(Bounded(self.driven_m, *errors_m, level.along_track_m, level.cross_track_m))

    def _send(self, fix: Fix, off_m: float) -> None:
        """The autopilot fuses a position of a stream, and is reset by another."""
        place = fix.place
        self._score(place, off_m)
        self.sent = FixTransmission(fix, self.t_ns, None)
        self.use(fix)
        at = *_meters(place).tolist(), place.stamp_ns / 1e9, place.sigma_m
        if self.is_stream:
            self.own_estimate.fuse(*at)
        else:
            self.own_estimate.reset(*at)

    def _score(self, place: PlaceFix, off_m: float) -> None:
        self.result.sigmas.append(off_m / place.sigma_m)
        self.result.off_m.append(off_m)
        self.result.known_at_m.append(self.driven_m)


def _meters(place: PlaceFix) -> Points:
    """East and north (2,)."""
    return np.array(east_north_of(place.lat_deg or 0.0, place.lon_deg or 0.0, HOME))
