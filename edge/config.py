"""The config file: a frozen struct for each section, all checked before anything is opened.

`default.toml` beside this file shows every key with its unit, range and default; a test holds it against the
structs. `start.toml` has those of its lines that most vehicles set. Paths are relative to the folder of the config file
that names them.

A plug-in has a section of its own, a `Section`: in `edge_plugins/NAME/__init__.py`, or where an entry point says.
"""

from __future__ import annotations

import contextlib
import logging
import math
import os
import re
from collections.abc import Callable, Iterator
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar

import msgspec
from msgspec import UNSET, Meta, Struct, UnsetType

from edge.errors import ConfigError, LookbackError
from edge.files import check_access
from edge.toml_file import convert_toml, read_text, toml_values

log = logging.getLogger(__name__)
MOST_CROPPED = 0.9
SEQUENCE_M = 80.0  # of section IV-D; docs/evaluation.md, "Any spacing"
FEWEST_FRAMES, MOST_FRAMES = 40, 80  # most: as far as it was measured, with frames each meter
DEFAULT_TOML = Path(__file__).with_name("default.toml")
START_TOML = Path(__file__).with_name("start.toml")
GROUP = "lookback.plugins"
RENAMED = {"rig": {"sigma_across_m": "sigma_cross_track_m"}}
"""Keys that have their old name too, for one version."""
SHIPPED = {
    name: EntryPoint(name, f"edge_plugins.{name}:{name.title()}Config", GROUP)
    for name in ("motion", "mapping", "recording", "home", "ros2", "nmea", "page")
}
"""The sections of the plug-ins that come with Lookback, in the order in which those are opened and called. Names only:
edge imports nothing of them."""

ConfigStruct = TypeVar("ConfigStruct", bound=Struct)
T = TypeVar("T")
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Ahead = Annotated[float, Meta(ge=-500, le=500)]
Left = Annotated[float, Meta(ge=-50, le=50)]
Share = Annotated[float, Meta(ge=0, le=0.9)]
FieldOfView = Annotated[float, Meta(ge=30, le=120)]
NETWORKS = ("grid", "fc6")
"""Names of those that Lookback knows: the first comes with it, the other is a package of its own."""
FIRST_NETWORK = "grid"
"""Of a new installation, and of commands without a config; a config that names none goes on with that of its maps."""
ModelPath = Annotated[str, Meta(description="of a network that Lookback knows; or a path, as FilePath")]
FilePath = Annotated[str, Meta(description="of a file or folder, relative to the folder of the config file")]


ADDRESS = re.compile(r"(\w[\w+.-]*://)(?:[^\s\"]*@)?([^\s?=\"'@]*)(?:[?=][^\s\"']*)?")
COMMAND = re.compile(r"^(exec:\s*\S+)\s.*", re.DOTALL)


def without_secrets(text: str) -> str:
    """The text with each address up to its query, without a user, and of a camera's command (exec:) only the program.

    A path with a password, as in rtsp://HOST/user=NAME_password=WORD.sdp, ends at its first "=".
    """
    return ADDRESS.sub(r"\1\2", COMMAND.sub(r"\1", text))


NO_DISTORTION: tuple[float, ...] = ()


class Lens(Struct, frozen=True, kw_only=True):
    """How a camera bends what it sees, by OpenCV's models: pinhole k1, k2, p1, p2, k3; fisheye k1, k2, k3, k4."""

    lens: Literal["pinhole", "fisheye"] = "pinhole"
    distortion: tuple[float, ...] = NO_DISTORTION

    def __post_init__(self) -> None:
        counts = (0, 4, 5) if self.lens == "pinhole" else (4,)
        if len(self.distortion) not in counts or not all(map(math.isfinite, self.distortion)):
            names = {"pinhole": "k1, k2, p1, p2 and perhaps k3", "fisheye": "k1, k2, k3, k4"}[self.lens]
            raise ValueError(f"distortion: a {self.lens} lens has {names} (OpenCV), not {list(self.distortion)}")
        if not self.distortion:  # a default is omitted where it is the same object, which Python 3.10 does not see to
            msgspec.structs.force_setattr(self, "distortion", NO_DISTORTION)

    @property
    def bends(self) -> bool:
        """Whether it differs from a pinhole."""
        return self.lens != "pinhole" or any(self.distortion)

    @property
    def alone(self) -> Lens:
        """Without what else it is a part of."""
        return Lens(lens=self.lens, distortion=self.distortion)


PINHOLE = Lens()


