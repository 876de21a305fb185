"""A map on the disk, and the recognizer of a vehicle on it, a picture at a time."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.config import NETWORKS, CameraConfig, DescriptorConfig, Lens, SamplingConfig, SequenceConfig
from edge.errors import MapError, ModelError
from edge.feed import View, decode_picture
from edge.keypoints import CameraModel
from edge.keypoints.mount import yaw_of
from edge.keypoints.pose import RelativePose, pose_to_keyframe
from edge.recognition.recognizer import model_key, open_recognizer
from edge.reference_map import MapSet, ReferenceMap, open_map
from edge.reference_map.keypoint_records import camera_of, keypoints_of, points_of
from edge.sequence import MotionPrior, PlaceMatch
from lookback import checks
from lookback.description import network_of
from lookback.verification import Picture, keypoints
from sim.datasets.found import read_drive
from sim.maps.adding_keypoints import key_of_feeds
from sim.maps.command import build_map
from sim.traverse import config_as_mapped, driven_m


class Map:
    """The places of a drive, as `lookback map build` writes them; see `build` and `open`."""

    def __init__(self, opened: ReferenceMap, model: str) -> None:
        self.opened, self.model, self.path = opened, model, opened.path

    @classmethod
    def build(
        cls,
        pictures: str | Path,
        path: str | Path,
        *,
        model: str | Path = "grid",
        spacing_m: float = 2.0,
        view: View | None = None,
        fov_deg: float | None = None,
    ) -> Map:
        """Describe a recording or a folder of pictures, and write its map into a new folder.

        model: as of `describe`, but a file of `lookback model import`. spacing_m: between places; of a recording that
        knows no meters every picture is one. view: which way the camera faced (None: as recorded, else front).
        fov_deg: horizontal, of the pictures (None: as recorded, else 75 with a sigma of 10). Where meters
        or this are known, the map has keypoints, see `pose`.
        Raises `Error`.
        """
        spacing_m = checks.number("spacing_m", spacing_m, least=0.01)
        fov_deg = None if fov_deg is None else checks.field_of_view(fov_deg)
        feed = read_drive(Path(pictures))
        if view is not None:
            checks.views((view, view))
            feed = replace(feed, header=msgspec.structs.replace(feed.header, view=view))
        is_metric = driven_m(feed) is not None
        sampling = SamplingConfig(by="distance", spacing_m=spacing_m) if is_metric else SamplingConfig(by="frames")
        if fov_deg is not None:
            feed = replace(feed, header=msgspec.structs.replace(feed.header, fov_deg=fov_deg))
        key_of = key_of_feeds([feed])
        with contextlib.redirect_stdout(io.StringIO()):
            made_by = network_of(str(model))
            build_map([feed], Path(path), DescriptorConfig(), sampling, network=made_by, keypoints=key_of)
        return cls.open(path, model=model)

    @classmethod
    def open(cls, path: str | Path, *, model: str | Path | None = None) -> Map:
        """The map in a folder, checked byte by byte. model: that it was made with, if it is a file. Raises `Error`."""
        opened = open_map(Path(path))
        made = opened.header.model
        for name in NETWORKS if model is None else (str(model),):
            with contextlib.suppress(*([] if model else [ModelError])):  # one that is not installed
                if model_key(network_of(name)) == made:
                    return cls(opened, name)
        raise MapError(f"{path}: made with the network {made}, not with {model or 'one of ours'}; name it by model=")

    def __len__(self) -> int:
        return len(self.opened.places)

    @property
    def places(self) -> NDArray[np.void]:
        """A record of each place (N,): lat_deg, lon_deg, heading_deg, route_m and others; NaN where not known."""
        return self.opened.places

    @property
    def descriptors(self) -> NDArray[np.float32]:
        """Descriptors (N, R, D) as `describe` gives them, of half precision."""
        return self.opened.raw().astype(np.float32)

    def picture(self, place: int) -> NDArray[np.uint8]:
        """A small picture (H, W, 3) uint8 BGR of a place. Raises `Error` where there is none."""
        return decode_picture(f"{self.path}: place {place}", self.opened.thumbnail(place))

    def pose(
        self,
        picture: Picture,
        place: int,
        *,
        fov_deg: float | None = None,
        lens: Literal["pinhole", "fisheye"] = "pinhole",
        distortion: Sequence[float] = (),
    ) -> RelativePose | None:
        """From where a picture shows a place: meters to the right and ahead of the place's camera, and turned from it.

        picture: a file, or an image (H, W, 3) uint8 BGR. fov_deg: horizontal, of its camera (None: that of the map),
        with the lens and its distortion by OpenCV, see docs/cameras.md. None where too few points agree: it shows
        another place, or its camera faced the other way. Raises `Error` for a map without keypoints.
        """
        key, records = self.opened.header.keypoints_key, self.opened.keypoints
        if key is None or records is None:
            raise MapError(f"{self.path}: no keypoints; add them with `lookback map keypoints`")
        query = keypoints(picture)
        height = round(key.width * query.size[0] / query.size[1])
        optics = key.fov_deg, key.alone
        if fov_deg is not None:
            optics = checks.field_of_view(fov_deg), Lens(lens=lens, distortion=tuple(distortion))
        camera = CameraModel(key.width, height, *optics)
        there, points = keypoints_of(records[place], key), points_of(records[place])
        found = pose_to_keyframe(query, there, points, camera)
        # A map has its points in the frame of a camera that faces along the road: this one's may face beside it.
        return found and found.turned(yaw_of(camera_of(key).directions(there.xy), points.places[:, :2]))


class Recognizer:
    """Recognizes pictures of a drive on a map, in their order, as the daemon does."""

    def __init__(self, reference: Map, *, length: int | None = None, view: View = "front") -> None:
        """length: frames of a sequence (None: 80 m of them). view: which way the camera faces.

        Pictures are to be as far apart as places, unless `observe` is given the distance driven.
        """
        checks.views((view, view))
        sequence = (
            SequenceConfig()
            if length is None
            else SequenceConfig(length=checks.count("length", length, checks.LONGEST))
        )
        config = config_as_mapped(reference.opened.header)
        config = msgspec.structs.replace(config, camera=CameraConfig(view=view), sequence=sequence)
        map_set = MapSet.of(reference.opened)
        self._recognizer = open_recognizer(config, network=network_of(reference.model), map_set=map_set)
        self._stamp_ns = 0

    def observe(self, image: NDArray[np.uint8], distance_m: float | None = None) -> PlaceMatch | None:
        """The place of the next picture (H, W, 3) uint8 BGR: its row in `Map.places`, direction and confidence.

        distance_m: driven since the drive began; needed for a map whose places know their meters. None while there are
        fewer pictures than a sequence has. `accepted`: whether the place is believed.
        """
        self._stamp_ns += 10**9
        return self._recognizer.observe(image, self._stamp_ns, MotionPrior(distance_m))
