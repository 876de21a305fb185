"""The records of the journal, but for those of plug-ins, distinguished by the key `event`.

This module is the reference of the journal's format, to which docs/journal.md leads: `unit` gives a key's unit and
meaning. SCHEMA grows when a key is removed or changes its meaning. A new record or key does not change it, because
readers ignore keys and pass over records that they do not know.

Places are given in map coordinates everywhere: `place` is a row of a map, and `map` the name of that map where
[map] path is a folder of maps. Stamps are CLOCK_MONOTONIC of the vehicle's computer.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Annotated, Any, Literal, get_type_hints

import msgspec
from msgspec import UNSET, Meta, UnsetType

SCHEMA = 3
"""1: journals without `journal_opened`, in which `map_excluded` was called `map_left_out`. 2: with the keys and words
of RENAMED."""
RENAMED = {
    "sigma_across_m": "sigma_cross_track_m",
    "level_across_m": "level_cross_track_m",
}
"""Keys of schema 2, as they are called now."""


def with_todays_keys(value: Any) -> Any:
    """Lists and dictionaries, at any depth, with RENAMED keys as they are called now."""
    if isinstance(value, list):
        return list(map(with_todays_keys, value))
    if isinstance(value, dict):
        return {RENAMED.get(key, key): with_todays_keys(one) for key, one in value.items()}
    return value


def unit(name: str, about: str, digits: int | None = None) -> Meta:
    """The unit of a field, "" for what has none, and what it is. digits: after the point, as the journal has it."""
    return Meta(description=about, extra={"unit": name, "digits": digits})


Direction = Annotated[
    Literal["forward", "reverse"], unit("", "direction of travel against the drive that made the map")
]
Order = Annotated[
    Literal["same", "swapped"], unit("", "whether left and right regions matched their own side or the other")
]
MapName = Annotated[str | UnsetType, unit("", "name of the map; only where [map] path is a folder of maps")]
Place = Annotated[int, unit("row", "row of the place in its map")]
Latitude = Annotated[float | None, unit("deg", "latitude (WGS 84), null where the map has no positions", 9)]
Longitude = Annotated[float | None, unit("deg", "longitude (WGS 84), null where the map has no positions", 9)]
Heading = Annotated[float | None, unit("deg", "heading of travel, clockwise from north, null where not known", 2)]
Distance = Annotated[float | None, unit("m", "distance from the autopilot's own position, null where it has none", 3)]
Points = Annotated[int | UnsetType, unit("", "keypoints that agree where the camera was, as in `place`")]
SigmaAlong = Annotated[float | UnsetType, unit("m", "one standard deviation along-track", 3)]


class Record(msgspec.Struct, frozen=True, tag_field="event"):
    """A record whose key `event` names it; those of a plug-in are beside what writes them, and begin with its name."""


def as_written(record: Record) -> dict[str, Any]:
    """The keys of a record, its numbers as exact as the journal has them."""
    fields: dict[str, Any] = msgspec.to_builtins(record)
    for name, digits in _digits(type(record)):
        if isinstance(value := fields.get(name), float):
            fields[name] = round(value, digits)
    return fields


@cache
def _digits(kind: type[Record]) -> tuple[tuple[str, int], ...]:
    hints = get_type_hints(kind, include_extras=True)
    told = ((name, one) for name, hint in hints.items() for one in getattr(hint, "__metadata__", ()))
    extras = ((name, one.extra or {}) for name, one in told if isinstance(one, Meta))
    return tuple((name, extra["digits"]) for name, extra in extras if extra.get("digits") is not None)


class JournalOpened(Record, frozen=True, tag="journal_opened"):
    """The journal was opened for writing: the first record of each run, and of each file of a long one."""

    schema: Annotated[int, unit("", "version of the records that follow")]
    lookback: Annotated[str, unit("", "version of Lookback that writes them")]
    renamed: Annotated[
        dict[str, str] | UnsetType, unit("", "keys of the schema before, and their names now; for one version")
    ] = UNSET


class JournalResumed(Record, frozen=True, tag="journal"):
    """The journal can be written again, after the disk was full or lost."""

    lost: Annotated[int, unit("lines", "lines that are missing before this one")]


class StateChanged(Record, frozen=True, tag="state"):
    """The daemon's state, or the reason for it, changed; docs/vehicle.md lists the states."""

    state: Annotated[str, unit("", "starting, warming up, on the map, off the map, degraded or failed")]
    why: Annotated[str, unit("", 'the reason, and why no position is sent; "" where there is nothing to say')] = ""

    def __str__(self) -> str:
        return f"{self.state}: {self.why}" if self.why else self.state


