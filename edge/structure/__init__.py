"""The shape of a street: where two drives with opposite views pass the same walls, poles and trees.

    MapPoints of a drive --path--> points (along, left, up) of the drive's path --cells--> StructureMatch

What the two cameras see of a thing is not alike, but where it stands is.
"""

from __future__ import annotations

from typing import NamedTuple


class StructureMatch(NamedTuple):
    """Where a vehicle was on a drive of the map, by the points that both passed.

    place_index: of the drive's place nearest to there. ahead_m, left_m: of the vehicle from that place, along the map's
    drive. frames: between then and the newest one. sigma_m: one standard deviation along-track and cross-track, without
    the error of the map. score: cosine of the cells.
    """

    place_index: int
    ahead_m: float
    left_m: float
    frames: float
    sigma_m: tuple[float, float]
    score: float
