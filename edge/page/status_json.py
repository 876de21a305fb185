"""A snapshot as the JSON that the live page draws, and the map's route."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from edge.page.status import MapView, Snapshot

ROW_POINTS = 300
"""A cost row of a large map is drawn as the lowest of so many stretches."""


def status_as_json(snapshot: Snapshot, since_ns: int, picture: bytes = b"") -> bytes:
    """The status, its history after `since_ns`, the cost row, and the cost matrix window; costs as cosine distances.

    picture: JPEG of the newest frame, in base64 within, which saves a request; "" for who has it already.
    """
    status = snapshot.status
    new = tuple(used for used in status.history if used.stamp_ns > since_ns)
    fields = msgspec.to_builtins(msgspec.structs.replace(status, history=new))
    return msgspec.json.encode({**fields, "row": _row(snapshot), "window": _window(snapshot), "picture": picture})


def route_as_json(map_view: MapView) -> bytes:
    """The map's drives, and how many places there are."""
    return msgspec.json.encode({"places": map_view.places, "drives": map_view.drives})


def _row(snapshot: Snapshot) -> dict[str, Any]:
    """The lowest cost of each stretch of the map, for each region order, and the place that it is at."""
    orders, places = snapshot.costs.shape
    if places == 0:
        return {"places": [], "orders": []}
    starts = np.unique(np.linspace(0, places, min(places, ROW_POINTS), endpoint=False).astype(int))
    lowest = np.minimum.reduceat(snapshot.costs, starts, axis=1) / snapshot.cost_one
    return {"places": snapshot.places[starts].tolist(), "orders": lowest.round(3).tolist()[:orders]}


def _window(snapshot: Snapshot) -> dict[str, Any]:
    """Rows of the cost matrix, oldest first, as whole thousandths."""
    rows = np.rint(snapshot.window * (1000 / snapshot.cost_one)).astype(int)
    return {"start": snapshot.window_start, "rows": rows.tolist()}
