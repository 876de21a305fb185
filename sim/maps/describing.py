"""A recording as the places of a map: descriptors and records, here or on the workers of a cluster.

    dask scheduler                                        # on one computer, from the package `distributed`
    dask worker ADDRESS --nworkers 4 --nthreads 1         # on each: the same version, the recordings by the same paths
    lookback map build ... --cluster ADDRESS

A worker describes a whole recording. Before anything of it is used, it must have described a test picture with the very
bytes of this computer: processors of other kinds round otherwise, and the map would depend on who made it.
"""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypedDict

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

import edge
from edge.camera.preprocessing import preprocessed_feed
from edge.config import Config, DescriptorConfig, SamplingConfig
from edge.descriptor.network import Network, pictures_for
from edge.descriptor.open_network import open_network
from edge.errors import ConfigError, MapError
from edge.extras import import_extra
from edge.feed import Feed, FeedOptions, Frame
from edge.keypoints import Keypoints
from edge.keypoints.lens import DriveKeypoints
from edge.keypoints.network import KeypointNetwork
from edge.reference_map.store import RegionsKey
from edge_plugins.mapping.builder import MapBuilder, Place, thumbnail
from sim.datasets.found import open_recording
from sim.traverse import TraverseFrame, has_odometer, traverse, whole_sigma_m, with_course

MEASURED = ("lat_deg", "lon_deg", "alt_m", "heading_deg", "position_sigma_m")
"""What places have as rows of a feed have it."""
TEST_PICTURE = 240, 320, 3
AHEAD = 2
"""Recordings for each worker that are described before the map needs them: one that it works on, one that waits."""
CONNECT_S = 3
"""A scheduler answers in milliseconds."""


class SegmentOptions(TypedDict):
    """What `begin_segment` takes."""

    has_odometer: bool
    whole_sigma_m: float | None
    heading_is_course: bool


@dataclass(frozen=True)
class RecordingDescriptors:
    """What a worker made of a recording: raw descriptors (N, R, D) as a map keeps them, and the places.

    keypoints: of each place, none where the map has none. made_by: see `fingerprint`.
    """

    name: str
    view: Literal["front", "rear"]
    known: SegmentOptions
    raw: NDArray[np.float16]
    places: tuple[Place, ...]
    keypoints: tuple[Keypoints, ...]
    made_by: str


@dataclass(frozen=True)
class Work:
    """What is to be done with every recording. config: [camera] and [descriptor] of it."""

    config: Config
    options: FeedOptions
    sampling: SamplingConfig
    must_have_distance: bool
    with_keypoints: bool = False


def add_feed(
    builder: MapBuilder,
    feed: Feed,
    network: Network,
    regions: RegionsKey,
    sampling: SamplingConfig,
    *,
    must_have_distance: bool = False,
) -> None:
    """Describe a recording here, and add it as a segment."""
    finder = None if builder.keypoints is None else DriveKeypoints(KeypointNetwork().extract)
    feed = with_course(feed)
    builder.begin_segment(feed.header.name, feed.header.view, **_known_of(feed))
    with tqdm(total=len(feed.rows), desc=feed.header.name, unit="frame", disable=None) as progress:
        for frame, raw, place in _described(feed, network, regions, sampling, must_have_distance):
            builder.add(raw, place)
            if builder.keypoints is not None and finder is not None:
                builder.keypoints.add(*finder.add(frame.image))
            progress.update(frame.index + 1 - progress.n)
        if builder.keypoints is not None and finder is not None:
            builder.keypoints.add(*finder.rest())
        progress.update(len(feed.rows) - progress.n)


