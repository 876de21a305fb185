"""Positions at the edges of the earth."""

from __future__ import annotations

import pytest

from edge.geodesy import moved


def test_across_the_antimeridian_it_is_west_again() -> None:
    assert moved(-17.0, 179.9999, 100.0, 0.0)[1] == pytest.approx(-179.99916, abs=1e-5)
