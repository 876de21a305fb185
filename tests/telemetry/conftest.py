"""Our connection against a simulated autopilot."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.telemetry.rig import OpenRig, Rig


@pytest.fixture
def open_rig(tmp_path: Path) -> Iterator[OpenRig]:
    """Opens a Rig with other options than `rig`'s."""
    opened: list[Rig] = []

    def open_one(**options: Any) -> Rig:
        opened.append(Rig(tmp_path, **options))
        return opened[-1]

    yield open_one
    for rig in opened:
        rig.close()


@pytest.fixture
def rig(open_rig: OpenRig, request: pytest.FixtureRequest) -> Rig:
    """A connection in `report`, or with the options that an indirect parameter gives."""
    return open_rig(**getattr(request, "param", {}))
