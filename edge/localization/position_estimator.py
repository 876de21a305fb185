"""Where the vehicle is, and whether that may be published: the one door to all that follows from a drive's events.

    update(t_ns, event)   the only way in: see `events`
    fix(t_ns, limits)     a position, or why there is none; asking changes nothing

All of it, in the order in which it came, is the list of the drive, which listeners get.

    ImageProcessed -> tracker -> GPS by the places -> observed evidence
    AutopilotState -> what aided the vehicle's position last
    fix            -> `decide` -> Fix | NoFix

Pure: no link, no clock, no file. Daemon, trial and the replays of recorded drives use it alike.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from msgspec import Struct

from edge.config import Config
from edge.geodesy import heading_between
from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import Odometry
from edge.localization.decide import NoFix, StateEstimate, decide
from edge.localization.events import (
    AutopilotState,
    Discontinuity,
    Event,
    ExternalPosition,
    Fix,
    FixFeedback,
    FixRequest,
    ImageProcessed,
    MapUpdate,
    OdometryUpdate,
)
from edge.localization.evidence import EvidenceHistory
from edge.localization.fused_poses import FixCandidate
from edge.localization.gps_monitor import GpsMonitor, GpsVerdict
from edge.localization.integrity import fix_likelihood
from edge.localization.position_aiding import PositionAiding
from edge.localization.sequence_match import Georeferencer
from edge.localization.tracker import Tracker
from edge.reference_map import Route
from edge.sequence import DeadReckoningPosition

KEPT_HEADINGS, HEADINGS_APART_NS = 128, 250_000_000
"""Of the autopilot: as many as come within 3 s at 40 Hz, and how far from an exposure the nearest may be."""


class FixResult(Struct, frozen=True, tag="Asked", rename={"request": "limits"}):
    """A position was asked for, and this was the answer: changes nothing, and can be compared."""

    request: FixRequest
    answer: Fix | NoFix


Entry: TypeAlias = Event | FixResult
"""Of the list of a drive."""
Listener: TypeAlias = Callable[[int, Entry], object]
"""Gets an entry, and its time in ns of CLOCK_MONOTONIC."""


@dataclass(frozen=True)
class EstimatorState:
    """What the events so far show, for those who publish it.

    position: at the exposure of the last match that passed the innovation test, None while the vehicle is lost. gps:
    by the places, "faulty" until it is consistent again. ignores_gps: whether positions are published as if GPS were
    lost. own_sigma_m: one standard deviation of the autopilot's own position, None where nothing has aided it.
    is_bounded: whether GPS or a fix of ours has aided that since the autopilot's boot. rests_on_fixes: whether a fix
    may have moved it since GPS aided it last. heading_error: see `Tracker`.
    """

    position: PlaceFix | None
    gps: GpsVerdict
    ignores_gps: bool
    own_sigma_m: float | None
    is_bounded: bool
    rests_on_fixes: bool
    heading_error: tuple[float, float] | None


class PositionEstimator:
    """Follows one vehicle, one event after another."""

    def __init__(self, config: Config, *listeners: Listener) -> None:
        self._config, self._listeners = config, listeners
        self._georeferencer: Georeferencer | None = None
        self._tracker: Tracker | None = None
        self._gps = GpsMonitor(config.gates)
        self._claims = EvidenceHistory(config.gates)
        self._aiding = PositionAiding(config.gates.drift_percent / 100)
        self._own = AutopilotState()
        self._headings: deque[tuple[int, float]] = deque(maxlen=KEPT_HEADINGS)  # the autopilot's: stamp, degrees
        self._moved: Odometry | None = None
        self._exposed: Odometry | None = None  # at the newest exposure with a position
        self._motion: Odometry | None = None  # at the newest frame
        self._is_recognized, self._velocity_error = False, 0.0
        self._known: EstimatorState | None = None  # since the newest event

    def update(self, t_ns: int, event: Event) -> None:
        """Use what happened; t_ns: when that was known, CLOCK_MONOTONIC."""
        self._publish(t_ns, event)
        self._known = None
        match event:
            case ImageProcessed():
                self._use_frame(event)
            case AutopilotState():
                self._use_own(t_ns, event)
            case OdometryUpdate():
                self._moved = event.motion
            case FixFeedback():
                self._aiding.use_fix(t_ns, event.fix, self._own)
                self._claims.contradict_nothing()
            case ExternalPosition():
                self._aiding.use_external(event, self._own)
                self._claims.contradict_nothing()
            case Discontinuity(kind="reboot"):
                self._aiding.restart()
                self._headings.clear()
            case Discontinuity():
                self._is_recognized = False
                if event.kind == "carried":
                    self._aiding.doubt_gps()
                if self._tracker is not None:
                    self._tracker.reset()
                self._gps.reset()
            case MapUpdate():
                self._use_maps(event)

    def fix(self, t_ns: int, limits: FixRequest) -> Fix | NoFix:
        """A position that may be published at a moment, or why none may."""
        known = self._estimate(self._asked(t_ns, limits))
        answer = decide(t_ns, known, limits, self._config.gates)
        self._publish(t_ns, FixResult(limits, answer))
        return answer

    def _publish(self, t_ns: int, entry: Entry) -> None:
        for listener in self._listeners:
            listener(t_ns, entry)

    @property
    def route(self) -> Route:
        """The drives of the maps that are searched."""
        assert self._georeferencer is not None
        return self._georeferencer.route

    @property
    def pose_ns(self) -> int | None:
        """The exposure of the newest keypoint pose, or structure, that may be a measurement; None without one."""
        place = None if self._tracker is None else self._tracker.pose().place
        return None if place is None else place.stamp_ns

    @property
    def state(self) -> EstimatorState:
        """What the events so far show."""
        if self._known is None:
            aiding, gps = self._aiding, self._gps
            position, heading_error = None, None
            if self._tracker is not None:
                position, heading_error = self._tracker.at_exposure(), self._tracker.heading_error
            of_own = aiding.own_sigma_m(self._own), aiding.is_bounded, aiding.rests_on_fixes
            self._known = EstimatorState(position, gps.verdict, gps.is_ignored, *of_own, heading_error)
        return self._known

    def dead_reckoning_position(self, motion: Odometry | None) -> DeadReckoningPosition | None:
        """Where the vehicle is at a displacement by GPS and its motion alone; None where that cannot be relied on."""
        return self._aiding.dead_reckoning_position(motion, self._own)

    def _use_maps(self, event: MapUpdate) -> None:
        """Follow the vehicle along their drives; what is known of GPS and of the autopilot stays."""
        if event.has_grown and self._georeferencer is not None:
            self._georeferencer.route.grow(event.map_set)
            return
        self._georeferencer = Georeferencer(Route(event.map_set), self._config)
        self._tracker = Tracker(self._georeferencer, self._config)
        self._tracker.follows_gps = not self._gps.is_wrong
        self._gps.use_maps(self._georeferencer.route, self._config.rig)

    def _use_frame(self, frame: ImageProcessed) -> None:
        assert self._tracker is not None and self._georeferencer is not None
        match = frame.match
        self._is_recognized = match is not None and match.accepted
        tracker, believed = self._tracker, self._gps.believed(self._own)
        before = self._motion
        yaw_rad = self._yaw_rad(frame.stamp_ns)
        with_pose = None if match is None else self._georeferencer.pose_measurement(match, yaw_rad)
        tracker.may_leave_gps = self._own.fuses_poses and self._config.gates.doubted_gps == "switch"
        is_compared = tracker.update(frame, with_pose, believed, yaw_rad)
        driven_m = 0.0 if before is None or frame.motion is None else math.hypot(*frame.motion.since(before))
        self._motion, was_wrong = frame.motion, self._gps.is_wrong
        if frame.in_line and self._gps.update(frame, tracker, believed, driven_m, is_compared=is_compared):
            tracker.doubt_scale()
        # GPS aids the autopilot's position while nothing speaks against GPS.
        if believed.position is not None and believed.gps_sigma_m is not None and not self._gps.is_doubted:
            tracker.bind()
        elif self._own.gps == "not healthy":  # else its filter may still go by GPS
            tracker.lose_gps(None if self._gps.is_doubted else self._own.scale)
        fix = self._tracker.at_exposure()
        self._aiding.drift = self._drift(fix)
        if fix is not None and fix.stamp_ns == frame.stamp_ns:
            self._exposed = frame.motion
            # By votes alone: dead reckoning would else be evidence for a place that it made credible.
            if match is not None and match.alone.accepted and match.alone.place_index == match.place_index:
                self._observe(fix, frame.motion)
        self._judge_gps(was_wrong=was_wrong)

    def _yaw_rad(self, stamp_ns: int) -> float | None:
        """The autopilot's heading at an exposure; None where it has reported none around then."""
        last = min(bisect_left(self._headings, (stamp_ns,)), len(self._headings) - 1)
        if last < 1 or abs(stamp_ns - self._headings[last][0]) > HEADINGS_APART_NS:
            return None
        (before_ns, before_deg), (after_ns, after_deg) = self._headings[last - 1], self._headings[last]
        return math.radians(heading_between(before_deg, after_deg, (stamp_ns - before_ns) / (after_ns - before_ns)))

    def _drift(self, fix: PlaceFix | None) -> float:
        """Of dead reckoning, by what GPS and places have shown of the velocity; fix: the newest."""
        shown = None if self._tracker is None else self._tracker.velocity_errors
        if fix is not None:
            self._velocity_error = fix.velocity_error
        return max(shown or (self._config.gates.drift_percent / 100, self._velocity_error))

    def _observe(self, fix: PlaceFix, motion: Odometry | None) -> None:
        """Keep what a position shows of the places, whether or not it may be published."""
        if motion is None or not fix.is_position or fix.disputed:
            return
        known = self._estimate(FixCandidate(fix, motion))
        innovation = known.aiding.innovation(fix, motion, known.autopilot)
        likelihood, is_shift = fix_likelihood(fix, innovation, known.cross_track)
        self._claims.observe(fix, motion, likelihood, may_be_shifted=is_shift)

    def _judge_gps(self, *, was_wrong: bool) -> None:
        """Use the newest verdict on GPS; once it is wrong, the vehicle is where GPS has it, less its error."""
        if self._gps.is_wrong and not was_wrong:
            # What GPS has contradicted so far is not contradicted any more.
            self._aiding.call_gps(self._gps.verdict.off_m)
            self._claims.contradict_nothing()
        elif self._gps.is_doubted:
            self._aiding.doubt_gps()

    def _use_own(self, t_ns: int, own: AutopilotState) -> None:
        self._own = own
        position, newest_ns = own.position, self._headings[-1][0] if self._headings else -1
        if position is not None and position.heading_deg is not None and position.stamp_ns > newest_ns:
            self._headings.append((position.stamp_ns, position.heading_deg))
        if own.gps_sigma_m is not None and not self._gps.is_wrong:
            self._aiding.use_gps(t_ns, own, is_doubted=self._gps.is_doubted)
            self._claims.contradict_nothing()

    def _asked(self, t_ns: int, limits: FixRequest) -> FixCandidate:
        """What is asked for, without a place where there is none."""
        tracker = self._tracker
        if tracker is None or limits.unable or self._own.is_doubled:
            return FixCandidate()
        if limits.at == "pose" or (limits.at == "now" and limits.moves_autopilot and tracker.has_pose):
            return tracker.pose()
        if limits.at == "now":
            return FixCandidate(tracker.at(t_ns, self._moved, self._yaw_rad(t_ns)), self._moved)
        return FixCandidate(tracker.at_exposure(), self._exposed)

    def _estimate(self, asked: FixCandidate) -> StateEstimate:
        is_blurred = self._is_recognized and self._tracker is not None and self._tracker.at_exposure() is None
        own, cross_track = self._gps.believed(self._own), None if self._tracker is None else self._tracker.cross_track
        return StateEstimate(*asked, own, self._aiding, self._claims, cross_track, is_blurred)
