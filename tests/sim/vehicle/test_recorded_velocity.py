"""A velocity that nothing measured, on recorded drives of PX4: how its error changes, and what is found of it.

It is found with lines along the true way.
"""

from __future__ import annotations

import gzip
import math
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.journal.records import FixSent
from edge.localization.velocity_error import PULLED_MPS_PER_M, PULLED_NS, VelocityError
from sim.journal import records_of
from sim.research.trial.courses.streams import WANDER_MPS
from sim.research.trial.recorded_drive import read_columns

FRAMES, SPACING_M = 40, 2.0
GPS_S = 9.0
"""From when the vehicle moves to when GPS is lost, in each of them."""
LINE_M, LINE_FRAMES = 3.0, 30
"""Standard deviation of the middle of a line, and for how many frames it stays about the same."""
SETTLED_S = 25.0
AFTER_S, BEFORE_S = 1.5, 0.1
"""How long a position that was sent moves the velocity, and how early it may have been."""


@dataclass(frozen=True)
class Replay:
    """Meters per second ahead at each frame, (n,): what the velocity was wrong by, and what was left of that."""

    wrong_mps: NDArray[np.float64]
    left_mps: NDArray[np.float64]
    sigma_mps: NDArray[np.float64]


def positions_sent(folder: Path) -> NDArray[np.float64]:
    """When positions were sent, in seconds since boot, and how far they were from the vehicle's own, (n, 2)."""
    with tempfile.TemporaryDirectory() as scratch:
        journal = Path(scratch, "journal.jsonl")
        journal.write_bytes(gzip.decompress((folder / "journal.jsonl.gz").read_bytes()))
        return np.array([(one.send_boot_s, one.distance_m) for one in records_of(journal, FixSent)])


@dataclass(frozen=True)
class Drive:
    """A recorded drive, at each report of the autopilot: time_s, heading_rad and driven_m (n,), the others (n, 2).

    ahead: the way it heads. driven_m: in truth. sent: see `positions_sent`, at seconds of time_s. moves_s: when it
    began to move.
    """

    time_s: NDArray[np.float64]
    own_mps: NDArray[np.float64]
    true_mps: NDArray[np.float64]
    heading_rad: NDArray[np.float64]
    ahead: NDArray[np.float64]
    driven_m: NDArray[np.float64]
    sent: NDArray[np.float64]
    moves_s: float


def read_drive(folder: Path) -> Drive:
    truth, own = (read_columns(folder / f"{name}.csv.gz") for name in ("truth", "autopilot_position"))
    time_s = own["mono_s"]
    true_m = np.stack([np.interp(time_s, truth["mono_s"], truth[name]) for name in ("east_m", "north_m")], axis=1)
    smooth = np.ones(15) / 15
    rates = [np.gradient(truth[name], truth["mono_s"]) for name in ("east_m", "north_m")]
    true_mps = np.stack(
        [np.interp(time_s, truth["mono_s"], np.convolve(rate, smooth, "same")) for rate in rates], axis=1
    )
    heading_rad = np.radians(own["heading_deg"])
    sent = positions_sent(folder)
    sent[:, 0] = np.interp(sent[:, 0], own["boot_ms"] / 1000, time_s)
    return Drive(
        time_s=time_s,
        own_mps=np.stack([own["east_mps"], own["north_mps"]], axis=1),
        true_mps=true_mps,
        heading_rad=heading_rad,
        ahead=np.stack([np.sin(heading_rad), np.cos(heading_rad)], axis=1),
        driven_m=np.r_[0.0, np.cumsum(np.hypot(*np.diff(true_m, axis=0).T))],
        sent=sent,
        moves_s=float(time_s[np.hypot(*true_mps.T) > 1.0][0]),
    )


