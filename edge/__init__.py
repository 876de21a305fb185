"""Lookback recognizes places of earlier drives, also in the opposite direction, and gives an autopilot its position.

A frame goes through these stages in this order, and none calls back; each passes a plain record to the next:

    feed/           recorded traverses  read, written, sampled
    camera/         -> Frame            image (H, W, 3), stamp_ns, index; one of the cameras plays a feed
    descriptor/     -> (R, D) float32   R regions, raw and normalized (NSD); fc6: D = 4096
    keypoints/      -> RelativePose     of the camera to a place, by points of its picture
    structure/      -> StructureMatch   where points of two drives with opposite views fit each other
    reference_map/  -> (2, N) int32     cosine cost of the query to each of N places, in both region orders
    sequence/       -> PlaceMatch       the best match in the last L cost rows, accepted or off the map
    recognition/    joins the stages up to here: one frame in, one match out; the room to read first
    localization/   -> PlaceFix         the vehicle's position along the map's drive, and whether it may be sent
    telemetry/      -> the autopilot    MAVLink 2: positions, lines for people, values to plot
    journal/        what happened, one record per line
    health/         the daemon's state, and systemd
    commands/       run; the table of all commands, most of which are in `edge_plugins` and `sim`

The files beside them:

    daemon            the loop that moves frames through the stages
    opened_parts      what the loop needs, opened as the config names it
    plugin            guests of the daemon: the parts in `edge_plugins/`, which only some vehicles need, or of others
    config            the one TOML file
    map_verification  which maps are used
    feed_start        when a feed begins that a vehicle follows
    errors            everything that can go wrong, in three kinds
    geodesy           degrees and local meters
    toml_file         a TOML file as a typed record
    files             files and folders that are replaced whole; whether the paths of a config can be reached
    backoff           delays that double while attempts fail
    extras            how to add the packages that only some users need

The public interface is below: `from edge import load_config, open_recognizer, open_map, PlaceMatch, ReferenceMap`.
"""

import os
from importlib import import_module
from typing import Any

__version__ = "0.4.0.dev0"
__all__ = ["PlaceMatch", "ReferenceMap", "load_config", "open_map", "open_recognizer"]

# OpenCV reads it when it is first imported, and the size of a picture before its pixels: 30,000 x 30,000 took 8 GB.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(1 << 26))

_HOMES = {
    "PlaceMatch": "edge.sequence",
    "ReferenceMap": "edge.reference_map",
    "load_config": "edge.config",
    "open_map": "edge.reference_map",
    "open_recognizer": "edge.recognition.recognizer",
}


def __getattr__(name: str) -> Any:
    """A public name, imported when it is first used: `import edge` alone loads no stage."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
