"""Requests for the way home or a route of the config: a command addressed to us, until the mission is verified.

A request only uploads a mission: nothing in here arms a vehicle, starts a mission or changes a mode. It is rejected
unless the vehicle is known, in a mode in which it does not drive by itself, and its position is known; and unless every
check of the way passes.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.errors import SetupError
from edge.journal.records import Record, unit
from edge.telemetry import encoders
from edge.telemetry.autopilot import AutopilotConnection
from edge.telemetry.codec import Message
from edge.telemetry.firmware import FIRMWARES
from edge.telemetry.session import Session
from edge_plugins.home import HomeConfig
from edge_plugins.home.mission_transfer import MissionTransfer, Next
from edge_plugins.home.replaced_mission import ReplacedMission
from edge_plugins.home.route import MissionItem, RoutePlan, RouteStart, mission_items

HOME_COMMAND, HOME_PARAMS = mavlink.MAV_CMD_USER_5, (1, 5665)
"""With parameters 1 and 2; 5665 is LOOK on a telephone's keys. Others may use the command, so both must be there:
ArduPilot's pull request 33167 has MAV_CMD_USER_1 with 1 stand for a spoofed GPS. Parameter 3 is the number of a route
of [home] routes, from 1; 0, as whoever leaves it out sends, is the way home."""
ON_THE_GROUND = (mavlink.MAV_TYPE_GROUND_ROVER, mavlink.MAV_TYPE_SURFACE_BOAT)
REPEATED_NS = 10_000_000_000
"""How long after an answer the same command with a confirmation count is a repetition, whose answer was lost."""
CHECK_AGAIN_NS = 30_000_000_000
"""From a check of a mission that may be cut off to the next, where the first came to no end."""
Plan = Callable[[RouteStart, Sequence[str]], RoutePlan]
Sender = tuple[int, int]
"""System and component of a command."""
log = logging.getLogger(__name__)


class HomeAnswered(Record, frozen=True, tag="home"):
    """A request for the way home or a route was answered; docs/home.md describes requests."""

    verified: Annotated[bool, unit("", "whether the autopilot now has the mission, downloaded again and compared")]
    text: Annotated[str, unit("", "what was uploaded, or why nothing was")]
    items: Annotated[int, unit("", "items of the mission, with ArduPilot's home position; 0 if nothing was uploaded")]


@dataclass(frozen=True)
class HomeReply:
    """The answer to a request. result: MAV_RESULT; items: of the mission; text: one line for people.

    brief: what the pilot reads of it, if not all.
    """

    result: int
    text: str
    items: int = 0
    brief: str = ""

    @property
    def is_accepted(self) -> bool:
        """Whether the autopilot now has the mission."""
        return bool(self.result == mavlink.MAV_RESULT_ACCEPTED)

    @property
    def is_final(self) -> bool:
        """Whether no other answer follows."""
        return bool(self.result != mavlink.MAV_RESULT_IN_PROGRESS)


@dataclass(frozen=True)
class Upload:
    """A transfer that is running. items: of the mission. done, brief, failed: words for both of its ends.

    asker: None where nobody has requested it: a mission that may be cut off is checked.
    """

    transfer: MissionTransfer
    items: int
    done: str
    brief: str
    failed: str
    asker: Sender | None = None


class HomeRequestError(Exception):
    """A request that cannot be done now; carries its MAV_RESULT, the reason, and what a pilot reads of that."""

    def __init__(self, result: int, why: str, brief: str = "") -> None:
        super().__init__(why)
        self.result, self.brief = result, brief or why


class HomeRequests:
    """At most one request at a time; messages that are due are returned, and sent by the caller."""

    def __init__(self, config: HomeConfig, link: AutopilotConnection) -> None:
        """link: whose autopilot gets the mission. The mission that is replaced is kept in a file beside the journal."""
        self._config = config
        self._vehicle, self._drive = link.vehicle, link.drive
        self._record, self._send_text = link.record, link.status_text
        self.plan: Plan | None = None
        """Plans the way through some places, home for none; None while there is no map."""
        self._upload: Upload | None = None
        journal = link.config.journal
        self._replaced = ReplacedMission(Path(journal).with_suffix(".mission") if journal else None)
        self._check: tuple[Session, int] | None = None  # where the pilot was warned, and when the mission is read next
        self._last: tuple[Sender, int, HomeReply] | None = None  # to whom, when, what

    def read(self, message: Message, now_ns: int, *, is_for_us: bool) -> list[Message]:
        """Read a message of any component on the autopilot's link; the messages that are due because of it.

        is_for_us: addressed to this very component, since a broadcast replaces no mission.
        """
        kind = message.get_msgId()
        if kind == mavlink.MAVLINK_MSG_ID_COMMAND_LONG and message.command == HOME_COMMAND:
            return self._command(message, now_ns) if is_for_us else []
        if self._upload is None or not (is_for_us or kind == mavlink.MAVLINK_MSG_ID_MISSION_CURRENT):
            return []
        sender = message.get_srcSystem(), message.get_srcComponent()
        if sender != (self._vehicle.system_id, mavlink.MAV_COMP_ID_AUTOPILOT1):
            return []
        return [*self._upload.transfer.read(message, now_ns), *self._finished(now_ns)]

    def due(self, now_ns: int) -> list[Message]:
        """Repetitions of what was not answered; the transfer is canceled if the vehicle begins to drive by itself."""
        if self._upload is None:
            return self._check_if_due(now_ns)
        transfer, why = self._upload.transfer, self._why_not_now()
        messages = transfer.cancel(why, now_ns) if why else []
        return [*messages, *transfer.due(now_ns), *self._finished(now_ns)]

    def abandon(self, now_ns: int) -> list[Message]:
        """End the transfer, if there is one: this program ends. A mission that is being driven is left alone."""
        if self._upload is None:
            return []
        messages = self._upload.transfer.abandon()
        return [*([] if self._vehicle.drives_itself else messages), *self._finished(now_ns)]

    def _command(self, message: Message, now_ns: int) -> list[Message]:
        sender = message.get_srcSystem(), message.get_srcComponent()
        if self._upload is not None and sender == self._upload.asker:
            return self._reply(sender, HomeReply(mavlink.MAV_RESULT_IN_PROGRESS, ""), now_ns)
        if message.confirmation and self._last is not None:
            to, answered_ns, answer = self._last
            if to == sender and now_ns - answered_ns < REPEATED_NS:
                return [encoders.acknowledgement(HOME_COMMAND, answer.result, answer.items, *sender)]
        if (message.param1, message.param2) != HOME_PARAMS:
            denied = HomeReply(mavlink.MAV_RESULT_DENIED, "parameters 1 and 2 of the command are not 1 and 5665")
            return self._reply(sender, denied, now_ns)
        return self._request(sender, message.param3, now_ns)

    def _request(self, asker: Sender, number: float, now_ns: int) -> list[Message]:
        """Request a route, 0 being the way home: the first answer, and the first of the transfer."""
        home_first, config = self._vehicle.session.firmware.home_is_item_0, self._config
        name = f"route {number:g}" if number else "way home"
        try:
            self._check_request()
            way = self._planned(number, now_ns)
        except HomeRequestError as error:
            refused = HomeReply(error.result, f"no {name}: {error}", brief=f"no {name}: {error.brief}")
            return self._reply(asker, self._answered(refused), now_ns)
        for warning in way.briefs(refuses=False):
            self._send_text(f"Lookback: {name}: {warning}", mavlink.MAV_SEVERITY_WARNING)
        items = mission_items(way, speed_mps=config.speed_mps, altitude_m=config.altitude_m, home_first=home_first)
        system_id = self._vehicle.target_id

        def keep(present: list[MissionItem]) -> Next:
            if self._replaced.begin(system_id, int(home_first), present, items):
                self._send_text("Lookback: cannot keep the mission that is replaced", mavlink.MAV_SEVERITY_WARNING)
            return "upload"

        transfer = MissionTransfer(items, system_id, first_is_home=home_first, decide=keep)
        brief = f"{name} ready, {way.length_m:.0f} m, {len(way.along_m)} waypoints"
        self._upload = Upload(transfer, len(items), f"uploaded and verified: {way}", brief, f"no {name}", asker)
        log.info("uploading %s", way)
        begun = HomeReply(mavlink.MAV_RESULT_IN_PROGRESS, f"uploading {way}")
        return [*self._reply(asker, begun, now_ns), *transfer.start(now_ns)]

    def _check_request(self) -> None:
        """Rejected where no request can be done now."""
        if not self._config.enabled:
            raise HomeRequestError(mavlink.MAV_RESULT_DENIED, "[home] enabled is false")
        why = "a mission is being uploaded" if self._upload is not None else self._why_not_now()
        if why:
            raise HomeRequestError(mavlink.MAV_RESULT_TEMPORARILY_REJECTED, why)
        if self._vehicle.session.autopilot not in FIRMWARES:
            names = " nor ".join(one.name for one in FIRMWARES.values())
            raise HomeRequestError(mavlink.MAV_RESULT_DENIED, f"neither {names}")

    def _check_if_due(self, now_ns: int) -> list[Message]:
        """Look at the mission where an upload of an earlier run was cut off, and clear it if it is a part of that."""
        kept, vehicle = self._replaced.kept, self._vehicle
        if kept.is_settled or not vehicle.connected or vehicle.system_id != kept.system_id:
            return []
        if self._check is None or self._check[0] is not vehicle.session:
            self._check = vehicle.session, now_ns
            text = "Lookback: upload cut off, do not start the mission"  # 50 characters, one STATUSTEXT
            log.warning("%s", text)
            self._send_text(text, mavlink.MAV_SEVERITY_WARNING)
        if now_ns < self._check[1] or self._why_not_now():
            return []
        self._check = vehicle.session, now_ns + CHECK_AGAIN_NS

        def clear_if_cut_off(present: list[MissionItem]) -> Next:
            return "clear" if self._replaced.is_cut_off(present) else "leave"

        transfer = MissionTransfer((), kept.system_id, first_is_home=bool(kept.first), decide=clear_if_cut_off)
        self._upload = Upload(transfer, 0, "", "", "mission checked")
        return transfer.start(now_ns)

    def _planned(self, number: float, now_ns: int) -> RoutePlan:
        """The route of a number from here; Rejected."""
        if self._vehicle.session.kind not in ON_THE_GROUND and not self._config.altitude_m:
            why = "not a ground vehicle or boat, and [home] altitude_m is 0"
            raise HomeRequestError(mavlink.MAV_RESULT_DENIED, why, "[home] altitude_m is 0")
        routes = ("", *self._config.routes)
        if number not in range(len(routes)):
            why = f"[home] routes has {len(routes) - 1}"
            raise HomeRequestError(mavlink.MAV_RESULT_DENIED, why)
        position, sigma_m = self._vehicle.position(now_ns), self._drive.state.own_sigma_m
        if position is None or sigma_m is None or self.plan is None:
            what = "autopilot has no position" if position is None else "position error not known"
            raise HomeRequestError(
                mavlink.MAV_RESULT_TEMPORARILY_REJECTED, "there is no map" if self.plan is None else what
            )
        start = RouteStart(position.lat_deg, position.lon_deg, position.heading_deg, sigma_m)
        try:
            way = self.plan(start, routes[int(number)].split())
        except SetupError as error:
            raise HomeRequestError(mavlink.MAV_RESULT_FAILED, str(error), "see Lookback's log") from None
        if way.refusals:
            more = f" (and {len(way.refusals) - 1} more)" if len(way.refusals) > 1 else ""
            why, brief = way.refusals[0] + more, way.briefs(refuses=True)[0]
            raise HomeRequestError(mavlink.MAV_RESULT_FAILED, why, brief)
        return way

    def _why_not_now(self) -> str:
        """Why no mission may be replaced at the moment; "" if it may."""
        if not self._vehicle.connected:
            return "no autopilot is connected"
        drives = self._vehicle.drives_itself
        if drives is None:
            return "the mode is not known yet"
        # Also of one that has just changed: it must last for a while, see `edge.telemetry.session`.
        return "select Manual; ask in 3 s" if drives else ""

    def _finished(self, now_ns: int) -> list[Message]:
        """The final answer, once the transfer has ended."""
        upload = self._upload
        if upload is None or upload.transfer.outcome is None:
            return []
        outcome, self._upload = upload.transfer.outcome, None
        if outcome.is_settled:
            self._replaced.settle()
        if outcome.verified:
            done = f"{upload.done}{self._replaced.where}"
            answer = self._answered(HomeReply(mavlink.MAV_RESULT_ACCEPTED, done, upload.items, upload.brief))
        else:
            more = self._replaced.where if outcome.is_settled and upload.asker is None else ""
            why = f"{upload.failed}: {outcome.why}"
            answer = self._answered(HomeReply(mavlink.MAV_RESULT_FAILED, why + more, brief=why))
        return [] if upload.asker is None else self._reply(upload.asker, answer, now_ns)

    def _answered(self, answer: HomeReply) -> HomeReply:
        """Publish a final answer."""
        log.info("way home: %s", answer.text)
        self._record(HomeAnswered(answer.is_accepted, answer.text, answer.items))
        severity = mavlink.MAV_SEVERITY_INFO if answer.is_accepted else mavlink.MAV_SEVERITY_WARNING
        self._send_text(f"Lookback: {answer.brief}", severity)
        return answer

    def _reply(self, asker: Sender, answer: HomeReply, now_ns: int) -> list[Message]:
        """The acknowledgement for whoever requested; kept where no other follows, to be repeated."""
        if answer.is_final:
            self._last = asker, now_ns, answer
        return [encoders.acknowledgement(HOME_COMMAND, answer.result, answer.items, *asker)]