class MapExcluded(Record, frozen=True, tag="map_excluded"):
    """A map of the folder cannot be used; the others are."""

    map: Annotated[str, unit("", "name of the map")]
    why: Annotated[str, unit("", "what is wrong with it")]


class PluginFailed(Record, frozen=True, tag="plugin_failed"):
    """A plug-in is closed until the next start; places and positions go on."""

    plugin: Annotated[str, unit("", "its name")]
    why: Annotated[str, unit("", "what it failed by")]


class LinkChanged(Record, frozen=True, tag="link"):
    """The state of a link changed."""

    state: Annotated[str, unit("", '"closed" (opened again with growing pauses), "waiting" (nobody heard) or "up"')]
    why: Annotated[str, unit("", 'why it is closed, else what was opened; "" where there is nothing to say')] = ""
    link: Annotated[str, unit("", '"autopilot", or the connection of a further link')] = "autopilot"


class CameraDiffers(Record, frozen=True, tag="camera_differs"):
    """What is seen contradicts [camera]; written once a run. Positions rest on what is seen."""

    configured_deg: Annotated[
        float, unit("deg", "horizontal field of view by the config, or by the map without one", 2)
    ]
    fov_deg: Annotated[float, unit("deg", "that of the pictures, without what the lens bends", 2)]
    fov_sigma_deg: Annotated[float, unit("deg", "one standard deviation of it", 2)]
    k1: Annotated[float, unit("", "k1 of the lens, beside that of the config", 3)]
    k1_sigma: Annotated[float, unit("", "one standard deviation of it", 3)]


class FrameUsed(Record, frozen=True, tag="frame"):
    """A frame went through the recognizer; with [telemetry] journal_frames, and as `lookback replay` writes it.

    The keys from `place` on are null while there is no match: warming up, searching a large map, or standing.
    """

    frame: Annotated[int, unit("", "index of the frame in its camera, or its row in the feed")]
    stamp_ns: Annotated[int, unit("ns", "exposure time")]
    accepted: Annotated[bool, unit("", "whether the place is accepted; false is the answer off the map")] = False
    emitted: Annotated[bool, unit("", "whether it was published as an event: accepted, and not held off")] = False
    missed: Annotated[
        int | UnsetType, unit("places", "passed without a frame before this one; only where there were any")
    ] = UNSET
    map: MapName = UNSET
    place: Annotated[int | None, unit("row", "row of the matched place in its map")] = None
    map_row: Annotated[int | None, unit("row", "row of that place in the feed that the map was built from")] = None
    uniqueness: Annotated[
        float | None, unit("", "lowest cost elsewhere over its own; 1: perceptual aliasing, below: better there")
    ] = None
    confidence: Annotated[float | None, unit("", "probability that this place is right, 0 to 1")] = None
    distance: Annotated[float | None, unit("", "mean cosine distance over the sequence match")] = None
    direction: Direction | None = None
    order: Order | None = None
    lat_deg: Latitude = None
    lon_deg: Longitude = None
    heading_deg: Heading = None


