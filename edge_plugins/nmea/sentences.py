"""A position as sentences of NMEA 0183: GGA, RMC and, for its accuracy, GST; and TXT, a line that people read.

The talker is GP, since phones and plotters look for no other. Nothing pretends to be a receiver's fix, though: the
quality is 6 and the mode E (estimated), satellites are 00, and there is no dilution of precision. RMC has the status A
with it, as receivers with dead reckoning have (u-blox M8, protocol specification, "Position fix flags in NMEA").
"""

from __future__ import annotations

import math
from datetime import datetime, timezone
from functools import reduce

from edge.journal.records import PlaceFix

ESTIMATED, NO_FIX = 6, 0
KNOTS_PER_MPS = 3600 / 1852
MINUTE_DIGITS = 5
"""After the point: 2 cm."""


def text_sentence(text: str) -> bytes:
    """A line in ASCII, as receivers send notices: one sentence of one, of type 02."""
    return _sentence("TXT", "01", "01", "02", text.replace(",", ";"))


def sentences(unix_ns: int, fix: PlaceFix | None, speed_mps: float | None = None, alt_m: float | None = None) -> bytes:
    """What is sent at a moment of UTC; fix: the position then, None for "no fix". alt_m: above mean sea level."""
    now = datetime.fromtimestamp(unix_ns // 10**9, timezone.utc)
    time, date = f"{now:%H%M%S}.{unix_ns % 10**9 // 10**7:02d}", f"{now:%d%m%y}"
    if fix is None or not fix.is_position or fix.lat_deg is None or fix.lon_deg is None:
        return _sentence("GGA", time, *[""] * 4, NO_FIX, "00", *[""] * 8) + _sentence(
            "RMC", time, "V", *[""] * 6, date, "", "", "N"
        )
    at = *_angle(fix.lat_deg, 2, "NS"), *_angle(fix.lon_deg, 3, "EW")
    height = ("", "") if alt_m is None or not math.isfinite(alt_m) else (f"{alt_m:.1f}", "M")
    knots = "" if speed_mps is None or not math.isfinite(speed_mps) else f"{abs(speed_mps) * KNOTS_PER_MPS:.2f}"
    course = "" if fix.heading_deg is None else f"{round(fix.heading_deg, 1) % 360:.1f}"
    return (
        _sentence("GGA", time, *at, ESTIMATED, "00", "", *height, "", "", "", "")
        + _sentence("RMC", time, "A", *at, knots, course, date, "", "", "E")
        + _sentence("GST", time, "", *_ellipse(fix), "")
    )


def _ellipse(fix: PlaceFix) -> tuple[str, str, str, str, str]:
    """Meters along both axes of the error ellipse, how the longer one lies, and meters north and east: 1 sigma each."""
    along_m, cross_track_m = fix.sigma_along_m, fix.sigma_cross_track_m
    if fix.heading_deg is None:
        along_m = cross_track_m = max(along_m, cross_track_m)
    heading_rad = math.radians(fix.heading_deg or 0.0)
    north_m = math.hypot(along_m * math.cos(heading_rad), cross_track_m * math.sin(heading_rad))
    east_m = math.hypot(along_m * math.sin(heading_rad), cross_track_m * math.cos(heading_rad))
    longer_deg = (fix.heading_deg or 0.0) + (90 if cross_track_m > along_m else 0)
    axes_m = max(along_m, cross_track_m), min(along_m, cross_track_m)
    lies = f"{round(longer_deg, 1) % 180:.1f}"
    return f"{axes_m[0]:.1f}", f"{axes_m[1]:.1f}", lies, f"{north_m:.1f}", f"{east_m:.1f}"


def _angle(angle_deg: float, digits: int, signs: str) -> tuple[str, str]:
    """Degrees and minutes in one number, and the hemisphere; rounded once, so that no minute is 60."""
    scale = 10**MINUTE_DIGITS
    degrees, minutes = divmod(round(abs(angle_deg) * 60 * scale), 60 * scale)
    return f"{degrees:0{digits}d}{minutes / scale:0{MINUTE_DIGITS + 3}.{MINUTE_DIGITS}f}", signs[angle_deg < 0]


def _sentence(kind: str, *fields: object) -> bytes:
    body = ",".join([f"GP{kind}", *map(str, fields)]).encode()
    return b"$%b*%02X\r\n" % (body, reduce(int.__xor__, body))
