"""Which drives are closed laps: by what their ends show, and by where they lie."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.reference_map import NO_LAP_M, Drives, ModelKey
from edge_plugins.mapping.builder import Place
from sim.compare.temporary_map import MappedDrive, temporary_map

LAP = 100
MODEL = ModelKey("none", "0" * 64, "fc6", 64)


def _lap_descriptors(places: int, lap: int = LAP) -> NDArray[np.float32]:
    """Raw descriptors (places, 2, 64) that change smoothly, and begin again after a lap."""
    rng = np.random.default_rng(3)
    noise = np.fft.rfft(rng.normal(size=(lap, 2, 64)), axis=0)
    smooth = np.fft.irfft(noise[: lap // 8], lap, axis=0) + 5
    repeated = np.tile(smooth, (2, 1, 1))[:places]
    return (repeated + 0.05 * rng.normal(size=repeated.shape)).astype(np.float32)


def _laps(raw: NDArray[np.float32], places: list[Place]) -> Any:
    with temporary_map([MappedDrive(raw, places, "front")], MODEL) as map_set:
        return map_set.laps, Drives(map_set, 2.0).lap_m(0)


@pytest.mark.parametrize("places", [LAP, LAP + 1, LAP + 5])
def test_a_drive_whose_end_shows_its_beginning_is_closed(places: int) -> None:
    unknown = [Place(row) for row in range(places)]
    assert _laps(_lap_descriptors(places), unknown) == ((LAP,), pytest.approx(2.0 * LAP))
    along = [Place(row, route_m=3.0 * row) for row in range(places)]
    assert _laps(_lap_descriptors(places), along) == ((LAP,), pytest.approx(3.0 * LAP))


@pytest.mark.parametrize("places", [3, 11, LAP - 10, LAP // 2])
def test_a_drive_that_ends_elsewhere_is_not_closed(places: int) -> None:
    assert _laps(_lap_descriptors(places), [Place(row) for row in range(places)]) == ((None,), NO_LAP_M)


def test_ends_that_look_alike_and_lie_apart_are_not_closed() -> None:
    straight = [Place(row, lat_deg=48.0 + 2e-5 * row, lon_deg=11.0, route_m=2.2 * row) for row in range(LAP)]
    assert _laps(_lap_descriptors(LAP), straight)[0] == (None,)
    turn = 2 * np.pi * np.arange(LAP) / LAP
    circle = [
        Place(row, lat_deg=48.0 + 3e-4 * np.sin(t), lon_deg=11.0 + 4.5e-4 * np.cos(t), route_m=2.1 * row)
        for row, t in enumerate(turn.tolist())
    ]
    assert _laps(_lap_descriptors(LAP), circle)[0] == (LAP,)
