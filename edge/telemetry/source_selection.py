"""Whether the autopilot's filter uses GPS, selected by command until that is known to be done. No I/O.

With `doubted_gps = "switch"` GPS is taken away when it is declared faulty, and given back when it is consistent again:
only where this program has taken it away before, which a file remembers over a crash. ArduPilot that fuses keypoint
poses takes them in set 2 alone, which is selected with the first one after GPS was lost, until that works again. What
the pilot has selected stays. A command is sent again while it is not done, and in every session: the autopilot may have
rebooted.

ArduPilot  42007 selects set 2 of its sources, or set 1; done when acknowledged, since it reports nothing of it
PX4        43006 sets GPS off or on, which it keeps when it reboots; done when FusionStatus (514) says so
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.journal.records import SourceSetAnswered
from edge.telemetry import encoders
from edge.telemetry.acknowledgements import NO_ANSWER, Command, result_name
from edge.telemetry.codec import Message
from edge.telemetry.firmware import GPS_SET, SET_WITHOUT_GPS
from edge.telemetry.people import Publisher
from edge.telemetry.vehicle import Vehicle

AGAIN_NS = 5_000_000_000  # at most: until it is selected, no position is used
DONE, NOT_READ_BACK, PILOTS = "ACCEPTED", "NOT_READ_BACK", "BY_THE_PILOT"
LOST = "lost"
"""What is said of a GPS that counts again as soon as it works."""
SWITCHED = "Using EKF Source Set "
"""What ArduPilot writes when the pilot's switch (RCx_OPTION 90) selects a set, and not when a command does."""


class SourceChoice(NamedTuple):
    """A set of sources, and what is said of GPS with it; "" where the pilot has selected it by a switch."""

    number: int
    why: str = ""


