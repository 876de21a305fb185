"""What each kind of measurement says of the state of a `Filter`: one function for each. Pure.

A function has the rows of the measurement's Jacobian, the innovation, and the noise that no state explains; it says
whether the measurement was used, or is an outlier. A further kind is one more function.
"""

from __future__ import annotations

import math

import numpy as np

from edge.localization.filter import (
    COMPASS,
    CORRELATION_M,
    DOUBT,
    GATE,
    GPS,
    HEADING,
    POSITION,
    Filter,
    Matrix,
    Slot,
    Vector,
)
from edge.localization.pose_measurement import SHARED_M, STANDS_M, PoseMeasurement
from edge.localization.sequence_match import LocalMidpoint, SequenceMatch, StructureMeasurement, left_of

GPS_NOISE_M = 0.8
"""Of a receiver from one fix to the next."""
COMPASS_NOISE_RAD = math.radians(0.7)
"""Of an autopilot's heading from one frame to the next."""
SECOND_SHARE, SECOND_M = 0.1, 2.5
"""Share of keypoint poses that are a second solution of their geometry, and how far off these are."""
SECOND, PLANE, TURN = np.diag([SECOND_M, SECOND_M, 0.0]) ** 2, np.eye(3, 2), np.eye(3)[:, 2]
"""Covariance of the latter, and Jacobians of a pose (3,) by a position (2,) and by what turns it."""
ALIKE = 1.7
"""Times the variance of structure, whose errors 20 m apart correlate by 0.25."""
WITHIN_M = 300.0
"""Within which a false place and a false fix may be anywhere: as far as hypotheses follow them."""


def by_gps(state: Filter, gps_m: Vector) -> bool:
    """Where GPS has the vehicle (2,)."""
    rows = state.rows((POSITION, np.eye(2)), (GPS, np.eye(2)))
    return state.correct(rows, gps_m - rows @ state.mean, GPS_NOISE_M**2 * np.eye(2), WITHIN_M**-2)


def by_compass(state: Filter, *, has_gps: bool) -> None:
    """The heading in which the velocity is, of an autopilot without GPS: it has the error of its compass."""
    state.by_gps = has_gps
    if not has_gps:
        row = state.rows((HEADING, [1.0]), (COMPASS, [1.0]))
        state.correct(row, -row @ state.mean, np.array([[COMPASS_NOISE_RAD**2]]))


def by_pose(state: Filter, slot: Slot, pose: PoseMeasurement, *, is_evidence: bool) -> bool:
    """A keypoint pose: the vehicle's position and heading, whose error it partly shares with the last pose.

    Far points hardly separate a turn from a shift, so both are one measurement. The heading is relative to that of the
    autopilot, whose error is also that of the velocity without GPS; with GPS the velocity lacks the compass error.
    is_evidence: whether it counts for a hypothesis; a match that only dead reckoning made credible does not.
    """
    shared = max(1.0, SHARED_M / max(state.since_pose_m, STANDS_M))
    rows = state.rows((POSITION, PLANE), (slot.map, PLANE), (slot.whole, PLANE), (HEADING, TURN), (slot.aim, TURN))
    if state.by_gps:
        rows[:, COMPASS] = -TURN
    off, noise = np.array([*pose.position_m, 0.0]) - rows @ state.mean, shared * pose.pose_covariance
    noise[2, 2] += COMPASS_NOISE_RAD**2
    if pose.yaw_rad is None:
        rows, off, noise = rows[:2], off[:2], noise[:2, :2]
    else:
        off[2] = math.remainder(pose.heading_rad - pose.yaw_rad + off[2], math.tau)
    known = len(off)
    anywhere = is_evidence * (WITHIN_M**-2 if known == 2 else WITHIN_M**-2 / math.tau)
    if not state.correct(rows, off, noise, anywhere, (SECOND_SHARE, SECOND[:known, :known])):
        return False
    state.since_pose_m = 0.0
    return True


def by_sequence(state: Filter, slot: Slot, line: SequenceMatch, *, is_evidence: bool) -> bool:
    """A sequence match: the vehicle's along-track position at its midpoint; cross-track, it is within its lane."""
    rows, off_m, noise = sequence_innovation(state, slot, line)
    spread = rows @ state.covariance @ rows.T
    if is_evidence and state.since_lane_m >= CORRELATION_M:  # a vehicle stays beside its lane
        state.since_lane_m = 0.0
        state.weigh(spread + noise, off_m, WITHIN_M**-2)
    elif is_evidence:
        state.weigh((spread + noise)[:1, :1], off_m[:1], 1 / WITHIN_M)
    if off_m[1] ** 2 > GATE[1] * (spread[1, 1] + noise[1, 1]):
        return False
    if not state.correct(rows[:1], off_m[:1], noise[:1, :1]):
        return False
    rows, off_m, noise = sequence_innovation(state, slot, line)
    variance, lane = float(rows[1] @ state.covariance @ rows[1]), float(noise[1, 1])
    if variance > lane:  # only as far as nothing else says where it is cross-track; the lane shows no velocity
        state.pull(rows[1:], off_m[1:], 1 / (1 / lane - 1 / variance))
    return True


def by_structure(state: Filter, slot: Slot, seen: StructureMeasurement) -> bool:
    """Structure: the vehicle's position in the middle of its window, along-track and cross-track.

    No evidence for a hypothesis: it was searched for where the place is believed.
    """
    rows, off_m = _midpoint_innovation(state, slot, seen.midpoint)
    return state.correct(rows, off_m, ALIKE * np.diag(np.square(seen.sigma_m)))


def sequence_innovation(state: Filter, slot: Slot, line: SequenceMatch) -> tuple[Matrix, Vector, Matrix]:
    """Rows, innovation and noise of a sequence match, along-track and cross-track."""
    rows, off_m = _midpoint_innovation(state, slot, line.midpoint)
    rows[0, slot.stays], rows[0, slot.changes] = 1.0, line.sigma_factor
    off_m[0] -= state.mean[slot.stays] + line.sigma_factor * state.mean[slot.changes]
    return rows, off_m, np.diag([(line.sigma_factor * line.sigma_m) ** 2, line.errors.lane_m**2])


def _midpoint_innovation(state: Filter, slot: Slot, midpoint: LocalMidpoint) -> tuple[Matrix, Vector]:
    """Rows and innovation of where the vehicle was, along-track and cross-track."""
    since_m, doubtful_m = midpoint.since_m[:2], midpoint.since_m[2:]
    axes = np.array([midpoint.along, left_of(midpoint.along)])
    rows = state.rows((POSITION, axes), (slot.map, axes), (slot.whole, axes))
    rows[:, HEADING : DOUBT + 1] = -axes @ state.slopes(since_m, doubtful_m)
    of_map_m = state.mean[slot.map] + state.mean[slot.whole]
    return rows, axes @ (midpoint.place_m - (state.position_m - state.truly(since_m, doubtful_m)) - of_map_m)
