"""The field of view that recordings say, each in its own way, in files that are written here."""

from __future__ import annotations

import struct
from collections.abc import Callable
from math import atan, degrees, hypot, radians, tan
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import ExifTags, Image

from edge.config import Lens
from edge.feed import read_feed
from sim.datasets import ReadOptions, open_dataset
from sim.datasets.field_of_view import APPLE
from tests.sim.datasets.conftest import HEIGHT, WIDTH
from tests.sim.datasets.test_video import box, klv, write_mp4

WritePictures = Callable[[Path, list[str]], None]
FOCAL_PX = 40.0
FOV_DEG = round(degrees(2 * atan(WIDTH / 2 / FOCAL_PX)), 2)
FILM_MM = FOCAL_PX * hypot(36, 24) / hypot(WIDTH, HEIGHT)


@pytest.mark.parametrize(("camera", "focal_px"), [("image_2", FOCAL_PX), ("image_0", 50.0)])
def test_kitti_says_it_in_calib_txt(
    tmp_path: Path, write_pictures: WritePictures, sim_import: Callable[..., int], camera: str, focal_px: float
) -> None:
    sequence = tmp_path / "sequences/04"
    write_pictures(sequence / camera, [f"{i:06d}.png" for i in range(4)])
    (sequence / "times.txt").write_text("0\n1\n2\n3\n")
    (tmp_path / "poses").mkdir()
    (tmp_path / "poses/04.txt").write_text("".join(f"1 0 0 0 0 1 0 0 0 0 1 {2 * i}\n" for i in range(4)))
    lines = [f"P{i}: {50 - 5 * i:e} 0 32 0 0 {50 - 5 * i:e} 24 0 0 0 1 0\n" for i in range(4)]
    (sequence / "calib.txt").write_text("".join(lines))
    sim_import(sequence, "-o", tmp_path / "feed", "--camera", camera, "--width", 32)
    found = read_feed(tmp_path / "feed").header.fov_deg
    assert found == pytest.approx(degrees(2 * atan(WIDTH / 2 / focal_px)), abs=0.01), "pictures of another size too"


def test_euroc_says_it_in_sensor_yaml(tmp_path: Path, write_pictures: WritePictures) -> None:
    cam = tmp_path / "mav0/cam0"
    write_pictures(cam / "data", [f"{1403636579763555584 + 50_000_000 * i}.png" for i in range(4)])
    lines = [f"{file.stem},{file.name}" for file in sorted((cam / "data").iterdir())]
    (cam / "data.csv").write_text("\n".join(["#timestamp [ns],filename", *lines]))
    said = f"rate_hz: 20\nresolution: [752, 480]\nintrinsics: [{752 * FOCAL_PX / WIDTH}, 457.2, 367.2, 248.3] #fu, fv\n"
    bent = "distortion_model: radial-tangential\ndistortion_coefficients: [-0.28, 0.07, 0.0002, 1.8e-05]\n"
    for more, distortion in (("", ()), (bent, (-0.28, 0.07, 0.0002, 1.8e-05))):
        (cam / "sensor.yaml").write_text(f"sensor_type: camera\n{said}{more}")
        found = open_dataset("pictures", cam / "data")
        assert (found.fov_deg, found.lens) == (FOV_DEG, Lens(distortion=distortion))


@pytest.mark.parametrize("orientation", [1, 6])
def test_pictures_say_it_by_their_focal_length_on_film(tmp_path: Path, orientation: int) -> None:
    """Of a phone, which stores what it takes upright on its side."""

    def take(name: str, focal_mm: float) -> None:
        exif = Image.Exif()
        exif[ExifTags.Base.Orientation] = orientation
        exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = focal_mm
        Image.new("RGB", (400, 300)).save(tmp_path / name, exif=exif)

    take("1.jpg", 26)
    take("2.jpg", 26)
    known = open_dataset("geotagged", tmp_path)
    height, width = known.pictures.read(0).shape[:2]
    focal_px = 26 / hypot(36, 24) * 500
    assert (width, known.fov_deg) == (
        400 if orientation == 1 else 300,
        round(degrees(2 * atan(width / 2 / focal_px)), 2),
    )
    assert height + width == 700
    take("2.jpg", 52)
    assert open_dataset("geotagged", tmp_path).fov_deg is None, "of a zoom"


def test_an_iphone_says_it_in_its_video(tmp_path: Path) -> None:
    write_mp4(tmp_path / "plain.mp4")
    with (
        av.open(str(tmp_path / "plain.mp4")) as plain,
        av.open(str(tmp_path / "phone.mov"), "w", options={"movflags": "use_metadata_tags"}) as phone,
    ):
        phone.metadata[APPLE] = f"{FILM_MM:.4f}"
        stream = phone.add_stream_from_template(plain.streams.video[0])
        for packet in plain.demux(video=0):
            if packet.dts is not None:
                packet.stream = stream
                phone.mux(packet)
    assert open_dataset("video", tmp_path / "phone.mov").fov_deg == pytest.approx(FOV_DEG, abs=0.01)
    assert open_dataset("video", tmp_path / "plain.mp4").fov_deg is None


@pytest.mark.parametrize("lens", [b"L", b"W"])
def test_a_gopro_says_it_and_is_a_fisheye_where_its_lens_bends_lines(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, lens: bytes
) -> None:
    file = tmp_path / "GX010042.MP4"
    write_mp4(file)
    data = file.read_bytes()
    at = data.rindex(b"moov") - 4
    focal = WIDTH / 2 / tan(radians(FOV_DEG / 2))
    half = hypot(WIDTH, HEIGHT) / 2 / focal
    diagonal_deg = 2 * degrees(atan(half) if lens == b"L" else half)
    settings = klv(b"VFOV", b"c", 1, lens) + klv(b"ZFOV", b"f", 4, struct.pack(">f", diagonal_deg))
    held = box(b"udta", box(b"GPMF", klv(b"DEVC", b"\0", 1, settings)))
    file.write_bytes(data[:at] + box(b"moov", data[at + 8 :], held))
    found = open_dataset("video", file)
    assert found.fov_deg == pytest.approx(FOV_DEG, abs=0.01)
    assert found.lens.lens == ("pinhole" if lens == b"L" else "fisheye")
    assert ("GX010042.MP4: its lens (W) bends straight lines" in caplog.text) == (lens == b"W")
    said = open_dataset("video", file, ReadOptions(fov_deg=86.0))
    assert said.fov_deg == 86.0 and not said.lens.bends
    assert ("--fov-deg 86 replaces its own lens" in caplog.text) == (lens == b"W"), "it is that of Linear"


def test_what_no_camera_has_is_not_used(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    exif = Image.Exif()
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = 400
    Image.fromarray(np.zeros((30, 40, 3), np.uint8)).save(tmp_path / "1.jpg", exif=exif)
    assert open_dataset("geotagged", tmp_path).fov_deg is None
    assert "1.jpg: a field of view of 5 degrees is not used: 30 to 120 are known here" in caplog.text
