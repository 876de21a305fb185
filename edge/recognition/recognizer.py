"""The place recognizer: one frame in, one answer out. No camera, no link, no file, no clock.

image -> regions -> descriptor -> `SequenceMatcher`: online NSD -> cost row -> sequence match -> belief
      -> keypoints, where the maps have them -------------> candidates -> keyframe match ---->

    recognizer = open_recognizer(load_config(path))
    match = recognizer.observe(image, stamp_ns)
"""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from msgspec.structs import replace as replace_fields
from numpy.typing import NDArray

from edge.config import FIRST_NETWORK, Config, DescriptorConfig
from edge.descriptor.model_file import network_of_map
from edge.descriptor.network import Network, pictures_for
from edge.descriptor.open_network import open_network
from edge.errors import MapError
from edge.geodesy import POSITION_SOURCES
from edge.recognition.sequence_matcher import MOST_MISSED, SequenceMatcher, Stopwatch, no_stopwatch
from edge.reference_map import MapSet, ModelKey, PartialMap, maps_in, open_map_set, read_header
from edge.sequence import NOTHING_KNOWN, MotionPrior, PlaceMatch
from edge.sequence.evidence import HoldOff

log = logging.getLogger(__name__)

STILL_NS = 3_000_000_000
"""From so long a halt on, the next frame is compared with the last one."""
CARRIED_CHANGE, FEWEST_CHANGES, KEPT_CHANGES = 2.0, 20, 100
"""How many times more than usual the picture must have changed over a halt for the vehicle to have been carried. Frames
2 m apart are up to 2.6 times as far apart as their median, 95 % up to 1.8; of frames 100 m apart 95 % more than 2.8;
after a tow of 100 m one was 2.3 times as far apart."""

VERIFY_AGAIN_NS, VERIFICATIONS = 1_000_000_000, 3
"""Pause between verifications of pictures from one spot, and their number: more show nothing new, until the picture has
changed CARRIED_CHANGE times as much since as within that time, as noise and passing cars change it."""
STILL_M = 0.2
"""Driven since the newest frame, up to which a vehicle stands where that was."""

State = Literal["warming up", "searching", "on the map", "off the map", "standing"]


@dataclass(frozen=True)
class _UsedFrame:
    """A raw descriptor (R, D), its exposure, and the odometer then, None where it was not known."""

    raw: NDArray[np.float32]
    stamp_ns: int
    distance_m: float | None

    def change_to(self, other: _UsedFrame) -> float:
        """Cosine distance of the raw descriptors."""
        lengths = float(np.linalg.norm(self.raw) * np.linalg.norm(other.raw))
        return 1.0 - float(np.vdot(self.raw, other.raw)) / max(lengths, 1e-12)

    def driven_since_m(self, before: _UsedFrame) -> float:
        """Meters driven since another frame, NaN where that is not known."""
        if self.distance_m is None or before.distance_m is None:
            return math.nan
        return self.distance_m - before.distance_m


class _UsedFrames:
    """The newest used frame, and by how much the picture usually changes from one to the next."""

    def __init__(self, config: Config) -> None:
        self._spacing_m, self._standing_change = config.sampling.spacing_m, config.descriptor.standing_change
        self.newest: _UsedFrame | None = None
        self.unmoved = 0
        """Frames since then that showed no other place."""
        self._changes: deque[float] = deque(maxlen=KEPT_CHANGES)  # from each to the next
        self._ns_per_m: deque[float] = deque(maxlen=KEPT_CHANGES)  # of the same

    def stands_still(self, frame: _UsedFrame) -> bool:
        """Whether this frame shows what the last used one did: normalized, it would be all zero, or mere noise."""
        last = self.newest
        if last is None or frame.driven_since_m(last) >= self._spacing_m / 2:
            return False
        return last.change_to(frame) <= self._standing_change

    def is_carried(self, frame: _UsedFrame) -> bool:
        """Whether the first frame after a halt shows another place than the last one before: on a tow, or a ferry.

        Where it drove on before the next frame, the two cannot be compared, and it may have been carried.
        """
        last = self.newest
        if last is None:
            return False
        change, driven_m = last.change_to(frame), frame.driven_since_m(last)
        elapsed_ns = frame.stamp_ns - last.stamp_ns
        if elapsed_ns >= STILL_NS and driven_m <= 2 * self._spacing_m:
            return len(self._changes) >= FEWEST_CHANGES and change > CARRIED_CHANGE * float(np.median(self._changes))
        if elapsed_ns >= STILL_NS and driven_m > 0 and self._ns_per_m:
            return elapsed_ns - driven_m * float(np.median(self._ns_per_m)) >= STILL_NS
        self._changes.append(change)
        if driven_m > 0:
            self._ns_per_m.append(elapsed_ns / driven_m)
        return False


