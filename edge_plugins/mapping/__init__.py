"""How maps are made, and live mapping: a drive is searched while it is driven, a fixed distance behind the vehicle.

`builder`    adds place after place, then normalizes and writes the whole set, atomically
`place_log`  the file that a drive's places are appended to, of `place_log_records`: after any crash, all that is whole;
             that of an earlier drive becomes an ordinary map
`live_map`   which frames become places; the file and the map in memory (`growing_map`) together
`outage`     places that were passed while GPS was lost: where they are, once it is back
`missed_places`  places that were passed without a frame
`status`     what people are shown of all this, and what to expect if GPS were lost now
`drive_mapper`   which frames of which camera are mapped, for the daemon (`plugin`)
"""

from edge_plugins.mapping.live_map import LiveMap
from edge_plugins.mapping.place_log_records import LogHeader
from edge_plugins.mapping.status import MappingStatus, MappingView, WayHome

__all__ = ["LiveMap", "LogHeader", "MappingStatus", "MappingView", "WayHome"]