class PlaceFix(Record, frozen=True, tag="place"):
    """A position of the vehicle on a map; the journal has those of events."""

    stamp_ns: Annotated[int, unit("ns", "the moment of the position: an exposure, or one to which it was moved on")]
    place: Place
    lat_deg: Latitude
    lon_deg: Longitude
    heading_deg: Heading
    sigma_along_m: Annotated[float, unit("m", "one standard deviation along-track", 2)]
    sigma_cross_track_m: Annotated[float, unit("m", "one standard deviation cross-track", 2)]
    direction: Direction
    order: Order
    uniqueness: Annotated[float, unit("", "uniqueness of the newest accepted match, see `frame`", 4)]
    matches: Annotated[int, unit("", "accepted matches that agree with the vehicle's motion")] = 1
    map: MapName = UNSET
    segment: Annotated[int, unit("", "number of the drive in its map, or in all maps of the folder together")] = 0
    recording: Annotated[str, unit("", "name of the recording that the map has that drive from")] = ""
    checked_m: Annotated[
        float | UnsetType, unit("m", "how far apart its positions are, if all moved as its odometer and heading said")
    ] = UNSET
    confidence: Annotated[float, unit("", "probability that the place is right, 0 to 1", 3)] = 0.0
    velocity_error: Annotated[float, unit("", "estimated error of the autopilot's velocity, as a share of it", 4)] = 0.0
    disputed: Annotated[bool, unit("", "whether the newest matches fail the innovation test")] = False
    by_lane: Annotated[bool, unit("", "whether nothing but the lane says where cross-track it is")] = False
    points: Annotated[
        int | UnsetType, unit("", "inliers of the newest pose relative to a keyframe; absent of a sequence match")
    ] = UNSET

    @property
    def sigma_m(self) -> float:
        """Of the distance from the truth: autopilots use one number for every direction."""
        return math.hypot(self.sigma_along_m, self.sigma_cross_track_m)

    @property
    def is_position(self) -> bool:
        """Whether it has a position on the earth and a finite accuracy: no null, no NaN, nothing out of range."""
        if self.lat_deg is None or self.lon_deg is None:
            return False
        has_sigma = 0 < self.sigma_along_m < math.inf and 0 < self.sigma_cross_track_m < math.inf
        return has_sigma and abs(self.lat_deg) <= 90 and abs(self.lon_deg) <= 180


class PositionMessageChosen(Record, frozen=True, tag="way"):
    """Which message will carry positions from now on."""

    way: Annotated[
        str, unit("", "external_position, vision_position or global_position_sensor; report: no position is sent")
    ]
    why: Annotated[str, unit("", "the setting, or the firmware and version that it suits")]


class FixWithheld(Record, frozen=True, tag="fix_withheld"):
    """A gate held a position back, for the first time since the last one went or since another gate held."""

    place: Place
    reason: Annotated[str, unit("", "the first gate that did not hold, see docs/positions.md")]
    distance_m: Distance = None
    map: MapName = UNSET


class FixSent(Record, frozen=True, tag="fix_sent"):
    """A position was sent to the autopilot; of a steady stream, one per second is recorded."""

    place: Place
    way: Annotated[str, unit("", "the message that carried it, as in `way`")]
    lat_deg: Annotated[float, unit("deg", "latitude (WGS 84)", 9)]
    lon_deg: Annotated[float, unit("deg", "longitude (WGS 84)", 9)]
    sigma_m: Annotated[float, unit("m", "one standard deviation of the distance from the truth", 3)]
    send_boot_s: Annotated[float, unit("s", "the autopilot's time since boot when it was sent")]
    age_s: Annotated[float, unit("s", "time from the moment of the position to sending")]
    distance_m: Distance
    map: MapName = UNSET
    level_along_m: Annotated[
        float | None, unit("m", "protection level along-track, null where nothing bounds the position", 2)
    ] = None
    level_cross_track_m: Annotated[float | None, unit("m", "protection level cross-track", 2)] = None
    points: Points = UNSET
    sigma_along_m: SigmaAlong = UNSET
    pose_sigma_m: Annotated[
        float | UnsetType, unit("m", "one standard deviation of a keypoint pose without the map's error", 3)
    ] = UNSET


