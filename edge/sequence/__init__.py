"""From cost rows to a match: lines through the last L rows (eq. 2 and 3), and whether the best one is believed.

costs (orders, N) --search--> best line that ends at each place --acceptance--> SequenceMatch
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Direction = Literal["forward", "reverse"]
Order = Literal["same", "swapped"]
Alignment = tuple[Direction, Order]
"""How a line runs through the cost matrix, and which of the two costs of a place it adds up."""

ORDERS: tuple[Order, ...] = ("same", "swapped")
"""Rows of a cost row, in this order."""

VIEWS_ALIKE: tuple[Alignment, ...] = (("forward", "same"), ("reverse", "swapped"))
"""What can occur if both cameras look ahead, or both back."""

VIEWS_OPPOSED: tuple[Alignment, ...] = (("forward", "swapped"), ("reverse", "same"))
"""What can occur if one camera looks ahead and one back: on the way back along the map the two look the same way."""


@dataclass(frozen=True)
class SequenceMatch:
    """The best line through the ring, believed or not.

    place: where the line ends, that is, what the newest frame shows (I_min of eq. 3).
    direction: "forward" if places were passed in the map's order, "reverse" if backwards.
    order: "swapped" if the query's left region matched the map's right.
    slope: how many places the line passes a frame, without sign.
    cost: mean cost along the line, in the units of the cost rows.
    uniqueness: lowest cost outside the window around `place` over the lowest cost; 1 is ambiguous.
    accepted: whether this is a place fix; False means that the vehicle is off the map, or cannot be told apart.
    beyond: places by which the line ends beyond `place` in the map's order, between places.
    width: half the number of places around it that are nearly as good.
    """

    place: int
    direction: Direction
    order: Order
    slope: float
    cost: float
    uniqueness: float
    accepted: bool
    beyond: float = 0.0
    width: float = 0.5
