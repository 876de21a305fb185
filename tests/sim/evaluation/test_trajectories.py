"""Tracks as other programs read them."""

from __future__ import annotations

import math

from sim.datasets.export import TrackPoint, as_gpx, as_tum

NORTH_M = 110_574.0  # a degree of latitude at the equator
ORIGIN = TrackPoint(1_700_000_000_123_456_789, 0.0, 0.0, 90.0)
THERE = TrackPoint(1_700_000_001_000_000_000, 100 / NORTH_M, 0.0, 0.0)


def test_tum_has_meters_from_the_origin_and_yaw_as_quaternion() -> None:
    rows = [[float(value) for value in line.split()] for line in as_tum([ORIGIN, THERE], "", ORIGIN).splitlines()]
    assert all(len(row) == 8 for row in rows)
    assert rows[0][1:] == [0, 0, 0, 0, 0, 0, 1]  # looks east
    assert abs(rows[1][2] - 100) < 0.1 and abs(rows[1][1]) < 1e-6
    assert abs(2 * math.atan2(rows[1][6], rows[1][7]) - math.pi / 2) < 1e-6  # looks north
    assert as_tum([ORIGIN], "", ORIGIN).startswith("1700000000.123456789 ")  # no nanosecond is lost


def test_tum_without_headings_is_whole() -> None:
    assert as_tum([TrackPoint(0, 0.0, 0.0, None)], "", ORIGIN).split()[-4:] == ["0", "0", "0.000000000", "1.000000000"]


def test_a_name_is_escaped() -> None:
    assert "<name>dusk &amp; night</name>" in as_gpx([ORIGIN, THERE], "dusk & night", ORIGIN)