class CameraConfig(Lens, frozen=True, forbid_unknown_fields=True):
    """[camera]: which camera, and the settings to request from it."""

    kind: str = "v4l2"
    view: Literal["front", "rear"] = "front"
    device: str = "/dev/video0"
    width: Annotated[int, Meta(ge=16, le=8192)] = 640
    height: Annotated[int, Meta(ge=16, le=8192)] = 480
    fps: Annotated[float, Meta(gt=0, le=240)] = 15.0
    fourcc: Annotated[str, Meta(pattern="^.{4}$")] = "MJPG"
    stall_timeout_s: Annotated[float, Meta(ge=0.1, le=60)] = 2.0
    latency_s: Annotated[float, Meta(ge=0, le=5)] = 0.0
    flip: Literal["none", "horizontal", "vertical", "both"] = "none"
    crop: tuple[Share, Share, Share, Share] = (0.0, 0.0, 0.0, 0.0)
    mask: FilePath = ""
    keep_pictures: bool = True
    fov_deg: FieldOfView | UnsetType = UNSET

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kind in ("v4l2", "feed", "oak") and "://" in self.device:
            raise ValueError(f'device: is an address, which needs kind = "stream"; it is "{self.kind}"')
        left, top, right, bottom = self.crop
        if max(left + right, top + bottom) > MOST_CROPPED:
            raise ValueError(f"crop: left and right together, and top and bottom, can be {MOST_CROPPED} at most")
        if self.bends and (left != right or top != bottom):
            raise ValueError("crop: with a lens it must be the same left and right, and top and bottom")

    @property
    def preprocessing(self) -> str:
        """What is done to each image, in words; "" for nothing."""
        words = [f"flip {self.flip}"] if self.flip != "none" else []
        if any(self.crop):
            words.append("crop " + " ".join(f"{share:g}" for share in self.crop))
        return "; ".join([*words, f"mask {Path(self.mask).name}"] if self.mask else words)

    def known_fov_deg(self, what: str) -> float:
        """The horizontal field of view. ConfigError where the file does not say it; what: needs it."""
        if self.fov_deg is UNSET:
            raise ConfigError(f"[camera] fov_deg: is not set, and {what}: the horizontal field of view, in degrees")
        return self.fov_deg

    @property
    def source(self) -> str:
        """Kind and device for people: without the password of an address, or the arguments of a command."""
        return f"{self.kind} {without_secrets(self.device)}"


class SamplingConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """[sampling]: which of the camera's frames are places; the paper samples at a constant 2 m."""

    by: Literal["distance", "time", "frames"] = "distance"
    spacing_m: Annotated[float, Meta(gt=0, le=100)] = 2.0
    spacing_frames: Annotated[int, Meta(ge=1)] = 1
    interval_s: Annotated[float, Meta(gt=0, le=60)] = 0.5


class DescriptorConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """[descriptor]: how a frame becomes a descriptor, and how that is normalized (eq. 1, sections III-B and III-D)."""

    model: ModelPath = ""
    provider: str = "cpu"
    region_width: Annotated[float, Meta(ge=0.1, le=1.0)] = 0.4
    standing_change: Annotated[float, Meta(ge=0, le=1)] = 0.005
    keep_statistics_min: Annotated[float, Meta(ge=0, le=1440)] = 30.0


class MapConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """[map]: the reference map, or the folder of maps, in which places are recognized."""

    path: FilePath = "/var/lib/lookback/map"
    require_signature_by: FilePath = ""
    places_per_frame: Annotated[int, Meta(ge=100, le=1_000_000)] = 20_000
    search_radius_m: Annotated[float, Meta(ge=10, le=100_000)] = 500.0


class SequenceConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """[sequence]: the search of eq. 2 and 3. Config.sequence_frames is the length where the file has none.

    structure: whether in opposite views keypoints vote for the place and make it exact, on maps with those.
    """

    length: Annotated[int, Meta(ge=2, le=500)] | UnsetType = UNSET
    slope_limit_rad: Annotated[float, Meta(ge=0, le=0.6)] = 0.2
    directions: Literal["both", "forward", "reverse"] = "both"
    max_gap_s: Positive = 30.0
    structure: bool = False


class AcceptanceConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """[acceptance]: when a place is believed, and what counts as the same place (section IV-B).

    confidence_from: probability of being right from which a place is believed. uniqueness_min: of a place that a scan
    found, from which it is searched around.
    """

    confidence_from: Annotated[float, Meta(gt=0, lt=1)] = 0.92
    uniqueness_min: Annotated[float, Meta(ge=1)] = 1.08
    window_m: Positive = 80.0
    window_places: Annotated[int, Meta(ge=1)] = 10
    hold_off_s: NotNegative = 1.0


class RigConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """[rig]: how far ahead of the vehicle the matched place lies, for each direction and region order of a match.

    sigma_*_*_m: standard deviation that remains for matches of that kind; 0 where not measured, sigma_along_m then.
    """

    ahead_forward_same_m: Ahead = 0.0
    ahead_forward_swapped_m: Ahead = 0.0
    ahead_reverse_same_m: Ahead = 0.0
    ahead_reverse_swapped_m: Ahead = 0.0
    left_forward_m: Left = 0.0
    left_reverse_m: Left = 0.0
    sigma_forward_same_m: NotNegative = 0.0
    sigma_forward_swapped_m: NotNegative = 0.0
    sigma_reverse_same_m: NotNegative = 0.0
    sigma_reverse_swapped_m: NotNegative = 0.0
    sigma_along_m: Positive = 3.0
    sigma_cross_track_m: Positive = 2.5
    look_ahead_forward_m: Ahead = 0.0
    look_ahead_reverse_m: Ahead = 0.0
    look_sigma_m: NotNegative = 0.0

    def ahead_m(self, direction: Literal["forward", "reverse"], order: Literal["same", "swapped"]) -> float:
        """The offset of matches of that kind, in meters in the direction of travel."""
        return float(getattr(self, f"ahead_{direction}_{order}_m"))

    def look_ahead_m(self, direction: Literal["forward", "reverse"]) -> float:
        """By how much more this camera is ahead of its antenna than the map's was of its own, in this vehicle's way."""
        return self.look_ahead_reverse_m if direction == "reverse" else self.look_ahead_forward_m

    def left_m(self, direction: Literal["forward", "reverse"]) -> float:
        """Meters to the left of the map's drive, in the direction of travel."""
        return self.left_reverse_m if direction == "reverse" else self.left_forward_m

    def sigma_m(self, direction: Literal["forward", "reverse"], order: Literal["same", "swapped"]) -> float:
        """The along-track standard deviation that remains for matches of that kind, in meters."""
        return float(getattr(self, f"sigma_{direction}_{order}_m")) or self.sigma_along_m


class TrackingConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """[tracking]: the vehicle's position by a filter, from matches and the autopilot's own velocity."""

    lost_after_m: Annotated[float, Meta(gt=0, le=1000)] = 20.0
    lost_after_s: Annotated[float, Meta(gt=0, le=60)] = 5.0
    scale_error_percent: Annotated[float, Meta(gt=0, le=50)] = 6.0
    heading_error_deg: Annotated[float, Meta(gt=0, le=30)] = 2.0


class GatesConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """[gates]: the conditions for sending a position to the autopilot, which has no such rules of its own."""

    with_gps: bool = False
    min_speed_mps: Annotated[float, Meta(ge=0, le=100)] = 0.3
    min_interval_s: Annotated[float, Meta(ge=0.1, le=600)] = 1.0
    risk: Annotated[float, Meta(gt=0, le=1)] = 1e-3
    risk_per_hour: Annotated[float, Meta(gt=0, le=1)] = 1e-3
    alert_limit_m: Annotated[float, Meta(ge=0, le=10_000)] = 0.0
    min_move_m: Annotated[float, Meta(ge=0, le=100)] = 3.0
    max_move_m: Annotated[float, Meta(gt=0, le=100_000)] = 200.0
    drift_percent: Annotated[float, Meta(ge=0, le=100)] = 5.0
    confirm_m: Annotated[float, Meta(gt=0, le=1000)] = 100.0
    doubted_gps: Literal["report", "switch", "send"] = "report"
    misled: Literal["ask", "hold"] = "ask"
    gps_false_call: Annotated[float, Meta(gt=0, le=0.1)] = 1e-3
    gps_missed: Annotated[float, Meta(gt=0, le=0.5)] = 0.01


class LinkConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """[[telemetry.links]]: a further MAVLink connection, on which events are published and never a position."""

    connection: str
    signing_key: FilePath = ""


class TelemetryConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """[telemetry]: the MAVLink connections, what is sent on them, and the journal."""

    connection: str = "serial:/dev/serial0:921600"
    emit: Literal["report", "external_position", "vision_position", "global_position_sensor", "auto"] = "report"
    system_id: Annotated[int, Meta(ge=0, le=255)] = 0
    component_id: Annotated[int, Meta(ge=1, le=255)] = 191
    sensor_id: Annotated[int, Meta(ge=1, le=255)] = 1
    odometry_from: tuple[Annotated[int, Meta(ge=1, le=255)], ...] = ()
    origin: tuple[float, ...] = ()
    signing_key: FilePath = ""
    signing_clock: FilePath = "/var/lib/lookback/signing"
    links: tuple[LinkConfig, ...] = ()
    journal: FilePath = "/var/lib/lookback/events.jsonl"
    journal_max_mb: Annotated[float, Meta(ge=1)] = 500.0
    journal_frames: bool = False
    drive: FilePath = ""

    def __post_init__(self) -> None:
        limits = zip(self.origin, (90, 180, 20000), strict=False)
        if len(self.origin) not in (0, 3) or any(not abs(value) <= limit for value, limit in limits):
            raise ValueError("origin: expected [latitude deg, longitude deg, meters above sea level], or []")
        if len(self.odometry_from) not in (0, 2):
            raise ValueError("odometry_from: expected [system ID, component ID], or []")


class Section(Struct, frozen=True, forbid_unknown_fields=True):
    """The section of a plug-in; `plugin` names its class (`edge.plugin.Plugin`), as "package.module:Class"."""

    plugin: ClassVar[str]

    def asks(self, config: Config) -> bool:
        """Whether the whole config asks for the plug-in; ConfigError, from "[section] key" on, where it contradicts."""
        return True


SectionKind = TypeVar("SectionKind", bound=Section)


class Config(Struct, frozen=True, forbid_unknown_fields=True):
    """The whole configuration; plugins: the sections of plug-ins by their names, as far as the file has them."""

    camera: CameraConfig = CameraConfig()
    sampling: SamplingConfig = SamplingConfig()
    descriptor: DescriptorConfig = DescriptorConfig()
    map: MapConfig = MapConfig()
    sequence: SequenceConfig = SequenceConfig()
    acceptance: AcceptanceConfig = AcceptanceConfig()
    rig: RigConfig = RigConfig()
    tracking: TrackingConfig = TrackingConfig()
    gates: GatesConfig = GatesConfig()
    telemetry: TelemetryConfig = TelemetryConfig()
    plugins: dict[str, Section] = {}

    def of(self, kind: type[SectionKind]) -> SectionKind:
        """The section of a plug-in by its class, at its defaults where the file has none."""
        return next((one for one in self.plugins.values() if type(one) is kind), None) or kind()

    @property
    def sequence_frames(self) -> int:
        """Frames of a sequence: the file's, or enough for the 80 m of the paper, between FEWEST_FRAMES and MOST_FRAMES.

        Sequences of 40 m are wrong too often: docs/evaluation.md, "Any spacing".
        """
        if self.sequence.length is not UNSET:
            return self.sequence.length
        frames = math.ceil(SEQUENCE_M / self.sampling.spacing_m) if self.sampling.by == "distance" else FEWEST_FRAMES
        return min(max(frames, FEWEST_FRAMES), MOST_FRAMES)


def load_config(path: Path) -> Config:
    """Read and check a config file; ConfigError names the file and the key, in one line."""
    config = parse_config(read_text(path), path)
    with naming(path):
        return change_paths(config, check_access)


def parse_config(text: str, path: Path) -> Config:
    """Check the text of a config file, and resolve its paths from the folder of `path`, which messages name."""
    with naming(path):
        config = _converted(toml_values(text, path), path)
    for where, why in _unusable_paths(config):
        raise ConfigError(f"{path}: {where}: {why}")
    return change_paths(config, lambda _, value: str(path.parent / os.path.expanduser(value)))  # noqa: PTH111


def in_todays_words(values: dict[str, Any], path: Path) -> dict[str, Any]:
    """The same sections with the names of today, where keys have old ones; ConfigError for a key that has both."""
    tables = {where: values[where] for where in RENAMED if isinstance(values.get(where), dict)}
    old = [(where, key) for where, table in tables.items() for key in RENAMED[where] if key in table]
    today = {**values, **{where: dict(tables[where]) for where, _ in old}}
    for where, key in old:
        new = RENAMED[where][key]
        if new in today[where]:
            raise ConfigError(f"{path}: [{where}] {key}: the old name of {new}, which is there too; remove it")
        today[where][new] = today[where].pop(key)
    return today if old else values


