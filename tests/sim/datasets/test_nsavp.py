"""NSAVP: sequences written here in the layout of nsavp_tools' documentation/data_format.md."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray
from pyproj import Transformer
from pyproj.enums import TransformDirection

from edge.feed import FeedImages, read_feed
from edge.geodesy import moved
from sim.datasets import ReadOptions, open_dataset

ORIGIN = (42.29, -83.71, 260.0)
FRAMES, ROWS, COLUMNS = 40, 48, 64
START_NS = 1_670_000_037_000_000_000
Import = Callable[..., int]
Refused = Callable[..., None]


def to_ecef(
    east_m: NDArray[np.float64], north_m: NDArray[np.float64], up_m: NDArray[np.float64], origin: Sequence[float]
) -> NDArray[np.float64]:
    """Points (N,) around an origin (degrees, meters above the ellipsoid) in meters of the ECEF frame, (3, N)."""
    lat_deg, lon_deg, alt_m = origin
    plane = f"+proj=topocentric +ellps=WGS84 +lat_0={lat_deg} +lon_0={lon_deg} +h_0={alt_m}"
    transformer = Transformer.from_pipeline(plane)
    return np.array(transformer.transform(east_m, north_m, up_m, direction=TransformDirection.INVERSE))


def quaternion_of(heading_deg: float, lat_deg: float, lon_deg: float) -> NDArray[np.float64]:
    """x y z w of the rotation from base_link (ahead, left, up) to the ECEF frame, by its matrix."""
    heading = np.radians(heading_deg)
    ahead, left = (np.sin(heading), np.cos(heading), 0.0), (-np.cos(heading), np.sin(heading), 0.0)
    axes = np.array([(0.0, 0.0, 0.0), ahead, left, (0.0, 0.0, 1.0)]).T
    ends = to_ecef(axes[0], axes[1], axes[2], (lat_deg, lon_deg, 0.0))
    matrix = ends[:, 1:] - ends[:, :1]
    values, vectors = np.linalg.eigh(_bar_itzhack(matrix))
    found: NDArray[np.float64] = vectors[:, values.argmax()]
    return found


def _bar_itzhack(m: NDArray[np.float64]) -> NDArray[np.float64]:
    """The matrix whose first eigenvector is the quaternion of rotation `m` (Bar-Itzhack 2000)."""
    out = np.zeros((4, 4))
    out[:3, :3] = m + m.T - np.eye(3) * np.trace(m)
    out[3, :3] = out[:3, 3] = (m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1])
    out[3, 3] = np.trace(m)
    return out / 3


@pytest.fixture
def sequence(tmp_path: Path) -> Callable[..., Path]:
    """sequence(prefix, ...) writes a drive of 1 m a frame, and returns its folder."""

    def write(
        prefix: str, *, heading_deg: float = 30.0, camera: str = "mono_left", encoding: str = "mono8", level: int = 4
    ) -> Path:
        folder = tmp_path / prefix
        folder.mkdir(exist_ok=True)
        images = np.empty((FRAMES, ROWS, COLUMNS), np.uint16 if encoding == "mono16" else np.uint8)
        images[:] = (np.arange(FRAMES) * level)[:, None, None] + (22500 if encoding == "mono16" else 0)
        if encoding == "bayer_rggb8":  # only the red pixels see anything
            images[:, 1::2] = images[:, :, 1::2] = 0
        with h5py.File(folder / f"{prefix}_{camera}.h5", "w") as h5:
            group = h5.create_group("image_raw")
            group.attrs.update(
                ros_message_type="sensor_msgs/Image", height=ROWS, width=COLUMNS, encoding=encoding, is_bigendian=0
            )
            group.create_dataset("images", data=images, chunks=(1, ROWS, COLUMNS), compression="gzip")
            stamps = group.create_dataset("timestamps", data=_stamps(FRAMES, 50_000_000))
            stamps.attrs["units"] = "nanoseconds"
        along_m = np.arange(10 * FRAMES) * 0.1
        east_m, north_m = along_m * np.sin(np.radians(heading_deg)), along_m * np.cos(np.radians(heading_deg))
        with h5py.File(folder / f"{prefix}_applanix.h5", "w") as h5:
            group = h5.create_group("pose_base_link")
            group["positions"] = to_ecef(east_m, north_m, 0 * east_m, ORIGIN).T
            group["quaternions"] = np.tile(quaternion_of(heading_deg, *ORIGIN[:2]), (len(along_m), 1))
            group["timestamps"] = _stamps(len(along_m), 5_000_000)
        return folder

    return write


def _stamps(count: int, step_ns: int) -> NDArray[np.uint64]:
    return np.uint64(START_NS) + np.arange(count, dtype=np.uint64) * np.uint64(step_ns)


def test_a_sequence_becomes_a_feed_with_a_picture_every_two_meters(
    sequence: Callable[..., Path], tmp_path: Path, sim_import: Import
) -> None:
    sim_import("nsavp", sequence("R0_FA0"), "-o", tmp_path / "feed", "--lossless")
    feed = read_feed(tmp_path / "feed")
    assert [row.extra["source_frame"] for row in feed.rows] == [str(frame) for frame in range(0, FRAMES, 2)]
    assert np.diff([row.distance_m for row in feed.rows]) == pytest.approx(2.0, abs=0.01)
    assert {round(row.heading_deg or 0.0, 2) for row in feed.rows} == {30.0}
    assert [row.stamp_ns for row in feed.rows] == _stamps(FRAMES, 50_000_000)[::2].tolist()
    assert (feed.header.view, feed.header.source) == ("front", "NSAVP R0_FA0_mono_left")
    lat_deg, lon_deg = moved(*ORIGIN[:2], 10 * np.sin(np.radians(30)), 10 * np.cos(np.radians(30)), ORIGIN[2])
    assert (feed.rows[5].lat_deg, feed.rows[5].lon_deg) == pytest.approx((lat_deg, lon_deg), abs=1e-7)
    assert np.unique(FeedImages(feed).read(5)).tolist() == [40]


def test_the_opposing_sequence_has_the_opposite_heading(sequence: Callable[..., Path]) -> None:
    rows = open_dataset("nsavp", sequence("R0_RA0", heading_deg=210.0)).rows
    assert {round(row.heading_deg or 0.0, 2) for row in rows} == {210.0}


@pytest.mark.parametrize(
    ("camera", "encoding", "level", "crop", "size", "value"),
    [
        ("rgb_left", "bayer_rggb8", 4, 8, (40, 64, 3), [0, 0, 40]),
        ("adk_right", "mono16", 25, None, (48, 64, 3), [25] * 3),  # 250 of the 2500 that become 255
    ],
)
def test_color_and_thermal_pictures(
    sequence: Callable[..., Path],
    camera: str,
    encoding: str,
    level: int,
    crop: int,
    size: tuple[int, ...],
    value: list[int],
) -> None:
    folder = sequence("R0_FN0", camera=camera, encoding=encoding, level=level)
    pictures = open_dataset("nsavp", folder, ReadOptions(camera=camera, crop_bottom=crop)).pictures
    image = pictures.read(10)
    pictures.close()
    assert image.shape == size and np.unique(image[1:-1, 1:-1].reshape(-1, 3), axis=0).tolist() == [value]


def test_what_is_missing_is_named(sequence: Callable[..., Path], refused: Refused) -> None:
    folder = sequence("R0_FA0")
    refused("nsavp", folder, r"R0_FA0: no file\(s\) \*_mono_right\.h5", ReadOptions(camera="mono_right"))
    refused("nsavp", folder, r"--crop-bottom: 48 rows of 48 leave nothing", ReadOptions(crop_bottom=ROWS))
    with h5py.File(folder / "R0_FA0_applanix.h5", "a") as h5:
        del h5["pose_base_link/quaternions"]
    refused("nsavp", folder, r"R0_FA0_applanix\.h5: no dataset /pose_base_link/quaternions in it")
    (folder / "R0_FA0_applanix.h5").write_bytes(b"not HDF5")
    refused("nsavp", folder, r"R0_FA0_applanix\.h5: not an HDF5 file that can be read")
    with h5py.File(folder / "R0_FA0_mono_left.h5", "a") as h5:
        h5["image_raw"].attrs["encoding"] = "rgb8"
    refused("nsavp", folder, r"R0_FA0_mono_left\.h5: /image_raw: encoding 'rgb8' is not one of mono8, mono16, bayer")
