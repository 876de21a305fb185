"""Maps of places whose descriptors a test makes up."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any, Literal

from numpy.typing import NDArray

from edge.config import SamplingConfig
from edge.reference_map.store import ModelKey, ReferenceMap, RegionsKey, open_map
from edge_plugins.mapping.builder import MapBuilder, Place

LEFT_RIGHT, WHOLE = RegionsKey("left-right", 0.4), RegionsKey("whole", 1.0)


def map_of(
    path: Path,
    raw: NDArray[Any],
    places: Iterable[Place],
    *,
    starts: Collection[int] = (0,),
    model: ModelKey | None = None,
    view: Literal["front", "rear"] = "front",
    **options: Any,
) -> ReferenceMap:
    """The map of places with descriptors (N, regions, D), one region or two, in drives that start at some of them.

    options: those of MapBuilder.
    """
    _, regions, dimensions = raw.shape
    model = model or ModelKey("test", "0" * 64, "fc6", dimensions)
    with MapBuilder(path, model, LEFT_RIGHT if regions == 2 else WHOLE, SamplingConfig(), **options) as builder:
        for number, (one, place) in enumerate(zip(raw, places, strict=True)):
            if number in starts:
                builder.begin_segment(f"drive {number}", view)
            builder.add(one.astype("f4"), place)
        builder.finish()
    return open_map(path)
