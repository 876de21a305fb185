"""The map of known places: on-disk format, and the cost of a query to every place.

`map_set`  a map, or a folder of them, as plain arrays; `map_folder` opens it, `place_index` counts its places through
`store`    the folder of one map: JSON header, int8 descriptors (memory-mapped), places, segments, thumbnails
`costs`    normalized query (n, R, D) -> integer cosine costs (n, 2, N), one plane for each region order; PCA
`self_similarity`  which drives are closed laps
`spatial_index`  which places a known position allows; `route` positions along the drives
`checksums` a piece at a time, between frames
`gps_motion`  whether positions move as the vehicle does
`map_so_far`  the map of this drive, searched while it grows
"""

from edge.reference_map.costs import COST_ONE
from edge.reference_map.map_folder import is_signed, maps_in, open_map_set
from edge.reference_map.map_set import ExcludedMap, MapSet
from edge.reference_map.map_so_far import PartialMap
from edge.reference_map.place_index import PlaceIndex
from edge.reference_map.place_records import sigmas_m
from edge.reference_map.route import NO_LAP_M, Drives, MapDrive, MapPlaces, Position, Route
from edge.reference_map.spatial_index import Bounds, Ranges
from edge.reference_map.store import MapHeader, ModelKey, ReferenceMap, RegionsKey, open_map, read_header

__all__ = [
    "COST_ONE",
    "NO_LAP_M",
    "Bounds",
    "Drives",
    "ExcludedMap",
    "MapDrive",
    "MapHeader",
    "MapPlaces",
    "MapSet",
    "ModelKey",
    "PartialMap",
    "PlaceIndex",
    "Position",
    "Ranges",
    "ReferenceMap",
    "RegionsKey",
    "Route",
    "is_signed",
    "maps_in",
    "open_map",
    "open_map_set",
    "read_header",
    "sigmas_m",
]
