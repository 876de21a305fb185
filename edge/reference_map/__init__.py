"""The map of known places: on-disk format, building, and the cost of a query to every place.

`map_set`  a map, or a folder of them, opened as plain arrays; `place_index` counts their places through
`store`    the folder of one map: JSON header, int8 descriptors (memory-mapped), places, segments, thumbnails
`costs`    normalized query (n, R, D) -> integer cosine costs (n, 2, N), one plane for each region order
`spatial_index`  which places a known position allows; `route` positions along the map's drives
`checksums`  a piece at a time, between frames; `signature` who made a map
`builder`  adds place after place, then normalizes and writes the whole set, atomically (`atomic_folder`)
`tiles`    one map cut into several; `pca` descriptors of fewer dimensions
"""

from edge.reference_map.costs import COST_ONE
from edge.reference_map.map_set import ExcludedMap, MapSet, open_map_set
from edge.reference_map.route import Drive, Drives, Position, Route
from edge.reference_map.spatial_index import Bounds, Ranges
from edge.reference_map.store import ModelKey, ReferenceMap, open_map

__all__ = [
    "COST_ONE",
    "Bounds",
    "Drive",
    "Drives",
    "ExcludedMap",
    "MapSet",
    "ModelKey",
    "Position",
    "Ranges",
    "ReferenceMap",
    "Route",
    "open_map",
    "open_map_set",
]