def add_by_cluster(builder: MapBuilder, network: Network, paths: Sequence[Path], work: Work, address: str) -> None:
    """Have the workers of the scheduler at an address describe recordings, and add them in their order.

    ConfigError where there is no such scheduler; MapError for a worker that describes otherwise than this computer.
    """
    distributed = import_extra("distributed", "cluster", "--cluster needs dask.distributed")
    here = fingerprint(network)
    try:
        client = distributed.Client(address, timeout=CONNECT_S)
    except (OSError, ValueError) as error:
        raise ConfigError(f"--cluster: no scheduler at {address} ({error}); start one with `dask scheduler`") from None
    with client:
        print(f"dashboard: {client.dashboard_link}", flush=True)
        left: deque[Path] = deque(paths)
        waiting: deque[Any] = deque()
        with tqdm(total=len(paths), desc=str(address), unit="recording", disable=None) as progress:
            while left or waiting:
                while left and len(waiting) < AHEAD * max(1, len(client.ncores())):
                    waiting.append(client.submit(describe, left.popleft().resolve(), work, pure=False))
                try:
                    drive: RecordingDescriptors = waiting.popleft().result()
                except distributed.KilledWorker as error:
                    why = f"--cluster: workers died of a recording, for want of memory perhaps: {error}"
                    raise MapError(why) from None
                if drive.made_by != here:
                    raise MapError(
                        f"--cluster: a worker described the test picture of {drive.name} otherwise than this computer:"
                        f" {drive.made_by} there, {here} here; use workers of one version on one kind of processor"
                    )
                builder.begin_segment(drive.name, drive.view, **drive.known)
                for raw, place in zip(drive.raw, drive.places, strict=True):
                    builder.add(raw.astype(np.float32), place)
                if builder.keypoints is not None:
                    for keypoints in drive.keypoints:
                        builder.keypoints.add(keypoints)
                progress.update()


def describe(path: Path, work: Work) -> RecordingDescriptors:
    """A recording, on a worker."""
    feed = with_course(preprocessed_feed(open_recording(path, work.options), work.config.camera))
    network = _network(work.config.descriptor)
    regions = RegionsKey.of(work.config.descriptor)
    finder = DriveKeypoints(KeypointNetwork().extract) if work.with_keypoints else None
    raw: list[NDArray[np.float16]] = []
    places: list[Place] = []
    keypoints: list[Keypoints] = []
    for frame, one, place in _described(feed, network, regions, work.sampling, work.must_have_distance):
        raw.append(one.astype("<f2"))
        places.append(place)
        keypoints += finder.add(frame.image) if finder is not None else []
    keypoints += finder.rest() if finder is not None else []
    made = feed.header.name, feed.header.view, _known_of(feed)
    return RecordingDescriptors(*made, np.array(raw), tuple(places), tuple(keypoints), fingerprint(network))


def fingerprint(network: Network) -> str:
    """Version, and a checksum of what the network makes of a picture here."""
    picture = np.random.default_rng(0).integers(0, 256, TEST_PICTURE, np.uint8)
    raw = network.describe(pictures_for(network.info, picture, "left-right", 0.5))
    return f"{edge.__version__} {hashlib.sha256(raw.tobytes()).hexdigest()[:16]}"


@cache
def _network(descriptor: DescriptorConfig) -> Network:
    return open_network(descriptor)


def _known_of(feed: Feed) -> SegmentOptions:
    return {
        "has_odometer": has_odometer(feed),
        "whole_sigma_m": whole_sigma_m(feed),
        "heading_is_course": feed.header.heading_is_course,
    }


def _described(
    feed: Feed, network: Network, regions: RegionsKey, sampling: SamplingConfig, must_have_distance: bool
) -> Iterator[tuple[Frame, NDArray[np.float32], Place]]:
    """Frame, raw descriptor and record of each place."""
    for item in traverse(feed, sampling, must_have_distance=must_have_distance):
        raw = network.describe(pictures_for(network.info, item.frame.image, regions.kind, regions.width))
        yield item.frame, raw, _place(item)


def _place(item: TraverseFrame) -> Place:
    row = item.row
    measured = {name: getattr(row, name) for name in MEASURED} | {"route_m": item.distance_m}
    known = {name: value for name, value in measured.items() if value is not None}
    picture = thumbnail(item.frame.image)
    return Place(item.frame.index, **known, thumbnail=picture, position_source=row.position_source)
