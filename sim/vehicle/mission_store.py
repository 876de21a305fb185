"""The mission of a simulated autopilot, and its side of the mission protocol, as ArduPilot and PX4 do it.

ArduPilot requests each item again after 1 s and gives up after 8 s, replaces its items one by one, and has its home
position as item 0. PX4 stores an upload only when it is complete.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable

from pymavlink.dialects.v20 import common as mavlink

from edge.telemetry.codec import Message

ACCEPTED, MISSION = mavlink.MAV_MISSION_ACCEPTED, mavlink.MAV_MISSION_TYPE_MISSION
AGAIN_S, GIVE_UP_S = 1.0, 8.0
MOST_ITEMS = {True: 724, False: 2000}
KINDS = (
    mavlink.MAVLINK_MSG_ID_MISSION_COUNT,
    mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT,
    mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_LIST,
    mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_INT,
    mavlink.MAVLINK_MSG_ID_MISSION_CLEAR_ALL,
    mavlink.MAVLINK_MSG_ID_MISSION_ACK,
)


class MissionStore:
    """`items` is the mission, as it was received; handlers return the answers. At most one upload at a time."""

    def __init__(self, *, is_ardupilot: bool) -> None:
        self._is_ardupilot = is_ardupilot
        self.items: list[Message] = []
        self.rejects: dict[int, int] = {}
        """MAV_MISSION_RESULT for items by their number, instead of storing them."""
        self.alters: Callable[[Message], Message] = lambda item: item
        """What becomes of an item when it is stored."""
        self._sender: tuple[int, int] | None = None  # of the upload that is under way
        self._received: list[Message] = []
        self._count = 0
        self._heard_s = self._requested_s = 0.0

    @property
    def waypoints_deg(self) -> list[tuple[float, float]]:
        """Latitude and longitude of the mission's waypoints, without ArduPilot's home position."""
        first = 1 if self._is_ardupilot else 0
        return [
            (item.x / 1e7, item.y / 1e7) for item in self.items[first:] if item.command == mavlink.MAV_CMD_NAV_WAYPOINT
        ]

    def handle(self, message: Message, now_s: float) -> list[Message]:
        """Read a message; the answers, addressed to its sender."""
        sender, kind = (message.get_srcSystem(), message.get_srcComponent()), message.get_msgId()
        if kind == mavlink.MAVLINK_MSG_ID_MISSION_COUNT:
            return self._counted(message, sender, now_s)
        if kind == mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT:
            return self._received_item(message, sender, now_s)
        if kind == mavlink.MAVLINK_MSG_ID_MISSION_CLEAR_ALL:
            return [self._clear(sender)]
        return [] if kind == mavlink.MAVLINK_MSG_ID_MISSION_ACK else [self._downloaded(message, sender)]

    def step(self, now_s: float) -> list[Message]:
        """What is due: the item that has not come, requested again; the end of an upload that stopped."""
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
        self._sender, self.items = None, list(self._received)
        return _answer(sender, ACCEPTED)

    def _clear(self, sender: tuple[int, int]) -> Message:
        if self._sender is not None:
            return _answer(sender, mavlink.MAV_MISSION_ERROR)
        self.items = []
        return _answer(sender, ACCEPTED)

    def _request(self, now_s: float) -> Message:
        """ArduPilot requests by the older message."""
        assert self._sender is not None
        self._requested_s = now_s
        older, newer = mavlink.MAVLink_mission_request_message, mavlink.MAVLink_mission_request_int_message
        return (older if self._is_ardupilot else newer)(*self._sender, len(self._received), MISSION)

    def _downloaded(self, message: Message, sender: tuple[int, int]) -> Message:
        if self._sender is not None:
            return _answer(sender, mavlink.MAV_MISSION_DENIED)
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_LIST:
            return mavlink.MAVLink_mission_count_message(*sender, len(self.items), MISSION)
        if message.seq >= len(self.items):
            return _answer(sender, mavlink.MAV_MISSION_INVALID_SEQUENCE)
        item = copy.copy(self.items[message.seq])
        item.target_system, item.target_component = sender
        if self._is_ardupilot and item.command == mavlink.MAV_CMD_NAV_WAYPOINT:
            item.param4 = 0.0 if math.isnan(item.param4) else item.param4
        return item


def _answer(sender: tuple[int, int], result: int) -> Message:
    return mavlink.MAVLink_mission_ack_message(*sender, result, MISSION)