def _converted(values: dict[str, Any], path: Path) -> Config:
    """Nested tables as a config, with the sections of plug-ins that it has."""
    today = in_todays_words(values, path)
    if today is not values:
        names = ", ".join(
            f"[{where}] {old} is now {new}" for where, keys in RENAMED.items() for old, new in keys.items()
        )
        log.warning("%s: %s; the old name works in this version only: rename it", path, names)
    values = today
    own = {field.name: field.type for field in msgspec.structs.fields(Config) if field.name != "plugins"}
    points = {name: found for name, found in plugin_points().items() if name not in own}
    kinds = {name: section_kind(name, points[name]) for name in values if name in points}
    # Of all other plug-ins no more than the name is known, by which a misspelled one is found.
    types = {**dict.fromkeys(points, dict), **kinds, **own}
    fields = [(name, kind, msgspec.field(default_factory=kind)) for name, kind in types.items()]
    read = convert_toml(values, path, msgspec.defstruct("File", fields, forbid_unknown_fields=True))
    sections = {name: getattr(read, name) for name in kinds}
    config = Config(**{name: getattr(read, name) for name in own}, plugins=sections)
    list(asked_sections(config))  # which may contradict the others
    return config


def plugin_points() -> dict[str, list[EntryPoint]]:
    """The entry points of all plug-ins that are installed, by their names: more than one is a mistake."""
    points = {name: [point] for name, point in SHIPPED.items()}
    for point in entry_points(group=GROUP):
        points.setdefault(point.name, []).append(point)
    return points


def section_kind(name: str, points: list[EntryPoint]) -> type[Section]:
    """The class of a plug-in's section; ConfigError where it cannot be imported, or others have this name too."""
    values = " and ".join(point.value for point in points)
    if len(points) > 1:
        raise ConfigError(f"[{name}] plug-in {name}: {values} have this name; uninstall one of them")
    kind: type[Section] = loaded(name, values, points[0].load)
    if not (isinstance(kind, type) and issubclass(kind, Section)):
        raise ConfigError(f"[{name}] plug-in {name} ({values}): the entry point must name its Section (edge/config.py)")
    return kind


def asked_sections(config: Config) -> Iterator[tuple[str, Section]]:
    """The plug-ins that a config asks for, in the order in which they are opened: name and section. ConfigError."""
    for name in dict.fromkeys((*SHIPPED, *config.plugins)):
        section = config.plugins.get(name) or section_kind(name, [SHIPPED[name]])()
        if section.asks(config):
            yield name, section


def loaded(name: str, value: str, call: Callable[[], T]) -> T:
    """What a call returns that imports or opens a part of a plug-in; LookbackError in one line, whatever it raises."""
    try:
        return call()
    except LookbackError:
        raise
    except Exception as error:
        why = " ".join(f"{type(error).__name__}: {error}".split())  # numpy's has many lines
        log.debug("where it failed", exc_info=True)
        raise ConfigError(f"[{name}] plug-in {name} ({value}): {why}; repair its package, or turn it off") from error


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """Put the name of the config file in front of a ConfigError about a key that was found while the key was used."""
    try:
        yield
    except ConfigError as error:
        lines = map(str, error.args)
        raise ConfigError(*(f"{path}: {line}" if line.startswith("[") else line for line in lines)) from None


def _unusable_paths(config: Config) -> Iterator[tuple[str, str]]:
    """Values that cannot be the name of a file or device: the key, and what is wrong."""
    own = msgspec.to_builtins(config)
    for section, keys in [*own.pop("plugins").items(), *own.items()]:
        for key, value in keys.items():
            # As JSON, which also covers values that are tables or lists.
            if "\\u0000" in msgspec.json.encode(value).decode().replace("\\\\", ""):
                yield f"[{section}] {key}", "has a null character in it"
    if not config.camera.device and config.camera.kind in ("v4l2", "stream", "feed", "sim"):
        yield "[camera] device", "is empty; name the device, the stream, or the folder of the feed"
    if not config.map.path:
        yield "[map] path", "is empty; name the map's folder"


def change_paths(config: ConfigStruct, change: Callable[[str, str], str], section: str = "") -> ConfigStruct:
    """The config, or a section, with each path of a file or folder changed. change: from the key, as in errors."""
    changes: dict[str, object] = {}
    for field in msgspec.structs.fields(config):
        value, below = getattr(config, field.name), f"{section}.{field.name}".lstrip(".")
        is_path = field.type in (FilePath, ModelPath) or (
            field.name == "device" and getattr(config, "kind", "") in ("feed", "sim")
        )
        if isinstance(value, Struct):
            changes[field.name] = change_paths(value, change, below)
        elif isinstance(config, Config):
            changes[field.name] = {name: change_paths(one, change, name) for name, one in value.items()}
        elif isinstance(value, tuple):
            changes[field.name] = tuple(
                change_paths(one, change, below) if isinstance(one, Struct) else one for one in value
            )
        elif field.type == ModelPath and value in NETWORKS:
            continue
        elif is_path and value and not value.startswith("credential:"):
            changes[field.name] = change(f"[{section}] {field.name}", value)
    return msgspec.structs.replace(config, **changes)
