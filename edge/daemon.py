"""The daemon: moves frames through the parts that the config names (`opened_parts`) until it is stopped.

camera -> usable, at a new place? -> recognizer -> estimator -> event -> journal, people, plug-ins
                                                             -> position -> autopilot

Read `Daemon.turn` first: each step of it is one of the methods below, in the same order.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from msgspec.structs import replace
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.camera import Frame
from edge.config import Config
from edge.errors import MapError, SetupError
from edge.feed.sampling import Sampler
from edge.health.health import HealthInputs
from edge.health.monitor import notify
from edge.journal.records import CameraDiffers, PlaceFix, Stopped
from edge.localization import AGREE_SIGMAS, Discontinuity, MapUpdate, OdometryUpdate, events
from edge.localization.dead_reckoning import Odometry, TurnAround
from edge.localization.place_fix import frame_used, untracked_fix
from edge.map_verification import MapVerification
from edge.opened_parts import OpenedParts
from edge.plugin import UsedFrame
from edge.reference_map import MapSet
from edge.sequence import MotionPrior, PlaceMatch, SearchRegion

TURN_S = 0.02  # at most this long between reads of the MAVLink port
log = logging.getLogger(__name__)


@dataclass
class _NewestFrames:
    """What the last one took, and at the newest keypoint pose: what was driven, and meters right of the map's drive."""

    took_s: float = 0.0
    posed: tuple[float, float] | None = None


