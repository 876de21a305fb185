"""How far a camera has moved over the ground between two pictures, in units of its height above it.

The older picture is warped as the ground should look by now, so that corners of the ground move by little; they are
tracked to the newer one and back. The motion is then the one that explains most of the tracks: forward, to the right,
a turn, and a change of pitch, with the pitch of the camera itself, all weighted by what is known of each before.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

GROUND_WIDTH_PX = 320
"""Pictures are made so narrow: at 80 degrees, a pixel is 0.3 degrees, a tenth of which corners are tracked to."""
BEHIND_HEIGHTS, FAR_HEIGHTS, LATERAL = -4.0, 8.0, 1.8
"""Ground that is used, in heights ahead and to each side: at 1.4 m up to 11 m, and a lane of 5 m. Further ahead a pitch
that is wrong by 0.1 degrees is 1.4 % of the distance."""
CORNERS, FEWEST_STRIPS = 80, 20
"""Tracked at most (each costs 14 us there and back), and at least: with fewer, wrong motions were found at night."""
APART_PX, BLOCK_PX, WINDOW_PX, BACK_PX = 5, 5, 11, 0.5
"""Between corners; their size; the size that is tracked; how far the track back may end from where it began."""
AROUND = np.ones((WINDOW_PX, WINDOW_PX), np.uint8)  # what must be seen of the ground around a corner
SMOOTHED_PX, LOCAL_PX, CONTRAST = 0.8, 17, 24.0
"""Pictures are compared by their contrast against squares of LOCAL_PX, brought to CONTRAST gray levels: a beam that
moves with the vehicle, and exposure, are gone."""
QUALITY = 0.05  # of the weakest corner that is tracked, against the best
ROUNDS, STEP = 5, 1e-4  # of least squares until it has converged; for slopes, in heights and radians
NOISE = 1.0  # gray levels of contrast that are left as weak as they are
SEARCHED = np.arange(-0.6, 2.41, 0.12)
"""Heights ahead that are tried where no motion is known: 17 m/s at 5 pictures a second and 1.4 m."""
SIDES_SHARE, FEWEST_OF_SIDE = 0.5, 5
"""Of the tracks that the motion must explain, and tracks left and right; with fewer, the ground may be another part."""
LEAST_PX = 0.15  # standard deviation of the best tracks
TOGETHER = np.array([1.0, 1.0, 2.0, 1.0, 1.0])
"""By how much more each part of the motion is uncertain than if each track erred by itself: with these, the errors on
simulated roads are as large as they say."""
SIDEWAYS, SLIDES = 0.01, 0.03
"""Standard deviations of the motion to the right: in heights (rolling by 0.5 degrees), and of the motion ahead."""
TURNS_RADPS = 0.35  # standard deviation of the turn within a second: 20 degrees, as at a crossing
NODS_RAD = math.radians(0.2)  # of the change of pitch between two pictures, of a car on a road
BY_GYRO_RAD = math.radians(0.1)
"""Of both, where an autopilot's gyroscopes measure them: a picture that is 20 ms late if a car pitches by 5 deg/s."""
IS_TURN = np.array([0.0, 0.0, 1.0, 1.0, 0.0])
"""The parts of the motion of which this is known. Tracks that contradict it count more the further they do, since a
mount shakes where no gyroscope feels it: by 0.5 degrees each way, it was 6.3 standard deviations off."""
GROUND_ALIKE, MORE_ALIKE = 0.6, 0.15
"""Correlation of the pictures, moved as was found, from which the motion counts; or by how much it must be more than if
nothing had moved. Lines along the road and reflections do not seem to move: on real streets, in pictures half a second
apart, cars that drove 3 to 5 m were found to stand; all of those are rejected by it."""
NEAREST_SHARE, STRIPS, AS_ALIKE = 0.25, 8, 0.4
"""Most of the picture may move otherwise: as water does, or a truck ahead. So each of as many strips beside each other
of this share of the ground, the nearest that both pictures show, must look as if it had moved, by this share of what
all of the ground does. Only ground is so near to a vehicle that drives on."""
SEEN = 20 * CONTRAST**2  # of a strip of which hardly anything is seen, some 20 pixels count as alike


