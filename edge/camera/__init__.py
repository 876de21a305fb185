"""Cameras: V4L2, a recorded feed, or a plug-in (OAK, streams, the simulator); all hand on a `Frame`.

`v4l2` is a device, and `recorded` plays a feed; `frame` lists what a device did not accept.
`preprocessing` flips, crops and masks the images of all of them. `newest` is the one thread, which keeps only the
newest frame of any of them and opens a lost camera again; `picture_check` finds pictures that show nothing, or are old;
`picture_age` says how old.
A further camera is a class like `Camera`, and a line in CAMERAS; or, outside this package, an entry point
`lookback.cameras`.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import EntryPoint, entry_points

from edge.camera.frame import Camera, CameraHealth, Frames
from edge.config import CameraConfig
from edge.errors import ConfigError
from edge.feed import Frame

__all__ = ["Camera", "CameraHealth", "Frame", "Frames", "check_kind", "open_camera"]


CAMERA_GROUP = "lookback.cameras"
CAMERAS = {
    "v4l2": "edge.camera.v4l2:V4l2Camera",
    "oak": "edge_plugins.cameras.oak:OakCamera",
    "stream": "edge_plugins.cameras.stream:StreamCamera",
    "feed": "edge.camera.recorded:RecordedCamera.of",
}
"""As entry points: a vehicle without an OAK never loads DepthAI."""


def open_camera(config: CameraConfig) -> Camera:
    """Open the camera that `config.kind` names, with its flip, crop and mask; only its module is imported."""
    check_kind(config)
    opener = next(_openers(config.kind))
    if not config.preprocessing or config.kind == "feed":  # whose images are processed as they are read
        camera: Camera = opener.load()(config)
        return camera
    from edge.camera.preprocessing import PreprocessedCamera, Preprocessor

    preprocessor = Preprocessor(config)  # before the device, so that a bad mask is found without one
    return PreprocessedCamera(opener.load()(config), preprocessor)


def check_kind(config: CameraConfig) -> None:
    """ConfigError, which names those that there are, if no camera is of the kind that the config names."""
    if next(_openers(config.kind), None) is None:
        known = [*CAMERAS, *sorted(entry_points(group=CAMERA_GROUP).names)]
        raise ConfigError(f"[camera] kind: unknown camera {config.kind!r}; use one of {', '.join(known)}")


def _openers(kind: str) -> Iterator[EntryPoint]:
    if kind in CAMERAS:
        yield EntryPoint(kind, CAMERAS[kind], CAMERA_GROUP)
    yield from entry_points(group=CAMERA_GROUP, name=kind)
