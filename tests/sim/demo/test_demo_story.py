"""The story's part of the report and the criterion of the smoke test, on drives whose figures are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from edge.errors import LookbackError
from sim.demo.story import (
    LENGTH_M,
    headline,
    laid,
    lost_at_m,
    median_95,
    picture,
    require_good,
    sections_of,
    true_track,
)
from sim.trial.records import FixErrors, TrialRun, TruthTrack
from sim.trial.simulation import NullLink, Simulation


def _track(left_m: float, end_off_m: float) -> TruthTrack:
    """10 m/s, out over LENGTH_M with GPS in the lane, then home without, `left_m` beside it."""
    time_s = np.arange(0.0, 2 * LENGTH_M / 10.0, 0.1)
    gps = time_s * 10.0 < LENGTH_M
    return TruthTrack(time_s, time_s * 10.0, np.where(gps, 0.0, left_m), np.zeros(len(time_s)), gps, end_off_m)


def _run() -> TrialRun:
    sent_s = LENGTH_M / 10.0 - 0.1 + np.array([8.0, 10.0])  # since the last moment with GPS
    sent = FixErrors(sent_s, np.array([1.0, 3.0]), np.array([2.0, 4.0]))
    return TrialRun(1, 21, _track(2.0, 3.0), _track(-30.0, 80.0), sent)


def test_the_table_tells_both_drives_side_by_side() -> None:
    rows = {str(name): (ours, alone) for name, ours, alone in sections_of(_run())[1].tables[0].rows}
    assert rows["first position after the failure"] == ("80 m further on", "none")
    assert rows["protection level below 15 m"][0] == "0 % of the way home"
    assert "No protection level was below that: it bounds" in sections_of(_run())[1].tables[0].note
    levels = np.array([[LENGTH_M / 10.0 + 8.0, 9.0, 9.0]])
    assert "No protection" not in sections_of(replace(_run(), levels=levels))[1].tables[0].note
    assert rows["beside the lane without GPS, 95 %"] == ("2.0 m", "30.0 m")
    assert rows["ended from where it should"] == ("3.0 m", "80.0 m")
    assert rows["largest standard deviation sent"][0] == "4.0 m"
    assert headline(_run()) == "95 % within 2.0 m of its lane; 30.0 m without Lookback"
    assert lost_at_m(_run()) == pytest.approx(LENGTH_M)


def test_where_no_position_came_there_is_no_error() -> None:
    assert (median_95([]), median_95([1.0, 3.0])) == ("–", "2.0 m / 2.9 m")


def test_the_picture_shows_the_true_tracks_in_meters() -> None:
    run = _run()
    ours, alone = true_track(run, run.track), true_track(run, run.alone)
    apart_m = np.hypot(*(ours - alone).T)
    assert apart_m[run.track.gps] == pytest.approx(0.0)
    assert apart_m[~run.track.gps] == pytest.approx(32.0)
    above = picture(run).axes[0]
    shown = {line.get_label(): line.get_xydata() for line in above.lines}
    assert np.asarray(shown["here a position was sent"]).shape == (2, 2)
    assert np.asarray(shown["home at night without Lookback"]) == pytest.approx(alone[~run.alone.gps])


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"track": _track(2.0, 10.5)}, "ended 10.5 m off"),
        ({"track": _track(5.5, 3.0)}, "cross-track 5.5 m"),
        ({"sent": FixErrors(np.array([60.0]), np.array([9.0]), np.array([2.0]))}, "4.5 sigma"),
        ({"sent": FixErrors(*np.zeros((3, 0)))}, "no position"),
    ],
)
def test_the_smoke_test_fails_on_a_bad_drive(change: dict[str, TruthTrack | FixErrors], told: str) -> None:
    require_good(_run())
    with pytest.raises(LookbackError, match=told):
        require_good(replace(_run(), **change))  # type: ignore[arg-type]


def test_the_bar_counts_the_meters_of_the_drive() -> None:
    draft, meters = laid(), list[float]()
    simulation = Simulation(draft, NullLink(), 1, meters.append)
    while not simulation.ended:
        simulation.step()
    assert sum(meters) == pytest.approx(simulation.driver.along_m, abs=2.0)
    assert max(meters) < 10, "the bar does not jump, not even at the turn"
    assert simulation.driver.along_m == pytest.approx(draft.legs[-1].to_m, rel=0.03), "the bar's total"
