"""The operator says where the vehicle is, at a start without GPS; a wrong one does no harm."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.descriptor.network import Network
from edge.feed import FeedImages, read_feed
from edge.geodesy import east_north_of, moved
from edge.journal.records import FixSent, PositionStated
from edge.telemetry.codec import MavlinkCodec
from sim.journal import records_of
from tests.faults.simulated_daemon import DaemonRig, ScriptedFrames
from tests.files_written import wait_for_files

FRAMES, MPS = 80, 10.0


@pytest.fixture
def drive(make_street: Callable[..., Path], grid: Network, tmp_path: Path) -> Any:
    """Due north at 10 m/s without GPS, a place every 2 m; one segment of the map, and the usual risk."""

    street, journal = make_street(range(FRAMES), period_ms=200), tmp_path / "events.jsonl"
    feed, config = read_feed(street / "feed"), tmp_path / "lookback.toml"
    images, first = FeedImages(feed), feed.rows[0]
    sections: dict[str, Any] = {
        "descriptor": {"model": "fc6"},
        "map": {"path": str(street / "map")},
        "sequence": {"length": 10},
        "acceptance": {"uniqueness_min": 1.02, "window_m": 10.0},
        "telemetry": {"journal": str(journal), "emit": "external_position"},
        "page": {"port": 0},
    }
    config.write_text(tomli_w.dumps(sections))
    assert first.lat_deg is not None and first.lon_deg is not None
    begins = first.lat_deg, first.lon_deg

    def driven(off_m: float | None, sigma_m: float = 20.0, command: str = "int") -> Any:
        with ExitStack() as parts:
            bench = DaemonRig(config, parts, grid, MPS, ScriptedFrames)
            for frame in range(FRAMES - 1):
                if frame == 20 and off_m is not None:
                    at = moved(*begins, 0.0, MPS * 0.2 * frame + off_m)
                    bench.cable.send(MavlinkCodec(255, 190).encode(statement(*at, sigma_m, command)))
                bench.step(images.read(frame) ^ np.uint8(1), frame)
        wait_for_files()
        for one in records_of(journal, FixSent):
            off = east_north_of(one.lat_deg or 0.0, one.lon_deg or 0.0, begins)
            assert abs(off[0]) < 4.0 and -4.0 < off[1] < MPS * 0.2 * FRAMES, "on the street"
        return list(records_of(journal, FixSent)), list(records_of(journal, PositionStated))

    return driven


def statement(lat_deg: float, lon_deg: float, sigma_m: float, command: str) -> Any:
    number, target = mavlink.MAV_CMD_EXTERNAL_POSITION_ESTIMATE, (1, 191)
    if command == "long":
        return mavlink.MAVLink_command_long_message(*target, number, 0, 0, 0, sigma_m, 0, lat_deg, lon_deg, math.nan)
    x, y = round(lat_deg * 1e7), round(lon_deg * 1e7)
    return mavlink.MAVLink_command_int_message(*target, 0, number, 0, 0, 0, 0, sigma_m, 0, x, y, math.nan)


def test_a_place_near_it_is_enough(drive: Any) -> None:
    sent, (stated,) = drive(off_m=8.0)
    assert sent and (stated.sigma_m, stated.by, stated.rejected) == (20.0, "255.190", "")


def test_without_it_one_segment_of_the_map_is_none(drive: Any) -> None:
    assert drive(off_m=None) == ([], [])


@pytest.mark.parametrize("command", ["int", "long"])
def test_a_wrong_one_makes_no_position_of_its_own_and_counts_for_nothing(drive: Any, command: str) -> None:
    sent, (stated,) = drive(off_m=200.0, sigma_m=0.0, command=command)
    assert not sent and (stated.sigma_m, stated.rejected) == (30.0, "")


def test_what_is_no_position_is_rejected(drive: Any) -> None:
    sent, stated = drive(off_m=0.0, sigma_m=5000.0)
    assert not sent and not stated
