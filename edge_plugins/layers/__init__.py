"""Drives over one road as its layers, and what each was good for. `lookback map learn` chooses which are searched.

`learner` runs that command after the daemon's drives
`tally`   what the daemon recognized, by map, light and stretch; a file for each run
`stored`  the maps of a folder on the disk, and which are deleted for want of space
`plugin`  both of them, for the daemon
`road`    which drives pass the same road, and how alike they look there
"""

from edge_plugins.layers.learner import Learner, learn_command
from edge_plugins.layers.road import NEEDED, REACH_M, Stretch, stretches
from edge_plugins.layers.stored import CLOCK_SET_UNIX_S, KEEP_FILE, StoredMap, delete_oldest, keys_of, stored_maps
from edge_plugins.layers.tally import (
    LIGHTS,
    STRETCH_PLACES,
    TALLIES,
    Counts,
    DriveTally,
    Tally,
    light_of,
    read_tallies,
    read_tally,
    source_of,
)

__all__ = [
    "CLOCK_SET_UNIX_S",
    "KEEP_FILE",
    "LIGHTS",
    "NEEDED",
    "REACH_M",
    "STRETCH_PLACES",
    "TALLIES",
    "Counts",
    "DriveTally",
    "Learner",
    "StoredMap",
    "Stretch",
    "Tally",
    "delete_oldest",
    "keys_of",
    "learn_command",
    "light_of",
    "read_tallies",
    "read_tally",
    "source_of",
    "stored_maps",
    "stretches",
]
