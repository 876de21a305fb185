"""[nmea] in the daemon: once a second the position of that moment, or that there is none."""

from __future__ import annotations

import logging
import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from edge.backoff import BackOff
from edge.geodesy import east_north_of
from edge.localization import NO_PLACES, STANDING, Fix, FixRequest, NoFix, OdometryUpdate, PlaceFix
from edge.plugin import Parts, Plugin
from edge_plugins.nmea import NmeaConfig
from edge_plugins.nmea.outlets import PtyOutlet, TcpOutlet
from edge_plugins.nmea.sentences import sentences, text_sentence

PERIOD_NS = 1_000_000_000
STOPPED_M = 1.0
"""What a vehicle that stands may roll: less than any position is accurate to."""
AGAIN_FIRST_NS, AGAIN_LAST_NS = 1_000_000_000, 30_000_000_000
log = logging.getLogger(__name__)


class Nmea(Plugin):
    """Positions by the conditions for an autopilot without GPS, as `[ros2]` has them, moved on to each second.

    Where the vehicle stands, no place is recognized anew. The last position then holds for a while, by a clock and by
    the distance driven: whoever waits at a red light is not lost.
    """

    def __init__(self, config: NmeaConfig, parts: Parts, unix_ns: Callable[[], int] = time.time_ns) -> None:
        """unix_ns: UTC, by this computer. ConfigError where the pseudo-terminal cannot be made."""
        self._config, self._parts, self._unix_ns = config, parts, unix_ns
        self._pty = PtyOutlet(Path(config.pty)) if config.pty else None
        self._tcp: TcpOutlet | None = None
        self._back_off = BackOff(AGAIN_FIRST_NS, AGAIN_LAST_NS)
        self._due_ns = 0
        self._given: _PositionSample | None = None  # the newest position that may be published
        self._stopped: _PositionSample | None = None

    def start(self) -> None:
        """Serve it; a port that cannot be had yet is tried again."""
        self._listen(self._parts.clock_ns())

    def turn(self, spare_s: float | None) -> None:
        """Send what is due."""
        now_ns, parts = self._parts.clock_ns(), self._parts
        if now_ns < self._due_ns:
            return
        self._due_ns = now_ns + PERIOD_NS
        self._listen(now_ns)
        own = parts.autopilot.vehicle.position(now_ns)
        speed_mps = parts.autopilot.vehicle.motion.speed_mps(now_ns)
        data = sentences(self._unix_ns(), self._position(now_ns), speed_mps, own.alt_m if own else None)
        data += text_sentence(str(parts.autopilot.steering))
        for outlet in (self._tcp, self._pty):
            if outlet is not None:
                outlet.send(data)

    def close(self) -> None:
        """Stop serving."""
        for outlet in (self._tcp, self._pty):
            if outlet is not None:
                outlet.close()

    def _listen(self, now_ns: int) -> None:
        config = self._config
        if config.port == 0 or self._tcp is not None or not self._back_off.is_over(now_ns):
            return
        try:
            self._tcp = TcpOutlet(config.bind, config.port)
        except OSError as error:
            log.warning(
                "NMEA: [nmea] %s port %d: %s; trying again", config.bind, config.port, os.strerror(error.errno or 0)
            )
            self._back_off.failed(now_ns)
        else:
            who = "on this computer alone" if config.is_local else "for whoever reaches it"
            log.info("NMEA: positions on %s, port %d, %s", config.bind, config.port, who)

    def _position(self, now_ns: int) -> PlaceFix | None:
        """Where the vehicle is now, None where nobody knows."""
        parts, motion = self._parts, self._parts.autopilot.vehicle.motion
        unable, driven_m = parts.health().unable(parts.pictures.why_no_position), motion.driven_m(now_ns)
        parts.drive.update(now_ns, OdometryUpdate(motion.displacement(now_ns)))
        answer = parts.drive.fix(now_ns, FixRequest("now", moves_autopilot=False, unable=unable))
        if driven_m is None:
            return None
        if isinstance(answer, Fix):
            self._given, self._stopped = _PositionSample(now_ns, driven_m, answer.place), None
            return answer.place
        return self._where_it_stands(now_ns, driven_m, answer)

    def _where_it_stands(self, now_ns: int, driven_m: float, refused: NoFix) -> PlaceFix | None:
        """Where it stopped, for `standing_s`, and where nothing else speaks against its last position."""
        given, fix = self._given, refused.fix
        if given is None or refused.reason not in (STANDING, NO_PLACES):
            return None
        if now_ns - given.stamp_ns > self._config.standing_s * 1e9:
            return None
        if refused.reason == STANDING and fix is not None and given.leads_to(fix, driven_m):
            self._stopped = _PositionSample(now_ns, driven_m, fix)
        stopped = self._stopped
        return None if stopped is None or driven_m - stopped.driven_m > STOPPED_M else stopped.place


@dataclass(frozen=True)
class _PositionSample:
    """Where the vehicle was at a moment, and how far it had driven by then."""

    stamp_ns: int
    driven_m: float
    place: PlaceFix

    def leads_to(self, fix: PlaceFix, driven_m: float) -> bool:
        """Whether a later position is no farther off than was driven since, and not of another place."""
        own = self.place
        if None in (own.lat_deg, own.lon_deg, fix.lat_deg, fix.lon_deg):
            return False
        way_m = east_north_of(fix.lat_deg or 0.0, fix.lon_deg or 0.0, (own.lat_deg or 0.0, own.lon_deg or 0.0))
        return math.hypot(*way_m) <= driven_m - self.driven_m + fix.sigma_m
