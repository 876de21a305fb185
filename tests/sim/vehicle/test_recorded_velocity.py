"""A velocity that nothing measured, on recorded drives of PX4: how its error changes."""

from __future__ import annotations

import gzip
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.journal.records import FixSent
from sim.journal import records_of
from sim.research.trial.courses.streams import WANDER_MPS
from sim.research.trial.recorded_drive import read_columns

GPS_S = 9.0
"""From when the vehicle moves to when GPS is lost, in each of them."""
AFTER_S, BEFORE_S = 1.5, 0.1
"""How long a position that was sent moves the velocity, and how early it may have been."""


def positions_sent(folder: Path) -> NDArray[np.float64]:
    """When positions were sent, in seconds since boot, and how far they were from the vehicle's own, (n, 2)."""
    with tempfile.TemporaryDirectory() as scratch:
        journal = Path(scratch, "journal.jsonl")
        journal.write_bytes(gzip.decompress((folder / "journal.jsonl.gz").read_bytes()))
        return np.array([(one.send_boot_s, one.distance_m) for one in records_of(journal, FixSent)])


@dataclass(frozen=True)
class Log:
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


def read_drive(folder: Path) -> Log:
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
    return Log(
        time_s=time_s,
        own_mps=np.stack([own["east_mps"], own["north_mps"]], axis=1),
        true_mps=true_mps,
        heading_rad=heading_rad,
        ahead=np.stack([np.sin(heading_rad), np.cos(heading_rad)], axis=1),
        driven_m=np.r_[0.0, np.cumsum(np.hypot(*np.diff(true_m, axis=0).T))],
        sent=sent,
        moves_s=float(time_s[np.hypot(*true_mps.T) > 1.0][0]),
    )


def changes_mps(drive: Log) -> NDArray[np.float64]:
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
