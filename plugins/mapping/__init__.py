"""Live mapping: the drive becomes a map while it is driven, and can be searched a fixed distance behind the vehicle.

`place_log`  the file that a drive's places are appended to, of `place_log_records`: after any crash, all that is whole;
             that of an earlier drive becomes an ordinary map
`live_map`   which frames become places; the file and the map in memory together
`outage`     places that were passed while GPS was lost: where they are, once it is back
`missed_places`  places that were passed without a frame
`status`     what people are shown of all this, and what to expect if GPS were lost now
"""

from plugins.mapping.live_map import LiveMap
from plugins.mapping.place_log_records import LogHeader
from plugins.mapping.status import MappingStatus, MappingView, WayHome

__all__ = ["LiveMap", "LogHeader", "MappingStatus", "MappingView", "WayHome"]
