"""What `lookback doctor` finds, also with `--offline`, in the config and the files that it names: model, maps, keys."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np
from msgspec import UNSET

from edge.camera import check_kind
from edge.config import LinkConfig, load_config
from edge.descriptor.network import Network
from edge.descriptor.open_network import open_network
from edge.errors import LookbackError
from edge.journal.records import CameraDiffers, Record
from edge.recognition.recognizer import network_for, open_recognizer
from edge.reference_map import MapSet, open_map_set
from edge.telemetry.autopilot import open_port
from edge.telemetry.link import parse_connection
from edge_plugins.doctor.findings import DoctorContext, Found, bad, good, note
from edge_plugins.home import HomeConfig
from edge_plugins.mapping import MappingConfig
from edge_plugins.motion import MotionConfig
from edge_plugins.motion.camera_motion import LEAST_NS, CameraMotion
from edge_plugins.motion.ground import FAR_HEIGHTS, GroundView
from edge_plugins.motion.height import WINDOW_M, WINDOWS

RecordT = TypeVar("RecordT", bound=Record)
TAIL_BYTES = 1_000_000  # minutes with every frame, hours without
MEASURE = "`lookback calibrate camera FEED` measures it (docs/cameras.md)"
LEAST_GROUND = 0.1
"""Of the picture: of one of 4 : 3 that is level, at 80 degrees, it is 30 %."""


def check_config(examined: DoctorContext) -> Iterator[Found]:
    """Whether every key of the config is right."""
    path = examined.path
    if path is None:
        remedy = "lookback doctor CONFIG; `lookback config > lookback.toml` writes one to start from"
        yield note("no config file was named, so no camera, map or autopilot is checked", remedy)
        return
    try:
        config = load_config(path)
        check_kind(config.camera)
    except LookbackError as error:
        remedy = "`lookback config --all` prints every key with its range"
        for mistake in str(error).splitlines():
            yield bad(mistake, remedy if path.exists() else "name the config file of `lookback run`")
        return
    examined.config = config
    yield good(f"{path}: every key is valid")


def check_model(examined: DoctorContext) -> Iterator[Found]:
    """Whether the model is complete, and how long it takes."""
    network = open_network(network_for(examined.settings))
    time_ms = _describe_ms(network)
    yield good(f"{network.info.name}: complete; two regions take {time_ms:.0f} ms here, on {network.provider}")
    examined.network = network


def _describe_ms(network: Network) -> float:
    images = np.zeros((2, *network.size, 3), dtype=np.uint8)
    network.describe(images)
    started_s = time.perf_counter()
    network.describe(images)
    return (time.perf_counter() - started_s) * 1e3


def check_map(examined: DoctorContext) -> Iterator[Found]:
    """Each map, whether they fit the model and the config, and whether there are enough places with positions."""
    config, path = examined.settings, Path(examined.settings.map.path)
    key = config.map.require_signature_by
    if config.of(MappingConfig).folder and not _has_maps(path):
        yield good(f"{path}: no map yet; the first drive becomes one")
        return
    maps = open_map_set(path, require_signature_by=Path(key) if key else None, every_file=True)
    examined.maps = maps = open_recognizer(config, network=examined.network, map_set=maps).map_set
    yield good(f"{path}: map of {maps}, all checksums match")
    for excluded in maps.excluded:
        yield note(f"{excluded.why}; excluded", "the others are used; build or copy this one again")
    places, length = maps.index.places, config.sequence_frames
    if places < 2 * length:
        found = bad if places < length else note  # with fewer places than frames no sequence ends anywhere
        words = f"{places} places are too few for sequences of {length}"
        yield found(words, "record a longer drive, or lower [sequence] length")
    blank = [index for index, one in enumerate(maps.maps) if np.isnan(one.places["lat_deg"]).any()]
    if blank:
        words = f"{maps.spell(blank)}: some places have no position"
        yield note(words, "they can be recognized, but no position is sent for them")


def check_field_of_view(examined: DoctorContext) -> Iterator[Found]:
    """Whether the camera's field of view is known where maps have keypoints, and what the last drive saw of it."""
    config, path = examined.settings, examined.settings.telemetry.journal
    known = {key.fov_deg for header in _maps(examined).headers if (key := header.keypoints_key) is not None}
    if known and config.camera.fov_deg is UNSET:
        spelled = " or ".join(f"{fov_deg:g}" for fov_deg in sorted(known))
        yield note(f"[camera] fov_deg: is not set; keypoints take it to be {spelled} degrees, the map's", MEASURE)
    with contextlib.suppress(OSError):
        if known and path and (found := _newest(Path(path), CameraDiffers)) is not None:
            camera = f"{found.fov_deg:.1f} ± {found.fov_sigma_deg:.1f} degrees, k1 {found.k1:+.2f}"
            yield note(f"a drive saw {camera}; the config then had {found.configured_deg:g} degrees", MEASURE)


