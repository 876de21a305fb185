"""A rig: our connection and a simulated autopilot on one wire, whose time is stepped."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from edge.config import Config, GatesConfig, TelemetryConfig
from edge.geodesy import VehiclePosition
from edge.journal.journal import Journal
from edge.localization import FixRequest, GpsFix, GpsVerdict, PlaceFix, PositionEstimator
from edge.localization.dead_reckoning import Odometry
from edge.localization.tracker import FixCandidate
from edge.telemetry.autopilot import AutopilotConnection
from edge.telemetry.codec import MavlinkCodec
from edge_plugins.home import HomeConfig
from edge_plugins.home.home_requests import HomeRequests
from sim.journal import R, records_of
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.command import straight_line
from sim.vehicle.pty_link import PtyLink, open_pty
from tests.files_written import wait_for_files

SPEED_MPS = 8.0
START_NS = 1_000_000_000_000
STEP_NS = 20_000_000
"""As the daemon's loop turns between two frames; shorter steps would only cost time."""
LENIENT = GatesConfig(with_gps=True, min_interval_s=0.1, risk=1.0, min_move_m=0.0)


class ToldEstimator(PositionEstimator):
    """One that is told the positions and verdicts which frames would lead to; all else is as in the daemon."""

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self.offered: tuple[PlaceFix, Odometry | None] | None = None
        self.pose_sigma_m: float | None = None
        """Of what is offered, where it is a keypoint pose."""

    def offer(self, t_ns: int, fix: PlaceFix, motion: Odometry | None) -> None:
        """A place that is recognized now."""
        self.offered, self._known = (fix, motion), None
        self._observe(fix, motion)

    def judge(self, verdict: GpsVerdict) -> None:
        """What the places say of GPS from now on."""
        was_wrong, self._gps.verdict = self._gps.is_wrong, verdict
        self._gps._state = verdict.state if verdict.state != "not recognized" else "cannot say"
        self._judge_gps(was_wrong=was_wrong)
        self._known = None

    @property
    def pose_ns(self) -> int | None:
        return self.offered[0].stamp_ns if self.offered is not None and self.pose_sigma_m is not None else None

    def _asked(self, t_ns: int, limits: FixRequest) -> FixCandidate:
        is_pose = self.pose_sigma_m is not None
        if limits.unable or self._own.is_doubled or self.offered is None or (limits.at == "pose" and not is_pose):
            return FixCandidate()
        return FixCandidate(*self.offered, self.pose_sigma_m)


class LossyLink:
    """The autopilot's end of the wire, which loses the messages that `loses` names, in both directions."""

    def __init__(self) -> None:
        self.link: PtyLink | None = None
        self.loses: Callable[[Any], bool] | None = None
        self._in, self._out = MavlinkCodec(1, 1), MavlinkCodec(1, 191)

    def receive(self) -> bytes:
        return self._kept(self._in, self._link.receive())

    def send(self, data: bytes) -> bool:
        return self._link.send(self._kept(self._out, data))

    def fileno(self) -> int:
        return self._link.fileno()

    def close(self) -> None:
        self._link.close()

    def _kept(self, codec: MavlinkCodec, data: bytes) -> bytes:
        if self.loses is None:
            return data
        return b"".join(bytes(one.get_msgbuf()) for one in codec.decode(data) if not self.loses(one))

    @property
    def _link(self) -> PtyLink:
        assert self.link is not None
        return self.link


