"""From matches to a position that follows the vehicle on the ground. Pure: no link, no clock.

All that is estimated is in one filter (`filter`), run for each hypothesis of what may be wrong (`hypotheses`). Here
each frame becomes a prediction and its measurements, and the state of the right filter becomes a position: while a
match that passed the innovation test is near, and nothing disputes it. A lost position goes on in the filter by dead
reckoning alone, and is published again once a match passes the test.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np
from msgspec import UNSET
from msgspec.structs import replace

from edge.config import Config
from edge.geodesy import moved
from edge.journal.records import PlaceFix
from edge.localization import measurements
from edge.localization.dead_reckoning import Odometry
from edge.localization.events import GPS_SIGMA_M, AutopilotState, GpsFix, ImageProcessed
from edge.localization.evidence import SPREAD_M, STRETCH_WRONG
from edge.localization.filter import CORRELATION_M, GATE, Filter, FilterStep, left_of
from edge.localization.fused_poses import FIRST, FixCandidate, FusedPoses
from edge.localization.hypotheses import ELSEWHERE_M, FilterBank, Name, Row
from edge.localization.odometer_calibration import AGREE_SIGMAS, NEAR_SIGMAS, ScaleFactor
from edge.localization.sequence_match import Georeferencer, SequenceMatch
from edge.localization.state import (
    COMPASS,
    GPS_M,
    GPS_SHARE,
    HEADING,
    POSITION,
    SCALE,
    DriveErrors,
    Slot,
    Vector,
)
from edge.sequence import LEAST_SHARPNESS, PlaceMatch

if TYPE_CHECKING:
    from edge.localization.structure_agreement import StructureAgreement

STOOD_NS = 10_000_000_000
"""A vehicle without a new frame for so long may have been carried away: no sequence may have a frame from before that.
Without it, vehicles that reversed for long or were ferried were up to 5 and 501 standard deviations off. After 30 s
instead, one that was towed 100 m in 12 s was sent positions 102 m off."""
FAR_M = 1000.0
"""Distance from the origin of local meters at which a new origin is chosen."""
POSE_HOLDS_NS = 1_000_000_000
"""After a keypoint pose, in which a predicted position still has its inliers."""
USUAL = 0.03
"""One standard deviation of the scale of wheels that GPS does not contradict: those of recorded drives are 0.3 to 3 %
wrong, and of 50 m GPS shows it to 3 %."""
DISAGREE = 3
"""Matches in a row that fail the innovation test before positions are disputed: one false match is none."""
SURE = 0.5
"""Confidence of a keypoint pose by itself from which it is evidence; a fainter one corrects, no more. On 31 flights 3 %
of the poses under 0.1 were over 3 m and 4 sigma off, 0.5 % under 0.5, 0.04 % of the others (548, 1,019 and 12,688): in
a bend of road 990, four in a row on each of eight flights, which outvoted where the vehicle was on six."""
CALL = 6.9
"""Logarithm of how much likelier the vehicle is lost, or its wheels slip, before that counts: 1000 to 1."""
BESIDE_M = 6.0
"""Cross-track standard deviation of a lane, for a vehicle that steers itself by its own position: at dusk, matches of
it are off by the vehicle's distance from it. Without it, rms over sigma of simulated positions is 1.4."""
KNOWN_SCALE = 0.015
"""Standard deviation of the odometer's scale up to which it has each frame of a sequence within a place."""
UNDATED_M = 5.0
"""A match whose place is uncertain by more, since its picture has no time, is evidence for no hypothesis."""
GPS_FAR_M = 2 * ELSEWHERE_M
"""GPS that is further off counts as so far off: there is no place for it among the hypotheses."""
MISLED_RAD = math.radians(15)
"""One standard deviation of the heading of an autopilot that followed a faulty GPS: 7 to 18 degrees on six drives."""