def _has_maps(path: Path) -> bool:
    return path.exists() and (not path.is_dir() or any(path.glob("map.json")) or any(path.glob("*/map.json")))


def _maps(examined: DoctorContext) -> MapSet:
    assert examined.maps is not None  # the check needs them
    return examined.maps


def check_motion(examined: DoctorContext) -> Iterator[Found]:
    """How much of the road the camera of [motion] shows, and whether its height is known."""
    config, motion = examined.settings, examined.settings.of(MotionConfig)
    if motion.use == "off":
        return
    camera, height = config.camera, CameraMotion(config).height
    view = GroundView(
        camera.known_fov_deg("[motion] needs it"), camera.width, camera.height, math.radians(motion.pitch_deg)
    )
    between_s = math.ceil(LEAST_NS / 1e9 * camera.fps) / camera.fps
    words = (
        f"{100 * view.ground_share:.0f} % of the picture are ground up to {FAR_HEIGHTS:g} heights of the camera ahead:"
    )
    words += (
        f" speeds up to {view.most_ahead * (height.height_m or 1.0) / between_s:.0f} m/s, within 3 to 5 % by simulation"
    )
    words += "" if height.height_m else ", for each meter of height"
    yield good(words) if view.ground_share >= LEAST_GROUND else note(words, "tilt the camera down, or crop less")
    if height.height_m:
        yield good(f"the camera was {height.height_m:.2f} m above the ground; {WINDOW_M:g} m with GPS check it")
    else:
        yield note("the camera's height is not known yet", f"drive {WINDOWS * WINDOW_M:g} m with GPS")


def check_links(examined: DoctorContext) -> Iterator[Found]:
    """The connection strings and signing keys of all links; no port is opened."""
    config = examined.settings.telemetry
    links = (LinkConfig(config.connection, config.signing_key), *config.links)
    for number, link in enumerate(links):
        open_port(config, link, number, time.monotonic_ns)
    for link in links:
        if link.signing_key or parse_connection(link.connection).is_local:
            yield good(f"{link.connection}: a valid connection{', signed' if link.signing_key else ''}")
        else:
            open_to = f"{link.connection}: unsigned, and who reaches it can speak in the autopilot's name"
            yield note(open_to, "set signing_key on both ends (docs/positions.md), or use a wire of its own")
            if examined.settings.of(HomeConfig).enabled:
                home = "he can have a way home planned and uploaded while a person steers (MAV_CMD 31014)"
                yield note(f"{link.connection}: {home}", "the same; it starts no mode")
            if link.connection.startswith("udpin:") and "@" not in link.connection:
                only = "the first sender is answered until the next start, whoever it is"
                yield note(f"{link.connection}: {only}", "name the autopilot's address: udpin:HOST:PORT@ADDRESS")


def _newest(path: Path, kind: type[RecordT]) -> RecordT | None:
    """The last record of a kind that a journal's newest file has; None where it has none.

    Only the end of the file is read. OSError where it cannot be.
    """
    with path.open("rb") as stream:
        stream.seek(max(0, path.stat().st_size - TAIL_BYTES))
        lines = stream.read().splitlines()
    for line in reversed(lines):
        with contextlib.suppress(msgspec.DecodeError, UnicodeDecodeError):
            fields = msgspec.json.decode(line, type=dict[str, Any])
            if fields.get("event") == kind.__struct_config__.tag:
                return msgspec.convert(fields, kind)
    return None
