"""What each kind of measurement says of the state of a `Filter`: one function for each. Pure.

A function has the rows of the measurement's Jacobian, the innovation, and the noise that no state explains; it says
whether the measurement was used, or is an outlier. A further kind is one more function.
"""

from __future__ import annotations

import math

import numpy as np

from edge.localization.filter import CORRELATION_M, GATE, Filter, Used, left_of
from edge.localization.pose_measurement import SHARED_M, STANDS_M, PoseMeasurement
from edge.localization.sequence_match import LocalMidpoint, SequenceMatch, StructureMeasurement
from edge.localization.state import AGE, COMPASS, GPS, HEADING, POSITION, VELOCITY, Matrix, Slot, Vector

GPS_NOISE_M = 0.8
"""Of a receiver from one fix to the next."""
COMPASS_NOISE_RAD = math.radians(0.7)
"""Of an autopilot's heading from one frame to the next."""
SECOND_M = 2.5
"""How far off keypoint poses are that are a second solution of their geometry."""
SECOND, PLANE, TURN = np.diag([SECOND_M, SECOND_M, 0.0]) ** 2, np.eye(3, 2), np.eye(3)[:, 2:]
"""Covariance of the latter, and Jacobians of a pose (3,) by a position (2,) and by what turns it."""
ALIKE = 1.7
"""Times the variance of structure, whose errors 20 m apart correlate by 0.25."""
WITHIN_M = 300.0
"""Within which a false place and a false fix may be anywhere: as far as hypotheses follow them."""


def by_gps(state: Filter, gps_m: Vector) -> Used:
    """Where GPS has the vehicle (2,)."""
    rows = state.rows((POSITION, np.eye(2)), (GPS, np.eye(2)))
    return state.correct(rows, gps_m - state.expected(rows), GPS_NOISE_M**2 * np.eye(2), WITHIN_M**-2)


def by_compass(state: Filter, *, has_gps: bool) -> None:
    """The heading in which the velocity is, of an autopilot without GPS: it has the error of its compass."""
    state.has_gps = has_gps
    if not has_gps:
        row = state.rows((HEADING, np.eye(1)), (COMPASS, np.eye(1)))
        state.correct(row, -state.expected(row), COMPASS_NOISE_RAD**2 * np.eye(1))


def by_pose(state: Filter, slot: Slot, pose: PoseMeasurement, *, is_evidence: bool) -> Used:
    """A keypoint pose: the vehicle's position and heading, whose error it partly shares with the last pose.

    Far points hardly separate a turn from a shift, so both are one measurement. The heading is relative to that of the
    autopilot, whose error is also that of the velocity without GPS; with GPS the velocity lacks the compass error.
    is_evidence: whether it counts for a hypothesis; a match that only dead reckoning made credible does not.
    """
    shared = np.maximum(1.0, SHARED_M / np.maximum(state.since_pose_m, STANDS_M))
    rows = state.rows((POSITION, PLANE), (slot.map, PLANE), (slot.whole, PLANE), (HEADING, TURN), (slot.aim, TURN))
    rows[..., AGE] = -state.rates[:, None]
    if state.has_gps:
        rows[..., COMPASS] = -TURN
    off, noise = -state.expected(rows), shared[..., None, None] * pose.pose_covariance
    off[..., :2] += pose.position_m
    noise[..., 2, 2] += COMPASS_NOISE_RAD**2
    known = 2 if pose.yaw_rad is None else 3
    if pose.yaw_rad is not None:
        turn_rad = pose.heading_rad - pose.yaw_rad + off[..., 2]
        off[..., 2] = turn_rad - math.tau * np.round(turn_rad / math.tau)
    anywhere = is_evidence * (WITHIN_M**-2 if known == 2 else WITHIN_M**-2 / math.tau)
    measured = rows[..., :known, :], off[..., :known], noise[..., :known, :known]
    is_used = state.correct(*measured, anywhere, SECOND[:known, :known])
    state.since_pose_m[is_used] = 0.0
    return is_used


def by_sequence(state: Filter, slot: Slot, line: SequenceMatch, *, is_evidence: bool) -> Used:
    """A sequence match: the vehicle's along-track position at its midpoint; cross-track, it is within its lane."""
    rows, off_m, noise = sequence_innovation(state, slot, line)
    spread = rows @ state.covariance @ rows.swapaxes(-1, -2) + noise
    if is_evidence and state.since_lane_m >= CORRELATION_M:  # a vehicle stays beside its lane
        state.since_lane_m = 0.0
        state.weigh(spread, off_m, WITHIN_M**-2)
    elif is_evidence:
        state.weigh(spread[..., :1, :1], off_m[..., :1], 1 / WITHIN_M)
    is_in_lane = off_m[..., 1] ** 2 <= GATE[1] * spread[..., 1, 1]
    along_noise = np.where(is_in_lane, noise[0, 0], math.inf)[..., None, None]  # without weight beside its lane
    is_used = is_in_lane & state.correct(rows[..., :1, :], off_m[..., :1], along_noise)
    rows, off_m, noise = sequence_innovation(state, slot, line)
    across, lane = rows[..., 1:, :], noise[1, 1]
    variance = across @ state.covariance @ across.swapaxes(-1, -2)
    # Only as far as nothing else says where it is cross-track; the lane shows no velocity.
    state.pull(across, off_m[..., 1:], is_used[..., None, None] * np.maximum(1 / lane - 1 / variance, 0.0))
    return is_used


def by_structure(state: Filter, slot: Slot, seen: StructureMeasurement) -> Used:
    """Structure: the vehicle's position in the middle of its window, along-track and cross-track.

    No evidence for a hypothesis: it was searched for where the place is believed.
    """
    rows, off_m = _midpoint_innovation(state, slot, seen.midpoint)
    return state.correct(rows, off_m, ALIKE * np.diag(np.square(seen.sigma_m)))


def sequence_innovation(state: Filter, slot: Slot, line: SequenceMatch) -> tuple[Matrix, Vector, Matrix]:
    """Rows, innovation and noise of a sequence match, along-track and cross-track."""
    rows, off_m = _midpoint_innovation(state, slot, line.midpoint)
    of_match = np.array([[1.0], [0.0]])
    rows[..., slot.stays], rows[..., slot.changes] = of_match, line.sigma_factor * of_match
    of_both = state.mean[..., slot.stays] + line.sigma_factor * state.mean[..., slot.changes]
    off_m = off_m - of_both * of_match[:, 0]
    return rows, off_m, np.diag([(line.sigma_factor * line.sigma_m) ** 2, line.errors.lane_m**2])


def _midpoint_innovation(state: Filter, slot: Slot, midpoint: LocalMidpoint) -> tuple[Matrix, Vector]:
    """Rows and innovation of where the vehicle was, along-track and cross-track."""
    along, since_m, doubtful_m = midpoint.along, midpoint.since_m[:2], midpoint.since_m[2:]
    axes = np.array([along, left_of(along)])
    rows = state.rows((POSITION, axes), (slot.map, axes), (slot.whole, axes))
    rows[..., AGE] = [[-math.hypot(*state.rates[:2])], [0.0]]
    off_m = axes @ midpoint.place_m - state.expected(rows) + state.truly(since_m, doubtful_m) @ axes.T
    rows[..., VELOCITY] = -axes @ state.slopes(since_m, doubtful_m)
    return rows, off_m