@dataclass(frozen=True)
class GroundMotion:
    """Motion between two pictures, `elapsed_s` apart, in heights of the camera above the ground.

    ahead, right: along the way the camera looks, and to its right; turn_rad: to the right. pitch_rad: of the camera
    afterwards, down from the horizon. *_sigma: standard deviations by the tracks, without what is unknown of the
    height.
    """

    elapsed_s: float
    ahead: float
    right: float
    turn_rad: float
    pitch_rad: float
    ahead_sigma: float
    right_sigma: float
    turn_sigma: float
    pitch_sigma: float

    @property
    def ahead_per_s(self) -> float:
        """Heights a second."""
        return self.ahead / self.elapsed_s


class GroundView:
    """A pinhole camera above level ground, and which of its pixels show ground that is used."""

    def __init__(self, fov_deg: float, width: int, height: int, pitch_rad: float) -> None:
        """fov_deg: horizontal. pitch_rad: roughly, down from the horizon; it decides which rows are kept."""
        self.focal_px = focal_px = GROUND_WIDTH_PX / 2 / math.tan(math.radians(fov_deg) / 2)
        rows = round(GROUND_WIDTH_PX * height / width)
        self._camera = np.array([[focal_px, 0, GROUND_WIDTH_PX / 2 - 0.5], [0, focal_px, rows / 2 - 0.5], [0, 0, 1]])
        mask, nearest = self._ground(pitch_rad, rows)
        self.ground_share = float((mask > 0).mean())
        self.most_ahead = min(max(0.0, FAR_HEIGHTS - nearest) / 2, float(SEARCHED[-1]))
        """Heights between two pictures that can be found: after which half of that ground is still to be seen."""
        self._top = max(0, int(np.flatnonzero(mask.any(axis=1))[0]) - LOCAL_PX) if mask.any() else 0
        self._camera[1, 2] -= self._top
        self._inverse = np.linalg.inv(self._camera)
        self.mask = np.ascontiguousarray(mask[self._top :])

    def _ground(self, pitch_rad: float, rows: int) -> tuple[NDArray[np.uint8], float]:
        """Its mask, and how far ahead it begins, in heights."""
        u, v = np.meshgrid(np.arange(GROUND_WIDTH_PX), np.arange(rows))
        rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(self._camera).T
        down, ahead = (rays @ direction for direction in _down_and_ahead(pitch_rad))
        with np.errstate(divide="ignore", invalid="ignore"):
            ahead, right = ahead / down, rays[..., 0] / down
        used = (down > 0) & (ahead > BEHIND_HEIGHTS) & (ahead < FAR_HEIGHTS) & (np.abs(right) < LATERAL)
        return np.where(used, 255, 0).astype(np.uint8), float(ahead[used].min(initial=FAR_HEIGHTS))

    def contrast(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The part of a picture (H, W, 3) BGR that may show ground, as local contrast around 128."""
        top = self._top * image.shape[0] // (self._top + self.mask.shape[0])
        gray = cv2.cvtColor(image[top:], cv2.COLOR_BGR2GRAY)
        if gray.shape != self.mask.shape:
            gray = cv2.resize(gray, self.mask.shape[::-1], interpolation=cv2.INTER_AREA)
        fine = cv2.GaussianBlur(gray, (5, 5), SMOOTHED_PX).astype(np.float32)
        fine -= cv2.blur(fine, (LOCAL_PX, LOCAL_PX))
        power = cv2.blur(fine * fine, (LOCAL_PX, LOCAL_PX))
        fine *= CONTRAST / np.sqrt(power + NOISE**2)
        return cv2.convertScaleAbs(fine, alpha=1.0, beta=128.0).astype(np.uint8, copy=False)

    def in_pixels(self, motion: NDArray[np.float64]) -> NDArray[np.float64]:
        """The homography (3, 3) of pixels that a motion of rays is."""
        return np.asarray(self._camera @ motion @ self._inverse)

    def rays(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N, 2) pixels as (N, 3) rays of depth 1."""
        return np.asarray(np.column_stack([pixels, np.ones(len(pixels))]) @ self._inverse.T)


def _down_and_ahead(pitch_rad: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The two directions (3,) in the axes of a camera: right, down and along its view."""
    sin, cos = math.sin(pitch_rad), math.cos(pitch_rad)
    return np.array([0.0, cos, sin]), np.array([0.0, -sin, cos])


def ground_motion(parameters: NDArray[np.float64]) -> NDArray[np.float64]:
    """The homography (3, 3) that takes a ray to a point of the ground to where it is seen after a motion.

    parameters (5,): ahead and to the right in heights, turn to the right, change of pitch, pitch before.
    """
    ahead, right, turn_rad, change_rad, pitch_rad = parameters
    down, along = _down_and_ahead(pitch_rad)
    moved = ahead * along + np.array([right, 0.0, 0.0])
    turned = cv2.Rodrigues(-turn_rad * down)[0]
    nodded = cv2.Rodrigues(np.array([change_rad, 0.0, 0.0]))[0]
    return np.asarray(nodded @ turned @ (np.eye(3) - np.outer(moved, down)))


def _seen(motion: NDArray[np.float64], rays: NDArray[np.float64]) -> NDArray[np.float64]:
    moved = rays @ motion.T
    return np.asarray(moved[:, :2] / moved[:, 2:])


def measure(
    view: GroundView,
    before: NDArray[np.uint8],
    now: NDArray[np.uint8],
    elapsed_s: float,
    last: GroundMotion | None,
    pitch: tuple[float, float],
    turned: tuple[float, float] | None = None,
) -> GroundMotion | str:
    """The motion between two pictures, as `GroundView.contrast` gives them; else why it cannot be seen.

    last: the step before, None where none is known. pitch: of the camera in radians, and its standard deviation.
    turned: by gyroscopes, in radians to the right and further down, None where none measure it.
    """
    share = elapsed_s / last.elapsed_s if last else 0.0
    ahead = last.ahead * share if last else _search(view, before, now, pitch[0])
    guessed = (last.turn_rad * share if last else 0.0, 0.0) if turned is None else turned
    start = np.array([ahead, 0.0, *guessed, pitch[0]])
    tracks = _track(view, before, now, view.in_pixels(ground_motion(start)), is_known=last is not None)
    if tracks is None:
        return "too few corners of the ground to be tracked"
    corners, tracked = map(view.rays, tracks)
    corners = corners @ np.linalg.inv(ground_motion(start)).T
    sideways = math.hypot(SIDEWAYS, SLIDES * ahead)
    turns = (TURNS_RADPS * elapsed_s, NODS_RAD) if turned is None else (BY_GYRO_RAD, BY_GYRO_RAD)
    known, sigmas = start * (1, 1, turned is not None, 1, 1), np.array([1.0, sideways, *turns, pitch[1]])
    solved = _solve(view.focal_px, corners / corners[:, 2:], tracked[:, :2], start, known, sigmas)
    if isinstance(solved, str):
        return solved
    motion, covariance = solved
    moved = cv2.warpPerspective(before, view.in_pixels(ground_motion(motion)), now.shape[::-1])
    seen = (view.mask > 0) & (cv2.erode(moved, AROUND) > 0)
    nearest = seen & (np.cumsum(seen.sum(axis=1))[:, None] > (1 - NEAREST_SHARE) * seen.sum())
    alike, stood = (float(_likeness(one, now, seen)[0]) for one in (moved, before))
    strips = _likeness(moved, now, nearest, STRIPS, SEEN)
    if (alike < GROUND_ALIKE and alike - stood < MORE_ALIKE) or strips.min() < AS_ALIKE * alike:
        return "the ground does not look as if it had moved"
    ahead_sigma, right_sigma, turn_sigma, *_ = TOGETHER * np.sqrt(np.diag(covariance))
    pitch_rad, pitch_sigma = motion[3:].sum(), math.sqrt(covariance[3:, 3:].sum())
    values = *motion[:3], pitch_rad, ahead_sigma, right_sigma, turn_sigma, pitch_sigma
    return GroundMotion(elapsed_s, *map(float, values))


def _likeness(
    one: NDArray[Any], other: NDArray[Any], used: NDArray[np.bool_], strips: int = 1, alike: float = 0.0
) -> NDArray[np.float32]:
    """The correlation (strips,) of two pictures of contrast around 128, in strips beside each other: 1 where alike."""
    first, second = (np.where(used, picture.astype(np.float32) - 128, 0) for picture in (one, other))
    products = np.stack([first * second, first * first, second * second])
    both, left, right = products.reshape(3, len(used), strips, -1).sum(axis=(1, 3))
    return np.asarray((both + alike) / (np.sqrt(left * right) + alike + 1))


def _search(view: GroundView, before: NDArray[np.uint8], now: NDArray[np.uint8], pitch_rad: float) -> float:
    """Heights ahead by which the older picture, moved on, is most like the newer one; at a quarter of the pixels."""
    half = np.diag([0.5, 0.5, 1.0])
    old, new, mask = (cv2.resize(one, None, fx=0.5, fy=0.5) for one in (before, now, view.mask))

    def likeness(ahead: float) -> float:
        moved = half @ view.in_pixels(ground_motion(np.array([ahead, 0.0, 0.0, 0.0, pitch_rad]))) @ np.linalg.inv(half)
        return float(_likeness(cv2.warpPerspective(old, moved, new.shape[::-1], borderValue=128), new, mask > 0)[0])

    return float(max(SEARCHED, key=likeness))


def _track(
    view: GroundView, before: NDArray[np.uint8], now: NDArray[np.uint8], moved: NDArray[np.float64], *, is_known: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Pixels (N, 2) of corners of the ground, and where the newer picture has them.

    The former are of the older picture warped as `moved` says pixels should move, which is known or searched for. None:
    too few.
    """
    warped = cv2.warpPerspective(before, moved, now.shape[::-1])
    # Contrast is hardly ever 0; what lies beyond the older picture is.
    used = cv2.bitwise_and(cv2.erode(cv2.threshold(warped, 0, 255, cv2.THRESH_BINARY)[1], AROUND), view.mask)
    corners = cv2.goodFeaturesToTrack(warped, CORNERS, QUALITY, APART_PX, mask=used, blockSize=BLOCK_PX)
    if corners is None or len(corners) < FEWEST_STRIPS:
        return None
    window, most = (WINDOW_PX, WINDOW_PX), 1 if is_known else 2  # levels
    there, found, _ = cv2.calcOpticalFlowPyrLK(warped, now, corners, np.empty(0), winSize=window, maxLevel=most)
    back, found_back, _ = cv2.calcOpticalFlowPyrLK(now, warped, there, np.empty(0), winSize=window, maxLevel=most)
    astray_px = np.linalg.norm((back - corners)[:, 0], axis=1)
    kept = (found[:, 0] == 1) & (found_back[:, 0] == 1) & (astray_px < BACK_PX)
    pixels = corners[kept, 0].astype(np.float64), there[kept, 0].astype(np.float64)
    return pixels if kept.sum() >= FEWEST_STRIPS else None


def _solve(
    focal_px: float,
    corners: NDArray[np.float64],
    tracked: NDArray[np.float64],
    start: NDArray[np.float64],
    known: NDArray[np.float64],
    sigmas: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | str:
    """The motion (5,) of most tracks, and its covariance, by robust least squares from what half of them agree on.

    The tracks lead from rays (N, 3) to (N, 2). known, sigmas (5,): of the motion beforehand, and standard deviations.
    """

    def residual_px(motion: NDArray[np.float64]) -> NDArray[np.float64]:
        return focal_px * (tracked - _seen(ground_motion(motion), corners))

    first_px = residual_px(start)
    slopes = np.stack([(first_px - residual_px(start + STEP * unit)) / STEP for unit in np.eye(5)], axis=-1)
    motion = start.copy()
    motion[0] = known[0] = start[0] + float(np.median(first_px[:, 1] / slopes[:, 1, 0]))
    scale_px = 1.0
    for _ in range(ROUNDS):
        off_px = residual_px(motion)
        lengths_px = np.linalg.norm(off_px, axis=1)
        weights = 1 / (1 + (lengths_px / (2 * scale_px)) ** 2) ** 2  # Geman and McClure
        weighted = (slopes * (weights / scale_px**2)[:, None, None]).reshape(-1, 5).T
        variances = sigmas**2 + IS_TURN * (known - motion) ** 2
        information = weighted @ slopes.reshape(-1, 5) + np.diag(1 / variances)
        pull = weighted @ off_px.ravel() + (known - motion) / variances
        motion = motion + np.linalg.solve(information, pull)
        scale_px = max(LEAST_PX, float(np.median(lengths_px)))
    off_px = residual_px(motion)
    agreeing = np.linalg.norm(off_px, axis=1) < 3 * scale_px
    on_right = int((tracked[agreeing, 0] > 0).sum())
    sides = on_right, int(agreeing.sum()) - on_right
    if sum(sides) < max(FEWEST_STRIPS, SIDES_SHARE * len(off_px)) or min(sides) < FEWEST_OF_SIDE:
        return "the ground does not move as one"
    return motion, np.linalg.inv(information)