class SourceSelection:
    """One command at a time, since an acknowledgement does not say which set it is for."""

    def __init__(self, vehicle: Vehicle, publisher: Publisher, remembered: Path | None = None) -> None:
        """remembered: a file that exists while set 2 may be selected by us."""
        self._vehicle, self._publisher, self._remembered = vehicle, publisher, remembered
        self._choice: SourceChoice | None = None
        self.in_use = SET_WITHOUT_GPS if remembered is not None and remembered.exists() else GPS_SET
        """Set 2 while it may be selected by us, else the first one."""
        self.new_session()

    def new_session(self) -> None:
        """The link came up, or the autopilot rebooted: which set it uses is not known."""
        self._command = Command(AGAIN_NS)
        self._asked: int | None = None  # which set was asked for last
        self._selected: int | None = None
        self._is_accepted = False  # but not reported yet
        self._published = ""
        if self._is_pilots:
            self._choice = None

    @property
    def _is_reported(self) -> bool:
        """Whether GPS itself is switched, which the autopilot reports."""
        return self._vehicle.session.firmware.gps_switch == "fusion"

    def want(self, number: int, why: str) -> None:
        """Select a set from now on, unless the pilot has; why: what is said of GPS."""
        if not self._is_pilots and self.wanted != number:
            self._choice = SourceChoice(number, why)

    @property
    def wanted(self) -> int | None:
        """The set to select; None until there is a reason for one, and where the pilot's stays."""
        return self._choice.number if self._choice is not None and self._choice.why else None

    @property
    def is_doubted(self) -> bool:
        """Whether GPS was taken away for what it says, or before a crash, so that nobody knows why."""
        if self._choice is None:
            return self.in_use == SET_WITHOUT_GPS
        return self._choice.number == SET_WITHOUT_GPS and self._choice.why != LOST

    @property
    def _is_pilots(self) -> bool:
        return self._choice is not None and not self._choice.why

    @property
    def is_without_gps(self) -> bool:
        """Whether set 2 is known to be selected."""
        return self._selected == SET_WITHOUT_GPS

    def read_text(self, text: str) -> None:
        """STATUSTEXT of the autopilot: where the pilot has selected another set by a switch, that stays."""
        if not text.startswith(SWITCHED) or not text[len(SWITCHED) :].isdigit():
            return
        number = int(text[len(SWITCHED) :])
        if number == (self._selected or self.in_use):  # as at boot
            return
        self._choice, self._selected = SourceChoice(number), number
        self._command.answered()
        self._remember(GPS_SET)
        self._vehicle.session.gps.is_fusion_on = number == GPS_SET
        self._publisher.record(SourceSetAnswered(number, PILOTS))
        self._publisher.warn(f"Lookback: source set {number} by the pilot, stays")

    @property
    def is_gps_off(self) -> bool:
        """Whether GPS itself was taken away, and that was reported."""
        return self._is_reported and self._selected == SET_WITHOUT_GPS

    def due(self, now_ns: int) -> list[Message]:
        """The command, if the wanted set is not selected yet and none is waiting for its answer."""
        if self._command.is_overdue(now_ns):
            self._command.answered()
            self._command.pause.failed(now_ns)
            self._publish(NO_ANSWER)
        wanted = self.wanted
        if wanted is None or wanted == self._selected or (wanted == GPS_SET and self.in_use == GPS_SET):
            return []
        if self._is_reported and self._vehicle.session.gps.is_fusion_on is (wanted == GPS_SET):
            self._command.answered()
            self._done(wanted)
        if wanted == self._selected or not self._command.is_due(now_ns):
            return []
        if self._is_accepted:
            self._publish(NOT_READ_BACK)
        return self._select(wanted, now_ns)

    def restore(self, now_ns: int) -> list[Message]:
        """The command for set 1 at the end, where GPS is consistent and set 2 may still be selected by us."""
        return self._select(GPS_SET, now_ns) if self.wanted == GPS_SET and self.in_use != GPS_SET else []

    def read_acknowledgement(self, result: int, now_ns: int) -> None:
        """The COMMAND_ACK of the command that was addressed to us."""
        was_asked = self._command.is_waiting
        if was_asked and self._is_reported and result == mavlink.MAV_RESULT_ACCEPTED:
            self._is_accepted = True
            self._command.answered()
            self._command.pause.failed(now_ns)  # unless it is reported within the pause
            return
        verdict = self._command.read(result, now_ns)
        if verdict == "wait":
            return
        if not was_asked:  # of two answers, a stranger may have forged the first: ask again where they differ
            self._selected = self._selected if verdict == "accepted" else None
            return
        if verdict == "never" and self._asked == SET_WITHOUT_GPS:
            self._remember(GPS_SET)
        if verdict == "accepted":
            self._done(self._asked or GPS_SET)
        else:
            self._publish(result_name(result))

    def _select(self, number: int, now_ns: int) -> list[Message]:
        self._asked, self._is_accepted = number, False
        self._command.ask(now_ns)
        self._remember(max(self.in_use, number))
        system_id = self._vehicle.target_id
        if self._is_reported:
            return [encoders.gps_fusion(system_id, is_on=number == GPS_SET)]
        return [encoders.source_set(system_id, number)]

    def _done(self, number: int) -> None:
        """It is selected: by us, or by somebody else, whose choice set 2 then is."""
        self._selected, self._is_accepted = number, False
        self._vehicle.session.gps.is_fusion_on = number == GPS_SET
        self._remember(min(self.in_use, number))
        if self._asked == number:
            self._publish(DONE)

    def _remember(self, in_use: int) -> None:
        if self._remembered is not None and in_use != self.in_use:
            with contextlib.suppress(OSError):  # its name is all that counts, which a full disk still has room for
                self._remembered.unlink(missing_ok=True) if in_use == GPS_SET else self._remembered.touch()
        self.in_use = in_use

    def _publish(self, result: str) -> None:
        """To the journal and the pilot, repetitions once."""
        number = self._asked or GPS_SET
        if f"{number} {result}" == self._published:
            return
        self._published = f"{number} {result}"
        self._publisher.record(SourceSetAnswered(number, result))
        what = f"GPS fusion {'on' if number == GPS_SET else 'off'}" if self._is_reported else f"source set {number}"
        by = "by GPS" if number == GPS_SET else "by places"
        why = self._choice.why if self._choice is not None else ""
        text = f"GPS {why}: {by}, {what}" if result == DONE else f"{what} {result}"
        self._publisher.warn(f"Lookback: {text}")
        if number == SET_WITHOUT_GPS and result != DONE:
            self.warn_that_gps_stays()

    def warn_that_gps_stays(self) -> None:
        """An autopilot whose GPS is switched ignores positions far from it."""
        if self._is_reported:
            self._publisher.warn(f"Lookback: {self._vehicle.session.firmware.name} uses GPS, may ignore positions")
