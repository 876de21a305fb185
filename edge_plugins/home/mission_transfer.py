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

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal, TypeAlias, TypeVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.backoff import Exchange
from edge.telemetry.acknowledgements import result_name
from edge.telemetry.codec import Message
from edge_plugins.home.replaced_mission import MISSION, is_same, item_message, mission_item
from edge_plugins.home.route import MissionItem

REPLY_NS, ITEM_NS = 1_500_000_000, 250_000_000
REPETITIONS = 5
UPLOAD_NS = 150_000_000_000
"""For all items: 700 of them take a minute on a slow line."""
CLEAR_REPETITIONS = 8
"""ArduPilot refuses to clear a mission until an upload that stopped has timed out, after 8 s."""
Next: TypeAlias = Literal["upload", "clear", "leave"]
BUSY = (mavlink.MAV_MISSION_ERROR, mavlink.MAV_MISSION_DENIED)
"""Refusals of firmware that is in another transfer, or has not noticed its end."""
ACCEPTED = mavlink.MAV_MISSION_ACCEPTED
ACK, COUNT = mavlink.MAVLINK_MSG_ID_MISSION_ACK, mavlink.MAVLINK_MSG_ID_MISSION_COUNT
ITEM, CURRENT = mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT, mavlink.MAVLINK_MSG_ID_MISSION_CURRENT
REQUESTS = (mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_INT, mavlink.MAVLINK_MSG_ID_MISSION_REQUEST)


@dataclass(frozen=True)
class TransferResult:
    """How a transfer ended. verified: the autopilot has exactly these items, and begins with the first.

    why: what went wrong, "" if nothing. is_settled: whether the autopilot cannot have a part of the items.
    """

    verified: bool
    why: str = ""
    is_settled: bool = True


class TransferError(Exception):
    """The transfer cannot succeed; carries the reason."""


class Request(Exchange):
    """Messages the last of which has to be answered, and how often they are sent again while it is not."""

    def __init__(self, messages: list[Message], wait_ns: int = REPLY_NS, repetitions: int = REPETITIONS) -> None:
        super().__init__(wait_ns, most=1 + repetitions)
        self.messages = messages


T = TypeVar("T")
Steps: TypeAlias = Generator["Request | None", "Message | None", T]
"""Yields what is to be sent, or None to wait for a further message. It gets each message that comes, and None where no
answer has come in time, not even to the last repetition."""


