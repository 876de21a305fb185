"""ArduPilot's set of position sources, selected by command 42007 until the autopilot acknowledges it. No I/O.

With `doubted_gps = "switch"` set 2 is selected when GPS is called wrong, and set 1 when GPS agrees again: only where
this program has selected set 2 before, which a file remembers over a crash. What the pilot has selected stays. A
command is sent again while it is not answered, and in every session: the autopilot may have rebooted.
"""

from __future__ import annotations

import contextlib
import logging
from pathlib import Path

from edge.journal.records import SourceSetAnswered
from edge.telemetry import encoders
from edge.telemetry.acknowledgements import NO_ANSWER, Command, result_name
from edge.telemetry.codec import Message
from edge.telemetry.people import Publisher
from edge.telemetry.vehicle import Vehicle

GPS_SET, SET_WITHOUT_GPS = 1, 2
AGAIN_NS = 5_000_000_000  # at most: until it is selected, no position is used
log = logging.getLogger(__name__)


class SourceSelection:
    """One command at a time, since an acknowledgement does not say which set it is for."""

    def __init__(self, vehicle: Vehicle, publisher: Publisher, remembered: Path | None = None) -> None:
        """remembered: a file that exists while set 2 may be selected by us."""
        self._vehicle, self._publisher, self._remembered = vehicle, publisher, remembered
        self.wanted: int | None = None
        """The set to select; None until there is a reason for one, and the pilot's choice stays."""
        self.in_use = SET_WITHOUT_GPS if remembered is not None and remembered.exists() else GPS_SET
        """Set 2 while it may be selected by us, else the first one."""
        self.new_session()

    def new_session(self) -> None:
        """The link came up, or the autopilot rebooted: which set it uses is not known."""
        self._command = Command(AGAIN_NS)
        self._asked: int | None = None  # which set was asked for last
        self._selected: int | None = None
        self._published = ""

    def due(self, now_ns: int) -> list[Message]:
        """The command, if the wanted set is not acknowledged yet and none is waiting for its answer."""
        if self._command.is_overdue(now_ns):
            self._command.give_up()
            self._command.failed(now_ns)
            self._publish(NO_ANSWER)
        if self.wanted in (None, self._selected) or self.wanted == self.in_use == GPS_SET:
            return []
        return self._select(self.wanted or GPS_SET, now_ns) if self._command.allows(now_ns) else []

    def restore(self, now_ns: int) -> list[Message]:
        """The command for set 1 at the end of the program, where GPS agrees and set 2 may still be selected by us."""
        return self._select(GPS_SET, now_ns) if self.wanted == GPS_SET != self.in_use else []

    def read_acknowledgement(self, result: int, now_ns: int) -> None:
        """COMMAND_ACK of 42007 that was addressed to us."""
        was_asked = self._command.is_waiting
        verdict = self._command.read(result, now_ns)
        if verdict == "wait":
            return
        if not was_asked:  # of two answers, a stranger may have forged the first: ask again where they differ
            self._selected = self._selected if verdict == "accepted" else None
            return
        if verdict == "accepted":
            self._selected = self._asked
            self._remember(self._asked or GPS_SET)
        self._publish(result_name(result))

    def _select(self, number: int, now_ns: int) -> list[Message]:
        self._asked = number
        self._command.sent(now_ns)
        self._remember(max(self.in_use, number))
        return [encoders.source_set(self._vehicle.target_id, number)]

    def _remember(self, in_use: int) -> None:
        if self._remembered is not None and in_use != self.in_use:
            with contextlib.suppress(OSError):  # a full disk costs what a crash needs, not the flight
                self._remembered.unlink(missing_ok=True) if in_use == GPS_SET else self._remembered.touch()
        self.in_use = in_use

    def _publish(self, result: str) -> None:
        """To the journal and the pilot, repetitions once."""
        number = self._asked or GPS_SET
        if f"{number} {result}" == self._published:
            return
        self._published = f"{number} {result}"
        self._publisher.record(SourceSetAnswered(number, result))
        self._publisher.warn(f"Lookback: source set {number} {result}")
