"""The mission of a simulated autopilot, and its side of the mission protocol, as ArduPilot and PX4 do it.

ArduPilot requests each item again after 1 s and gives up after 8 s, replaces its items one by one, and has its home
position as item 0. PX4 stores an upload only when it is complete, and is deaf to other requests during a transfer.

Both keep the current item over an upload, as they were recorded and as AP_Mission.cpp and PX4's mission_base.cpp
(updateMavlinkMission) and mavlink_mission.cpp have it: PX4 its index or the last, ArduPilot its index where the new
mission has it. PX4 sends MISSION_CURRENT once a second.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.telemetry.codec import Message

ACCEPTED, MISSION = mavlink.MAV_MISSION_ACCEPTED, mavlink.MAV_MISSION_TYPE_MISSION
AGAIN_S, GIVE_UP_S = 1.0, 8.0
DEAF_S = 5.0
"""How long PX4 waits for the acknowledgement of a download."""
CURRENT_S = 1.0
MOST_ITEMS = {True: 724, False: 2000}
KINDS = (
    mavlink.MAVLINK_MSG_ID_MISSION_COUNT,
    mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT,
    mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_LIST,
    mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_INT,
    mavlink.MAVLINK_MSG_ID_MISSION_CLEAR_ALL,
    mavlink.MAVLINK_MSG_ID_MISSION_ACK,
    mavlink.MAVLINK_MSG_ID_MISSION_SET_CURRENT,
)


class MissionStore:
    """`items` is the mission, as it was received; handlers return the answers. At most one upload at a time."""

    def __init__(self, *, is_ardupilot: bool) -> None:
        self._is_ardupilot = is_ardupilot
        self.items: list[Message] = []
        self.current = 0
        """The item at which the mission goes on in AUTO or Mission mode; a drive that follows it moves it."""
        self.rejects: dict[int, int] = {}
        """MAV_MISSION_RESULT for items by their number, instead of storing them."""
        self.alters: Callable[[Message], Message] = lambda item: item
        """What becomes of an item when it is stored."""
        self._sender: tuple[int, int] | None = None  # of the upload that is under way
        self._received: list[Message] = []
        self._count = 0
        self._heard_s = self._requested_s = 0.0
        self._deaf_s = self._current_s = -math.inf  # until when a download goes on; of the last MISSION_CURRENT

    @property
    def waypoints_deg(self) -> list[tuple[float, float]]:
        """Latitude and longitude of the mission's waypoints, without ArduPilot's home position."""
        return self._waypoints_from(0)

    @property
    def ahead_deg(self) -> list[tuple[float, float]]:
        """Those of them that a vehicle would drive to, from the current item on."""
        return self._waypoints_from(self.current if self.current < len(self.items) else 0)

    def _waypoints_from(self, first: int) -> list[tuple[float, float]]:
        items = self.items[max(first, 1 if self._is_ardupilot else 0) :]
        return [(item.x / 1e7, item.y / 1e7) for item in items if item.command == mavlink.MAV_CMD_NAV_WAYPOINT]

    def handle(self, message: Message, now_s: float) -> list[Message]:
        """Read a message; the answers, addressed to its sender."""
        sender, kind = (message.get_srcSystem(), message.get_srcComponent()), message.get_msgId()
        if kind == mavlink.MAVLINK_MSG_ID_MISSION_COUNT:
            return self._counted(message, sender, now_s)
        if kind == mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT:
            return self._received_item(message, sender, now_s)
        if kind == mavlink.MAVLINK_MSG_ID_MISSION_CLEAR_ALL:
            return self._clear(sender, now_s)
        if kind == mavlink.MAVLINK_MSG_ID_MISSION_SET_CURRENT:
            return self._set_current(message.seq, now_s)
        if kind == mavlink.MAVLINK_MSG_ID_MISSION_ACK:
            return self._acknowledged(message.type, sender)
        return [self._downloaded(message, sender, now_s)]

    def step(self, now_s: float) -> list[Message]:
        """What is due: the item that has not come, requested again; the end of an upload; PX4's current item."""
        if not self._is_ardupilot and now_s - self._current_s >= CURRENT_S:
            self._current_s = now_s
            return [mavlink.MAVLink_mission_current_message(self.current)]
        if self._sender is None:
            return []
        if now_s - self._heard_s > GIVE_UP_S:
            sender = self._sender
            self._sender = None
            return [_answer(sender, mavlink.MAV_MISSION_OPERATION_CANCELLED)]
        return [self._request(now_s)] if now_s - self._requested_s > AGAIN_S else []

    def _counted(self, message: Message, sender: tuple[int, int], now_s: float) -> list[Message]:
        if self._sender not in (None, sender):
            return [_answer(sender, mavlink.MAV_MISSION_DENIED)]
        if now_s < self._deaf_s:
            return [_answer(sender, mavlink.MAV_MISSION_ERROR)]
        if message.count > MOST_ITEMS[self._is_ardupilot]:
            return [_answer(sender, mavlink.MAV_MISSION_NO_SPACE)]
        self._sender, self._count, self._heard_s = sender, message.count, now_s
        self._received = []
        if self._is_ardupilot:
            del self.items[message.count :]
        return [self._request(now_s)] if message.count else [self._complete(sender)]

    def _received_item(self, item: Message, sender: tuple[int, int], now_s: float) -> list[Message]:
        if self._sender is None:  # no upload is under way
            return [_answer(sender, mavlink.MAV_MISSION_ERROR)] if self._is_ardupilot else []
        if item.seq != len(self._received):
            return [_answer(sender, mavlink.MAV_MISSION_INVALID_SEQUENCE)]
        if item.seq in self.rejects:
            self._sender = None
            return [_answer(sender, self.rejects[item.seq])]
        self._heard_s = now_s
        stored = self.alters(copy.copy(item))
        self._received.append(stored)
        if self._is_ardupilot:
            self.items[item.seq : item.seq + 1] = [stored]
        return [self._complete(sender) if len(self._received) == self._count else self._request(now_s)]

    def _complete(self, sender: tuple[int, int]) -> Message:
        if not self._is_ardupilot and [*map(_content, self._received)] != [*map(_content, self.items)]:
            marked = [item.seq for item in self._received if item.current]
            self.current = marked[-1] if marked else max(0, min(self.current, len(self._received) - 1))
        self._sender, self.items = None, list(self._received)
        return _answer(sender, ACCEPTED)

    def _clear(self, sender: tuple[int, int], now_s: float) -> list[Message]:
        if self._sender is not None or now_s < self._deaf_s:
            return [_answer(sender, mavlink.MAV_MISSION_ERROR)] if self._is_ardupilot else []
        self.items, self.current = [], 0
        return [_answer(sender, ACCEPTED)]

    def _set_current(self, number: int, now_s: float) -> list[Message]:
        """ArduPilot answers with the number that it was sent, although its first item is 1."""
        if number >= len(self.items) or (self._is_ardupilot and len(self.items) == 1):
            return []
        if not self._is_ardupilot and (self._sender is not None or now_s < self._deaf_s):
            return []
        self.current = max(number, 1) if self._is_ardupilot else number
        return [mavlink.MAVLink_mission_current_message(number)] if self._is_ardupilot else []

    def _acknowledged(self, result: int, sender: tuple[int, int]) -> list[Message]:
        """The end of a download, or of an upload that its sender cancels; ArduPilot heeds neither."""
        self._deaf_s = -math.inf
        is_cancelled = result == mavlink.MAV_MISSION_OPERATION_CANCELLED and sender == self._sender
        if is_cancelled and not self._is_ardupilot:
            self._sender = None
        return []

    def _request(self, now_s: float) -> Message:
        """ArduPilot requests by the older message."""
        assert self._sender is not None
        self._requested_s = now_s
        older, newer = mavlink.MAVLink_mission_request_message, mavlink.MAVLink_mission_request_int_message
        return (older if self._is_ardupilot else newer)(*self._sender, len(self._received), MISSION)

    def _downloaded(self, message: Message, sender: tuple[int, int], now_s: float) -> Message:
        if self._sender is not None:
            return _answer(sender, mavlink.MAV_MISSION_DENIED)
        if not self._is_ardupilot:
            self._deaf_s = now_s + DEAF_S
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_LIST:
            return mavlink.MAVLink_mission_count_message(*sender, len(self.items), MISSION)
        if message.seq >= len(self.items):
            return _answer(sender, mavlink.MAV_MISSION_INVALID_SEQUENCE)
        item = copy.copy(self.items[message.seq])
        item.target_system, item.target_component = sender
        item.current = int(message.seq == self.current)
        if self._is_ardupilot and item.command == mavlink.MAV_CMD_NAV_WAYPOINT:
            item.param4 = 0.0 if math.isnan(item.param4) else item.param4
        return item


def _answer(sender: tuple[int, int], result: int) -> Message:
    return mavlink.MAVLink_mission_ack_message(*sender, result, MISSION)


def _content(item: Message) -> str:
    """What PX4's checksum of a mission covers; NaN equals itself."""
    return repr((item.command, item.frame, item.param1, item.param2, item.param3, item.param4, item.x, item.y, item.z))
