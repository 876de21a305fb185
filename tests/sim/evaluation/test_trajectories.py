"""Trajectories as other programs read them."""

from __future__ import annotations

import json
import math
from xml.etree import ElementTree

from sim.evaluation.trajectories import Fix, geojson, gpx, tum

NORTH_M = 110_574.0  # a degree of latitude at the equator
ORIGIN = Fix(1_700_000_000_123_456_789, 0.0, 0.0, 90.0)
THERE = Fix(1_700_000_001_000_000_000, 100 / NORTH_M, 0.0, 0.0, 1.25, 3.0)


def test_tum_has_metres_from_the_origin_and_yaw_as_quaternion() -> None:
    rows = [[float(value) for value in line.split()] for line in tum([ORIGIN, THERE], ORIGIN).splitlines()]
    assert all(len(row) == 8 for row in rows)
    assert rows[0][1:] == [0, 0, 0, 0, 0, 0, 1]  # looks east
    assert abs(rows[1][2] - 100) < 0.1 and abs(rows[1][1]) < 1e-6
    assert abs(2 * math.atan2(rows[1][6], rows[1][7]) - math.pi / 2) < 1e-6  # looks north
    assert tum([ORIGIN], ORIGIN).startswith("1700000000.123456789 ")  # no nanosecond is lost


def test_tum_of_a_feed_without_headings_is_whole() -> None:
    assert tum([Fix(0, 0.0, 0.0, None)], ORIGIN).split()[-4:] == ["0", "0", "0.000000000", "1.000000000"]


def test_geojson_has_longitude_first() -> None:
    feature = json.loads(geojson([Fix(5, -27.4, 153.0, None, 1.25, 3.0)]))["features"][0]
    assert feature["geometry"] == {"type": "Point", "coordinates": [153.0, -27.4]}
    assert feature["properties"] == {"stamp_ns": 5, "uniqueness": 1.25, "error_m": 3.0}


def test_gpx_is_a_track_with_times() -> None:
    root = ElementTree.fromstring(gpx([ORIGIN, THERE], "dusk & night"))
    space = {"g": "http://www.topografix.com/GPX/1/1"}
    points = root.findall("g:trk/g:trkseg/g:trkpt", space)
    assert [point.findtext("g:time", namespaces=space) for point in points][1] == "2023-11-14T22:13:21.000000Z"
    assert root.findtext("g:trk/g:name", namespaces=space) == "dusk & night"
    assert float(points[1].attrib["lat"]) == round(100 / NORTH_M, 8)
