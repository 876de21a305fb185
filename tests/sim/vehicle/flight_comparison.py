"""The simulated autopilot's estimate against recorded flights: the same truth and the same positions, replayed.

`python -m tests.sim.vehicle.flight_comparison` prints the table that docs/trial.md sums up.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.telemetry.encoders import EXTERNAL_POSITION_ESTIMATE
from sim import Pose
from sim.research.trial.recorded_drive import Columns, read_columns, read_messages
from sim.vehicle.estimator import AS_FLOWN, Estimator, FilterNoise, OdometryErrors
from sim.vehicle.firmware import FIRMWARES
from sim.vehicle.position_inputs import InputContext, PositionInputs

STEP_S = 0.1
SLOW, RIGHT, FAST = (replace(AS_FLOWN, scale=scale) for scale in (0.97, 0.999, 1.027))
VELOCITY_SENSOR = OdometryErrors("velocity sensor", 1.03)
EVV_NOISE = FilterNoise(position=2e-3, gate_sigmas=3.0)
"""Of PX4 with the EKF2_EVV_NOISE of firmware_config/px4_velocity_aid.params, 0.5 instead of 0.1."""
FLIGHTS: dict[str, OdometryErrors] = {
    "night_auto_daemon_off": AS_FLOWN,
    "vision_auto_daemon_off": SLOW,
    "px4_aided_mission_daemon_off": VELOCITY_SENSOR,
    "night_auto_a": AS_FLOWN,
    "night_auto_b": AS_FLOWN,
    "night_auto_no_gps": AS_FLOWN,
    "night_person": AS_FLOWN,
    "dusk_auto": AS_FLOWN,
    "dusk_person": AS_FLOWN,
    "px4_aided_mission": VELOCITY_SENSOR,
    "px4_aided_person": VELOCITY_SENSOR,
    "px4_no_velocity_aid_person": OdometryErrors("none"),
    "px4_external_position_person": OdometryErrors("none"),
    "px4_rover_mission": OdometryErrors("none"),
}


@dataclass(frozen=True)
class Comparison:
    """Errors (N, 2), east and north, of the recorded and of the simulated autopilot from the loss of GPS on.

    heading_rad: (N,), in truth. fixes: how many positions it got.
    """

    real: NDArray[np.float64]
    simulated: NDArray[np.float64]
    heading_rad: NDArray[np.float64]
    fixes: int

    @property
    def real_m(self) -> NDArray[np.float64]:
        """Meters (N,)."""
        return np.asarray(np.hypot(*self.real.T))

    @property
    def simulated_m(self) -> NDArray[np.float64]:
        """Meters (N,)."""
        return np.asarray(np.hypot(*self.simulated.T))

    @property
    def mean_ratio(self) -> float:
        """Mean error of the simulated autopilot over that of the real one."""
        return float(self.simulated_m.mean() / self.real_m.mean())

    @property
    def end_ratio(self) -> float:
        """The same of the errors at the end of the drive."""
        return float(self.simulated_m[-1] / self.real_m[-1])


def compare(folder: Path, errors: OdometryErrors, noise: FilterNoise | None = None) -> Comparison:
    """Replay one recorded flight from the loss of GPS on; noise: of the filter, where not that of its firmware."""
    truth, own = (read_columns(folder / f"{name}.csv.gz") for name in ("truth", "autopilot_position"))
    is_px4 = folder.name.startswith("px4")
    messages = [(at_s, message) for at_s, _, message in read_messages(folder / "telem2.tlog.gz")]
    mono_of_boot_s = float(np.median(own["mono_s"] - own["boot_ms"] / 1e3))
    unix_of_boot_s = np.median(
        [at - m.time_boot_ms / 1e3 for at, m in messages if m.get_type() == "LOCAL_POSITION_NED"]
    )
    messages = [(at - unix_of_boot_s + mono_of_boot_s, message) for at, message in messages]
    times_s = np.arange(truth["mono_s"][0], truth["mono_s"][-1], STEP_S)
    lost_s = _gps_lost_s(messages, times_s, truth)
    poses = _poses(truth, times_s, course_for_heading=is_px4)
    at = int(np.searchsorted(times_s, lost_s))
    own_m = np.stack([np.interp(times_s, own["mono_s"], own[name]) for name in ("east_m", "north_m")])
    firmware = FIRMWARES["px4" if is_px4 else "ardupilot"]
    estimate = Estimator(poses[at], times_s[at], errors, noise or firmware.noise)
    estimate.reset(float(own_m[0, at]), float(own_m[1, at]), float(times_s[at]))
    inputs = PositionInputs(firmware, estimate)
    positions = [(time_s, message) for time_s, message in messages if time_s > lost_s and _is_position(message)]
    believed, fixes = [], len(positions)
    for time_s, pose in zip(times_s[at + 1 :], poses[at + 1 :], strict=True):
        estimate.update(pose, float(time_s), None)
        while positions and positions[0][0] <= time_s:
            sent_s, message = positions.pop(0)
            _give(inputs, message, sent_s, lost_s - 1.0)
        believed.append((estimate.east_m, estimate.north_m))
    true_m = np.array([(pose.east_m, pose.north_m) for pose in poses])[at + 1 :]
    heading_rad = np.radians([pose.heading_deg for pose in poses[at + 1 :]])
    return Comparison(own_m.T[at + 1 :] - true_m, np.array(believed) - true_m, heading_rad, fixes)


def _give(inputs: PositionInputs, message: Any, now_s: float, lost_s: float) -> None:
    kind = message.get_type()
    moment = InputContext(now_s, message.param1 if kind == "COMMAND_INT" else 0.0, lost_s, origin_m=(0.0, 0.0))
    if kind == "COMMAND_INT":
        inputs.command(message, moment)
    else:
        inputs.sensor(message, moment)


def _is_position(message: Any) -> bool:
    kind = message.get_type()
    is_fix = kind == "COMMAND_INT" and message.command == EXTERNAL_POSITION_ESTIMATE
    return bool(is_fix or kind == "GLOBAL_POSITION_SENSOR")


def _gps_lost_s(messages: list[tuple[float, Any]], times_s: NDArray[np.float64], truth: Columns) -> float:
    """When GPS was lost; where there was none, when the vehicle set off."""
    had_s = [
        time_s
        for time_s, message in messages
        if message.get_type() == "GPS_RAW_INT" and message.fix_type >= mavlink.GPS_FIX_TYPE_3D_FIX
    ]
    moved = np.hypot(truth["east_m"] - truth["east_m"][0], truth["north_m"] - truth["north_m"][0]) > 1.0
    started_s = float(truth["mono_s"][np.argmax(moved)])
    return max([time_s for time_s in had_s if time_s < times_s[-1]], default=started_s)


def _poses(truth: Columns, times_s: NDArray[np.float64], *, course_for_heading: bool) -> list[Pose]:
    """The true poses. course_for_heading: a multicopter's velocity does not follow its nose."""
    east_m, north_m = (np.interp(times_s, truth["mono_s"], truth[name]) for name in ("east_m", "north_m"))
    kernel = np.ones(5) / 5
    v_east, v_north = (np.convolve(np.gradient(values, STEP_S), kernel, "same") for values in (east_m, north_m))
    speeds = np.hypot(v_east, v_north)
    headings = np.interp(times_s, truth["mono_s"], np.unwrap(np.radians(truth["heading_deg"])))
    if course_for_heading:
        headings = np.where(speeds > 0.5, np.arctan2(v_east, v_north), headings)
    driven = np.cumsum(speeds) * STEP_S
    return [
        Pose(*map(float, values))
        for values in zip(east_m, north_m, np.degrees(headings) % 360, speeds, driven, strict=True)
    ]


def table(flights: Path) -> str:
    """The table, in Markdown."""
    lines = [
        "| drive | positions received | real: mean, at the end | simulated: mean, at the end | ratio of the means |",
        "|---|---|---|---|---|",
    ]
    for name, errors in FLIGHTS.items():
        found = compare(flights / name, errors)
        real, simulated = found.real_m, found.simulated_m
        lines.append(
            f"| {name} | {found.fixes or 'none'} | {real.mean():.1f} m, {real[-1]:.1f} m"
            f" | {simulated.mean():.1f} m, {simulated[-1]:.1f} m | {found.mean_ratio:.2f} |"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    print(table(Path(__file__).parents[4] / "shared" / "flights"))
