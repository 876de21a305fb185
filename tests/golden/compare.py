"""Compares a golden with what comes out now: to the byte, but for the last digit of a figure that has two or more.

Sums differ in their last bits from one processor to another, so that a figure that is rounded afterwards may be one
unit of its last digit off. Words, counts, times in whole nanoseconds and all else are held to the byte.
"""

from __future__ import annotations

import re
from decimal import Decimal
from itertools import zip_longest

FIGURE = re.compile(
    r"-?\d+\.\d+(?:e[-+]?\d+)?|-?\d+e-\d+"
    r'|(?:(?<="lat": )|(?<="lon": )|(?<="x": )|(?<="y": ))-?\d+'  # of messages: degrees, as integers of 1e-7
)
FINEST = 1e-9
"""What is held of a figure that is written with all its digits."""
SINGLE = 2.0**-22
"""Two units in the last place of a float32, as a share of the number: messages have such fields."""


def first_difference(expected: str, now: str) -> str | None:
    """The first line that differs, for a person; None where all agree."""
    for number, (old, new) in enumerate(zip_longest(expected.splitlines(), now.splitlines()), start=1):
        if old != new and (old is None or new is None or not _agree(old, new)):
            return f"line {number}:\n  expected {old}\n  now      {new}"
    return None


def _agree(old: str, new: str) -> bool:
    if FIGURE.sub("", old) != FIGURE.sub("", new):
        return False
    share = SINGLE if '"mavpackettype"' in old else 0.0
    for was, text in zip(FIGURE.findall(old), FIGURE.findall(new), strict=True):
        one, other = Decimal(was), Decimal(text)
        exponent = min(int(each.as_tuple().exponent) for each in (one, other))
        fine = 0.0 if exponent == 0 else max(FINEST, share * abs(float(one)))
        unit = 0.0 if exponent == -1 else max(10.0**exponent, fine)
        if abs(float(one - other)) > 1.01 * unit:
            return False
    return True