class TrackScore:
    """The newest match that passed the innovation test, its time, and meters driven since it and since the first one.

    by_chance: probability that the first one passed by chance. confidence: the greatest of all.
    """

    def __init__(self, by_chance: float) -> None:
        self.newest: SequenceMatch | None = None
        self.stamp_ns, self.matches, self.disagreeing = 0, 0, 0
        self.since_m, self.driven_m, self.confidence = 0.0, 0.0, 0.0
        self.by_chance = by_chance

    def add(self, measured: SequenceMatch, stamp_ns: int) -> None:
        """One more match that passed the test."""
        self.newest, self.stamp_ns, self.since_m, self.disagreeing = measured, stamp_ns, 0.0, 0
        self.matches, self.confidence = self.matches + 1, max(self.confidence, measured.match.confidence)

    @property
    def is_confirmed(self) -> bool:
        """Whether dead reckoning makes its first match as certain as an independent segment of the map, or matches have
        passed the innovation test for a correlation length.

        After a long way without places, false matches pass it too: at dusk, the first one in 500 m moved a recorded
        drive from 20 m off to 41 (fc6, confidence 0.92).
        """
        is_likely = not self.by_chance or (1 - self.confidence) * self.by_chance <= STRETCH_WRONG
        return is_likely or self.driven_m - self.since_m >= CORRELATION_M


