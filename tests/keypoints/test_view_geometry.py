"""What a camera's pixels are of directions: whatever its resolution, and through its lens."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from edge.config import Lens
from edge.keypoints import CameraModel

EUROC = Lens(distortion=(-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05))
FISHEYE = Lens(lens="fisheye", distortion=(0.00348, 0.00072, -0.00205, 0.0002))


def test_a_pixel_of_the_network_is_as_wide_in_a_larger_picture() -> None:
    small, large = CameraModel(320, 240, 80.0), CameraModel(1280, 960, 80.0)
    assert large.network_focal_px == pytest.approx(small.network_focal_px)
    assert small.network_focal_px == small.focal_px, "maps of such pictures stay as they are, to the bit"


def bent(camera: CameraModel, directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pixels by OpenCV's own equations of what a lens does."""
    inside = np.array(
        [[camera.focal_px, 0, camera.middle[0]], [0, camera.focal_px, camera.middle[1]], [0, 0, 1.0]], np.float64
    )
    flat, factors = directions.reshape(-1, 1, 2), np.array(camera.lens.distortion)
    if camera.lens.lens == "fisheye":
        found = cv2.fisheye.distortPoints(flat, inside, factors)
    else:
        rays = cv2.convertPointsToHomogeneous(flat)
        found = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), inside, factors)[0]
    return np.asarray(found.reshape(directions.shape))


@pytest.mark.parametrize(("lens", "fov_deg", "reach"), [(EUROC, 78.7, (1.1, 0.7)), (FISHEYE, 107.0, (1.6, 1.6))])
def test_directions_are_without_what_the_lens_bends(lens: Lens, fov_deg: float, reach: tuple[float, float]) -> None:
    """To the corners of EuRoC's pictures, whose lens moves points by 140 pixels there."""
    camera = CameraModel(752, 480, fov_deg, lens)
    directions = np.stack(np.meshgrid(*(np.linspace(-one, one, 9) for one in reach)), axis=-1)
    pixels = bent(camera, directions)
    np.testing.assert_allclose(camera.directions(pixels), directions, atol=1e-4)
    assert np.abs(camera._replace(lens=Lens()).directions(pixels) - directions).max() > 0.1


def test_what_a_fisheye_shows_beside_the_camera_has_no_direction_ahead() -> None:
    found = CameraModel(752, 752, 107.0, FISHEYE).directions(np.array([[0.0, 0.0], [375.5, 375.5]]))
    assert np.isnan(found[0]).all() and np.abs(found[1]).max() < 1e-9
