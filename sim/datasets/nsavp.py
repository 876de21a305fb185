"""NSAVP, Novel Sensors for Autonomous Vehicle Perception: one sequence, as HDF5 files in a folder.

    R0_FA0/R0_FA0_mono_left.h5   /image_raw: attribute encoding; images (n, rows, columns), timestamps (n,) ns
    R0_FA0/R0_FA0_applanix.h5    /pose_base_link: positions (m, 3) ECEF m, quaternions (m, 4) x y z w, timestamps

Specified in https://github.com/umautobots/nsavp_tools (documentation/data_format.md). The letter after R0_ is the
direction along the route: F forward, R reverse; every camera looks ahead. Stamps are TAI. Positions are those of the
middle of the rear axle. As in its place_recognition/netvlad_place_recognition.py, thermal pictures are scaled to 8 bits
and the hood is cut off color pictures. Lenses are not corrected, which that script does.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import h5py
import numpy as np
from numpy.typing import NDArray
from pyproj import Geod, Transformer

from edge.errors import FeedError, FrameError
from sim.datasets import ONE_CLOCK_S, ReadOptions, Traverse
from sim.datasets.track import Fix, Track

SOURCE = "NSAVP"
COLOR_CROP_BOTTOM = 174  # the script keeps 850 rows of 1024
ENCODINGS = {"mono8": cv2.COLOR_GRAY2BGR, "mono16": cv2.COLOR_GRAY2BGR, "bayer_rggb8": cv2.COLOR_BayerRGGB2BGR}
COLDEST, HOTTEST = 22500, 25000  # of thermal pictures, as in the script


class H5Pictures:
    """The pictures of one camera, read one by one from its file."""

    def __init__(self, file: Path, encoding: str, rows: int) -> None:
        """encoding: of `ENCODINGS`. rows: how many are kept, from the top."""
        self._file, self._encoding, self._rows = file, encoding, rows
        self._h5: h5py.File | None = None

    def read(self, index: int) -> NDArray[np.uint8]:
        """Picture `index` of the file, (H, W, 3) uint8 BGR; FrameError names it."""
        self._h5 = self._h5 or _open(self._file)
        try:
            raw = self._h5["image_raw/images"][index]
        except OSError as error:
            raise FrameError(f"{self._file}: picture {index}: {error}") from None
        if self._encoding == "mono16":
            scaled = (np.clip(raw, COLDEST, HOTTEST).astype(np.float32) - COLDEST) * (255 / (HOTTEST - COLDEST))
            raw = scaled.astype(np.uint8)
        return np.asarray(cv2.cvtColor(raw, ENCODINGS[self._encoding])[: self._rows], dtype=np.uint8)

    def close(self) -> None:
        """Close the file; more than once is harmless."""
        if self._h5 is not None:
            self._h5.close()
            self._h5 = None


def open_traverse(path: Path, options: ReadOptions) -> Traverse:
    """One camera of a sequence; `camera` is mono_left by default, `positions` another file of poses.

    FeedError names the file or the HDF5 object that is missing.
    """
    file = _file(path, options.camera or "mono_left")
    poses = Path(options.positions) if options.positions else _file(path, "applanix")
    with _open(file) as h5:
        images = _dataset(file, h5, "image_raw/images")
        encoding, rows = str(images.parent.attrs.get("encoding", "")), int(images.shape[1])
        stamps_ns = _dataset(file, h5, "image_raw/timestamps")[:].astype(np.int64).tolist()
    if encoding not in ENCODINGS:
        raise FeedError(f"{file}: /image_raw: encoding {encoding!r} is not one of {', '.join(ENCODINGS)}")
    hood = COLOR_CROP_BOTTOM if encoding == "bayer_rggb8" else 0
    crop_bottom = hood if options.crop_bottom is None else options.crop_bottom
    if crop_bottom >= rows:
        raise FeedError(f"--crop-bottom: {crop_bottom} rows of {rows} leave nothing")
    files = [f"{file.name}#{index}" for index in range(len(stamps_ns))]
    return Traverse(
        name=file.stem,
        source=f"{SOURCE} {file.stem}",
        rows=_track(poses).rows(str(file), files, stamps_ns),
        pictures=H5Pictures(file, encoding, rows - crop_bottom),
        notes=f"TAI stamps, positions of the rear axle; {encoding}, lowest {crop_bottom} rows cut off",
        time_sigma_s=ONE_CLOCK_S,
    )


def _file(folder: Path, what: str) -> Path:
    files = sorted(folder.glob(f"*_{what}.h5"))
    if len(files) != 1:
        raise FeedError(f"{folder}: {len(files) or 'no'} file(s) *_{what}.h5; a folder holds one sequence of {SOURCE}")
    return files[0]


def _open(file: Path) -> h5py.File:
    try:
        return h5py.File(file, "r")
    except OSError as error:
        raise FeedError(f"{file}: not an HDF5 file that can be read: {str(error).splitlines()[0]}") from None


def _dataset(file: Path, h5: h5py.File, name: str) -> h5py.Dataset:
    dataset = h5.get(name)
    if not isinstance(dataset, h5py.Dataset):
        raise FeedError(f"{file}: no dataset /{name} in it")
    return dataset


def _track(file: Path) -> Track:
    with _open(file) as h5:
        columns: Sequence[NDArray[np.float64]] = [
            _dataset(file, h5, f"pose_base_link/{name}")[:] for name in ("positions", "quaternions")
        ]
        stamps_ns = _dataset(file, h5, "pose_base_link/timestamps")[:].astype(np.int64)
    positions, (x, y, z, w) = columns[0].T, columns[1].T
    to_degrees = Transformer.from_pipeline(
        "+proj=pipeline +step +inv +proj=cart +ellps=WGS84 +step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
    lon_deg, lat_deg, _ = to_degrees.transform(positions[0], positions[1], positions[2])
    # The vehicle's x axis, which points forward, in the ECEF frame.
    forward = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)])
    ahead_lon_deg, ahead_lat_deg, _ = to_degrees.transform(*(positions + forward))
    heading_deg = Geod(ellps="WGS84").inv(lon_deg, lat_deg, ahead_lon_deg, ahead_lat_deg)[0] % 360.0
    values = np.column_stack([lat_deg, lon_deg, heading_deg]).tolist()
    fixes = (
        Fix(stamp_ns, lat, lon, heading_deg=heading)
        for stamp_ns, (lat, lon, heading) in zip(stamps_ns.tolist(), values, strict=True)
    )
    return Track(str(file), fixes)
