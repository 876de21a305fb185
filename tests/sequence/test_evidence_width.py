"""How many places a match is nearly as good at, on costs whose answer is known."""

from __future__ import annotations

import numpy as np

from edge.sequence.evidence import places_nearly_as_good
from edge.sequence.search import NO_LINE


def test_the_width_is_that_of_the_valley_below_a_fifth_of_its_depth() -> None:
    costs = (1000 + 50 * (np.arange(40) - 20.0) ** 2).astype(np.int32)
    assert places_nearly_as_good(costs, 20, elsewhere=3000) == 2.5, "those within 2 places cost less than 1400"
    assert places_nearly_as_good(costs, 20, elsewhere=1010) == 0.5, "only itself"
    assert places_nearly_as_good(costs, 20, elsewhere=NO_LINE) == 20.0, "all of them"