class FixAnswered(Record, frozen=True, tag="fix_answered"):
    """The autopilot answered a position, or did not."""

    place: Place
    result: Annotated[str, unit("", 'name of the MAV_RESULT without its prefix, or "NO_ANSWER"')]
    map: MapName = UNSET


class FixChecked(Record, frozen=True, tag="fix_checked"):
    """Whether an autopilot that was far from positions came nearer: by resets within 3 s, to a stream within 10 s."""

    place: Place
    moved: Annotated[bool, unit("", "whether it went at least half of the way, or is within the fix's deviation")]
    remaining_m: Annotated[float, unit("m", "how far it still is from where the fix puts it", 2)]
    map: MapName = UNSET


class SourceSetAnswered(Record, frozen=True, tag="source_set"):
    """The autopilot answered a selection of its position sources (ArduPilot 42007, PX4 43006); repetitions once."""

    number: Annotated[int, unit("", "1 with GPS, 2 without; ArduPilot's set of sources")]
    result: Annotated[str, unit("", 'name of the MAV_RESULT without its prefix, "NO_ANSWER" or "NOT_READ_BACK"')]


class VehicleMisled(Record, frozen=True, tag="misled"):
    """A vehicle steers itself while GPS is wrong and no place says where it is; every three seconds."""

    gps: Annotated[str, unit("", "what the places say of GPS, as in `gps_judged`")]
    stopped: Annotated[bool, unit("", "whether it was stopped, by [gates] misled; else the pilot was asked to")]


class SteeringChanged(Record, frozen=True, tag="steering"):
    """By what the vehicle steers, or whether GPS is in use, changed, and has been so for three seconds."""

    gps: Annotated[str, unit("", "in use, not used (its receiver works), lost or faulty")]
    by: Annotated[str, unit("", "GPS, places, dead reckoning, or unknown: nobody knows where it is")]


class PositionStated(Record, frozen=True, tag="position_stated"):
    """The operator said where the vehicle is: a measurement, until GPS or a position that was sent replaces it."""

    lat_deg: Annotated[float, unit("deg", "latitude (WGS 84)", 7)]
    lon_deg: Annotated[float, unit("deg", "longitude", 7)]
    sigma_m: Annotated[float, unit("m", "one standard deviation, as stated", 1)]
    by: Annotated[str, unit("", "page, or the system and component that sent the command")]
    rejected: Annotated[str, unit("", "why it does not count; empty if it does")]


class GpsJudged(Record, frozen=True, tag="gps_judged"):
    """What the recognized places say of GPS has changed; docs/integrity.md says how they are compared."""

    state: Annotated[
        str, unit("", "cannot say, consistent, suspect, inconsistent, faulty, map faulty, or not recognized")
    ]
    east_m: Annotated[float | None, unit("m", "GPS less places, to the east, null where not known", 1)] = None
    north_m: Annotated[float | None, unit("m", "the same to the north", 1)] = None
    doubt: Annotated[
        float | None, unit("", "evidence that GPS is faulty, as a share of what it takes to declare it so, 0 to 1", 2)
    ] = None


class Stopped(Record, frozen=True, tag="stopped"):
    """The daemon ended in order: the last record of such a run."""

    frames_used: Annotated[int, unit("frames", "frames that went through the recognizer")]
    events: Annotated[int, unit("", "places that were published")]
    stages_ms: Annotated[dict[str, float], unit("ms", "median time of each stage of a frame")]
    camera: Annotated[dict[str, int], unit("frames", "delivered, overwritten by a newer one before use, and bad")]


KINDS = tuple(Record.__subclasses__())
"""All of the above: what edge itself records."""
