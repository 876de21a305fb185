"""Forward speed and turn of the vehicle from consecutive pictures; the camera's height is learned while GPS is good."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.journal.records import Record, unit
from edge_plugins.motion import MotionConfig
from edge_plugins.motion.ground import GroundMotion, GroundView, measure
from edge_plugins.motion.height import CameraHeight, read_height

LEAST_NS, LONGEST_STEP_NS = 60_000_000, 500_000_000
"""Between two pictures that are compared: of 30 a second one in two, which halves what they cost; and after the latter
little of the ground is still to be seen, at 10 m/s and 1.4 m."""
MOUNTED_RAD, RESTS_RAD = math.radians(2.0), math.radians(0.6)
"""Standard deviations of the pitch: of a camera that was mounted by hand, and of a car around where it rests."""
RESTS_S = 2.0  # how soon it is back where it rests
MOST_JUMP_MPS2, LEAST_HEIGHT_M = 10.0, 0.5
"""No vehicle changes its speed faster by much, whose camera is at least so high: after a loss, one in five motions that
were found was that of something else, and none twice."""
STILL = 0.3
"""Heights a second, below which it may be dirt on the lens that is seen in the dark: it stands where it came to a halt,
and not where it was found to stand after nothing was seen."""
LEAST_SIGMA_MPS = 0.05
"""Of a speed: a car that comes to rest lifts its nose again, by which it was up to 0.15 m/s off."""
SLIDES, LEAST_SIDEWAYS_MPS = 0.03, 0.2
"""Standard deviations of a velocity to the side that is not measured: 2 degrees of the speed, and as much where a
vehicle stands as its body rocks."""
YAW_RAD = math.radians(0.7)
"""Of the camera's yaw that GPS has shown: in flight, slips of up to 3 degrees were found to 0.3 (mean of 4 s)."""
LEARNT_MPS = 2.0
"""Slower, the velocity of GPS is wrong by too large a share."""
RECORDED_NS = 1_000_000_000  # between records in the journal


class MotionMeasured(Record, frozen=True, tag="motion"):
    """The vehicle's motion by its camera, once a second; with [motion] use."""

    stamp_ns: Annotated[int, unit("ns", "exposure time of the newer picture")]
    speed_mps: Annotated[float | None, unit("m/s", "ahead, null where it could not be measured")] = None
    sigma_mps: Annotated[float | None, unit("m/s", "one standard deviation of it")] = None
    turn_radps: Annotated[float | None, unit("rad/s", "turn to the right")] = None
    right_mps: Annotated[float | None, unit("m/s", "to the right, 0 until the camera's yaw is learned")] = None
    gps_mps: Annotated[float | None, unit("m/s", "speed by GPS, null while GPS is not good")] = None
    height_m: Annotated[float | None, unit("m", "of the camera above the ground, null until it is learned")] = None
    why: Annotated[str, unit("", 'why nothing was measured, "" where it was')] = ""


class CameraSpeed(NamedTuple):
    """What a camera measured of the vehicle at `stamp_ns`, the middle between two exposures: ahead, and turning right.

    right_mps: to the side, as a vehicle slips in a bend. *_sigma_*: one standard deviation. scale_share: that of the
    camera's height, which is in sigma_mps as well, as a share of the speed: all speeds have the same error by it.
    """

    stamp_ns: int
    speed_mps: float
    sigma_mps: float
    turn_radps: float
    turn_sigma_radps: float
    right_mps: float
    right_sigma_mps: float
    scale_share: float