def replay(folder: Path) -> Replay:
    """From the loss of GPS on; frames are used every 2 m of the velocity without the error that was found."""
    drive = read_drive(folder)
    time_s, own_mps, ahead, lost_s = drive.time_s, drive.own_mps, drive.ahead, drive.moves_s + GPS_S
    error, rng = VelocityError(FRAMES), np.random.default_rng(1)
    odometer_m = due_m = line_off_m = 0.0
    passed_m: list[float] = []
    found = []
    for at in range(int(np.searchsorted(time_s, lost_s)), len(time_s)):
        stamp_ns = round(1e9 * time_s[at])
        recent = (drive.sent[:, 0] <= time_s[at]) & (time_s[at] - drive.sent[:, 0] <= PULLED_NS / 1e9)
        pulled_m = float(drive.sent[recent, 1].max(initial=0.0))
        own_east_mps, own_north_mps = own_mps[at].tolist()
        error.predict(stamp_ns, float(drive.heading_rad[at]), (own_east_mps, own_north_mps), pulled_m)
        odometer_m += float((own_mps[at] - error.error_mps) @ ahead[at]) * (time_s[at] - time_s[at - 1])
        if odometer_m < due_m:
            continue
        due_m = odometer_m + SPACING_M
        passed_m = [*passed_m[1 - FRAMES :], drive.driven_m[at]]
        kept = math.exp(-1 / LINE_FRAMES)
        line_off_m = kept * line_off_m + math.sqrt(1 - kept**2) * rng.normal(0.0, LINE_M)
        error.add_frame(stamp_ns)
        if len(passed_m) == FRAMES:
            error.use_line(1, passed_m[FRAMES // 2] + line_off_m, passed_m[-1] - passed_m[0])
        wrong_mps = float((own_mps[at] - drive.true_mps[at]) @ ahead[at])
        left_mps = float(np.array(error.error_mps) @ ahead[at]) - wrong_mps
        if time_s[at] > lost_s + SETTLED_S:
            found.append((wrong_mps, left_mps, error.sigma_mps))
    return Replay(*np.array(found).T)


def changes_mps(drive: Drive) -> NDArray[np.float64]:
    """By what the error ahead changes within a second without GPS, while the vehicle moves and no position comes."""
    time_s, second = drive.time_s, round(1.0 / float(np.median(np.diff(drive.time_s))))
    first, last = np.arange(len(time_s) - second), np.arange(second, len(time_s))
    until_next_s = drive.sent[None, :, 0] - time_s[first, None]
    is_free = ~((until_next_s > -AFTER_S) & (until_next_s < 1.0 + BEFORE_S)).any(axis=1)
    moves = np.hypot(*drive.true_mps.T) > 1.0
    is_free &= (time_s[first] > drive.moves_s + GPS_S + 1.0) & (time_s[last] - time_s[first] < 1.3)
    wrong_mps = drive.own_mps - drive.true_mps
    changes = ((wrong_mps[last] - wrong_mps[first]) * drive.ahead[last]).sum(axis=1)
    return np.asarray(changes[is_free & moves[first] & moves[last]])


def flight(shared: Path, name: str) -> Path:
    folder = shared / "flights" / name
    if not folder.is_dir():
        pytest.skip(f"needs the recorded flight {folder}")
    return folder


@pytest.mark.parametrize(
    ("name", "share"),
    [("px4_no_velocity_aid_person", 0.1), ("px4_external_position_person", 0.9), ("px4_rover_mission", 0.3)],
)
def test_what_is_left_of_the_error_is_as_uncertain_as_stated(shared: Path, name: str, share: float) -> None:
    """share: of the error itself, that is left of it (rms)."""
    found = replay(flight(shared, name))
    sigmas = found.left_mps / found.sigma_mps
    assert np.sqrt(np.mean(sigmas**2)) <= 1.1
    assert np.abs(sigmas).max() <= 4.0
    assert np.sqrt(np.mean(found.left_mps**2)) <= share * np.sqrt(np.mean(found.wrong_mps**2))


@pytest.mark.parametrize(
    ("name", "wanders_mps"),
    [
        ("px4_no_velocity_aid_person", 0.35),
        ("px4_external_position_person", 0.25),
        ("px4_failure_gps_off", 0.24),
        ("px4_rover_mission", 0.09),
    ],
)
def test_a_simulated_velocity_that_nothing_measures_wanders_more_than_recorded(
    shared: Path, name: str, wanders_mps: float
) -> None:
    changes = changes_mps(read_drive(flight(shared, name)))
    assert np.std(changes) == pytest.approx(wanders_mps, abs=0.01)
    assert wanders_mps < WANDER_MPS


def test_a_position_that_was_sent_changes_the_velocity_by_no_more_than_assumed(shared: Path) -> None:
    drive = read_drive(flight(shared, "px4_external_position_person"))
    error_mps = ((drive.own_mps - drive.true_mps) * drive.ahead).sum(axis=1)
    sent_s, off_m = drive.sent[drive.sent[:, 1] > 8.0].T
    before_mps, after_mps = (np.interp(sent_s + later_s, drive.time_s, error_mps) for later_s in (0.0, 1.0))
    per_meter = np.abs(after_mps - before_mps) / off_m
    assert len(per_meter) == 5
    assert per_meter.min() > 0.02 and per_meter.max() < PULLED_MPS_PER_M
