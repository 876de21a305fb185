"""Cameras: V4L2, OAK, stream, recorded feed, or an installed plug-in (the simulator); all hand on a `Frame`.

`v4l2` and `oak` are devices; `frame` lists what a device did not accept. `stream` is a video stream from the network
or from a command (`command_output`), with its own clock. `recorded` plays a feed.
`preprocessing` flips, crops and masks the images of all of them. `newest` is the one thread, which keeps only the
newest frame of any of them and opens a lost camera again; `picture_check` finds pictures that show nothing, or are old.
A further camera is a module with a class like `Camera`, and a line in `open_camera`; or, outside this package, an entry
point `lookback.cameras`.
"""

from __future__ import annotations

from importlib.metadata import entry_points

from edge.camera.frame import Camera, CameraHealth, Frames
from edge.camera.preprocessing import PreprocessedCamera, Preprocessor
from edge.config import CameraConfig
from edge.errors import ConfigError
from edge.feed import Frame

__all__ = ["Camera", "CameraHealth", "Frame", "Frames", "check_kind", "open_camera"]


def open_camera(config: CameraConfig) -> Camera:
    """Open the camera that `config.kind` names, with its flip, crop and mask; only its module is imported."""
    if config.kind == "feed":
        from edge.camera.recorded import RecordedCamera

        return RecordedCamera.of(config)
    if not config.preprocessing:
        return _open_live(config)
    preprocessor = Preprocessor(config)  # before the device, so that a bad mask is found without one
    return PreprocessedCamera(_open_live(config), preprocessor)


def _open_live(config: CameraConfig) -> Camera:
    # Imported here, so that a vehicle without an OAK never loads DepthAI.
    if config.kind == "v4l2":
        from edge.camera.v4l2 import V4l2Camera

        return V4l2Camera(config)
    if config.kind == "oak":
        from edge.camera.oak import OakCamera

        return OakCamera(config)
    if config.kind == "stream":
        from edge.camera.stream import StreamCamera

        return StreamCamera(config)
    check_kind(config)
    point = next(iter(entry_points(group="lookback.cameras", name=config.kind)))
    camera: Camera = point.load()(config)
    return camera


def check_kind(config: CameraConfig) -> None:
    """ConfigError, which names those that there are, if no camera is of the kind that the config names."""
    known = ["v4l2", "oak", "stream", "feed", *sorted(entry_points(group="lookback.cameras").names)]
    if config.kind not in known:
        raise ConfigError(f"[camera] kind: unknown camera {config.kind!r}; use one of {', '.join(known)}")
