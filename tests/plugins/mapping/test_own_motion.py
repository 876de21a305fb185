"""What vouches for the map of a drive: wheels or a camera that agree with GPS, and never what GPS has a part in."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.reference_map import read_header
from edge.telemetry.position_history import ExposureQueue, PositionHistory
from edge.telemetry.vehicle import Vehicle
from edge_plugins.mapping import MappingConfig
from edge_plugins.mapping.gps_consistency import GpsConsistency, GpsFreeDistance, GpsFreeOdometer
from tests.common import S
from tests.plugins.mapping.test_live_map import IMAGE, START_S, live, raw_of
from tests.plugins.mapping.test_outage import at
from tests.reference_map.test_gps_motion import STEP_M
from tests.reference_map.test_gps_motion import drive as gps_drive
from tests.telemetry.speaker import Speaker, connect
from tests.tlog import messages_of

PLACES, SPEED_MPS = 400, 8.0


def vouched(folder: Path, seed: int, drift_mps: float, counted: list[int], gaps_from: int, headings: int) -> list[bool]:
    """Whether the map of a drive moved as driven: while it is made, and as the next start makes it.

    GPS drifts ahead, and the odometer is its velocity. counted: places at which wheels or a camera have counted;
    from `gaps_from` on, anew. headings: places up to which there is one.
    """
    points = gps_drive(seed, drift_mps, "ahead", SPEED_MPS)
    by_gps_m = np.r_[0.0, np.cumsum(np.hypot(*np.diff(points[0], axis=0).T))]
    mapped = live(folder)
    for row in range(PLACES):
        now = replace(at(points, row), stamp_ns=round(row * STEP_M / SPEED_MPS * 1e9))
        if row >= headings:
            now = replace(now, heading_deg=None)
        if row in counted:
            mapped.own.compare(GpsFreeDistance(now.stamp_ns, float(points[1][row]), int(row >= gaps_from)), now)
        mapped.add(raw_of(row), IMAGE, now, float(by_gps_m[row]))
        while mapped.store.waiting > 8:
            os.sched_yield()
    growing = mapped.store.whole().header.segments
    mapped.store.close()
    live(folder, START_S + 3600).store.close()
    finished = read_header(folder / mapped.status.name).segments
    assert len(growing) == len(finished) == 1
    assert finished[0].end == PLACES, "what GPS measures itself ends no mapping"
    return [growing[0].moved_as_driven, finished[0].moved_as_driven]


@pytest.mark.parametrize(
    ("drift_mps", "counted", "gaps_from", "headings", "is_vouched"),
    [
        (0.0, range(0, PLACES, 4), PLACES, PLACES, True),
        (0.0, range(PLACES), PLACES, PLACES, True),
        (1.0, range(0, PLACES, 4), PLACES, PLACES, False),
        (2.0, range(0, PLACES, 4), PLACES, PLACES, False),
        (0.0, [], PLACES, PLACES, False),
        (0.0, range(20, PLACES, 4), PLACES, PLACES, False),
        (0.0, range(0, 380, 4), PLACES, PLACES, False),
        (0.0, range(0, PLACES, 4), 200, PLACES, False),
        (0.0, range(0, PLACES, 4), PLACES, 390, False),
    ],
    ids=["wheels each second", "camera", "spoofed 1 m/s", "spoofed 2 m/s", "GPS alone", "counted late",
         "silent at last", "counted anew", "no heading at last"],
)  # fmt: skip
def test_a_drive_is_vouched_for_where_what_gps_has_no_part_in_agrees_all_along(
    tmp_path: Path, drift_mps: float, counted: range, gaps_from: int, headings: int, is_vouched: bool
) -> None:
    """Wheels are 3 % and the compass is 3 degrees off."""
    for seed in range(3):
        found = vouched(tmp_path / f"{seed}", seed, drift_mps, list(counted), gaps_from, headings)
        assert found == [is_vouched, is_vouched]


@pytest.mark.parametrize(
    ("name", "is_vouched"),
    [
        ("flights_b06f79e/ardupilot_tmh921", True),
        ("flights_eca2e43/ardupilot_tmh972_no_turn", True),
        ("flights_b06f79e/ardupilot_spoofA912", False),
        ("flights_b06f79e/px4_take_me_home_wrong_item_w924", False),
    ],
)
def test_recorded_drives(shared: Path, name: str, is_vouched: bool) -> None:
    """Real autopilots with wheels each second, GPS honest or spoofed by 1 m/s; PX4 has none of them."""
    file = shared / name / "telem2.tlog.gz"
    if not file.is_file():
        pytest.skip(f"needs the recorded drive {file.parent}")
    now_ns = 0
    vehicle, own, history = (
        Vehicle(),
        GpsConsistency(MappingConfig(folder="maps"), STEP_M),
        PositionHistory(lambda: now_ns),
    )
    counted: ExposureQueue[GpsFreeDistance] = ExposureQueue(history)
    meters = GpsFreeOdometer()
    vehicle.velocity.listen = meters.hear
    found, newest = [], None
    for now_ns, messages in messages_of(file):
        for message in messages:
            vehicle.handle(message, now_ns)
            position = vehicle.position(now_ns)
            receiver = vehicle.session.gps.behind(position, now_ns) if position is not None else None
            if position is not None and receiver is not None:
                history.add(replace(position, sigma_m=receiver.accuracy_m, source=receiver.source))
                found.append(own.vouches(position.stamp_ns))
            if meters.driven not in (None, newest):
                newest = meters.driven
                assert newest is not None
                counted.add(newest.stamp_ns, newest)
            for each, there in counted.known():
                own.compare(each, there)
    assert len(found) > 1000
    assert found[-1] == is_vouched


def test_what_gps_has_no_part_in_counts_without_its_velocity() -> None:
    """The camera until wheels do; where the one followed the other, were silent or damaged, nobody counted."""
    speaker = Speaker()
    vehicle = connect(speaker)
    velocity, meters = vehicle.velocity, GpsFreeOdometer()
    velocity.listen = meters.hear
    for tenth in range(10, 60):
        vehicle.handle(speaker.fix(100 * tenth, float(tenth), vn_mps=10.0, ve_mps=0.0), tenth * S // 10)
        velocity.use_speed(tenth * S // 10, 7.0)
    told = [(6, 9.0, 34.3, 1), (7, 18.0, 43.3, 1), (8, 26.0, 51.3, 1), (8, 26.0, 51.3, 1), (9, 24.0, 49.3, 1),
            (12, 54.0, 49.3, 2), (13, math.nan, 49.3, 3), (14, 1e9, 49.3, 4), (15, 1e9 + 1, 50.3, 4)]  # fmt: skip
    for now_s, wheels_m, driven_m, gaps in told:
        message = mavlink.MAVLink_wheel_distance_message(now_s * 1_000_000, 1, [wheels_m] + [0.0] * 15)
        vehicle.handle(speaker.say(message), now_s * S)
        velocity.use_speed(now_s * S, 7.0)
        assert meters.driven is not None
        assert meters.driven.driven_m == pytest.approx(driven_m)
        assert meters.driven == (now_s * S, meters.driven.driven_m, 1 + gaps)
