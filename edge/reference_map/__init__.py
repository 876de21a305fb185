"""The map of places seen from behind: on-disk format, building, and the cost of a query to every place.

`store`   the folder: JSON header, int8 descriptors (memory-mapped), places, segments, thumbnails
`extent`  where a map's places lie, and what it was cut from
`atlas`   one map or a folder of them as one: `numbering` counts their places through, a `sheet` is one that is open
`build`   adds place after place, then normalises and writes the whole set, atomically
`costs`   normalised query (n, R, D) -> integer cosine costs (n, 2, N), one plane for each region order
`areas`   which places a known position allows; `route` positions along the map's drives
`split`   one map cut into tiles; `new_folder` puts what is written in its place at once
`projection`, `verification`   descriptors of fewer dimensions; checksums, a piece at a time
"""

from edge.reference_map.route import Drive, Position, Route

__all__ = ["Drive", "Position", "Route"]
