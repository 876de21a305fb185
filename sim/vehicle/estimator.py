"""The simulated autopilot's own estimate: a small Kalman filter that errs as real ones were recorded to err.

With GPS the position is the receiver's. Without it the filter integrates a velocity, and its errors are those of the
velocity's source: a wheel scale and a heading error (wheels), a scale alone (a velocity sensor), or an acceleration
bias that nothing stops (none). Positions correct the estimate, and through the covariance also the heading or the
velocity: a stream of correlated positions turns the heading, as on the real autopilot. Likewise the compass finds what
a gyroscope does wrong and takes back what that has moved the position by, until a reset of the position cuts what the
covariance knows of it. docs/trial.md compares it with recorded flights.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from sim import Pose
from sim.vehicle.attitude import HeadingWander

VelocitySource: TypeAlias = Literal["wheels", "velocity sensor", "camera", "none"]
"""With "camera" it is what a companion computer sends, and nothing else."""
KEPT_S = 16.0  # PX4 applies fixes that are up to 15 s old
GPS_SIGMA_M = 1.0
STARVED_S = 5.0  # EKF2_NOAID_TOUT: after this long without aiding, a rejected source resets the estimate
VELOCITY_STARVED_S = 1.0  # the same for a velocity alone (EKF2_NOAID_TOUT as shipped); EKF3 then begins anew as well
COVARIANCE_S = 0.1
SPIN_S, SPIN_EVERY_S = 3.0, 20.0  # as wheels were driven to spin on the trial's first drives of that kind
LEVELS_PER_S2 = 0.012
"""By how much an error of a measured velocity changes the estimated bias of the accelerometers within a second, in
m/s^2 for each m/s: EKF2 and EKF3 learn it, as a quarter of the square of what corrects the velocity (0.22 a second).
Recorded PX4 stays within 4.5 m with a velocity that is 3 % wrong, so that none is left."""
FOLLOWS, FOLLOWS_S, FOLLOWS_MPS = 0.47, 4.0, 1.0
"""Share of the angle between the course of GPS and the true one by which the filter turns its heading, within what
time, and above which speed: EKF3 on a recorded drive whose GPS was spoofed to the left by 1 m/s at 3.6 m/s, from -1.4
to -8.5 degrees within 10 s."""
EAST, NORTH, V_EAST, V_NORTH, HEADING, TURN = range(6)
"""Of the covariance; TURN is by what the heading turns wrong, in rad/s: the bias of a gyroscope."""
STATES = TURN + 1


@dataclass(frozen=True)
class OdometryErrors:
    """What is wrong with an autopilot's velocity and heading.

    scale: of the measured speed. heading_deg: the error, clockwise, of the compass. gyro_dps: what the filter has not
    found yet of the gyroscope's bias when GPS is lost: its heading turns by it, by the most after half a minute.
    turns_deg, turns_within_m: see `HeadingWander`, of the compass besides, from `seed`.
    spins: times by which the wheels turn too fast besides for SPIN_S of every SPIN_EVERY_S. slips: the same from
    `slips_from_m` driven on, as on another surface. acceleration_mps2: the forward bias of an accelerometer that no
    velocity aids; wander_mps: by how much that changes the velocity besides within a second, each way, from `seed`.
    """

    source: VelocitySource = "wheels"
    scale: float = 1.0
    spins: float = 1.0
    slips: float = 1.0
    slips_from_m: float = math.inf
    heading_deg: float = 0.0
    gyro_dps: float = 0.0
    turns_deg: float = 0.0
    turns_within_m: float = math.inf
    acceleration_mps2: float = 0.15
    wander_mps: float = 0.0
    seed: int = 0


AS_FLOWN = OdometryErrors(scale=1.03, heading_deg=0.14, gyro_dps=0.11)
"""Of ArduPilot Rover 4.6.3 with wheel encoders, on the recorded drives home at night."""


@dataclass(frozen=True)
class FilterNoise:
    """The noise that a firmware's filter assumes, and its gate; of EKF3 as its parameters are shipped, by default.

    position: of dead reckoning, m^2/s. heading_rad: standard deviation of the heading by gyroscope and compass, and
    compass_s the time within which the compass corrects it; shown_rad, turn_rps: that of heading and bias of the
    gyroscope when GPS is lost. acceleration: m^2/s^3, without a velocity aid. gate_sigmas: of the innovation of a
    stream.
    """

    position: float = 0.02
    heading_rad: float = 0.09
    compass_s: float = 17.7
    shown_rad: float = 0.032
    turn_rps: float = 0.0019
    acceleration: float = 0.0012
    gate_sigmas: float = 5.0


class Estimator:
    """Position in meters east and north, velocity and heading error, moved by odometry and corrected by positions."""

    def __init__(self, pose: Pose, time_s: float, errors: OdometryErrors, noise: FilterNoise) -> None:
        self._errors, self._noise = errors, noise
        self._pose, self._time_s = pose, time_s
        self._past: list[tuple[float, float, float]] = [(time_s, pose.east_m, pose.north_m)]
        self._shift_m = (0.0, 0.0)  # to be added to all that is past: what positions have moved the estimate by
        turns_rad, wander_rng = math.radians(errors.turns_deg), np.random.default_rng([errors.seed, 2])
        self._wander = HeadingWander(turns_rad, errors.turns_within_m, wander_rng)
        self._heading_rad = self._compass_rad
        self._turn_rps = 0.0  # by what the heading turns wrong
        self._bias_mps = (0.0, 0.0)  # of the velocity, where nothing measures it
        self._felt_mps2 = np.zeros(2)  # the bias of the accelerometers, as found
        self._rng = np.random.default_rng(errors.seed)
        self.driven_m = pose.distance_m * errors.scale
        """Distance by the wheel encoders."""
        self._covariance_s = time_s
        self._covariance: NDArray[np.float64] = np.zeros((STATES, STATES))
        self._gps = False
        self._off_m: tuple[float, float] | None = None  # GPS from the truth, while it is fused
        self._is_free = errors.source in ("camera", "none")
        self._fused_s = self._velocity_fused_s = -math.inf
        self._motions: deque[tuple[float, float, float]] = deque(
            maxlen=100
        )  # time, true heading (rad) and speed; for 2 s
        self._restart(GPS_SIGMA_M)

    @property
    def east_m(self) -> float:
        """Estimated meters east of the origin."""
        return self._past[-1][1] + self._shift_m[0]

    @property
    def north_m(self) -> float:
        """Estimated meters north of the origin."""
        return self._past[-1][2] + self._shift_m[1]

    @property
    def sigma_m(self) -> float:
        """Standard deviation of the position, as the filter believes."""
        return math.sqrt((self._covariance[EAST, EAST] + self._covariance[NORTH, NORTH]) / 2)

    @property
    def error_m(self) -> float:
        """Distance from the truth of the last update."""
        return math.hypot(self.east_m - self._pose.east_m, self.north_m - self._pose.north_m)

    @property
    def steering_error_rad(self) -> float:
        """The error, clockwise, of the heading that the autopilot steers by."""
        return self._heading_rad

    @property
    def heading_deg(self) -> float:
        """Reported heading, clockwise from north."""
        return (self._pose.heading_deg + math.degrees(self._heading_rad)) % 360.0

    @property
    def velocity_mps(self) -> tuple[float, float]:
        """Reported velocity, east and north."""
        errors = self._errors
        turned_rad = self._heading_rad if errors.source == "wheels" else 0.0
        heading_rad = math.radians(self._pose.heading_deg) + turned_rad
        speed_mps = self._pose.speed_mps * (1.0 if self._gps or self._is_free else self._scale)
        return (
            speed_mps * math.sin(heading_rad) + self._bias_mps[0],
            speed_mps * math.cos(heading_rad) + self._bias_mps[1],
        )

    @property
    def _compass_rad(self) -> float:
        """The error, clockwise, of the heading by the compass."""
        return math.radians(self._errors.heading_deg) + self._wander.error_rad

    @property
    def _scale(self) -> float:
        errors = self._errors
        slips = errors.slips if self._pose.distance_m >= errors.slips_from_m else 1.0
        return errors.scale * slips * (errors.spins if self._time_s % SPIN_EVERY_S < SPIN_S else 1.0)

    def boot(self) -> None:
        """Begin anew: how far it is from its origin is not known, and what it drove before counts no more."""
        self.driven_m = 0.0
        self._heading_rad = self._compass_rad
        self._bias_mps = (0.0, 0.0)
        self._felt_mps2 = np.zeros(2)
        self._restart(GPS_SIGMA_M)

    def update(self, pose: Pose, time_s: float, gps: tuple[float, float] | None) -> None:
        """Move on to the true `pose` at `time_s`, which must not go back; gps: the receiver's position, if usable."""
        elapsed_s, self._time_s = time_s - self._time_s, time_s
        driven_m = pose.distance_m - self._pose.distance_m
        self.driven_m += driven_m * self._scale
        self._heading_rad += self._wander.move(driven_m)
        self._pose, self._gps = pose, gps is not None
        self._motions.append((time_s, math.radians(pose.heading_deg), pose.speed_mps))
        if gps is not None:
            self._bias_mps = (0.0, 0.0)
            east_m, north_m = gps
            self._follow(east_m - pose.east_m, north_m - pose.north_m, elapsed_s)
            self._restart(GPS_SIGMA_M)
        else:
            self._off_m = None
            self._heading_rad += self._turn_rps * elapsed_s
            self._drift(elapsed_s)
            east_mps, north_mps = self.velocity_mps
            east_m, north_m = self.east_m + east_mps * elapsed_s, self.north_m + north_mps * elapsed_s
        self._past.append((time_s, east_m - self._shift_m[0], north_m - self._shift_m[1]))
        self._predict(time_s)
        if self._past[0][0] < time_s - 2 * KEPT_S:
            self._past = [entry for entry in self._past if entry[0] >= time_s - KEPT_S]

    def reset(self, east_m: float, north_m: float, time_s: float, sigma_m: float = GPS_SIGMA_M) -> None:
        """A hard reset: the vehicle was there at `time_s`; the estimates since then are shifted by the difference."""
        then_east_m, then_north_m = self._at(time_s)
        self.shift(east_m - then_east_m, north_m - then_north_m)
        self._covariance[: NORTH + 1] = self._covariance[:, : NORTH + 1] = 0.0
        self._covariance[EAST, EAST] = self._covariance[NORTH, NORTH] = sigma_m**2

    def fuse(self, east_m: float, north_m: float, time_s: float, sigma_m: float, reset_gate: float = math.inf) -> bool:
        """A gated correction by a measurement of `time_s`; False if the gate rejected it. See STARVED_S.

        reset_gate: an innovation beyond so many standard deviations resets the position at once; no other gate then.
        """
        then_east_m, then_north_m = self._at(time_s)
        innovation = np.array([east_m - then_east_m, north_m - then_north_m])
        variance = self._covariance[:2, :2] + sigma_m**2 * np.eye(2)
        gate = reset_gate if reset_gate < math.inf else self._noise.gate_sigmas
        if innovation @ np.linalg.solve(variance, innovation) <= gate**2:
            self._correct(innovation, self._covariance[:, :2] @ np.linalg.inv(variance), slice(2))
        elif reset_gate < math.inf or not (self._gps or self._time_s - self._fused_s < STARVED_S):
            self.reset(east_m, north_m, time_s, sigma_m)
        else:
            return False
        self._fused_s = self._time_s
        return True

    def fuse_velocity(
        self,
        ahead_mps: float,
        ahead_sigma_mps: float,
        sideways_mps: float,
        time_s: float,
        course_rad: float | None = None,
    ) -> bool:
        """A gated velocity ahead at a time; False if the gate rejected it.

        sideways_mps: one standard deviation of that to the side, which is 0. course_rad: of ahead, clockwise from
        north; None for the filter's own heading. After VELOCITY_STARVED_S without one, it resets the velocity.
        """
        _, true_rad, speed_mps = min(self._motions, key=lambda one: abs(one[0] - time_s))
        heading_rad = true_rad + self._heading_rad if course_rad is None else course_rad
        ahead = np.array([math.sin(heading_rad), math.cos(heading_rad)])
        right = np.array([ahead[1], -ahead[0]])
        true = speed_mps * np.array([math.sin(true_rad), math.cos(true_rad)])
        innovation = ahead_mps * ahead - true - np.array(self._bias_mps)
        noise = ahead_sigma_mps**2 * np.outer(ahead, ahead) + sideways_mps**2 * np.outer(right, right)
        variance = self._covariance[2:4, 2:4] + noise
        if innovation @ np.linalg.solve(variance, innovation) <= self._noise.gate_sigmas**2:
            self._correct(innovation, self._covariance[:, 2:4] @ np.linalg.inv(variance), slice(2, 4))
            since_s = min(self._time_s - self._velocity_fused_s, VELOCITY_STARVED_S)
            self._felt_mps2 -= LEVELS_PER_S2 * since_s * innovation
        elif self._gps or self._time_s - self._velocity_fused_s < VELOCITY_STARVED_S:
            return False
        else:
            self._bias_mps = self._bias_mps[0] + float(innovation[0]), self._bias_mps[1] + float(innovation[1])
            self._covariance[2:4] = self._covariance[:, 2:4] = 0.0
            self._covariance[2:4, 2:4] = noise
        self._velocity_fused_s = self._time_s
        return True

    @property
    def aided_s(self) -> float:
        """When anything but GPS measured its position or velocity last: now, with a sensor of its own."""
        return max(self._fused_s, self._velocity_fused_s) if self._is_free else self._time_s

    @property
    def is_aided(self) -> bool:
        """Whether anything besides GPS measures its velocity now."""
        return not self._is_free or self._time_s - self._velocity_fused_s < STARVED_S

    def _correct(self, innovation: NDArray[np.float64], gain: NDArray[np.float64], measured: slice | int) -> None:
        """Apply a Kalman gain (STATES, n) to the state and to its covariance; measured: the n states."""
        change = gain @ innovation
        self._covariance = self._covariance - gain @ self._covariance[measured].reshape(len(innovation), STATES)
        self.shift(float(change[EAST]), float(change[NORTH]))
        self._bias_mps = self._bias_mps[0] + float(change[V_EAST]), self._bias_mps[1] + float(change[V_NORTH])
        self._heading_rad += float(change[HEADING])
        self._turn_rps += float(change[TURN])

    def _restart(self, sigma_m: float) -> None:
        """The state while GPS is fused: the velocity is known, the heading as well as GPS shows it."""
        noise = self._noise
        self._turn_rps = math.radians(self._errors.gyro_dps)
        self._covariance = np.diag([sigma_m**2, sigma_m**2, 0.01, 0.01, noise.shown_rad**2, noise.turn_rps**2])
        self._covariance[HEADING, TURN] = self._covariance[TURN, HEADING] = noise.shown_rad * noise.turn_rps
        if not self._is_free:
            self._covariance[V_EAST, V_EAST] = self._covariance[V_NORTH, V_NORTH] = 0.0

    def _follow(self, east_m: float, north_m: float, elapsed_s: float) -> None:
        """Turn the heading with a GPS that moves otherwise than the vehicle; meters of GPS from the truth."""
        before, self._off_m = self._off_m, (east_m, north_m)
        if before is None or elapsed_s <= 0:
            return
        sin, cos = math.sin(math.radians(self._pose.heading_deg)), math.cos(math.radians(self._pose.heading_deg))
        east_mps, north_mps = (east_m - before[0]) / elapsed_s, (north_m - before[1]) / elapsed_s
        ahead_mps, right_mps = self._pose.speed_mps + east_mps * sin + north_mps * cos, east_mps * cos - north_mps * sin
        turned_rad = math.atan2(right_mps, ahead_mps) if self._pose.speed_mps > FOLLOWS_MPS else 0.0
        unfollowed_rad = self._compass_rad + FOLLOWS * turned_rad - self._heading_rad
        self._heading_rad += unfollowed_rad * min(1.0, elapsed_s / FOLLOWS_S)

    def _drift(self, elapsed_s: float) -> None:
        if self._is_free:
            heading_rad = math.radians(self._pose.heading_deg)
            gained_mps, felt_mps = self._errors.acceleration_mps2 * elapsed_s, self._felt_mps2 * elapsed_s
            east_mps, north_mps = self._errors.wander_mps * math.sqrt(elapsed_s) * self._rng.standard_normal(2)
            self._bias_mps = (
                self._bias_mps[0] + gained_mps * math.sin(heading_rad) + float(east_mps) - felt_mps[0],
                self._bias_mps[1] + gained_mps * math.cos(heading_rad) + float(north_mps) - felt_mps[1],
            )

    def _predict(self, time_s: float) -> None:
        """Predict the covariance up to `time_s`, in steps of COVARIANCE_S."""
        step_s = time_s - self._covariance_s
        if step_s < COVARIANCE_S or self._gps:
            self._covariance_s = time_s if self._gps else self._covariance_s
            return
        self._covariance_s = time_s
        moves, noise = np.eye(STATES), np.zeros(STATES)
        moves[HEADING, TURN] = step_s
        if self._is_free:
            moves[EAST, V_EAST] = moves[NORTH, V_NORTH] = step_s
            noise[V_EAST] = noise[V_NORTH] = self._noise.acceleration * step_s
        else:
            noise[EAST] = noise[NORTH] = self._noise.position * step_s
        if self._errors.source == "wheels":
            east_mps, north_mps = self.velocity_mps
            moves[EAST, HEADING], moves[NORTH, HEADING] = north_mps * step_s, -east_mps * step_s
            noise[HEADING] = self._noise.heading_rad**2 / self._noise.compass_s * step_s
        self._covariance = moves @ self._covariance @ moves.T + np.diag(noise)
        self._fuse_compass(step_s)

    def _fuse_compass(self, step_s: float) -> None:
        """The compass turns the heading, and moves the position by what the heading's error had done to it."""
        innovation = self._compass_rad - self._heading_rad
        variance = self._covariance[HEADING, HEADING] + self._noise.heading_rad**2 * self._noise.compass_s / step_s
        self._correct(np.array([innovation]), self._covariance[:, [HEADING]] / variance, HEADING)

    def shift(self, east_m: float, north_m: float) -> None:
        """Move the estimate, also of the past."""
        self._shift_m = self._shift_m[0] + east_m, self._shift_m[1] + north_m

    def _at(self, time_s: float) -> tuple[float, float]:
        """The estimate at a time of the past."""
        index = min(max(bisect_right(self._past, (time_s, math.inf, math.inf)), 1), len(self._past) - 1)
        (t0, e0, n0), (t1, e1, n1) = self._past[max(index - 1, 0)], self._past[index]
        share = min(max((time_s - t0) / (t1 - t0), 0.0), 1.0) if t1 > t0 else 1.0
        return e0 + share * (e1 - e0) + self._shift_m[0], n0 + share * (n1 - n0) + self._shift_m[1]
