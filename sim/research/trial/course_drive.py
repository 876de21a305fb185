"""One drive of a course: what goes wrong, and what the drive was worth by the course's rules."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import Config, GatesConfig
from edge.journal.records import FrameUsed, PlaceFix
from edge.telemetry.encoders import EXTERNAL_POSITION_ESTIMATE
from edge.telemetry.link import Link
from edge_plugins.mapping import MappingConfig
from edge_plugins.motion import MotionConfig
from edge_plugins.motion.camera_motion import CameraMotion
from edge_plugins.motion.height import WINDOWS_MOST
from sim import ORIGIN_ALT_M, Pose, geodetic
from sim.journal import records_of
from sim.research.trial.course import Course, CourseDraft, drafted
from sim.research.trial.course_map import build_map
from sim.research.trial.course_rules import WRONG_M, CourseRun, failures, within_protection_level
from sim.trial.records import Array, TrialRun
from sim.trial.run import TrialDrive
from sim.trial.simulation import FRAME_S, STEP_S, NullLink, Simulation
from sim.trial.views import RoadLibrary, TrialCamera, View
from sim.vehicle.autopilot import BOOTS_S, SimulatedAutopilot
from sim.vehicle.firmware import FIRMWARES
from sim.vehicle.gps import NO_FIX, GpsReport
from sim.vehicle.position_inputs import east_north_m
from sim.world.scenario import Scenario
from sim.world.sensor import CAMERA_HIGH_M

COMPANION_OFF_M, COMPANION_SIGMA_M = 3.0, 5.0  # of its positions: wrong in each direction, and as they say


def drive(course: Course, seed: int, length_m: float, world: int, folder: Path, library: RoadLibrary) -> CourseRun:
    """Drive a course once with the daemon and once without; its journal stays in `folder`."""
    run = CourseDrive(drafted(course, seed, length_m, world), seed, folder, library).run()
    assert isinstance(run, CourseRun)
    return run


NEEDED_M = 12.0
"""Of an autopilot's error, from which a reset by sequence matches is needed: three of their standard deviations."""


class CourseSimulation(Simulation):
    """A vehicle that something goes wrong with."""

    _draft: CourseDraft

    def __init__(self, draft: CourseDraft, link: Link, seed: int, driven: Callable[[float], object]) -> None:
        super().__init__(draft, link, seed, driven)
        late = round(draft.late_s / FRAME_S)
        shown_m = draft.shown_m if draft.motion != "off" or draft.late_s or draft.keypoints else None
        self._front = TrialCamera(lambda: self.now_ns, np.random.default_rng([seed, 9]), late, shown_m=shown_m)
        if draft.keypoints:
            self.rear = TrialCamera(lambda: self.now_ns, np.random.default_rng([seed, 12]), shown_m=draft.shown_m)
        if not draft.steers:
            self.driver.belief, self.autopilot.base_mode = None, 0
        self.autopilot.loses = self._loses
        self.autopilot.has_script = draft.doubted_gps == "send"
        self.autopilot.timesync_off_s = draft.clock_off_s
        self._companion_due_s, self._restarts_s = draft.companion_s, draft.restarted_s or math.inf
        self.is_heard = True
        """Whether the daemon runs."""
        self._sets_origin = isinstance(link, NullLink)
        """Which somebody else does then."""
        self._companion_rng = np.random.default_rng([seed, 15])

    def _autopilot(self, link: Link, pose: Callable[[], Pose], **others: Any) -> SimulatedAutopilot:
        draft = self._draft
        return super()._autopilot(
            link,
            pose,
            firmware=draft.firmware,
            gps=draft.has_gps,
            has_origin=draft.has_gps,
            **{"booted_before_s": draft.booted_before_s, **others},
        )

    def step(self) -> None:
        """Move everything on by STEP_S."""
        super().step()
        if self.time_s() >= self._restarts_s:
            self._restarts_s = math.inf
            self.autopilot.reboot(BOOTS_S)
        if self.time_s() >= self._companion_due_s:
            self._companion_due_s += self._draft.companion_s
            self._hear_companion()
        if self._sets_origin and self._draft.origin_m is not None:
            self.autopilot.set_origin(*self._draft.origin_m)

    def _hear_companion(self) -> None:
        """Another computer on the vehicle resets the autopilot's position."""
        pose, off_m = self.driver.pose, self._companion_rng.normal(0.0, COMPANION_OFF_M, 2)
        lat_deg, lon_deg = geodetic(pose.east_m + off_m[0], pose.north_m + off_m[1])
        values = self.autopilot.boot_s, 0.0, COMPANION_SIGMA_M, math.nan
        place = round(lat_deg * 1e7), round(lon_deg * 1e7), math.nan
        command = EXTERNAL_POSITION_ESTIMATE
        self.autopilot.handle(
            mavlink.MAVLink_command_int_message(1, 1, mavlink.MAV_FRAME_GLOBAL, command, 0, 0, *values, *place)
        )

    def _show(self, view: View) -> None:
        frozen_s = self._draft.frozen_s
        view = view._replace(route_m=self._draft.seen_m(view.route_m))
        is_unseen = self._draft.unseen_s[0] <= self.time_s() < self._draft.unseen_s[1]
        if self._draft.maps_live or not is_unseen:
            self._front.expose(view, frozen=frozen_s[0] <= self.time_s() < frozen_s[1])
        if self._draft.maps_live and not is_unseen:
            self.rear.expose(view.of_rear())

    def gps(self, time_s: float) -> GpsReport:
        """The receiver's report, where there is one."""
        return super().gps(time_s) if self._draft.has_gps else NO_FIX

    def _loses(self, message: Any, outgoing: bool) -> bool:
        if not self.is_heard:
            return True
        silence = self._draft.silence_s
        if silence and outgoing and silence[0] <= self.time_s() < silence[1]:
            return bool(message.get_type() != "HEARTBEAT")
        return self._draft.loses(self.time_s(), message, outgoing)

    def fall_silent(self, until_s: float) -> None:
        """The daemon is dead until a moment of the drive, or its end."""
        if self.ended:
            return
        self._link.receive()  # what it said when its parts were closed; a daemon that is killed says nothing
        self.is_heard = False
        while self.time_s() < until_s and not self.ended:
            self.take(STEP_S)
        self.is_heard = True


