"""One upload of a mission by MAVLink's mission protocol, downloaded again and compared, and set to its start. No I/O.

First the present mission is downloaded alike, and `decide` gets it: to keep a copy, or to leave or clear it.

    MISSION_COUNT -> (MISSION_REQUEST_INT or MISSION_REQUEST -> MISSION_ITEM_INT)... -> MISSION_ACK
    MISSION_REQUEST_LIST -> MISSION_COUNT -> (MISSION_REQUEST_INT -> MISSION_ITEM_INT)... -> MISSION_ACK
    MISSION_SET_CURRENT 0 -> MISSION_CURRENT 0

A new mission begins where the old one was left: PX4 keeps its index, at most the last item's, and ArduPilot resumes at
the item that it stopped at. Timeouts and the number of repetitions are those that the protocol's document recommends.
ArduPilot replaces its items one by one, so that after a failure it may have a mission of old and new items: a mission
that was begun and is not verified is cleared (MISSION_CLEAR_ALL).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

from pymavlink.dialects.v20 import common as mavlink

from edge.mission import MissionItem
from edge.telemetry.acknowledgements import result_name
from edge.telemetry.codec import Message

ANSWER_NS, ITEM_NS = 1_500_000_000, 250_000_000
REPETITIONS = 5
LONGEST_NS = 150_000_000_000
"""For all items: 700 of them take a minute on a slow line."""
CLEAR_REPETITIONS = 8
"""ArduPilot refuses to clear a mission until an upload that stopped has timed out, after 8 s."""
SAME_DEG = 2.5e-7  # 2 of MAVLink's 1e-7: PX4 stores degrees as floating-point numbers, and truncates them
SAME_M = 0.02
SAME_PARAM = 1e-3
SAME_FRAMES = {mavlink.MAV_FRAME_GLOBAL_INT: 0, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT: 3}
"""Frames of integers, which firmware may answer with instead of the others."""
MISSION = mavlink.MAV_MISSION_TYPE_MISSION
Next: TypeAlias = Literal["upload", "clear", "leave"]
BUSY = (mavlink.MAV_MISSION_ERROR, mavlink.MAV_MISSION_DENIED)
"""Refusals of firmware that is in another transfer, or has not noticed its end."""
REQUESTS = (mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_INT, mavlink.MAVLINK_MSG_ID_MISSION_REQUEST)


@dataclass(frozen=True)
class Outcome:
    """How a transfer ended. verified: the autopilot has exactly these items, and begins with the first.

    why: what went wrong, "" if nothing. is_settled: whether the autopilot cannot have a part of the items.
    """

    verified: bool
    why: str = ""
    is_settled: bool = True


class MissionTransfer:
    """One upload; `outcome` is None while it runs."""

    def __init__(
        self,
        items: Sequence[MissionItem],
        system_id: int,
        *,
        first_is_home: bool,
        decide: Callable[[list[MissionItem]], Next] = lambda present: "upload",
    ) -> None:
        """system_id: of the autopilot, component 1. first_is_home: it replaces item 0 by its own home position.

        decide: what is done about the present mission, before anything is changed.
        """
        self._system_id, self._first_is_home, self._decide = system_id, first_is_home, decide
        self._sent = items
        self._items = [_item_message(system_id, number, item) for number, item in enumerate(items)]
        self.outcome: Outcome | None = None
        self._phase: Literal["upload", "list", "download", "begin", "clear"] = "list"
        self._why = ""
        self._looks = True  # at the present mission: nothing is changed yet
        self._is_busy = False  # the autopilot has refused to begin: with an upload that was cut off, for 8 s
        self._began = False  # the autopilot may have changed its mission
        self._count, self._downloaded = 0, list[MissionItem]()
        self._assumed_complete = False  # the last acknowledgement may be lost, which the download will show
        self._pending: list[Message] = []
        self._sent_ns = self._tries = self._started_ns = 0

    def start(self, now_ns: int) -> list[Message]:
        """The first message."""
        self._started_ns = now_ns
        return self._request_list(now_ns)

    def due(self, now_ns: int) -> list[Message]:
        """What has not been answered in time, again; a failure after the last repetition."""
        if self.outcome is not None:
            return []
        if self._phase != "clear" and now_ns - self._started_ns > LONGEST_NS:
            return self._fail("the upload takes too long", now_ns)
        if now_ns - self._sent_ns < (ITEM_NS if self._phase == "download" else ANSWER_NS):
            return []
        if self._tries > (CLEAR_REPETITIONS if self._phase == "clear" or self._is_busy else REPETITIONS):
            return self._fail(self._unanswered(), now_ns)
        if self._phase == "upload" and self._pending[-1] is self._items[-1] and not self._assumed_complete:
            # Repeated, it would be an error for ArduPilot, if only its acknowledgement was lost.
            self._assumed_complete = True
            return self._request_list(now_ns)
        self._sent_ns, self._tries = now_ns, self._tries + 1
        return self._pending

    def read(self, message: Message, now_ns: int) -> list[Message]:
        """Read a message of the autopilot that is addressed to us, or to nobody; returns the answers."""
        kind = message.get_msgId()
        if self.outcome is None and kind == mavlink.MAVLINK_MSG_ID_MISSION_CURRENT:
            # ArduPilot answers with the number that it was sent, PX4 once a second.
            self.outcome = Outcome(verified=True) if self._phase == "begin" and message.seq == 0 else None
            return []
        if self.outcome is not None or getattr(message, "mission_type", None) != MISSION:
            return []
        if kind == mavlink.MAVLINK_MSG_ID_MISSION_ACK:
            return self._acknowledged(message.type, now_ns)
        if kind in REQUESTS and (self._phase == "upload" or (self._phase == "list" and self._assumed_complete)):
            return self._requested(message.seq, now_ns)
        if kind == mavlink.MAVLINK_MSG_ID_MISSION_COUNT and self._phase == "list":
            return self._counted(message.count, now_ns)
        is_item = kind == mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT and self._phase == "download"
        return self._compared(message, now_ns) if is_item else []

    def cancel(self, why: str, now_ns: int) -> list[Message]:
        """End it without success."""
        return [] if self.outcome is not None or self._phase == "clear" else self._fail(why, now_ns)

    def abandon(self) -> list[Message]:
        """End it without waiting for an answer; PX4 keeps its last mission, where ArduPilot would have a part of each.

        Both take an empty mission at once, where they would refuse to clear theirs until the upload has timed out.
        """
        if self.outcome is not None:
            return []
        # PX4 stores what is complete.
        is_stored = not self._looks and (self._first_is_home or self._phase != "upload")
        self.outcome = Outcome(verified=False, why="Lookback ended", is_settled=not is_stored)
        empty = [mavlink.MAVLink_mission_count_message(self._system_id, 1, 0, MISSION)] if is_stored else []
        return [self._acknowledgement(mavlink.MAV_MISSION_OPERATION_CANCELLED), *empty]

    def _requested(self, number: int, now_ns: int) -> list[Message]:
        self._began, self._phase = True, "upload"
        if number >= len(self._items):
            return self._fail(f"the autopilot requests item {number} of {len(self._items)}", now_ns)
        return self._expect([self._items[number]], now_ns)

    def _acknowledged(self, result: int, now_ns: int) -> list[Message]:
        accepted = result == mavlink.MAV_MISSION_ACCEPTED
        if self._phase == "clear":
            # An error while the autopilot still waits for items: try again.
            return self._end() if accepted else []
        is_repeated = self._phase == "upload" and result == mavlink.MAV_MISSION_INVALID_SEQUENCE  # an item
        is_early = self._looks or (self._phase == "upload" and not self._began and result in BUSY)
        if is_repeated or (is_early and not accepted):
            self._is_busy = not is_repeated
            return []  # what is not answered in time is sent again
        if self._phase == "list" and self._assumed_complete and result == mavlink.MAV_MISSION_DENIED:
            self._phase = "upload"  # it still waits for the last item
            return self._expect([self._items[-1]], now_ns)
        if not accepted:
            name = result_name(result, "MAV_MISSION_RESULT", "MAV_MISSION_")
            return self._fail(f"the autopilot refuses the mission: {name}", now_ns)
        if self._phase != "upload" or not self._began:
            return []
        return self._request_list(now_ns)

    def _counted(self, count: int, now_ns: int) -> list[Message]:
        if not self._looks and count != len(self._items):
            return self._fail(f"the autopilot has {count} items of {len(self._items)}", now_ns)
        self._phase, self._count, self._downloaded = "download", count, []
        return self._request_next(now_ns) if count else self._decided(now_ns)

    def _compared(self, item: Message, now_ns: int) -> list[Message]:
        if item.seq != len(self._downloaded):
            return []
        present = _mission_item(item)
        is_compared = not (self._looks or (self._first_is_home and item.seq == 0))
        if is_compared and not is_same(present, self._sent[item.seq]):
            return self._fail(f"item {item.seq} is not the one that was uploaded", now_ns)
        self._downloaded.append(present)
        if len(self._downloaded) < self._count:
            return self._request_next(now_ns)
        if self._looks:
            return self._decided(now_ns)
        self._phase = "begin"
        # PX4 ignores the second while it waits for the first, so both are repeated.
        begin = mavlink.MAVLink_mission_set_current_message(self._system_id, 1, 0)
        return self._expect([self._acknowledgement(mavlink.MAV_MISSION_ACCEPTED), begin], now_ns)

    def _decided(self, now_ns: int) -> list[Message]:
        """The present mission is known: what `decide` says is done."""
        self._looks = self._is_busy = False
        ended = self._acknowledgement(mavlink.MAV_MISSION_ACCEPTED)
        decision = self._decide(self._downloaded)
        if decision == "leave":
            self._why = "the mission is not one that was cut off"
            return [ended, *self._end()]
        if decision == "clear":
            self._why, self._phase = "a mission that was cut off is cleared", "clear"
            clear = mavlink.MAVLink_mission_clear_all_message(self._system_id, 1, MISSION)
            return self._expect([ended, clear], now_ns)
        self._phase = "upload"
        count = mavlink.MAVLink_mission_count_message(self._system_id, 1, len(self._items), MISSION)
        return self._expect([ended, count], now_ns)

    def _request_list(self, now_ns: int) -> list[Message]:
        self._phase = "list"
        return self._expect([mavlink.MAVLink_mission_request_list_message(self._system_id, 1, MISSION)], now_ns)

    def _request_next(self, now_ns: int) -> list[Message]:
        request = mavlink.MAVLink_mission_request_int_message(self._system_id, 1, len(self._downloaded), MISSION)
        return self._expect([request], now_ns)

    def _unanswered(self) -> str:
        """What it means that no answer has come."""
        if self._phase == "begin":
            return "the autopilot does not go back to the first item"
        # Without a request the count may have arrived or not; ArduPilot cuts its mission down to it.
        doubt = "" if self._began or self._looks else "; look at the autopilot's mission before you start it"
        return f"the autopilot does not answer{doubt}"

    def _expect(self, messages: list[Message], now_ns: int) -> list[Message]:
        """Send messages the last of which has to be answered."""
        self._pending, self._sent_ns, self._tries = messages, now_ns, 1
        return self._pending

    def _acknowledgement(self, result: int) -> Message:
        return mavlink.MAVLink_mission_ack_message(self._system_id, 1, result, MISSION)

    def _fail(self, why: str, now_ns: int) -> list[Message]:
        if self._phase == "clear":
            self._why += "; do not start the autopilot's mission: it may be incomplete, and could not be cleared"
            return self._end(is_settled=False)
        self._why = why
        if not self._began:
            return self._end(is_settled=self._looks)
        self._phase = "clear"
        # PX4 ignores the second during a transfer, and waits 5 s for one that has stopped.
        ended = self._acknowledgement(mavlink.MAV_MISSION_OPERATION_CANCELLED)
        return self._expect([ended, mavlink.MAVLink_mission_clear_all_message(self._system_id, 1, MISSION)], now_ns)

    def _end(self, *, is_settled: bool = True) -> list[Message]:
        self.outcome = Outcome(verified=False, why=self._why, is_settled=is_settled)
        return []


def _mission_item(item: Message) -> MissionItem:
    one, two, three, four, altitude_m = (
        None if math.isnan(value) else value for value in (item.param1, item.param2, item.param3, item.param4, item.z)
    )
    position = item.x / 1e7, item.y / 1e7, altitude_m
    return MissionItem(item.command, item.frame, (one, two, three, four), *position, item.autocontinue)


def _item_message(system_id: int, number: int, item: MissionItem) -> Message:
    *params, altitude_m = (math.nan if value is None else value for value in (*item.params, item.altitude_m))
    return mavlink.MAVLink_mission_item_int_message(
        system_id,
        1,
        number,
        item.frame,
        item.command,
        int(number == 0),  # the current one; both firmware types need MISSION_SET_CURRENT all the same
        item.goes_on,
        *params,
        round(item.lat_deg * 1e7),
        round(item.lon_deg * 1e7),
        altitude_m,
        MISSION,
    )


def is_same(item: MissionItem, sent: MissionItem) -> bool:
    """Whether an item came back as it was sent."""
    if item.command != sent.command:
        return False
    if sent.command == mavlink.MAV_CMD_NAV_WAYPOINT and not (
        SAME_FRAMES.get(item.frame, item.frame) == SAME_FRAMES.get(sent.frame, sent.frame)
        and abs(item.lat_deg - sent.lat_deg) <= SAME_DEG
        and abs(item.lon_deg - sent.lon_deg) <= SAME_DEG
        and _is_near(item.altitude_m, sent.altitude_m, SAME_M)
    ):
        return False
    pairs = zip(item.params, sent.params, strict=True)
    return all(_is_near(theirs, ours, SAME_PARAM * max(1.0, abs(ours or 0.0))) for theirs, ours in pairs)


def _is_near(theirs: float | None, ours: float | None, tolerance: float) -> bool:
    return ours is None or (theirs is not None and abs(theirs - ours) <= tolerance)
