"""The current item of the simulated autopilot's mission, against a drive of a real PX4."""

from __future__ import annotations

from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.vehicle.mission_store import KINDS, MissionStore
from tests.tlog import messages_of


def test_an_upload_keeps_the_item_that_a_real_px4_kept(shared: Path) -> None:
    """It had driven a mission of 13 items to the last, and Lookback uploaded 14 none of which was marked."""
    folder = shared / "flights_b06f79e" / "px4_take_me_home_wrong_item_w924"
    if not folder.is_dir():
        pytest.skip(f"needs the recorded drive {folder}")
    store = MissionStore(is_ardupilot=False)
    store.items = [mavlink.MAVLink_mission_item_int_message(5, 1, number, *[0] * 12) for number in range(13)]
    recorded, simulated = [], []
    for now_ns, messages in messages_of(folder / "telem2.tlog.gz"):
        for message in messages:
            if message.get_type() == "MISSION_CURRENT":
                if len(store.items) == 13:
                    store.current = message.seq  # as it drove
                else:
                    recorded.append(message.seq)
                    simulated.append(store.current)
            elif message.get_srcComponent() == 191 and message.get_msgId() in KINDS:
                store.handle(message, now_ns / 1e9)
    assert len(store.items) == 14
    assert len(recorded) > 20
    driven_until_the_end = recorded.index(13)
    assert set(recorded[:driven_until_the_end]) == set(simulated) == {12}