class Daemon:
    """The running parts; `turn` moves at most one frame from the camera to the autopilot."""

    def __init__(self, parts: OpenedParts) -> None:
        self.parts = parts
        self._clock_ns, self._autopilot = parts.clock_ns, parts.autopilot
        self._recognizer, self._drive = parts.recognizer, parts.drive
        self._sampler = Sampler(parts.config.sampling)
        self._turn_around = TurnAround()
        self._distance_gaps = 0
        self._warned_of: set[str] = set()
        self._newest = _NewestFrames()

    def turn(self) -> bool:
        """One turn of the loop; False when the camera has come to its end (a feed or the simulator)."""
        parts = self.parts
        self._autopilot.poll()
        waits_ns = self._clock_ns()
        frame = parts.camera.take(TURN_S)
        waited_s = (self._clock_ns() - waits_ns) / 1e9
        frame = None if frame is None else self._dated(frame)
        is_usable = frame is not None and self._is_usable(frame)
        is_used = frame is not None and is_usable and self._process_if_place(frame)
        if not (is_usable or parts.verification.checksums.is_done):
            self._check_maps(self._recognizer.matcher.search.folders_in_use)
        if self._update_health():
            self._reset()
        self._publish_position()
        self._compare_with_gps()
        spare_s = None if is_used else waited_s
        parts.plugins.each(lambda plugin: plugin.turn(spare_s))
        parts.monitor.feed_watchdog()
        return not parts.camera.ended

    def _dated(self, frame: Frame) -> Frame:
        """A frame with the stamp of its exposure; where that is known anew, what was recognized was at wrong times."""
        pictures, vehicle, now_ns = self.parts.pictures, self._autopilot.vehicle, self._clock_ns()
        before_ns = pictures.age_ns
        frame = pictures.dated(frame, vehicle.motion.speed_mps(now_ns), vehicle.position(now_ns))
        if pictures.age_ns != before_ns:
            late_s = pictures.age_ns / 1e9
            self._autopilot.status_text(f"pictures {late_s:.1f} s late: corrected", mavlink.MAV_SEVERITY_WARNING)
            self._reset()
        return frame

    def _is_usable(self, frame: Frame) -> bool:
        """Whether a frame may be used: its picture shows something, and it is not the first after a gap."""
        parts = self.parts
        is_usable = parts.pictures.is_usable(frame, self._autopilot.vehicle.motion.speed_mps(self._clock_ns()))
        return is_usable and not (parts.device and parts.monitor.is_first_after_gap(parts.device.health))

    def _process_if_place(self, frame: Frame) -> bool:
        """Process a frame that shows a new place, by [sampling]; False if it does not."""
        self.parts.plugins.show(frame)
        distance_m = self._autopilot.vehicle.motion.distance_m(frame.stamp_ns)
        is_place = self._sampler.is_place(frame.stamp_ns, distance_m)
        if is_place:
            self._process_frame(frame, distance_m)
        elif self._recognizer.may_verify_again(frame.stamp_ns, distance_m):
            self._verify_again(frame, distance_m)
        return is_place

    def _process_frame(self, frame: Frame, distance_m: float | None) -> None:
        """Recognize the place of a frame, follow the vehicle, and publish both."""
        self.parts.times.start()
        began_ns, missed = self._clock_ns(), self._sampler.missed
        displacement = self._autopilot.vehicle.motion.displacement(frame.stamp_ns)
        if self._turn_around.add(displacement):
            self._recognizer.begin_way_back()
        reckoned = self._drive.dead_reckoning_position(displacement)
        moved_m = None if displacement is None else (displacement.east_m, displacement.north_m)
        travel = MotionPrior(distance_m, missed, self._search_area(), self._turn_around.course_rad, reckoned, moved_m)
        match = self._recognize(frame, travel)
        self._estimate(frame.stamp_ns, match, displacement, missed)
        self._publish_frame(frame, match, distance_m, missed)
        self._grow_maps()
        self._warn_without_odometer()
        self._warn_of_camera()
        self.parts.times.lap("telemetry")
        now_ns = self._clock_ns()
        self._newest.took_s = (now_ns - began_ns) / 1e9
        # Only here: a file that is written anew while nothing is seen would make old statistics look fresh.
        self.parts.warm_start.keep_if_due(now_ns)

    def _verify_again(self, frame: Frame, distance_m: float | None) -> None:
        """Verify a further picture while the vehicle stands, and nothing is believed; publish the place it shows."""
        displacement = self._autopilot.vehicle.motion.displacement(frame.stamp_ns)
        reckoned = self._drive.dead_reckoning_position(displacement)
        travel = MotionPrior(distance_m, 0, self._search_area(), self._turn_around.course_rad, reckoned)
        match = self._recognize(frame, travel, again=True)
        if match is not None:
            self._estimate(frame.stamp_ns, match, displacement, 0)
            self._publish_place(frame, match)

    def _estimate(self, stamp_ns: int, match: PlaceMatch | None, displacement: Odometry | None, missed: int) -> None:
        """What follows from the answer to a frame: for the vehicle, and for GPS."""
        self._autopilot.report_own()
        now_ns = self._clock_ns()
        vehicle, in_line = self._autopilot.vehicle, self._recognizer.is_in_line
        frame = events.ImageProcessed(
            stamp_ns,
            match,
            motion=displacement,
            without_gps=vehicle.velocity.without_gps.at(stamp_ns),
            gps=vehicle.gps_fix(stamp_ns, now_ns),
            missed=missed,
            in_line=in_line,
            timestamp_sigma_s=self.parts.pictures.stamp_sigma_s,
        )
        self._drive.update(now_ns, frame)
        driven_m = vehicle.motion.driven_m(now_ns)
        if match is not None and match.seen is not None and driven_m is not None:
            self._newest.posed = driven_m, match.seen.right_m * (-1 if self.parts.config.camera.view == "rear" else 1)
        if in_line:
            self._autopilot.judge_gps()

    def _recognize(self, frame: Frame, travel: MotionPrior, *, again: bool = False) -> PlaceMatch | None:
        """The recognizer's answer to a frame; a believed one only if the maps behind it are not damaged.

        again: from the spot of the last one.
        """
        if self._distance_gaps != self._autopilot.vehicle.motion.gaps:
            self._distance_gaps = self._autopilot.vehicle.motion.gaps
            self._recognizer.restart_odometer()
        try:
            observe = self._recognizer.verify_again if again else self._recognizer.observe
            match = observe(frame.image, frame.stamp_ns, travel)
        except MapError:
            left = self.parts.verification.without_cut(self._recognizer.map_set)
            if left is self._recognizer.map_set:
                raise
            self._exclude(left)
            return None
        if self._recognizer.was_carried:
            self._drive.update(self._clock_ns(), Discontinuity("carried"))
        believed = [] if match is None else [one for one in (match, match.alone) if one.accepted]
        return match if all(self._is_verified(one) for one in believed) else None

    def _search_area(self) -> SearchRegion | None:
        """Where the autopilot may be, None where it does not know or nobody knows how well."""
        own, sigma_m = self._autopilot.vehicle.position(self._clock_ns()), self._drive.state.own_sigma_m
        if own is None or sigma_m is None:
            return None
        return SearchRegion(
            own.lat_deg, own.lon_deg, max(self.parts.config.map.search_radius_m, AGREE_SIGMAS * sigma_m)
        )

    def _is_verified(self, match: PlaceMatch) -> bool:
        """Check the maps behind a match before anything is published of it; False if one had to be excluded, or if the
        disk is too slow to say so now.
        """
        behind = self._recognizer.map_set.folders_behind(match.place_index, self.parts.config.sequence_frames)
        verification = self.parts.verification
        while not verification.checksums.is_verified(behind):
            if not (self._check_maps(behind, waits=True) and verification.may_wait):
                return False
            self.parts.monitor.feed_watchdog()
        return True

    def _check_maps(self, first: Sequence[Path], *, waits: bool = False) -> bool:
        """Check a further piece of the maps, some of them first; False if one is damaged, and excluded from now on."""
        maps = self.parts.verification.check_next(self._recognizer.map_set, first, waits=waits)
        if maps is not None:
            self._exclude(maps)
        return maps is None

    def _exclude(self, left: MapSet) -> None:
        self._recognizer.use_maps(left)
        self._use_maps()

    def reopen_maps(self) -> None:
        """Use the maps as they are on the disk now, from the next frame on; those so far where they cannot be used."""
        parts = self.parts
        try:
            self._recognizer.reopen_maps(parts.plugins.newest_map())
        except SetupError as error:
            log.warning("%s; the maps so far stay in use", error)
            self._autopilot.status_text("Lookback: new map is not usable", mavlink.MAV_SEVERITY_WARNING)
            return
        maps = self._recognizer.map_set
        parts.verification = MapVerification(maps, parts.record)
        self._use_maps()
        log.info("maps opened again: %s", maps)
        self._autopilot.status_text(f"Lookback: new map, {maps.index.places} places", mavlink.MAV_SEVERITY_INFO)

    def _use_maps(self) -> None:
        """Those that the recognizer searches: nothing is known of where the vehicle is on them."""
        self._drive.update(self._clock_ns(), MapUpdate(self._recognizer.map_set))

    def _grow_maps(self) -> None:
        """Search what of this drive's map lies far enough behind by now."""
        maps = self.parts.plugins.grown_maps(self._recognizer.map_set)
        if maps is not None:
            self._recognizer.grow_maps(maps)
            self._drive.update(self._clock_ns(), MapUpdate(maps, has_grown=True))

    def _publish_frame(self, frame: Frame, match: PlaceMatch | None, distance_m: float | None, missed: int) -> None:
        """To the journal where it is to have every frame, an event to people, and both to the plug-ins."""
        parts = self.parts
        record = frame_used(frame.index, frame.stamp_ns, match, self._drive.route, parts.config.rig, missed)
        parts.frames_used += 1
        if parts.config.telemetry.journal_frames:
            parts.record(record)
        fix = None if match is None else self._publish_place(frame, match)
        used = UsedFrame(parts.plugins.copied(frame), distance_m, missed, match, record, fix)
        parts.plugins.each(lambda plugin: plugin.frame_used(used))

    def _publish_place(self, frame: Frame, match: PlaceMatch) -> PlaceFix | None:
        """To people, if it is an event."""
        if not match.event:
            return None
        fix = self._drive.state.position
        if fix is None or fix.stamp_ns != frame.stamp_ns:
            fix = untracked_fix(match, frame.stamp_ns, self._drive.route, self.parts.config.rig)
        self.parts.events += 1
        self.parts.record(fix)
        self._autopilot.publish_place(fix)
        return fix

    def _warn_without_odometer(self) -> None:
        """Say once that the distance driven is not known, and what follows."""
        matcher = self._recognizer.matcher
        if "odometer" in self._warned_of or not matcher.lacks_odometer:
            return
        self._warned_of.add("odometer")
        if matcher.needs_odometer:
            log.warning('speed unknown: no place is recognized; if you drive as when mapping, [sampling] by = "time"')
            text = "speed unknown: no place is recognized"
        else:
            log.warning("speed unknown: %s; they must be as far apart", matcher.spacing)
            text = "speed unknown: drive as when mapping"
        self._autopilot.status_text(text, mavlink.MAV_SEVERITY_WARNING)

    def _warn_of_camera(self) -> None:
        """Say once that the pictures are of another camera than the config's, with what to set."""
        camera = None if "camera" in self._warned_of else self._recognizer.matcher.camera
        if camera is None or not camera.is_another:
            return
        self._warned_of.add("camera")
        of_view = camera.configured_deg, camera.fov_deg, camera.fov_sigma_deg
        self.parts.record(CameraDiffers(*of_view, camera.k1, camera.k1_sigma))
        found = f"{camera.fov_deg:.1f} degrees, k1 {camera.k1:+.2f}"
        remedy = "poses are by that; `lookback calibrate camera` measures it"
        log.warning("[camera] fov_deg: pictures have %s, not %g; %s", found, camera.configured_deg, remedy)
        text = f"camera sees {found}; config {camera.configured_deg:g}"
        self._autopilot.status_text(text, mavlink.MAV_SEVERITY_WARNING)

    def _update_health(self) -> bool:
        """Publish the daemon's state; True when what was recognized so far must be dropped."""
        parts = self.parts
        fault = parts.pictures.fault
        # Not the fault of a single picture, which lasts for a moment: it would be news to the pilot each time.
        undated = parts.pictures.why_undated if self._autopilot.positions.enabled else ""
        driven_m = self._autopilot.vehicle.motion.driven_m(self._clock_ns())
        if self._newest.posed and (driven_m is None or driven_m < self._newest.posed[0]):  # the odometer began anew
            self._newest.posed = None
        posed_m, right_m = self._newest.posed or (driven_m or 0.0, 0.0)
        inputs = HealthInputs(
            recognizer=self._recognizer.state,
            frames_used=parts.frames_used,
            frame_s=self._newest.took_s,
            picture=fault.what if fault and fault.sure else "",
            link=self._autopilot.state,
            link_why=self._autopilot.why_closed,
            gps=self._autopilot.gps_fault,
            withheld=undated or self._autopilot.why_no_position,
            driven_m=driven_m,
            no_pose_m=None if driven_m is None or self._newest.posed is None else driven_m - posed_m,
            right_m=right_m,
            lens=self._recognizer.matcher.lens,
        )
        hang = parts.device.hang(self._clock_ns()) if parts.device else ""
        return self.parts.monitor.update(inputs, parts.camera.health, hang)

    def _reset(self) -> None:
        """Begin anew: nothing is published that rests on frames from before a blindness."""
        self._recognizer.reset()
        self._drive.update(self._clock_ns(), Discontinuity("blind"))

    def _publish_position(self) -> None:
        """A position for the autopilot, if one is due, or why there is none."""
        limits = self._autopilot.position_due()
        if limits is None:
            return
        now_ns, unable = self._clock_ns(), self._unable()
        self._autopilot.report_own()
        if limits.at == "now":
            self._drive.update(now_ns, OdometryUpdate(self._autopilot.vehicle.motion.displacement(now_ns)))
        self._autopilot.send_position(self._drive.fix(now_ns, replace(limits, unable=unable)))

    def _compare_with_gps(self) -> None:
        """To the journal, where no position is sent: what would have been, beside GPS."""
        shadow = self.parts.shadow
        if shadow is not None and self._autopilot.state == "up":
            shadow.turn(self._clock_ns(), self._autopilot.vehicle.motion, self._autopilot.history, self._unable)

    def _unable(self) -> str:
        """Why nothing is recognized at this moment, "" while it is."""
        return self.parts.monitor.health.unable(self.parts.pictures.why_no_position)

    def last_words(self) -> Stopped:
        """What was done, for the journal."""
        parts = self.parts
        self._autopilot.restore_sources()
        parts.warm_start.keep()
        if parts.shadow is not None:
            parts.shadow.close()
        parts.plugins.close()  # which may write records
        health = parts.camera.health
        counts = {"delivered": health.delivered, "overwritten": health.overwritten, "bad": health.bad}
        stopped = Stopped(parts.frames_used, parts.events, parts.times.medians_ms(), counts)
        parts.record(stopped)
        return stopped


def run(config: Config, stop: threading.Event, reload: threading.Event, opened: threading.Event) -> Stopped:
    """Run until `stop` is set or the camera comes to its end; `opened` is set once all parts are open.

    reload: set when the maps are to be opened again.
    """
    with ExitStack() as parts:
        daemon = Daemon(OpenedParts(config, parts))
        opened.set()
        with daemon.parts.monitor.failures():
            while not stop.is_set() and daemon.turn():
                if reload.is_set():
                    reload.clear()
                    daemon.reopen_maps()
        notify("STOPPING=1")
        return daemon.last_words()