class CameraMotion:
    """The motion of one vehicle, from each of its camera's pictures in turn."""

    def __init__(
        self,
        config: Config,
        record: Callable[[Record], object] = lambda record: None,
        turned_rad: Callable[[int, int], tuple[float, float] | None] = lambda since_ns, until_ns: None,
    ) -> None:
        """Read the height that earlier drives have shown. record: writes a record (`Journal.write`).

        turned_rad: by how much the vehicle has turned between two moments (`Vehicle.turned_rad`).
        """
        motion, camera, journal = config.of(MotionConfig), config.camera, config.telemetry.journal
        self._config, self._fov_deg = motion, camera.known_fov_deg("[motion] needs it")
        self._sign = 1.0 if camera.view == "front" else -1.0
        self._record, self._recorded_ns, self._turned_rad = record, 0, turned_rad
        path = Path(journal).with_suffix(".height") if journal else None
        key = f"{camera.source} {camera.view} {camera.preprocessing} {self._fov_deg:g} {motion}"
        kept = read_height(path, key, math.radians(motion.pitch_deg))
        self.height = CameraHeight(kept, config.sequence_frames, path)
        self._view: GroundView | None = None
        self._seen: tuple[NDArray[np.uint8], int] | None = None
        self._step: GroundMotion | None = None
        self._stepped_ns = 0
        self.speed: CameraSpeed | None = None
        """The newest, None where it could not be measured."""
        self._begin_anew("no picture yet")

    def _begin_anew(self, why: str) -> None:
        self.why, self._step = why, None
        self._pitch_rad = self.height.pitch_rad
        self._pitch_sigma = RESTS_RAD if self.height.height_m else MOUNTED_RAD

    def follow(
        self, image: NDArray[np.uint8], stamp_ns: int, gps_mps: float | None, gps_slip: float = 0.0
    ) -> CameraSpeed | None:
        """The vehicle's speed by this picture (H, W, 3) BGR and the one before; None where there is none: see `why`.

        gps_mps: its speed by GPS, from which the height is learned, None while GPS is not good. gps_slip: the speed to
        the right of where the autopilot has it head, as a share of that ahead, which shows the camera's yaw. A picture
        less than LEAST_NS after the last one is passed over.
        """
        before = self._seen
        if before is not None and 0 <= stamp_ns - before[1] < LEAST_NS:
            return None
        if self._view is None:
            self._view = GroundView(self._fov_deg, image.shape[1], image.shape[0], math.radians(self._config.pitch_deg))
        now = self._seen = self._view.contrast(image), stamp_ns
        self.speed = None
        if before is None or not 0 < stamp_ns - before[1] <= LONGEST_STEP_NS:
            self._begin_anew("no picture shortly before")
        else:
            elapsed_s = (stamp_ns - before[1]) / 1e9
            body = self._turned_rad(before[1], stamp_ns)
            turned = None if body is None else (body[1], -self._sign * body[0])
            pitch = self._pitch_after(elapsed_s)
            step = measure(self._view, before[0], now[0], elapsed_s, self._step, pitch, turned)
            if isinstance(step, str):
                self.why = step
                if stamp_ns - self._stepped_ns > LONGEST_STEP_NS:
                    self._begin_anew(step)
            else:
                self._use(step, stamp_ns, gps_mps, gps_slip)
        if stamp_ns - self._recorded_ns >= RECORDED_NS:
            self._recorded_ns = stamp_ns
            values = (*self.speed[1:4], self.speed.right_mps) if self.speed else (None,) * 4
            self._record(MotionMeasured(stamp_ns, *values, gps_mps, self.height.height_m, self.why))
        return self.speed

    def _pitch_after(self, elapsed_s: float) -> tuple[float, float]:
        """The camera's pitch in radians, on its way back to where it rests, and its standard deviation."""
        kept = math.exp(-elapsed_s / RESTS_S)
        rests_rad = self.height.pitch_rad if self.height.height_m else self._pitch_rad
        sigma = math.hypot(kept * self._pitch_sigma, math.sqrt(1 - kept**2) * RESTS_RAD)
        return rests_rad + kept * (self._pitch_rad - rests_rad), sigma

    def _use(self, step: GroundMotion, stamp_ns: int, gps_mps: float | None, gps_slip: float) -> None:
        before, high_m = self._step, self.height.height_m or LEAST_HEIGHT_M
        jump_mps = math.inf if before is None else abs(step.ahead_per_s - before.ahead_per_s) * high_m
        has_jumped = jump_mps > MOST_JUMP_MPS2 * (stamp_ns - self._stepped_ns) / 1e9
        if has_jumped and abs(step.ahead_per_s) < STILL:
            self._begin_anew("nothing moves: it stands, or sees no road")
            return
        self._step, self._stepped_ns = step, stamp_ns
        self._pitch_rad, self._pitch_sigma = step.pitch_rad, step.pitch_sigma
        if has_jumped:
            self.why = "the ground has not moved alike twice in a row"
            return
        self.height.drive(self._sign * step.ahead_per_s, stamp_ns)
        if gps_mps is not None and gps_mps >= LEARNT_MPS:
            yaw_rad = gps_slip - step.right / step.ahead if step.ahead else 0.0
            self.height.compare(gps_mps * step.elapsed_s, abs(step.ahead), (step.pitch_rad, yaw_rad), stamp_ns)
        height_m, share = self.height.height_m, self.height.share
        self.why = "" if height_m else "the height of the camera is not learned yet"
        if height_m:
            per_s = height_m / step.elapsed_s
            sigma_mps = math.hypot(step.ahead_sigma * per_s, share * step.ahead * per_s, LEAST_SIGMA_MPS)
            middle_ns = stamp_ns - round(step.elapsed_s * 1e9 / 2)
            speed_mps = self._sign * step.ahead_per_s * height_m
            right_mps, right_sigma_mps = 0.0, max(SLIDES * abs(speed_mps), LEAST_SIDEWAYS_MPS)
            if self.height.yaw_rad is not None:
                right_mps = self._sign * step.right * per_s + self.height.yaw_rad * speed_mps
                right_sigma_mps = math.hypot(step.right_sigma * per_s, YAW_RAD * speed_mps, LEAST_SIGMA_MPS)
            turns = step.turn_rad / step.elapsed_s, step.turn_sigma / step.elapsed_s
            self.speed = CameraSpeed(middle_ns, speed_mps, sigma_mps, *turns, right_mps, right_sigma_mps, share)
