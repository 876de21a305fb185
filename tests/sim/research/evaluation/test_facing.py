"""The table of two cameras that face each other, on a road made of random descriptors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.research.evaluation.facing import of_worlds
from sim.research.evaluation.roads import DriveDescriptors, Drives

PLACES, SPACING_M = 200, 2.0


def test_a_course_tells_the_way_home_from_the_way_out_that_it_resembles_more() -> None:
    rng = np.random.default_rng(3)
    raw = rng.normal(size=(PLACES + 2, 2, 128))
    alike = np.asarray(raw[:-2] + raw[1:-1] + raw[2:], np.float32)
    route_m = np.arange(0.0, PLACES) * SPACING_M
    ground_m = np.column_stack([np.zeros(PLACES), route_m])
    out = DriveDescriptors(alike, route_m, route_m, ground_m)
    back = alike[::-1, ::-1]  # the sides of the road are swapped
    home = DriveDescriptors(back + 1.2 * alike, route_m[::-1].copy(), route_m, ground_m[::-1].copy())
    plain = replace(home, raw=back + 0.5 * rng.normal(size=back.shape).astype(np.float32))
    drives: Drives = {("night", "forward"): out, ("day", "reverse"): home, ("night", "reverse"): plain}
    cells = [[cell.strip() for cell in row.split("|")[2:5]] for row in list(of_worlds([(out, drives)]))[2:]]
    (without, not_believed, _), (right, believed, wrong) = cells
    assert float(without) < 0.3
    assert float(right) > 0.9
    assert float(believed.split("; ")[1]) > 0.6 > float(not_believed.split("; ")[0])
    assert wrong.startswith("0; 0 of ")
