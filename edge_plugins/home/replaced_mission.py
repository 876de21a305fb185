"""A mission as MAVLink has it; a copy of what an upload replaces, and a mark while that may be cut off, in a file.

Both are on the disk before the autopilot is asked to change anything. So the start after a kill or a power cut knows
that the autopilot may have a mixture, and by which items to recognize it. Beside it is what was replaced as a file of
waypoints, which a ground station uploads again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import msgspec
from msgspec.structs import replace
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.errors import reason
from edge.files import PersistentFile, replacing
from edge.telemetry.codec import Message
from edge_plugins.home.route import MissionItem

SAME_DEG = 2.5e-7  # 2 of MAVLink's 1e-7: PX4 stores degrees as floating-point numbers, and truncates them
SAME_M = 0.02
SAME_PARAM = 1e-3
SAME_FRAMES = {mavlink.MAV_FRAME_GLOBAL_INT: 0, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT: 3}
"""Frames of integers, which firmware may answer with instead of the others."""
MISSION = mavlink.MAV_MISSION_TYPE_MISSION


class MissionBackup(msgspec.Struct, frozen=True):
    """The file. replaced, uploaded: the missions; is_settled: whether the autopilot cannot have a part of the upload.

    first: number of the first item that counts; 1 where item 0 is the autopilot's own home position.
    """

    system_id: int = 0
    first: int = 0
    replaced: tuple[MissionItem, ...] = ()
    uploaded: tuple[MissionItem, ...] = ()
    is_settled: bool = True


class ReplacedMission:
    """What is kept of the newest upload."""

    def __init__(self, path: Path | None) -> None:
        """path: None keeps it in memory only, and writes no file of waypoints beside it."""
        self._waypoints = path and path.with_suffix(".waypoints")
        self._file = PersistentFile(path, MissionBackup, "a mission that was cut off is not known")
        self.kept = self._file.read() or MissionBackup()

    @property
    def where(self) -> str:
        """The file of the mission that was replaced, as the end of a sentence; "" where there was none."""
        is_kept = self._waypoints is not None and len(self.kept.replaced) > self.kept.first
        return f"; the mission before it: {self._waypoints}" if is_kept else ""

    def begin(self, system_id: int, first: int, present: Sequence[MissionItem], uploaded: Sequence[MissionItem]) -> str:
        """Keep the present mission, unless it is what earlier uploads have left; returns why that failed, or ""."""
        is_known = self.kept.system_id == system_id and self._explains(present)
        replaced = self.kept.replaced if is_known else tuple(present)
        why = self._store(MissionBackup(system_id, first, replaced, tuple(uploaded), is_settled=False))
        if not self.where or self._waypoints is None:
            return why
        try:
            with replacing(self._waypoints) as stream:
                # The format's item 0 is the home position.
                stream.write(as_waypoints(replaced if first else (replaced[0], *replaced)))
        except OSError as error:
            return reason(error)
        return why

    def settle(self) -> None:
        """The autopilot has all of the upload, or nothing of it."""
        if not self.kept.is_settled:
            self._store(replace(self.kept, is_settled=True))

    def is_cut_off(self, present: Sequence[MissionItem]) -> bool:
        """Whether it is a part of the upload, or a mixture of that with what it replaced; not if it is another one."""
        before = self.kept.replaced
        pairs = list(zip(present, before, strict=False))[self.kept.first :]
        is_as_before = len(present) == len(before) and all(is_same(item, other) for item, other in pairs)
        return self._explains(present) and not is_as_before

    def _explains(self, present: Sequence[MissionItem]) -> bool:
        """Whether each item is of the upload or of what it replaced: nobody has written another mission since."""
        missions = self.kept.replaced, self.kept.uploaded
        return all(
            any(number < len(one) and is_same(item, one[number]) for one in missions)
            for number, item in enumerate(present)
            if number >= self.kept.first
        )

    def _store(self, kept: MissionBackup) -> str:
        self.kept = kept
        return self._file.write(kept)


def as_waypoints(items: Sequence[MissionItem]) -> bytes:
    """QGC WPL 110, which Mission Planner, MAVProxy and QGroundControl read; item 0 is the home position."""
    rows = ["QGC WPL 110", *(_row(number, item) for number, item in enumerate(items))]
    return ("\n".join(rows) + "\n").encode()


def _row(number: int, item: MissionItem) -> str:
    params = (f"{param or 0.0:.8f}" for param in item.params)
    position = f"{item.lat_deg:.8f}\t{item.lon_deg:.8f}\t{item.altitude_m or 0.0:.6f}"
    fields = [number, int(number == 0), item.frame, item.command, *params, position, item.goes_on]
    return "\t".join(map(str, fields))


def mission_item(item: Message) -> MissionItem:
    """An item of MISSION_ITEM_INT."""
    one, two, three, four, altitude_m = (
        None if math.isnan(value) else value for value in (item.param1, item.param2, item.param3, item.param4, item.z)
    )
    position = item.x / 1e7, item.y / 1e7, altitude_m
    return MissionItem(item.command, item.frame, (one, two, three, four), *position, item.autocontinue)


def item_message(system_id: int, number: int, item: MissionItem) -> Message:
    """MISSION_ITEM_INT of an item."""
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