class CourseDrive(TrialDrive):
    """A course, driven once with the daemon and once without."""

    draft: CourseDraft
    _map_errors_m: Array | None = None

    def make_map(self, path: Path) -> None:
        """Before the drive, unless it is made on the way."""
        if self.draft.maps_live:
            path.mkdir()
        else:
            self._map_errors_m = build_map(self.draft, path, self.network, self.library, self.seed)

    def simulation(self, link: Link, driven: Callable[[float], object] = lambda meters: None) -> CourseSimulation:
        """The vehicle at its start."""
        return CourseSimulation(self.draft, link, self.seed, driven)

    def config(self, connection: str, map_path: Path) -> Config:
        """What the course asks for."""
        config, draft = super().config(connection, map_path), self.draft
        origin = (*geodetic(*draft.origin_m), ORIGIN_ALT_M) if draft.origin_m else ()
        replace, mapping = msgspec.structs.replace, config.of(MappingConfig)
        if not draft.maps_live:
            mapping = MappingConfig()
        return replace(
            config,
            camera=replace(config.camera, kind="stream" if draft.late_s else "sim", fov_deg=Scenario().fov_deg),
            gates=GatesConfig(doubted_gps=draft.doubted_gps),
            telemetry=replace(config.telemetry, emit=draft.emit, origin=origin, journal_frames=True),
            plugins={**config.plugins, "motion": MotionConfig(use=draft.motion), "mapping": mapping},
        )

    def run_daemon(self, simulation: Simulation, config: Config, until_s: float = math.inf) -> None:
        """With the camera's height as if it was learned before; twice where it is killed."""
        assert isinstance(simulation, CourseSimulation)
        draft = self.draft
        if draft.height is not None:
            heights_m = (CAMERA_HIGH_M * draft.height,) * WINDOWS_MOST
            height = msgspec.structs.replace(CameraMotion(config).height.kept, heights_m=heights_m)
            self.journal.with_suffix(".height").write_bytes(msgspec.json.encode(height))
        if draft.killed_s is not None:
            super().run_daemon(simulation, config, draft.killed_s)
            simulation.fall_silent(draft.killed_s + draft.down_s)
        super().run_daemon(simulation, config)

    def judged(self, simulation: Simulation, alone: Simulation) -> CourseRun:
        """Both drives, by the truth and by the course's rules."""
        autopilot = simulation.autopilot
        texts = tuple(
            (simulation.time_s(item.time_s), item.message.severity, item.message.text)
            for item in autopilot.received
            if item.message.get_type() == "STATUSTEXT"
        )
        run = super().judged(simulation, alone)
        told = CourseRun(
            **vars(run),
            expected=self._expected(run.track.along_m, run.track.gps) & self._is_needed(run.track.error_m),
            after_m=np.array([item.error_after_m for item in (*autopilot.inputs.resets, *autopilot.inputs.fused)]),
            texts=texts,
            source_set=autopilot.inputs.source_set,
            lane_m=self._from_lane_m(run),
            **self._faced(simulation),
        )
        return dataclasses.replace(told, failures=failures(told, (*self.draft.rules, within_protection_level)))

    def _faced(self, simulation: Simulation) -> dict[str, Any]:
        """How far headings are off, and how many frames were believed, by the journal: fields of CourseRun."""
        rows = np.array(simulation.rows)

        def true(stamp_ns: int, *columns: int) -> list[float]:
            return [float(np.interp(simulation.time_s(stamp_ns / 1e9), rows[:, 0], rows[:, one])) for one in columns]

        turned_deg = [
            math.remainder(one.heading_deg - true(one.stamp_ns, 7)[0], 360.0)
            for one in records_of(self.journal, PlaceFix)
            if one.points and one.heading_deg is not None
        ]
        frames = list(records_of(self.journal, FrameUsed))

        def off(one: FrameUsed | PlaceFix) -> list[tuple[float, float]]:
            if one.lat_deg is None or one.lon_deg is None:
                return []
            there_m = east_north_m(one.lat_deg, one.lon_deg)
            return [(simulation.time_s(one.stamp_ns / 1e9), math.dist(there_m, true(one.stamp_ns, 3, 4)))]

        believed = [found for one in frames if one.accepted for found in off(one)]
        known = believed + [found for one in records_of(self.journal, PlaceFix) for found in off(one)]
        return {
            "turned_deg": np.array(turned_deg),
            "used": len(frames),
            "believed": len(believed),
            "wrong": sum(off_m > WRONG_M for _, off_m in believed),
            "known": np.array(known).reshape(-1, 2),
            "set_down_m": float(np.flatnonzero(self.draft.way.carried).max(initial=-1) + 1),
        }

    def _from_lane_m(self, run: TrialRun) -> Array:
        """How far positions are from where the map would have the vehicle, whose errors are those of its places."""
        if self._map_errors_m is None or len(self.draft.map) != 1:
            return np.empty((0, 2))
        way, at = self.draft.way, self._map_errors_m.T
        along_m = np.interp(run.sent.of_s, run.track.time_s, run.track.along_m)
        heading_rad = np.array([way.at(one)[2] for one in along_m.tolist()])
        route_m = np.interp(along_m, np.arange(len(way.route_m)), way.route_m)
        east_m, north_m = (np.interp(route_m, at[0], off_m) for off_m in at[1:])
        sin, cos = np.sin(heading_rad), np.cos(heading_rad)
        found: Array = run.sent.off_m - np.column_stack([east_m * sin + north_m * cos, east_m * cos - north_m * sin])
        return found

    def _is_needed(self, error_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Where the autopilot needs a position: always, if it weighs each; to be reset only once it is far off."""
        firmware = FIRMWARES[self.draft.firmware]
        return np.full(len(error_m), firmware.fuses_sensor or firmware.fuses_poses) | (error_m > NEEDED_M)

    def _expected(self, along_m: NDArray[np.float64], gps: NDArray[np.bool_]) -> NDArray[np.bool_]:
        draft, way = self.draft, self.draft.way
        row = along_m.astype(int).clip(0, len(way.route_m) - 1)
        expected = ~gps & (np.array(way.roads, object)[way.road[row]] == draft.home) & ~way.carried[row]
        route_m = way.route_m[row]
        known = [(stretch.start_m <= route_m) & (route_m < stretch.end_m) for stretch in draft.map if stretch.is_true]
        expected &= np.any(known, axis=0) if known else False
        for start_m, end_m in draft.unsent:
            expected &= ~((along_m >= start_m) & (along_m < end_m))
        return np.asarray(expected, bool)
