"""What `lookback doctor` and `lookback check` find in the files that a config names: model, maps and keys."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from edge.commands.diagnostic import Diagnostic, bad, good, note
from edge.config import Config, LinkConfig, TelemetryConfig
from edge.descriptor.network import Head, Network
from edge.errors import LookbackError
from edge.recognizer import open_recognizer
from edge.reference_map import MapSet, open_map_set
from edge.telemetry.autopilot import open_port


def check_model_and_map(config: Config) -> Iterator[Diagnostic]:
    """Model and maps, each of them, and whether they fit each other and the config."""
    try:
        network = Network.load(Path(config.descriptor.model) if config.descriptor.model else None)
        Head.load(network)
        yield good("model", f"{network.info.name}: complete; two regions take {_describe_ms(network):.0f} ms here")
    except LookbackError as error:
        yield bad("model", str(error), 'set [descriptor] model = "" for the model that comes with lookback')
        return
    key = config.map.require_signature_by
    try:
        maps = open_map_set(Path(config.map.path), require_signature_by=Path(key) if key else None, every_file=True)
        maps = open_recognizer(config, network=network, map_set=maps).map_set
    except LookbackError as error:
        yield bad("map", str(error), f"record a drive, then: lookback map build FEED -o {config.map.path}")
        return
    yield good("map", f"{config.map.path}: map of {maps}, all checksums match")
    for excluded in maps.excluded:
        yield note("map", f"{excluded.why}; excluded", "the others are used; build or copy this one again")
    yield from _places(maps, config)


def _places(maps: MapSet, config: Config) -> Iterator[Diagnostic]:
    """How well the maps will serve, by their headers and places."""
    places, length = maps.index.places, config.sequence.length
    if places < 2 * length:
        words = f"{places} places are too few for sequences of {length}"
        found = bad if places < length else note  # with fewer places than frames no sequence ends anywhere
        yield found("map", words, "record a longer drive, or lower [sequence] length")
    otherwise = [index for index, one in enumerate(maps.maps) if one.header.sampling != config.sampling]
    if otherwise:
        words = f"{maps.spell(otherwise)}: not sampled as [sampling] says"
        yield note("map", words, "set [sampling] to what `lookback map info` prints")
    blank = [index for index, one in enumerate(maps.maps) if np.isnan(one.places["lat_deg"]).any()]
    if blank:
        words = f"{maps.spell(blank)}: some places have no position"
        yield note("map", words, "they can be recognized, but no position is sent for them")


def _describe_ms(network: Network) -> float:
    size = network.info.input_size
    images = np.zeros((2, size, size, 3), dtype=np.uint8)
    network.describe(images)
    started_s = time.perf_counter()
    network.describe(images)
    return (time.perf_counter() - started_s) * 1e3


def check_links(config: TelemetryConfig) -> Iterator[Diagnostic]:
    """The connection strings and signing keys of all links; no port is opened."""
    links = (LinkConfig(config.connection, config.signing_key), *config.links)
    try:
        for number, link in enumerate(links):
            open_port(config, link, number, time.monotonic_ns)
    except LookbackError as error:
        yield bad("link", str(error), "correct [telemetry]")
        return
    for link in links:
        yield good("link", f"{link.connection}: a valid connection{', signed' if link.signing_key else ''}")
