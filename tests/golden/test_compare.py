from __future__ import annotations

import pytest

from tests.golden.compare import first_difference

FIX = '{"event":"fix_sent","place":129,"lat_deg":-27.477408448,"sigma_m":4.199,"age_s":0.2,"level_m":1e-06}'
MESSAGE = '{"mavpackettype": "COMMAND_INT", "lat": -274773761, "time_usec": 48465000, "param2": 0.45396992564201355}'


@pytest.mark.parametrize(
    ("line", "old", "new"),
    [
        (FIX, "4.199", "4.198"),
        (FIX, "4.199", "4.2"),
        (FIX, "408448", "408447"),
        (FIX, "1e-06", "2e-06"),
        (MESSAGE, "-274773761", "-274773760"),
        (MESSAGE, "564201355", "5940036774"),
    ],
)
def test_a_last_digit_may_be_rounded_otherwise(line: str, old: str, new: str) -> None:
    assert first_difference(line, line.replace(old, new)) is None


@pytest.mark.parametrize(
    ("line", "old", "new"),
    [
        (FIX, "129", "130"),
        (FIX, "4.199", "4.201"),
        (FIX, "4.199", "null"),
        (FIX, "408448", "408446"),
        (FIX, "0.2", "0.3"),
        (FIX, "fix_sent", "fix_withheld"),
        (FIX, "}", "}\n{}"),
        (MESSAGE, "-274773761", "-274773759"),
        (MESSAGE, "48465000", "48465001"),
        (MESSAGE, "0.453969", "0.453970"),
    ],
)
def test_all_else_is_held(line: str, old: str, new: str) -> None:
    assert first_difference(f"{FIX}\n{line}", f"{FIX}\n{line.replace(old, new)}") is not None
