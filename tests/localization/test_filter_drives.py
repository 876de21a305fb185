"""A road with several drives of the map, on `Filter` alone: its error is as large as it says, however many."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.localization.filter import Filter, FilterStep
from edge.localization.measurements import by_pose
from edge.localization.pose_measurement import AIM_RAD, PoseMeasurement
from edge.localization.state import MAP_M, WANDER, DriveErrors

STEP_M, RUNS, DRIVEN_M, TURN_M = 10.0, 60, 800.0, 10.0
MAP_SIGMA_M, WHOLE_M, POSE_M = 1.0, 3.0, 0.4
SCALE = 0.001
ERRORS = DriveErrors(MAP_SIGMA_M, WHOLE_M**2 * np.eye(2), 2.0, 2.0, 1.0)
NONE = np.zeros(2)


def errors_in_sigmas(drives: int) -> NDArray[np.float64]:
    """Squared errors of RUNS filters in standard deviations, summed over two dimensions, at the end of a straight road.

    The velocity's scale and the drives of the map are off as the filter expects it. Keypoint poses come every 10 m, of
    another drive after every 20 m.
    """
    rng = np.random.default_rng(drives)
    scale, at_m = rng.normal(0.0, SCALE, (RUNS, 1)), np.zeros((RUNS, 2))
    whole, wander = rng.normal(0.0, WHOLE_M, (drives, RUNS, 2)), rng.normal(0.0, MAP_SIGMA_M, (drives, RUNS, 2))
    aim = rng.normal(0.0, AIM_RAD, (drives, RUNS))
    state = Filter(1e-6, SCALE).take(None).take([0] * RUNS)
    state.place(at_m + rng.normal(0.0, 5.0, (RUNS, 2)), 25.0 * np.eye(2))
    state.has_gps = True
    kept, noise = math.exp(-STEP_M / MAP_M), np.diag([POSE_M**2, POSE_M**2, math.radians(0.5) ** 2])
    for number in range(int(DRIVEN_M / STEP_M)):
        moved_m = np.array([0.0, STEP_M])
        at_m = at_m + (1 + scale) * moved_m + rng.normal(0.0, WANDER * math.sqrt(STEP_M), (RUNS, 2))
        wander = kept * wander + rng.normal(0.0, MAP_SIGMA_M * math.sqrt(1 - kept**2), wander.shape)
        state.predict(FilterStep(moved_m, NONE, 1.0, 0.0, 0.0))
        drive = int(number * STEP_M / TURN_M) % drives
        pose_m = at_m + whole[drive] + wander[drive] + rng.normal(0.0, POSE_M, (RUNS, 2))
        yaw_rad: Any = aim[drive] + rng.normal(0.0, math.radians(0.5), RUNS)
        pose = PoseMeasurement(pose_m, noise, yaw_rad, 50, 0.0)
        by_pose(state, state.slot(drive, ERRORS), pose, is_evidence=True)
    off_m = state.position_m - at_m
    return np.asarray((off_m[:, None] @ np.linalg.solve(state.spread, off_m[..., None])).ravel())


@pytest.mark.parametrize("drives", [1, 3, 4, 5, 8])
def test_the_error_is_as_large_as_the_filter_says_however_many_drives_the_road_has(drives: int) -> None:
    assert 0.7 < math.sqrt(np.mean(errors_in_sigmas(drives)) / 2) < 1.2
