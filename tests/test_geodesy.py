"""Our own conversion against pymap3d's, all over the earth."""

from __future__ import annotations

import numpy as np
import pymap3d
import pytest

from edge.geodesy import moved


@pytest.mark.parametrize("far_m", [1.0, 1000.0, 100_000.0])
def test_a_moved_position_is_where_pymap3d_has_it(far_m: float) -> None:
    rng = np.random.default_rng(1)
    for lat_deg, lon_deg in zip(rng.uniform(-89.9, 89.9, 100), rng.uniform(-180, 180, 100), strict=True):
        (east_m, north_m), alt_m = rng.uniform(-far_m, far_m, 2), rng.choice([0.0, 3000.0])
        lat, lon, _ = pymap3d.enu2geodetic(east_m, north_m, 0.0, lat_deg, lon_deg, alt_m)
        assert moved(lat_deg, lon_deg, east_m, north_m, alt_m) == pytest.approx((lat, lon), abs=1e-9)


def test_across_the_antimeridian_it_is_west_again() -> None:
    assert moved(-17.0, 179.9999, 100.0, 0.0)[1] == pytest.approx(-179.99916, abs=1e-5)
