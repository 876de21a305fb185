"""How many places of a map have keypoints whose distances are known, and if they are few, why."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from edge.keypoints.drive_points import SPARSE_REACH_M
from edge.keypoints.points import FEWEST_ROWS
from edge.keypoints.pose import FEWEST_POINTS
from edge.reference_map import ReferenceMap

MOST = 512
"""Places that are read, evenly chosen: 12 MB."""
FEW = 0.5
"""Share of places below which a map says why."""


def distances_known(reference_map: ReferenceMap) -> tuple[int, NDArray[np.int64]]:
    """How many points of known distance each of some places has, and of how many places; none without keypoints."""
    records, places = reference_map.keypoints, reference_map.header.places
    if records is None:
        return places, np.empty(0, np.int64)
    chosen = np.unique(np.linspace(0, places - 1, min(places, MOST)).round().astype(int))
    return places, np.array([np.isfinite(records[place]["sigma"]).sum() for place in chosen])


def spell_distances(reference_map: ReferenceMap) -> Iterator[str]:
    """For people: the share of places from which a pose can be computed; if it is small, also why."""
    places, known = distances_known(reference_map)
    if not known.size:
        return
    enough = known >= FEWEST_POINTS
    checked = "" if len(known) == places else " checked"
    many = f", {np.median(known[enough]):.0f} in the median" if enough.any() else ""
    yield f"{enough.sum()} of {len(known)} keyframes{checked} have map points ({FEWEST_POINTS} or more{many})"
    if enough.mean() < FEW:
        yield f"few, since {_why(reference_map)}"


def _why(reference_map: ReferenceMap) -> str:
    """What most places lack."""
    places, key = reference_map.places, reference_map.header.keypoints_key
    assert key is not None
    if np.isnan(places["route_m"]).mean() >= FEW:
        return "the recording has neither positions nor distances for its pictures"
    if np.isnan(places["heading_deg"]).mean() >= FEW:
        if np.isfinite(places["lat_deg"]).mean() >= FEW:
            return "the map has positions, but hardly a heading; build it again, or run `map keypoints`"
        return "the recording has no headings, and no positions whose course would be one"
    steps_m = np.concatenate([np.diff(places["route_m"][one.start : one.end]) for one in reference_map.header.segments])
    apart_m = float(np.nanmedian(steps_m))
    if apart_m > SPARSE_REACH_M:
        return f"places are {apart_m:.0f} m apart, and a distance needs {FEWEST_ROWS} within {SPARSE_REACH_M:g} m"
    return (
        f"what is seen does not move as positions and a field of view of {key.fov_deg:g} degrees say, or little is seen"
        " again: check --fov-deg, the view, and the times of the positions"
    )
