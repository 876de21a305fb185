"""What `lookback doctor` finds, also with `--offline`, in the files that a config names: model, maps and keys."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from edge.commands.diagnostic import Diagnostic, bad, good, note
from edge.config import Config, LinkConfig, TelemetryConfig
from edge.descriptor.network import Head, Network
from edge.descriptor.open_network import open_network
from edge.errors import LookbackError
from edge.feed.sampling import spell_spacing
from edge.map_agreement import disagreements
from edge.mission import plan_way_home
from edge.recognizer import open_recognizer
from edge.reference_map import Drives, MapSet, open_map_set
from edge.reference_map.place_records import spell_accuracy
from edge.telemetry.autopilot import open_port
from edge.telemetry.link import parse_connection


def check_model_and_map(config: Config) -> Iterator[Diagnostic]:
    """Model and maps, each of them, and whether they fit each other and the config."""
    try:
        network = open_network(config.descriptor)
        if network.info.labels:
            Head.load(network)
        time_ms = _describe_ms(network)
        yield good(
            "model", f"{network.info.name}: complete; two regions take {time_ms:.0f} ms here, on {network.provider}"
        )
    except LookbackError as error:
        yield bad("model", str(error), 'set [descriptor] model = "" for the model that comes with lookback')
        return
    key = config.map.require_signature_by
    if config.mapping.folder and not _has_maps(Path(config.map.path)):
        yield good("map", f"{config.map.path}: no map yet; the first drive becomes one")
        return
    try:
        maps = open_map_set(Path(config.map.path), require_signature_by=Path(key) if key else None, every_file=True)
        maps = open_recognizer(config, network=network, map_set=maps).map_set
    except LookbackError as error:
        yield bad("map", str(error), f"record a drive, then: lookback map build FEED -o {config.map.path}")
        return
    yield good("map", f"{config.map.path}: map of {maps}, all checksums match")
    yield good("map accuracy", spell_accuracy(maps.places))
    for one in disagreements(maps):
        yield note("map accuracy", str(one), "find out which drive is wrong, and build the map without it")
    for excluded in maps.excluded:
        yield note("map", f"{excluded.why}; excluded", "the others are used; build or copy this one again")
    yield from _places(maps, config)
    if config.home.enabled:
        yield from _way_home(maps, config)


def check_mapping(config: Config) -> Iterator[Diagnostic]:
    """Whether drives can become maps: the folder can be written, and has room."""
    folder, min_free_mb = Path(config.mapping.folder), config.mapping.min_free_mb
    if not config.mapping.folder:
        return
    existing = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    free_mb = shutil.disk_usage(existing).free / 1e6
    if not os.access(existing, os.W_OK):
        yield bad("mapping", f"{existing}: this user may not write there", "change its owner or its mode")
    elif free_mb <= min_free_mb:
        yield bad(
            "mapping", f"{folder}: {free_mb:.0f} MB are free, and mapping stops at {min_free_mb:.0f}", "make room"
        )
    else:
        yield good("mapping", f"{folder}: {free_mb / 1e3:.1f} GB are free")
    if Path(config.map.path).resolve() != folder.resolve():
        words = "[mapping] folder is not [map] path: a finished map is searched only where the configuration names it"
        yield note("mapping", words, "name the same folder in both, unless you want this")


def _has_maps(path: Path) -> bool:
    return path.exists() and (not path.is_dir() or any(path.glob("map.json")) or any(path.glob("*/map.json")))


def _places(maps: MapSet, config: Config) -> Iterator[Diagnostic]:
    """How well the maps will serve, by their headers and places."""
    places, length = maps.index.places, config.sequence.length
    if places < 2 * length:
        words = f"{places} places are too few for sequences of {length}"
        found = bad if places < length else note  # with fewer places than frames no sequence ends anywhere
        yield found("map", words, "record a longer drive, or lower [sequence] length")
    drives = Drives(maps, config.sampling.spacing_m)
    words = spell_spacing(config.sampling, drives.spacing_m if drives.is_metric else None)
    if drives.is_metric and config.sampling.by == "distance":
        yield good("sampling", f"{words}; without the autopilot's speed, drive as fast as when it was made")
    else:
        yield note("sampling", f"{words}; they must be as far apart", 'set [sampling] by = "distance" where you can')
    blank = [index for index, one in enumerate(maps.maps) if np.isnan(one.places["lat_deg"]).any()]
    if blank:
        words = f"{maps.spell(blank)}: some places have no position"
        yield note("map", words, "they can be recognized, but no position is sent for them")


def _way_home(maps: MapSet, config: Config) -> Iterator[Diagnostic]:
    """Whether the whole of the newest drive can be driven back."""
    try:
        way = plan_way_home(maps, None, config.home, config.rig.left_reverse_m)
    except LookbackError as error:
        yield note("way home", str(error), "record a drive with positions")
        return
    for text in (*way.refusals, *way.warnings):
        yield note("way home", text, "docs/home.md explains the checks")
    if not way.refusals:
        yield good("way home", str(way))


def _describe_ms(network: Network) -> float:
    images = np.zeros((2, *network.size, 3), dtype=np.uint8)
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
        if link.signing_key or parse_connection(link.connection).is_local:
            yield good("link", f"{link.connection}: a valid connection{', signed' if link.signing_key else ''}")
        else:
            open_to = f"{link.connection}: unsigned, and who reaches it can speak in the autopilot's name"
            yield note("link", open_to, "set signing_key on both ends (docs/positions.md), or use a wire of its own")