class Rig:
    """The real connection on a pseudo-terminal that a symbolic link names, as udev would; time is stepped."""

    def __init__(
        self,
        folder: Path,
        emit: Any = "report",
        gates: GatesConfig = LENIENT,
        config: Any = None,
        home: HomeConfig = HomeConfig(),  # noqa: B008  # frozen
        *,
        motion: str = "off",
        **autopilot: Any,
    ) -> None:
        self.now_ns = START_NS
        self.off_m = 0.0
        """How far a test has its GPS to the east of the truth."""
        self.port = folder / "autopilot"
        self.journal = Journal(folder / "events.jsonl")
        self.options = autopilot
        self.pty: PtyLink | None = None
        self.wire = LossyLink()
        self.plug()
        options = {
            "connection": f"serial:{self.port}:921600",
            "emit": emit,
            "journal": str(folder / "events.jsonl"),
            **(config or {}),
        }
        self._config, self._gates, self._home = TelemetryConfig(**options), gates, home
        self._motion = motion
        self.connect()

    def connect(self) -> None:
        """Start our end; the autopilot goes on as it is."""
        self.drive = ToldEstimator(Config(gates=self._gates))
        self.connection = AutopilotConnection(
            self._config, lambda: self.now_ns, self.journal.write, self._gates, self.drive
        )
        if self._motion != "off":
            self.connection.use_camera_motion(sends=self._motion == "send")
        self.unable = ""
        """Why nothing is recognized now."""
        self.home = HomeRequests(self._home, self.connection)
        self.connection.serve(self.home)

    def send_position(self, fix: PlaceFix) -> bool:
        """Of a place that is recognized now; whether it was sent."""
        connection = self.connection
        connection.report_own()
        self.drive.offer(self.now_ns, fix, connection.vehicle.motion.displacement(fix.stamp_ns))
        return self.publish_position()

    def publish_position(self) -> bool:
        """As the daemon does in each turn."""
        limits = self.connection.position_due()
        if limits is None:
            return False
        return self.connection.send_position(self.drive.fix(self.now_ns, replace(limits, unable=self.unable)))

    def judge_gps(self, verdict: GpsVerdict) -> None:
        """What the places say of GPS, after a frame."""
        self.connection.report_own()
        self.drive.judge(verdict)
        self.connection.judge_gps()

    def crash(self) -> None:
        """Our end is gone without a word, as after kill -9; its port is free again."""
        wait_for_files()
        self.unplug()
        self.connection.poll()
        self.open_port()

    def plug(self) -> None:
        self.open_port()
        pose_at = straight_line(SPEED_MPS, 60.0, START_NS / 1e9)
        self.autopilot = SimulatedAutopilot(self.wire, pose_at, lambda: self.now_ns, **self.options)

    def open_port(self) -> None:
        """A port under the same name; the autopilot's end of it."""
        self.pty = self.wire.link = open_pty()
        self.port.unlink(missing_ok=True)
        self.port.symlink_to(self.pty.device)

    def unplug(self) -> None:
        assert self.pty is not None
        self.pty.close()
        self.pty = None

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Step both ends; whether `until` came true."""
        for _ in range(round(seconds * 1e9 / STEP_NS)):
            self.now_ns += STEP_NS
            if self.pty is not None:
                self.autopilot.step()
            self.connection.poll()
            if until():
                return True
        return False

    @property
    def bounded_m(self) -> float | None:
        """One standard deviation of the autopilot's own position, None where nothing bounds it."""
        self.connection.report_own()
        return self.drive.state.own_sigma_m

    @property
    def uncertainty_m(self) -> float:
        """The same, where something must."""
        assert self.bounded_m is not None
        return self.bounded_m

    @property
    def gps_fix(self) -> GpsFix | None:
        """Where GPS puts the vehicle now."""
        return self.connection.vehicle.gps_fix(self.now_ns, self.now_ns)

    @property
    def position(self) -> VehiclePosition:
        """The autopilot's own, which must be known."""
        found = self.connection.vehicle.position(self.now_ns)
        assert found is not None
        return found

    def received(self, name: str) -> list[Any]:
        return [entry.message for entry in self.autopilot.received if entry.message.get_type() == name]

    def journalled(self, kind: type[R]) -> list[R]:
        return list(records_of(self.port.with_name("events.jsonl"), kind))

    def true_position(self, age_s: float = 0.5) -> tuple[float, float]:
        """Latitude and longitude of so many seconds ago, deg."""
        return straight_line(SPEED_MPS, 60.0, START_NS / 1e9)(self.now_ns / 1e9 - age_s).geodetic()

    def fix(self, age_s: float = 0.5, **changes: Any) -> PlaceFix:
        exposed_ns = self.now_ns - round(age_s * 1e9)
        lat_deg, lon_deg = self.true_position(age_s)
        fields: dict[str, Any] = {
            "stamp_ns": exposed_ns,
            "place": 42,
            "lat_deg": lat_deg,
            "lon_deg": lon_deg,
            "heading_deg": 60.0,
            "sigma_along_m": 2.4,
            "sigma_cross_track_m": 1.8,
            "direction": "reverse",
            "order": "same",
            "uniqueness": 1.31,
            "matches": 20,
            "confidence": 0.9,
        }
        return PlaceFix(**{**fields, **changes})

    def close(self) -> None:
        self.connection.close()
        self.journal.close()
        if self.pty is not None:
            self.pty.close()


OpenRig = Callable[..., Rig]
