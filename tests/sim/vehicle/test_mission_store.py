"""The simulated autopilot's side of the mission protocol, judged by MAVSDK's client."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.vehicle.mission_store import KINDS, MissionStore
from tests.common import PATIENCE_S
from tests.tlog import messages_of

pytest.importorskip("mavsdk")

import mavsdk
from mavsdk.plugins.mission_raw.mission_raw import MissionItem, MissionRaw

from edge.telemetry import open_link
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.command import straight_line
from tests.udp_port import free_port


def item(number: int, lat_e7: int) -> Any:
    return MissionItem(number, 6, 16, int(number == 0), 1, 0.0, 0.0, 0.0, math.nan, lat_e7, 1530283000, 5.0, 0)


@contextmanager
def judged(firmware: str) -> Iterator[tuple[SimulatedAutopilot, MissionRaw]]:
    """The simulated autopilot in a thread, and MAVSDK as a ground station."""
    port = free_port()
    station = mavsdk.Mavsdk(mavsdk.Configuration.create_manual(245, 190, True))
    assert station.add_any_connection(f"udpin://127.0.0.1:{port}") == mavsdk.ConnectionResult.SUCCESS
    link, stop = open_link(f"udp:127.0.0.1:{port}"), threading.Event()
    autopilot = SimulatedAutopilot(link, straight_line(0.0, 0.0, time.monotonic()), firmware=firmware)
    thread = threading.Thread(target=autopilot.run, args=(stop,))
    thread.start()
    try:
        yield autopilot, MissionRaw(first_system(station))
    finally:
        stop.set()
        thread.join()
        link.close()
        station.destroy()


def first_system(station: Any) -> Any:
    found, gone = threading.Event(), time.monotonic() + PATIENCE_S
    station.subscribe_on_new_system(lambda *_: found.set())
    while not station.get_systems():
        assert time.monotonic() < gone, "MAVSDK does not hear the simulated autopilot"
        found.wait(0.1)
    return station.get_systems()[0]


@pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
def test_mavsdk_uploads_and_downloads_the_same_mission(firmware: str) -> None:
    with judged(firmware) as (autopilot, client):
        client.upload_mission([item(number, -274772000 + 1000 * number) for number in range(5)])
        assert len(autopilot.mission.items) == 5
        first = 1 if firmware == "ardupilot" else 0
        assert [round(lat_deg * 1e7) for lat_deg, _ in autopilot.mission.waypoints_deg] == [
            -274772000 + 1000 * number for number in range(first, 5)
        ]
        downloaded = client.download_mission()
        assert [found.x for found in downloaded] == [-274772000 + 1000 * number for number in range(5)]
        client.clear_mission()
        assert autopilot.mission.waypoints_deg == []


def test_mavsdk_reads_a_refusal() -> None:
    with judged("ardupilot") as (autopilot, client):
        autopilot.mission.rejects = {2: mavlink.MAV_MISSION_UNSUPPORTED}
        with pytest.raises(Exception, match="UNSUPPORTED"):
            client.upload_mission([item(number, -274772000 + 1000 * number) for number in range(5)])


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