class Tracker:
    """Follows the vehicle over the ground along the drives of a map."""

    def __init__(self, georeferencer: Georeferencer, config: Config) -> None:
        self._config, self._georeferencer = config.tracking, georeferencer
        self._assumed = self._config.scale_error_percent / 100
        self.bank = FilterBank(Filter(math.radians(self._config.heading_error_deg), self._assumed))
        self.follows_gps = True
        """Whether GPS counts as a measurement: it was neither declared faulty nor left."""
        self.may_leave_gps = False
        """Whether keypoint poses that contradict GPS are enough to leave it."""
        self._is_bound, self._is_shown = False, False  # by GPS: the position, and the scale of the velocity without it
        self.reset()

    def reset(self) -> None:
        """No frame from before counts (after a blindness, or where the motion is not known), nor where it was."""
        self._georeferencer.clear()
        self.is_checked = False
        """Whether the drive of the newest match moved as its vehicle did."""
        self._is_placed, self._is_begun = False, False  # where the vehicle is: known, or begun at the newest match
        self._gps_m: Vector | None = None
        self._at: ImageProcessed | None = None
        self._bridged_m = 0.0  # the most by which a speed that was bridged may have moved it wrongly by then
        self._yaw_rad: float | None = None  # the autopilot's heading at the newest frame
        self._stamp_sigma_s = -1.0  # of its stamp; none so far
        self._exposure: PlaceFix | None = None
        self._track: TrackScore | None = None
        self._poses = FusedPoses()
        self._structure: StructureAgreement | None = None
        self.cross_track: tuple[float, float] | None = None
        """Cross-track distance of the vehicle by dead reckoning since GPS from the matches' road, and its sigma."""

    def update(
        self,
        frame: ImageProcessed,
        with_pose: SequenceMatch | None,
        own: AutopilotState,
        yaw_rad: float | None = None,
    ) -> bool:
        """Use a frame; whether a place was compared with the state. with_pose: the match with its keypoint pose.

        own: the autopilot's state, as far as it is believed. yaw_rad: its heading at the exposure.
        """
        motion, match, before, yaw_before = frame.motion, frame.match, self._at, self._yaw_rad
        self._yaw_rad = yaw_rad
        if motion is None:
            self.reset()
            return False
        if before is not None and before.motion is not None and motion.odometry_epoch != before.motion.odometry_epoch:
            self._georeferencer.clear()
            self._structure = None
            self._lose_position()
        has_stood = before is None or frame.stamp_ns - before.stamp_ns > STOOD_NS
        if has_stood or frame.missed > self._georeferencer.length // 2:
            self._georeferencer.clear()
        self._at = frame
        if before is not None and before.motion is not None:
            self._move(before, frame, math.remainder((yaw_rad or 0.0) - (yaw_before or yaw_rad or 0.0), math.tau))
        is_undated = self._is_undated(frame.timestamp_sigma_s)
        if frame.in_line:
            self._georeferencer.add(_vector(motion))
        gps_m = self._gps(frame, own)
        self._gps_m = gps_m
        if gps_m is not None and self.follows_gps:
            if not self._is_placed:
                self._place(gps_m)
            measurements.by_gps(self.bank.all, gps_m)
        if before is not None:
            measurements.by_compass(self.bank.all, has_gps=own.gps_sigma_m is not None)
        track = self._track
        if track is not None and self._is_lost(track, frame.stamp_ns, 0.0):
            self._lose_position()
        measured = None
        is_faint = match is not None and with_pose is not None and (seen := match.seen) and seen.confidence < SURE
        is_evidence = match is not None and match.alone.accepted and not is_undated and not is_faint
        if match is not None and match.accepted and not (is_undated and gps_m is not None):
            measured = self._measured(match, with_pose)
        if measured is not None:
            self._use(measured, own, frame.stamp_ns, is_evidence=is_evidence)
        self._use_structure(None if is_undated else match, frame.stamp_ns)
        has_gps = gps_m is not None and self.follows_gps
        self.bank.judge(frame.stamp_ns / 1e9, has_gps=has_gps)
        if not has_gps and self._corrects_itself(frame.stamp_ns) and measured is not None:
            self._add(self._track or TrackScore(0.0), measured, frame.stamp_ns)
        self._choose_origin()
        return measured is not None and is_evidence

    def _is_undated(self, sigma_s: float) -> bool:
        """Use the standard deviation of a stamp; whether the place of its frame is uncertain by more than UNDATED_M."""
        if sigma_s != self._stamp_sigma_s:
            self._stamp_sigma_s = sigma_s
            self.bank.all.expect_age(sigma_s)
        return sigma_s * math.hypot(*self.bank.all.rates[:2]) > UNDATED_M

    def _gps(self, frame: ImageProcessed, own: AutopilotState) -> Vector | None:
        """Where GPS has the vehicle at a frame; None without GPS."""
        gps = frame.gps
        if gps is None and own.gps_sigma_m is not None and own.position is not None:
            gps = GpsFix(*own.position.at(frame.stamp_ns), own.gps_sigma_m)
        if gps is None:
            return None
        self.bank.all.expect_gps(gps.sigma_m * GPS_SHARE)
        gps_m = self._georeferencer.local(gps)
        off_m = gps_m - self.bank.right.position_m
        far_m = float(np.hypot(*off_m)) if self._is_placed and self.follows_gps else 0.0
        return gps_m if far_m <= GPS_FAR_M else self.bank.right.position_m + off_m * (GPS_FAR_M / far_m)

    def _place(self, position_m: Vector) -> None:
        self.bank.right.place(position_m, ELSEWHERE_M**2 * np.eye(2))
        self.bank.begin()
        self._is_placed = True

    def lose_gps(self, shown: ScaleFactor | None) -> None:
        """GPS is lost. shown: what it has shown of the velocity that counts from now on."""
        if self._is_bound and shown is not None:
            usual = min(USUAL, self._assumed)
            is_usual = abs(shown.mean) <= NEAR_SIGMAS * math.hypot(usual, shown.sigma)
            scale = ScaleFactor(0.0, usual if is_usual else self._assumed).and_also(shown)
            self._is_shown = scale.later < self._assumed
            if self._is_shown:
                self.bank.all.expect_scale(scale)
        self._is_bound = False

    def bind(self) -> None:
        """GPS aids the autopilot's position, and corrects its velocity."""
        self._is_bound, self.cross_track = True, None

    @property
    def gps_off_m(self) -> Vector | None:
        """GPS less where the vehicle is, meters (2,); None where one of them is not known."""
        return None if self._gps_m is None or not self._is_placed else self._gps_m - self.bank.right.position_m

    @property
    def gps_from_places_m(self) -> Vector | None:
        """GPS less where places have the vehicle, if they are elsewhere."""
        state = self.bank.of("map elsewhere")
        if self._gps_m is None or state.newest is None:
            return None
        return self._gps_m - state.position_m - state.mean[state.newest.whole]

    @property
    def gps_is_near(self) -> bool:
        """Whether GPS is where the vehicle is, by the standard deviations of both; a spoofing drift is not, at 5 m."""
        off_m, both = self.gps_off_m, self.bank.right.spread + GPS_M**2 * np.eye(2)
        return off_m is not None and float(off_m @ np.linalg.solve(both, off_m)) <= NEAR_SIGMAS**2

    def gps_off(self, name: Name) -> float:
        """How far GPS is from where a hypothesis has the vehicle."""
        return 0.0 if self._gps_m is None else float(np.hypot(*(self._gps_m - self.bank.of(name).position_m)))

    @property
    def has_pose(self) -> bool:
        """Whether there was a keypoint pose within the last CORRELATION_M."""
        return bool(self.bank.right.since_pose_m < CORRELATION_M)

    def call_gps(self, right: Row) -> None:
        """GPS is faulty as a hypothesis has it, and may have turned the heading of the autopilot."""
        self.bank.begin(right)
        self.bank.all.lose_gps()
        self.bank.all.set(COMPASS, 0.0, MISLED_RAD**2)
        self.follows_gps, self._is_shown = False, False
        self._lose_position(self._track)  # the filter that followed GPS had the vehicle there

    def doubt_scale(self) -> None:
        """What GPS has shown of the velocity's scale does not hold."""
        if self._is_shown:
            self._is_shown = False
            self.bank.all.doubt_scale(self._assumed)

    @property
    def velocity_errors(self) -> tuple[float, float] | None:
        """What scale and heading, in radians, are expected to be wrong by; None where GPS has shown nothing of them."""
        if not self._is_shown or self._is_bound:
            return None
        state = self.bank.right
        scale, heading_rad = (math.hypot(state.value(at), state.sigma(at)) for at in (SCALE, HEADING))
        return scale, heading_rad

    @property
    def heading_error(self) -> tuple[float, float] | None:
        """Radians by which the vehicle heads further clockwise than its displacement says, and one standard deviation.

        None without a keypoint pose in the last CORRELATION_M.
        """
        state = self.bank.right
        is_known = self._track is not None and state.since_pose_m < CORRELATION_M
        return (state.value(HEADING), state.sigma(HEADING)) if is_known else None

    def _measured(self, match: PlaceMatch, with_pose: SequenceMatch | None) -> SequenceMatch | None:
        """Where a match has the vehicle: by its keypoint pose, or else by its sequence."""
        if with_pose is not None:
            return with_pose
        # Where another place fits this frame better, the votes know the place, but no sequence ends in this frame.
        if match.uniqueness < 1 or match.sharpness < LEAST_SHARPNESS:
            return None
        return self._georeferencer.of(match)

    def _use(self, measured: SequenceMatch, own: AutopilotState, stamp_ns: int, *, is_evidence: bool) -> None:
        if not self._is_placed:
            self._begin(measured)
        track = self._track or TrackScore(self._by_chance(measured))
        if own.drives_itself:
            lane_m = math.hypot(measured.errors.lane_m, BESIDE_M)
            measured = dataclasses.replace(measured, errors=dataclasses.replace(measured.errors, lane_m=lane_m))
        pose, slot = measured.pose, self.bank.all.slot(measured.drive, measured.errors)
        self._compare_across(measured, slot)
        gps_m, since_pose_m = (self._gps_m if self.follows_gps else None), float(self.bank.right.since_pose_m)
        is_left = pose is not None and is_evidence and self._poses.contradict_gps(pose, gps_m, since_pose_m)
        if is_left and self.may_leave_gps:
            self._leave_gps(measured.errors, slot, stamp_ns)
        if pose is not None:
            is_used = measurements.by_pose(self.bank.all, slot, pose, is_evidence=is_evidence)
        else:
            is_used = measurements.by_sequence(self.bank.all, slot, measured, is_evidence=is_evidence)
        if is_used[0]:  # by the right filter
            self._add(track, measured, stamp_ns)
        else:
            track.disagreeing += 1

    def _leave_gps(self, errors: DriveErrors, slot: Slot, stamp_ns: int) -> None:
        """Begin where the poses are, with what is known of the vehicle, and nothing of what GPS said of the map."""
        self.call_gps("right")
        self.bank.all.set(slot.map, 0.0, errors.map_m**2 * np.eye(2))
        self.bank.all.set(slot.whole, 0.0, errors.whole)
        self.bank.all.widen(POSITION, GPS_SIGMA_M)
        self._poses.leave_gps(stamp_ns)

    def _add(self, track: TrackScore, measured: SequenceMatch, stamp_ns: int) -> None:
        """A match passed the innovation test."""
        self._track, self.is_checked = track, measured.mapped.checked_m > 0
        track.add(measured, stamp_ns)
        if track.is_confirmed and self.cross_track is None:
            self.bank.drop_before()
        if track.matches >= FIRST or measured.pose is None:
            self._exposure = self._fix(track, self.bank.right, stamp_ns, 0.0, self._yaw_rad)
        at, origin = self._at, self._georeferencer.origin
        if measured.pose is not None and at is not None and origin is not None:
            position_m, errors = self._by_stamp(measured.pose.position_m, measured.errors)
            pose = dataclasses.replace(measured.pose, position_m=position_m)
            self._poses.add(pose, errors, at, self._exposure, origin)

    def _by_stamp(self, position_m: Vector, errors: DriveErrors) -> tuple[Vector, DriveErrors]:
        """A position (2,) at the exposure, where its stamp says; poses share the stamps' error as they do the map's."""
        aged_m, spread = self.bank.right.aged_m
        return position_m + aged_m, dataclasses.replace(errors, whole=errors.whole + spread)

    def _use_structure(self, match: PlaceMatch | None, stamp_ns: int) -> None:
        """Correct by structure that agrees with the one before, and hand on the third one like a keypoint pose."""
        if match is None or not match.accepted or not self._is_placed:
            return
        seen, at = self._georeferencer.structure_measurement(match), self._at
        if seen is None or at is None or at.motion is None:
            return
        if self._structure is None:
            from edge.localization.structure_agreement import StructureAgreement  # which few vehicles need

            self._structure = StructureAgreement()
        line = self._georeferencer.of(match)  # also where no sequence ends in this frame
        if line is None or not self._structure.agrees(seen, _vector(at.motion), self.bank.right):
            return
        track = self._track or TrackScore(self._by_chance(line))
        if not self._structure.correct(self.bank.all):
            return
        self._add(track, line, stamp_ns)
        handed_on, origin = self._structure.handed_on(self.bank.right), self._georeferencer.origin
        if handed_on is not None and origin is not None:
            position_m, covariance, heading_rad = handed_on
            position_m, errors = self._by_stamp(position_m, seen.errors)
            self._poses.hand_on(position_m, covariance, heading_rad, errors, at, self._exposure, origin)

    def _begin(self, measured: SequenceMatch) -> None:
        """Be where the first match is."""
        since_m = measured.midpoint.since_m
        self._place(measured.midpoint.place_m + self.bank.right.truly(since_m[:2], since_m[2:]))
        self._is_begun = True

    def _lose_position(self, track: TrackScore | None = None) -> None:
        self._track, self._exposure, self._poses.newest = track, None, FixCandidate()

    def _by_chance(self, measured: SequenceMatch) -> float:
        """Probability that a match anywhere along the road would be where it is expected.

        0 while what is known says which place within a correlation length it is.
        """
        if self._is_begun:
            self._is_begun = False
            return 0.0
        along = measured.midpoint.along
        reach_m = AGREE_SIGMAS * math.sqrt(float(along @ self.bank.right.spread @ along))
        return 0.0 if reach_m <= CORRELATION_M else min(1.0, 2 * reach_m / SPREAD_M)

    def _compare_across(self, measured: SequenceMatch, slot: Slot) -> None:
        """A vehicle beside the road stays there until its motion says otherwise, whatever street matches."""
        if measured.pose is not None and self.bank.before is None:
            self.cross_track = None  # the pose measures the cross-track position
            return
        state, left = self.bank.before or self.bank.right, left_of(measured.midpoint.along)
        if measured.pose is not None:
            off_m = float(left @ (measured.pose.position_m - state.position_m))
            rows = state.rows((POSITION, left[None]), (slot.map, left[None]), (slot.whole, left[None]))
            noise = float(left @ measured.pose.pose_covariance[:2, :2] @ left)
        else:
            both, innovation, noises = measurements.sequence_innovation(state, slot, measured)
            rows, off_m, noise = both[1:], float(innovation[1]), float(noises[1, 1])
        sigma_m = math.sqrt(float((rows @ state.covariance @ rows.T)[0, 0]) + noise)
        if abs(off_m) > AGREE_SIGMAS * sigma_m:
            self.cross_track = abs(off_m), sigma_m
        elif self.cross_track is not None and self.cross_track[0] - abs(off_m) > AGREE_SIGMAS * sigma_m:
            self.cross_track = None

    def _corrects_itself(self, stamp_ns: int) -> bool:
        """Without GPS, the vehicle is elsewhere, or its wheels slip, once that is a thousand times likelier."""
        bank = self.bank
        # By sequence matches alone, no vehicle is a lane further.
        names: tuple[Name, ...] = ("lost", "beside", "slips") if self.has_pose else ("lost", "slips")
        if not self._is_placed or bank.evidence(*names) < CALL:
            return False
        name = max(names, key=bank.evidence)
        before = bank.before
        if name == "slips":
            self._is_shown = False
            bank.begin(name, "before")
            return True
        if name == "beside":
            self._poses.outvote(stamp_ns)
        if before is not None and _apart(bank.of(name), before) <= GATE[2]:  # it was not lost, after all
            bank.begin("before")
            self._track = TrackScore(0.0)
        else:
            is_elsewhere = name == "lost"  # where matches must agree for a correlation length
            bank.begin(name, "right" if is_elsewhere and before is None else "before")
            self._track = TrackScore(math.inf if is_elsewhere else 0.0)
        self._track.matches = FIRST - 1  # those that outvoted what was known
        return True

    def at_exposure(self) -> PlaceFix | None:
        """The position at the exposure of the last match that passed the innovation test; None while it is lost."""
        exposure = self._exposure
        return exposure if exposure is None else replace(exposure, disputed=self._is_disputed)

    def pose(self) -> FixCandidate:
        """The newest keypoint pose that passed the innovation test, as did the one before it within HOLE_S.

        Without a place before the first one, and once the vehicle is lost.
        """
        pose = self._poses.newest
        if pose.place is None or self._exposure is None:
            return FixCandidate()
        return pose._replace(place=replace(pose.place, disputed=self._is_disputed))

    @property
    def _is_disputed(self) -> bool:
        """Whether dead reckoning or matches contradict the estimate."""
        track = self._track
        if track is None:
            return False
        is_on_probation = self._at is not None and self._poses.are_on_probation(self._at.stamp_ns)
        return is_on_probation or not track.is_confirmed or track.disagreeing >= DISAGREE

    def at(self, stamp_ns: int, displacement: Odometry | None, yaw_rad: float | None) -> PlaceFix | None:
        """The position at another moment, moved on by the autopilot's velocity; None while that is not known.

        yaw_rad: the autopilot's heading then.
        """
        track, before = self._track, self._at
        motion = None if before is None else before.motion
        if track is None or self._exposure is None or before is None or motion is None or displacement is None:
            return None
        if displacement.odometry_epoch != motion.odometry_epoch:
            return None
        step = self._step(motion, displacement, (stamp_ns - before.stamp_ns) / 1e9)
        driven_m = float(np.hypot(*step.moved_m))
        if self._is_lost(track, stamp_ns, driven_m):
            return None
        state = self.bank.right.copy()
        state.predict(step)
        return self._fix(track, state, stamp_ns, track.since_m + driven_m, yaw_rad)

    def _is_lost(self, track: TrackScore, stamp_ns: int, driven_m: float) -> bool:
        is_silent = not 0 <= stamp_ns - track.stamp_ns <= self._config.lost_after_s * 1e9
        return is_silent or track.since_m + driven_m > self._config.lost_after_m

    def _move(self, before: ImageProcessed, now: ImageProcessed, yaw_rad: float) -> None:
        assert before.motion is not None and now.motion is not None
        step = self._step(before.motion, now.motion, (now.stamp_ns - before.stamp_ns) / 1e9, before, now)
        step = dataclasses.replace(step, yaw_rad=yaw_rad)
        unknown_m = now.motion.unknown_since(before.motion)
        self._bridged_m = self._bridged_m + unknown_m if unknown_m > 0 else 0.0
        driven_m = float(np.hypot(*step.moved_m))
        self.bank.all.predict(step)
        if self._track is not None:
            self._track.since_m += driven_m
            self._track.driven_m += driven_m
        if step.doubtful_m.any():  # wheels that spin or lock
            self.doubt_scale()

    def _step(
        self,
        then: Odometry,
        now: Odometry,
        seconds: float,
        before: ImageProcessed | None = None,
        frame: ImageProcessed | None = None,
    ) -> FilterStep:
        moved_m = _vector(now) - _vector(then)
        unknown_m, bridged_m2, unknown_m2 = now.unknown_since(then), 0.0, 0.0
        if now.odometry_epoch != then.odometry_epoch:
            unknown_m2 = unknown_m**2 / 3
        else:  # from first to last, a speed that was bridged is off in one way
            bridged_m2 = ((self._bridged_m + unknown_m) ** 2 - self._bridged_m**2) / 3
        one, other = before and before.without_gps, frame and frame.without_gps
        turned_rad, variance = None, 0.0
        if one and other and one.gyros and other.gyros and one.odometry_epoch == other.odometry_epoch:
            turned_rad = math.remainder(other.gyros.compass_rad - one.gyros.compass_rad, math.tau)
            variance = max(0.0, other.gyros.turned_rad2 - one.gyros.turned_rad2)
        return FilterStep(moved_m[:2], moved_m[2:], max(0.0, seconds), turned_rad, variance, unknown_m2, bridged_m2)

    def _choose_origin(self) -> None:
        """A new origin for local meters where the last one is far away."""
        origin, shift_m = self._georeferencer.origin, self.bank.right.position_m.copy()
        if origin is None or float(np.hypot(*shift_m)) < FAR_M:
            return
        self._georeferencer.origin = moved(*origin, float(shift_m[0]), float(shift_m[1]))
        self._structure = None
        self.bank.all.mean[..., POSITION] -= shift_m

    def _fix(
        self, track: TrackScore, state: Filter, stamp_ns: int, since_m: float, yaw_rad: float | None
    ) -> PlaceFix | None:
        newest, origin = track.newest, self._georeferencer.origin
        assert newest is not None
        match, sign = newest.match, 1 if newest.match.direction == "forward" else -1
        found = self._georeferencer.position(match, newest.along_m + sign * since_m)
        if found is None or found.heading_deg is None or origin is None:
            return None
        lat_deg, lon_deg = moved(*origin, float(state.position_m[0]), float(state.position_m[1]))
        heading_rad, has_pose = math.radians(found.heading_deg), state.since_pose_m < CORRELATION_M
        slot = state.newest
        if has_pose and yaw_rad is not None and slot is not None:
            heading_rad = yaw_rad + state.value(HEADING) + state.value(slot.aim)
        along = np.array([math.sin(heading_rad), math.cos(heading_rad)])
        covariance = state.spread
        if newest.pose is None:
            covariance = covariance + _line_variance(state, newest) * np.outer(along, along)
        along_var = float(along @ covariance @ along)
        return PlaceFix(
            stamp_ns=stamp_ns,
            place=match.place,
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            heading_deg=math.degrees(heading_rad) % 360,
            sigma_along_m=math.sqrt(along_var),
            sigma_cross_track_m=math.sqrt(float(np.trace(covariance)) - along_var),
            direction=match.direction,
            order=match.order,
            uniqueness=match.uniqueness,
            matches=track.matches,
            segment=newest.mapped.segment,
            recording=newest.mapped.recording,
            checked_m=newest.mapped.checked_m or UNSET,
            confidence=match.confidence,
            velocity_error=math.hypot(state.value(HEADING), state.value(SCALE)),
            disputed=self._is_disputed,
            by_lane=not has_pose and self._poses.newest.place is None,
            points=newest.pose.inliers if newest.pose and stamp_ns - track.stamp_ns < POSE_HOLDS_NS else UNSET,
            map=UNSET if match.map is None else match.map,
        )


def _line_variance(state: Filter, line: SequenceMatch) -> float:
    """Along-track variance that the state lacks: an odometer's scale error moves the midpoint of a match as well.

    The displacement since the midpoint is in the state; the other half of the sequence has the same error.
    """
    since_m = line.midpoint.since_m[:2]
    return max(0.0, state.sigma(SCALE) ** 2 - KNOWN_SCALE**2) * (2**2 - 1**2) * float(since_m @ since_m)


def _apart(one: Filter, other: Filter) -> float:
    """How far the positions of two filters are apart: squared, in standard deviations."""
    off_m = one.position_m - other.position_m
    return float(off_m @ np.linalg.solve(one.spread + other.spread, off_m))


def _vector(displacement: Odometry) -> Vector:
    doubtful_m = displacement.doubtful_east_m, displacement.doubtful_north_m
    return np.array([displacement.east_m, displacement.north_m, *doubtful_m])
