"""How far ahead of the vehicle the matched place lies: measured on recorded drives with GPS, for each direction."""

from __future__ import annotations

import statistics

import msgspec

from edge.camera.feed import Feed
from edge.config import RigConfig
from edge.descriptor.network import Head, Network
from edge.recognizer import PlaceRecognizer
from edge.reference_map.store import ReferenceMap
from edge.replay import config_for_map, replay
from edge.sequence import Direction


def measure_rig(reference_map: ReferenceMap, drives: list[Feed]) -> RigConfig:
    """The median offset over all accepted matches of the drives; 0 m for a direction that none of them has.

    The drives must have been recorded along the map's own route, with `route_m` in every row.
    """
    offsets_m: dict[Direction, list[float]] = {"forward": [], "reverse": []}
    map_route_m = reference_map.places["route_m"]
    network = Network.load()
    for drive in drives:
        config = config_for_map(reference_map.header)
        config = msgspec.structs.replace(config, camera=msgspec.structs.replace(config.camera, view=drive.header.view))
        recognizer = PlaceRecognizer(network, Head.load(network), reference_map, config)
        for seen in replay(recognizer, drive, config.sampling, reference_map.places["row"].tolist()):
            if seen.accepted and seen.place is not None and seen.direction is not None:
                further_m = float(map_route_m[seen.place]) - float(drive.rows[seen.frame].extra["route_m"])
                # On the way back "ahead" is towards the start of the route.
                offsets_m[seen.direction].append(further_m if seen.direction == "forward" else -further_m)
    medians = {direction: statistics.median(values) if values else 0.0 for direction, values in offsets_m.items()}
    return RigConfig(ahead_forward_m=medians["forward"], ahead_reverse_m=medians["reverse"])
