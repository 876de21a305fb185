"""The current item of the simulated autopilot's mission, against a drive of a real PX4."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.telemetry.codec import MavlinkCodec
from sim.vehicle.mission_store import KINDS, MissionStore


def test_an_upload_keeps_the_item_that_a_real_px4_kept(shared: Path) -> None:
    """It had driven a mission of 13 items to the last, and Lookback uploaded 14 none of which was marked."""
    folder = shared / "flights_b06f79e" / "px4_take_me_home_wrong_item_w924"
    if not folder.is_dir():
        pytest.skip(f"needs the recorded drive {folder}")
    data = gzip.decompress((folder / "telem2.tlog.gz").read_bytes())
    store, codec = MissionStore(is_ardupilot=False), MavlinkCodec(5, 1)
    store.items = [mavlink.MAVLink_mission_item_int_message(5, 1, number, *[0] * 12) for number in range(13)]
    at, recorded, simulated = 0, [], []
    while at < len(data):
        size = 12 + data[at + 9] + 13 * (data[at + 10] & 1)
        time_s = int.from_bytes(data[at : at + 8], "big") / 1e6
        for message in codec.decode(data[at + 8 : at + 8 + size]):
            if message.get_type() == "MISSION_CURRENT":
                if len(store.items) == 13:
                    store.current = message.seq  # as it drove
                else:
                    recorded.append(message.seq)
                    simulated.append(store.current)
            elif message.get_srcComponent() == 191 and message.get_msgId() in KINDS:
                store.handle(message, time_s)
        at += 8 + size
    assert len(store.items) == 14
    assert len(recorded) > 20
    driven_until_the_end = recorded.index(13)
    assert set(recorded[:driven_until_the_end]) == set(simulated) == {12}