class MissionTransfer:
    """One upload; `outcome` is None while it runs. Read `_transfer` first: what is sent and awaited, step by step."""

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
        self._items, self._system_id, self._first_is_home, self._decide = items, system_id, first_is_home, decide
        self.outcome: TransferResult | None = None
        self._phase: Literal["look", "upload", "verify", "begin", "clear"] = "look"
        self._began = False  # the autopilot may have changed its mission
        self._steps = self._whole()
        self._request = Request([])
        self._started_ns = 0

    def start(self, now_ns: int) -> list[Message]:
        """The first message."""
        self._started_ns = now_ns
        return self._advance(partial(next, self._steps), now_ns)

    def due(self, now_ns: int) -> list[Message]:
        """What has not been answered in time, again; a failure after the last repetition."""
        request = self._request
        if self._phase != "clear" and now_ns - self._started_ns > UPLOAD_NS:
            return self.cancel("the upload takes too long", now_ns)
        if self.outcome is not None or not request.is_overdue(now_ns):
            return []
        if not request.is_given_up:
            request.ask(now_ns)
            return request.messages
        return self._advance(partial(self._steps.send, None), now_ns)

    def read(self, message: Message, now_ns: int) -> list[Message]:
        """Read a message of the autopilot that is addressed to us, or to nobody; returns the answers."""
        is_mission = message.get_msgId() == CURRENT or getattr(message, "mission_type", None) == MISSION
        if self.outcome is not None or not is_mission:
            return []
        return self._advance(partial(self._steps.send, message), now_ns)

    def cancel(self, why: str, now_ns: int) -> list[Message]:
        """End it without success."""
        if self.outcome is not None or self._phase == "clear":
            return []
        return self._advance(partial(self._steps.throw, TransferError(why)), now_ns)

    def abandon(self) -> list[Message]:
        """End it without waiting for an answer; PX4 keeps its last mission, where ArduPilot would have a part of each.

        Both take an empty mission at once, where they would refuse to clear theirs until the upload has timed out.
        """
        if self.outcome is not None:
            return []
        # PX4 stores what is complete.
        is_stored = self._phase != "look" and (self._first_is_home or self._phase != "upload")
        self.outcome = TransferResult(verified=False, why="Lookback ended", is_settled=not is_stored)
        empty = [mavlink.MAVLink_mission_count_message(self._system_id, 1, 0, MISSION)] if is_stored else []
        return [self._ended(mavlink.MAV_MISSION_OPERATION_CANCELLED), *empty]

    def _advance(self, step: Callable[[], Request | None], now_ns: int) -> list[Message]:
        """Go on to the next exchange, if there is one; the messages that it sends."""
        try:
            request = step()
        except StopIteration as end:
            self.outcome = end.value
            return []
        if request is None:
            return []
        self._request = request
        request.ask(now_ns)
        return request.messages

    def _whole(self) -> Steps[TransferResult]:
        """The transfer, and what follows where it fails: the autopilot may have a mission of old and new items."""
        try:
            return (yield from self._transfer())
        except TransferError as error:
            why = str(error)
        if not self._began:
            return TransferResult(verified=False, why=why, is_settled=self._phase == "look")
        # PX4 ignores the second during a transfer, and waits 5 s for one that has stopped.
        return (yield from self._clear(mavlink.MAV_MISSION_OPERATION_CANCELLED, why))

    def _transfer(self) -> Steps[TransferResult]:
        counted = yield from self._answer(self._list(), lambda message: message.get_msgId() == COUNT)
        present = yield from self._download(counted.count)
        decision = self._decide(present)
        if decision == "leave":
            yield Request([self._ended()], wait_ns=0, repetitions=0)
            return TransferResult(verified=False, why="the mission is not one that was cut off")
        if decision == "clear":
            return (yield from self._clear(ACCEPTED, "a mission that was cut off is cleared"))
        yield from self._upload()
        self._phase = "begin"
        # PX4 ignores the second while it waits for the first, so both are repeated. ArduPilot answers with the number
        # that it was sent, PX4 sends that once a second.
        begin = [self._ended(), mavlink.MAVLink_mission_set_current_message(self._system_id, 1, 0)]
        yield from self._answer(Request(begin), lambda message: message.get_msgId() == CURRENT and message.seq == 0)
        return TransferResult(verified=True)

    def _upload(self) -> Steps[None]:
        """Send the items that are requested, until the autopilot has all of them as they were sent."""
        count = mavlink.MAVLink_mission_count_message(self._system_id, 1, len(self._items), MISSION)
        request = Request([self._ended(), count])
        is_assumed = False  # complete: the last acknowledgement may be lost, which the download will show
        while True:
            self._phase = "upload"
            message = yield request
            while message is not None and not self._is_upload_answer(message):
                message = yield None
            if message is None:
                if request.most > 1:
                    raise TransferError(self._unanswered())
                is_assumed = True  # repeated, the item would be an error for ArduPilot
            if message is None or message.get_msgId() == ACK:
                self._phase = "verify"
                message = yield from self._answer(self._list(), partial(_is_listed, is_assumed=is_assumed))
            if message.get_msgId() == COUNT:
                break
            # It waits for an item: for the last one, where it does not say for which.
            last = len(self._items) - 1
            number = message.seq if message.get_msgId() in REQUESTS else last
            self._began = True
            if number > last:
                raise TransferError(f"the autopilot requests item {number} of {len(self._items)}")
            item = item_message(self._system_id, number, self._items[number])
            request = Request([item], repetitions=0 if number == last and not is_assumed else REPETITIONS)
        if message.count != len(self._items):
            raise TransferError(f"the autopilot has {message.count} items of {len(self._items)}")
        yield from self._download(message.count, self._items)

    def _is_upload_answer(self, message: Message) -> bool:
        """Whether it requests an item, or accepts all of them; Failed where it refuses them."""
        if message.get_msgId() != ACK:
            return message.get_msgId() in REQUESTS
        if message.type in BUSY and not self._began:
            self._request.most = 1 + CLEAR_REPETITIONS
        elif message.type != mavlink.MAV_MISSION_INVALID_SEQUENCE:  # of an item that was repeated
            _check(message.type)
            return self._began
        return False

    def _download(self, count: int, sent: Sequence[MissionItem] | None = None) -> Steps[list[MissionItem]]:
        """The autopilot's items, each of which must be as it was sent, if it was."""
        items: list[MissionItem] = []
        for number in range(count):
            request = mavlink.MAVLink_mission_request_int_message(self._system_id, 1, number, MISSION)
            item = yield from self._answer(Request([request], ITEM_NS), partial(_is_item, number=number))
            items.append(mission_item(item))
            is_compared = sent is not None and not (self._first_is_home and number == 0)
            if sent is not None and is_compared and not is_same(items[-1], sent[number]):
                raise TransferError(f"item {number} is not the one that was uploaded")
        return items

    def _clear(self, ended: int, why: str) -> Steps[TransferResult]:
        """Clear the mission, after the transfer has `ended` with a MAV_MISSION_RESULT."""
        self._phase = "clear"
        clear = mavlink.MAVLink_mission_clear_all_message(self._system_id, 1, MISSION)
        request = Request([self._ended(ended), clear], repetitions=CLEAR_REPETITIONS)
        try:
            yield from self._answer(request, lambda message: message.get_msgId() == ACK and message.type == ACCEPTED)
        except TransferError:
            why += "; do not start the autopilot's mission: it may be incomplete, and could not be cleared"
            return TransferResult(verified=False, why=why, is_settled=False)
        return TransferResult(verified=False, why=why)

    def _answer(self, request: Request, is_answer: Callable[[Message], bool]) -> Steps[Message]:
        """Send, and wait for the answer; Failed where the autopilot refuses, or does not answer."""
        message = yield request
        while message is not None and not is_answer(message):
            if message.get_msgId() == ACK and self._phase == "look" and message.type != ACCEPTED:
                request.most = 1 + CLEAR_REPETITIONS  # busy with an upload that was cut off, for 8 s
            elif message.get_msgId() == ACK and self._phase != "clear":  # which is tried again after an error
                _check(message.type)
            message = yield None
        if message is None:
            raise TransferError(self._unanswered())
        return message

    def _unanswered(self) -> str:
        """What it means that no answer has come."""
        if self._phase == "begin":
            return "the autopilot does not go back to the first item"
        # Without a request the count may have arrived or not; ArduPilot cuts its mission down to it.
        doubt = "" if self._began or self._phase == "look" else "; look at the autopilot's mission before you start it"
        return f"the autopilot does not answer{doubt}"

    def _list(self) -> Request:
        return Request([mavlink.MAVLink_mission_request_list_message(self._system_id, 1, MISSION)])

    def _ended(self, result: int = ACCEPTED) -> Message:
        return mavlink.MAVLink_mission_ack_message(self._system_id, 1, result, MISSION)


def _is_listed(message: Message, *, is_assumed: bool) -> bool:
    """Whether it answers a request for the list; or, where an upload was assumed complete, shows that it is not."""
    kind = message.get_msgId()
    is_waiting = kind in REQUESTS or (kind == ACK and message.type == mavlink.MAV_MISSION_DENIED)
    return kind == COUNT or (is_assumed and is_waiting)


def _is_item(message: Message, *, number: int) -> bool:
    return bool(message.get_msgId() == ITEM and message.seq == number)


def _check(result: int) -> None:
    if result != ACCEPTED:
        name = result_name(result, "MAV_MISSION_RESULT", "MAV_MISSION_")
        raise TransferError(f"the autopilot refuses the mission: {name}")
