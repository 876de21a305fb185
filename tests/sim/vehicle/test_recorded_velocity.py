"""What is found of a velocity that nothing measured: recorded drives of PX4, replayed with lines along the true way."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.localization.dead_reckoning import VelocityError
from tests.sim.vehicle.flight_comparison import read_columns

FRAMES, SPACING_M = 40, 2.0
GPS_S = 9.0
"""From when the vehicle moves to when GPS is lost, in each of them."""
LINE_M, LINE_FRAMES = 3.0, 30
"""Standard deviation of the middle of a line, and for how many frames it stays about the same."""
SETTLED_S = 25.0


@dataclass(frozen=True)
class Replay:
    """Meters per second ahead at each frame, (n,): what the velocity was wrong by, and what was left of that."""

    wrong_mps: NDArray[np.float64]
    left_mps: NDArray[np.float64]
    sigma_mps: NDArray[np.float64]


def replay(folder: Path) -> Replay:
    """From the loss of GPS on; frames are used every 2 m of the velocity without the error that was found."""
    truth, own = (read_columns(folder / f"{name}.csv.gz") for name in ("truth", "autopilot_position"))
    time_s = own["mono_s"]
    true_m = np.stack([np.interp(time_s, truth["mono_s"], truth[name]) for name in ("east_m", "north_m")], axis=1)
    smooth = np.ones(15) / 15
    rates = [np.gradient(truth[name], truth["mono_s"]) for name in ("east_m", "north_m")]
    true_mps = np.stack(
        [np.interp(time_s, truth["mono_s"], np.convolve(rate, smooth, "same")) for rate in rates], axis=1
    )
    driven_m = np.r_[0.0, np.cumsum(np.hypot(*np.diff(true_m, axis=0).T))]
    heading_rad = np.radians(own["heading_deg"])
    ahead = np.stack([np.sin(heading_rad), np.cos(heading_rad)], axis=1)
    own_mps = np.stack([own["east_mps"], own["north_mps"]], axis=1)
    moves_s = time_s[np.hypot(*true_mps.T) > 1.0][0]
    error, rng = VelocityError(FRAMES), np.random.default_rng(1)
    odometer_m = due_m = line_off_m = 0.0
    passed_m: list[float] = []
    found = []
    for at in range(int(np.searchsorted(time_s, moves_s + GPS_S)), len(time_s)):
        odometer_m += float((own_mps[at] - error.error_mps) @ ahead[at]) * (time_s[at] - time_s[at - 1])
        if odometer_m < due_m:
            continue
        due_m = odometer_m + SPACING_M
        passed_m = [*passed_m[1 - FRAMES :], driven_m[at]]
        kept = math.exp(-1 / LINE_FRAMES)
        line_off_m = kept * line_off_m + math.sqrt(1 - kept**2) * rng.normal(0.0, LINE_M)
        stamp_ns = round(1e9 * time_s[at])
        error.predict(stamp_ns, float(heading_rad[at]), (float(own_mps[at, 0]), float(own_mps[at, 1])))
        error.add_frame(stamp_ns, odometer_m)
        if len(passed_m) == FRAMES:
            error.use_line(1, passed_m[FRAMES // 2] + line_off_m, passed_m[-1] - passed_m[0])
        wrong_mps = float((own_mps[at] - true_mps[at]) @ ahead[at])
        left_mps = float(np.array(error.error_mps) @ ahead[at]) - wrong_mps
        if time_s[at] > moves_s + GPS_S + SETTLED_S:
            found.append((wrong_mps, left_mps, error.sigma_mps))
    return Replay(*np.array(found).T)


@pytest.mark.parametrize(
    ("name", "share"),
    [("px4_no_velocity_aid_person", 0.2), ("px4_external_position_person", 1.0), ("px4_rover_mission", 0.7)],
)
def test_what_is_left_of_the_error_is_as_uncertain_as_stated(shared: Path, name: str, share: float) -> None:
    """share: of the error itself, that is left of it (rms)."""
    folder = shared / "flights" / name
    if not folder.is_dir():
        pytest.skip(f"needs the recorded flight {folder}")
    found = replay(folder)
    sigmas = found.left_mps / found.sigma_mps
    assert np.sqrt(np.mean(sigmas**2)) <= 1.1
    assert np.abs(sigmas).max() <= 4.0
    assert np.sqrt(np.mean(found.left_mps**2)) <= share * np.sqrt(np.mean(found.wrong_mps**2))