class PlaceRecognizer:
    """Recognizes the places of a reference map, or of a folder of maps, frame by frame; see `open_recognizer`."""

    def __init__(self, network: Network, map_set: MapSet, config: Config, stopwatch: Stopwatch = no_stopwatch) -> None:
        """network, map_set: that fit each other and the config."""
        self._network = network
        self.config = config
        self._stopwatch = stopwatch
        self.matcher = SequenceMatcher(map_set, config, stopwatch)
        self._hold_off = HoldOff(config.acceptance.hold_off_s)
        self._used = _UsedFrames(config)
        self.was_carried = False
        """Whether the vehicle was moved without its wheels before the newest frame, so that nothing before counts."""
        self.is_in_line = False
        """Whether the newest frame is part of the sequence: it shows another place, so far from the last one."""
        self.state: State = "warming up"
        self._verifications_left = 0
        self._verified: tuple[_UsedFrame, _UsedFrame] | None = None
        """From the spot of the newest frame, while nothing is believed there: the first picture that was verified since
        the view changed, and the newest."""

    @property
    def map_set(self) -> MapSet:
        """The maps that are searched."""
        return self.matcher.map_set

    def observe(
        self, image: NDArray[np.uint8], stamp_ns: int, travel: MotionPrior = NOTHING_KNOWN
    ) -> PlaceMatch | None:
        """Match one frame (H, W, 3) uint8 BGR; None while warming up, searching, and while the vehicle stands.

        On a map with keypoints there may be an answer meanwhile, by keyframe matches alone.

        stamp_ns: exposure time on any one clock; it only serves to notice gaps and to hold events off.
        """
        raw = self.describe(image)
        frame = _UsedFrame(raw, stamp_ns, travel.distance_m)
        self.was_carried, self.is_in_line = False, False
        if self._used.stands_still(frame) and not self._is_first_with_distance(frame):
            # A feed whose every frame is a place has passed one, even if it looks like the last.
            self._used.unmoved += self.config.sampling.by == "frames"
            self.state = "standing"
            return self._verify_again(image, frame, travel) if self._is_verification_due(stamp_ns) else None
        self.was_carried = self._used.is_carried(frame)
        self._reset_after_gap(frame)
        travel = replace(travel, missed=travel.missed + self._used.unmoved)
        self._used.newest, self._used.unmoved = frame, 0
        self.is_in_line = travel.distance_m is not None or not self.matcher.needs_odometer
        match = self.matcher.push(raw, travel, image)
        if self.matcher.was_carried:
            self.was_carried = True
            self.matcher.reset()
            match = None
        self._verifications_left = VERIFICATIONS
        self._verified = None if match is not None and match.accepted else (frame, frame)
        if match is None:
            off_the_map = self.is_in_line and self.matcher.has_lines
            self.state = "off the map" if off_the_map else "searching" if self.matcher.is_scanning else "warming up"
            return None
        self.state = "on the map" if match.accepted else "off the map"
        return self._as_event(match, stamp_ns)

    def _is_first_with_distance(self, frame: _UsedFrame) -> bool:
        """Whether the last frame was not searched for, since it came before the odometer was known."""
        last = self._used.newest
        is_unknown = last is not None and last.distance_m is None
        return is_unknown and frame.distance_m is not None and self.matcher.needs_odometer

    def may_verify_again(self, stamp_ns: int, distance_m: float | None) -> bool:
        """Whether a further picture from the spot of the newest frame, where the vehicle stands, may show its place."""
        last = self._used.newest
        if last is None or distance_m is None or last.distance_m is None or not self._is_verification_due(stamp_ns):
            return False
        return abs(distance_m - last.distance_m) <= STILL_M

    def verify_again(
        self, image: NDArray[np.uint8], stamp_ns: int, travel: MotionPrior = NOTHING_KNOWN
    ) -> PlaceMatch | None:
        """Such a picture (H, W, 3) uint8 BGR: a place that is believed by keyframe matches, else None."""
        self.was_carried, self.is_in_line = False, False
        return self._verify_again(image, _UsedFrame(self.describe(image), stamp_ns, travel.distance_m), travel)

    def _is_verification_due(self, stamp_ns: int) -> bool:
        verified = self._verified
        return self.matcher.may_verify and verified is not None and stamp_ns - verified[1].stamp_ns >= VERIFY_AGAIN_NS

    def _verify_again(self, image: NDArray[np.uint8], frame: _UsedFrame, travel: MotionPrior) -> PlaceMatch | None:
        assert self._verified is not None  # or none would be due
        first, before = self._verified
        if first.change_to(frame) > CARRIED_CHANGE * before.change_to(frame):
            first, self._verifications_left = frame, VERIFICATIONS
        self._verified, self._verifications_left = (first, frame), self._verifications_left - 1
        match = self.matcher.verify_again(image, frame.raw, travel) if self._verifications_left >= 0 else None
        if match is None or not match.accepted:
            return None
        self.state, self._verified = "on the map", None
        return self._as_event(match, frame.stamp_ns)

    def _as_event(self, match: PlaceMatch, stamp_ns: int) -> PlaceMatch:
        return replace(match, event=True) if match.accepted and self._hold_off.passes(stamp_ns) else match

    def describe(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """The raw descriptor (R, D) of an image (H, W, 3) uint8 BGR."""
        descriptor = self.config.descriptor
        pictures = pictures_for(self._network.info, image, "left-right", descriptor.region_width)
        self._stopwatch("regions")
        raw = self._network.describe(pictures)
        self._stopwatch("network")
        return raw

    def raw_of(self, stamp_ns: int) -> NDArray[np.float32] | None:
        """The raw descriptor (R, D) of the newest frame, None if it showed the same place as the one before it."""
        last = self._used.newest
        return last.raw if last is not None and last.stamp_ns == stamp_ns else None

    @property
    def model_name(self) -> str:
        """Name of the network."""
        return self._network.info.name

    def use_maps(self, map_set: MapSet) -> None:
        """Search these maps from now on, beginning a new sequence."""
        self.matcher.use_maps(map_set)
        self.reset()

    def reopen_maps(self, newest: PartialMap | None) -> None:
        """Search the maps that the config names as they are on the disk now. SetupError; then those so far stay."""
        self.use_maps(open_maps(self.config, newest).fitting(model_key(self._network), self.config.descriptor))

    def grow_maps(self, map_set: MapSet) -> None:
        """Search further places after those of the maps so far, without beginning a new sequence."""
        self.matcher.grow(map_set)

    def reset(self) -> None:
        """Begin a new sequence with the next frame (after a blindness); the statistics stay."""
        self.matcher.reset()
        self._used.newest, self._used.unmoved, self._verified = None, 0, None
        self.state = "warming up"

    def begin_way_back(self) -> None:
        """The vehicle has turned around; see `SequenceMatcher.begin_way_back`."""
        self.matcher.begin_way_back()

    def restart_odometer(self) -> None:
        """The distance driven before cannot be compared with what follows: no sequence has frames of both."""
        if self._used.newest is not None:
            self._used.newest = replace(self._used.newest, distance_m=None)
        if self.matcher.needs_odometer:
            self.matcher.reset()

    def _reset_after_gap(self, frame: _UsedFrame) -> None:
        """A sequence has frames that follow each other: begin a new one after a gap, or when time went back.

        Not where the odometer says that hardly anything was passed meanwhile: the vehicle stood.
        """
        if self.was_carried:
            self.matcher.reset()
            return
        last = self._used.newest
        if last is None or 0 <= frame.stamp_ns - last.stamp_ns <= self.config.sequence.max_gap_s * 1e9:
            return
        stood_m = MOST_MISSED * self.config.sequence_frames * self.config.sampling.spacing_m
        if not (frame.stamp_ns > last.stamp_ns and 0 <= frame.driven_since_m(last) <= stood_m):
            self.matcher.reset()


def open_recognizer(
    config: Config,
    *,
    network: Network | None = None,
    map_set: MapSet | None = None,
    newest: PartialMap | None = None,
    stopwatch: Stopwatch = no_stopwatch,
) -> PlaceRecognizer:
    """Open the model and the maps that the config names. SetupError names what cannot be used.

    network, map_set: instead of those. newest: the map of this drive, searched as well, even if it is the only one.
    Maps that do not fit the network and the config are excluded with their reason in
    `PlaceRecognizer.map_set.excluded`; MapError if none fits.
    """
    network = network or open_network(network_for(config))
    map_set = map_set or open_maps(config, newest)
    map_set = map_set.fitting(model_key(network), config.descriptor)
    if not config.descriptor.model:
        words = "[descriptor] model is not set, so it is %s; `lookback model use %s CONFIG` writes it"
        log.warning(words, *2 * [network_of_map(network.info.name) or network.info.name])
    return PlaceRecognizer(network, map_set, config, stopwatch)


def network_for(config: Config) -> DescriptorConfig:
    """[descriptor], with the network of the first usable map where it names none, and without a map the grid.

    fc6 is for non-commercial use, so that it is used only where the config or a map names it. A map that cannot be
    read is reported where maps are opened.
    """
    if config.descriptor.model:
        return config.descriptor
    name = next(filter(None, _networks_of_maps(Path(config.map.path))), FIRST_NETWORK)
    return replace_fields(config.descriptor, model=name)


def _networks_of_maps(path: Path) -> Iterator[str]:
    """The names of the networks that readable maps were made with, "" for one that Lookback does not know."""
    with suppress(MapError):
        for folder in maps_in(path) or [path]:
            with suppress(MapError):
                yield network_of_map(read_header(folder).model.name)


def open_maps(config: Config, newest: PartialMap | None) -> MapSet:
    """The maps that the config names, and that of this drive. SetupError."""
    key = config.map.require_signature_by
    maps = open_map_set(Path(config.map.path), require_signature_by=Path(key) if key else None, newest=newest)
    local = maps.places["position_source"] == POSITION_SOURCES.index("local")
    if config.telemetry.emit != "report" and bool(local.any()):
        raise MapError(
            f"{config.map.path}: its positions are meters from an origin of their own, which no autopilot knows; set"
            ' [telemetry] emit = "report", or map a recording with latitudes and longitudes'
        )
    return maps


def model_key(network: Network) -> ModelKey:
    """What a map keeps of the network that described it."""
    info = network.info
    return ModelKey(info.name, info.sha256, info.output, info.dimensions, network.provider)
