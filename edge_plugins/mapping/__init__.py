"""How maps are made, and live mapping: a drive is searched while it is driven, a fixed distance behind the vehicle.

`builder`    adds place after place, then normalizes and writes the whole set, atomically
`place_log`  the file that takes a drive's places, of `place_log_records`: after any crash, all that is whole
`earlier_drives`  the files of earlier drives become ordinary maps
`live_keypoints`  the keypoints of each place, by a thread of their own
`drive_store`  the file and the map in memory (`growing_map`) together; what of it is searched
`live_map`   which frames become places, and where these are
`outage`     places that were passed while GPS was lost: where they are, once it is back
`missed_places`  places that were passed without a frame
`status`     what people are shown of all this
`plugin`     which frames of which camera are mapped, for the daemon
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from msgspec import UNSET, Meta, UnsetType

from edge.config import CameraConfig, Config, FilePath, NotNegative, Positive, Section
from edge.errors import ConfigError


class MappingConfig(Section, frozen=True):
    """[mapping]: the drive becomes a map while it is driven.

    camera: [mapping.camera], a camera of its own; [camera] maps as well where there is none. keypoints: of each place.
    """

    plugin: ClassVar[str] = "edge_plugins.mapping.plugin:Mapping"
    folder: FilePath = ""
    max_sigma_m: Positive = 5.0
    without_gps: Literal["stop", "continue"] = "stop"
    behind_m: Annotated[float, Meta(ge=10, le=10_000)] = 60.0
    resume_min: Annotated[float, Meta(ge=0, le=1440)] = 30.0
    keypoints: bool = True
    quota_mb: Positive = 20_000.0
    min_free_mb: NotNegative = 500.0
    camera: CameraConfig | UnsetType = UNSET

    def asks(self, config: Config) -> bool:
        """Where a folder is named."""
        if self.camera is not UNSET and not self.folder:
            raise ConfigError("[mapping] folder: is empty; name the folder of maps, or remove [mapping.camera]")
        if self.folder and config.sampling.by != "distance":
            raise ConfigError('[mapping] folder: mapping needs [sampling] by = "distance"')
        return bool(self.folder)
