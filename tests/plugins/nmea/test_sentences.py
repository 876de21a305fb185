"""What is sent, read back by pynmea2: an estimate says that it is one, and what is no position is no fix."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from edge.journal.records import PlaceFix
from edge_plugins.nmea.sentences import sentences

pynmea2 = pytest.importorskip("pynmea2", reason="the extra import is not installed")
UNIX_NS = 1_700_000_000_340_000_000  # 2023-11-14 22:13:20.34 UTC
FIX = PlaceFix(10**12, 3, -26.999, 152.001, 60.0, 4.0, 2.0, "forward", "same", 1.2)


def read(data: bytes) -> list[Any]:
    assert data.endswith(b"\r\n")
    return [pynmea2.parse(line, check=True) for line in data.decode("ascii").splitlines()]


def test_a_position_comes_with_its_time_its_accuracy_and_says_that_it_is_estimated() -> None:
    gga, rmc, gst = read(sentences(UNIX_NS, FIX, speed_mps=10.0, alt_m=12.34))
    assert (gga.gps_qual, gga.num_sats, gga.horizontal_dil) == (6, "00", "")
    assert (gga.latitude, gga.longitude) == pytest.approx((-26.999, 152.001), abs=1e-7)
    assert (gga.altitude, gga.altitude_units) == (12.3, "M")
    assert (rmc.status, rmc.mode_indicator) == ("A", "E")
    assert (rmc.spd_over_grnd, rmc.true_course) == (pytest.approx(19.44, abs=0.01), 60.0)
    assert f"{rmc.datetime:%Y-%m-%d %H:%M:%S.%f}" == "2023-11-14 22:13:20.340000"
    assert (gst.std_dev_major, gst.std_dev_minor, gst.orientation) == (4.0, 2.0, 60.0)
    north_m = math.hypot(4 * math.cos(math.radians(60)), 2 * math.sin(math.radians(60)))
    east_m = math.sqrt(20 - north_m**2)
    assert (gst.std_dev_latitude, gst.std_dev_longitude) == pytest.approx((north_m, east_m), abs=0.05)


def test_the_longer_axis_may_lie_across_the_road_and_a_heading_may_not_be_known() -> None:
    across = read(sentences(UNIX_NS, replace(FIX, sigma_along_m=1.0, sigma_cross_track_m=3.0, heading_deg=359.97)))
    assert (across[2].std_dev_major, across[2].std_dev_minor, across[2].orientation) == (3.0, 1.0, 90.0)
    assert across[1].true_course == 0.0 and across[0].altitude is None and across[1].spd_over_grnd is None
    unknown = read(sentences(UNIX_NS, replace(FIX, heading_deg=None)))
    assert (unknown[2].std_dev_latitude, unknown[2].std_dev_longitude) == (4.0, 4.0), "the larger one all around"
    assert unknown[1].true_course is None


@pytest.mark.parametrize(
    "none", [None, replace(FIX, lat_deg=None), replace(FIX, lon_deg=math.nan), replace(FIX, sigma_along_m=math.inf)]
)
def test_no_position_is_no_fix(none: PlaceFix | None) -> None:
    gga, rmc = read(sentences(UNIX_NS, none, speed_mps=3.0, alt_m=5.0))
    assert (gga.gps_qual, gga.lat, gga.lon, gga.altitude) == (0, "", "", None)
    assert (rmc.status, rmc.mode_indicator, rmc.lat, rmc.lon) == ("V", "N", "", "")


@given(st.floats(-90, 90), st.floats(-180, 180))
def test_every_angle_is_read_back(lat_deg: float, lon_deg: float) -> None:
    """No minute is 60, and none has lost a digit."""
    gga, _, _ = read(sentences(UNIX_NS, replace(FIX, lat_deg=lat_deg, lon_deg=lon_deg)))
    assert float(gga.lat) % 100 < 60 and float(gga.lon) % 100 < 60
    assert (gga.latitude, gga.longitude) == pytest.approx((lat_deg, lon_deg), abs=1e-7)
