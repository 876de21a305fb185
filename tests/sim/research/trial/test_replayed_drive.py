"""Recorded drives on real autopilots, whose positions are computed anew."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from edge.descriptor.network import Network
from edge.errors import FeedError
from sim.research.trial.recorded_drive import read_drive
from sim.research.trial.replayed_drive import Replayed, replay
from sim.trial.views import RoadLibrary


@pytest.fixture
def replayed(shared: Path, tmp_path: Path) -> Callable[[str], Replayed]:
    """Replays the recorded drive of that name."""

    def found(name: str) -> Replayed:
        folder = shared / "flights_b06f79e" / name
        if not folder.is_dir():
            pytest.skip(f"needs the recorded drive {folder}")
        library = RoadLibrary(Network.load(), tmp_path / "views", cell_m=3)
        try:
            return replay(read_drive(folder), tmp_path, library)
        finally:
            library.close()

    return found


def test_a_replay_repeats_what_was_recorded(replayed: Callable[[str], Replayed]) -> None:
    """The same frames are used, and the positions are about as good: the map and the pictures are made again."""
    found = replayed("ardupilot_a914")
    then, now = found.recorded, found.replayed
    assert found.replayed_frames.used == pytest.approx(found.recorded_frames.used, abs=5)
    assert found.replayed_frames.believed == pytest.approx(found.recorded_frames.believed, rel=0.25)
    assert found.recorded_frames.false == found.replayed_frames.false == 0
    assert np.median(now.error_m) == pytest.approx(np.median(then.error_m), abs=0.7)
    # Today's first positions come 190 m sooner, when they are less certain.
    assert np.percentile(now.error_m, 95) == pytest.approx(np.percentile(then.error_m, 95), abs=1.5)
    assert (now.error_m / now.own_sigma_m).max() < 3.0
    assert now.share == pytest.approx(then.share, abs=0.2)


@pytest.mark.soak
def test_where_nothing_measures_the_velocity_no_place_is_believed(replayed: Callable[[str], Replayed]) -> None:
    """PX4 without a velocity aid, by which a frame was used every 45 m and more: its velocity ran away."""
    found = replayed("px4_no_aid_person_296_w921")
    assert found.recorded_frames.apart_m.max() > 45.0
    assert found.recorded_frames.believed > 0 and found.replayed_frames.believed == 0
    assert not len(found.replayed.time_s)


@pytest.mark.soak
def test_positions_come_again_after_a_reboot_far_from_the_origin(replayed: Callable[[str], Replayed]) -> None:
    """342 m from it, 5713 s after the computer's start; then there was none for 558 m."""
    found = replayed("ardupilot_reboot913")
    assert not (found.recorded.time_s > 5713.0).any()
    again = found.replayed.time_s > 5713.0
    assert again.sum() >= 10
    assert (found.replayed.error_m / found.replayed.own_sigma_m)[again].max() < 3.0


def test_a_folder_without_a_recording_is_named_with_what_it_lacks(tmp_path: Path) -> None:
    with pytest.raises(FeedError, match=r"no recorded drive of the daemon, it has no truth\.csv\.gz and no auto"):
        read_drive(tmp_path)
