"""Bytes to MAVLink messages and back: pymavlink's generated dialect, used as a codec only.

That of ArduPilot, which has all common messages as well; both EKF_STATUS_REPORT and VISION_POSITION_DELTA are its own.

Not `mavutil`: it imports GPL modules, swallows write errors and opens ports that others hold.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

if TYPE_CHECKING:
    from edge.telemetry.signing import Signer, Stream

# pymavlink's messages have no static types; `Message` says where one is meant.
Message: TypeAlias = Any

TRIM_BYTES = 16_384
OLDEST_TICKS = 6_000_000
"""A minute, in the 10 us of signed timestamps: MAVLink's limit for the first frame of a stream, here for all."""
USELESS_FRAMES = 10
"""In a row, after which the next one may begin within the last. Not sooner: what a damaged one carries is no frame."""
MARKERS = (mavlink.PROTOCOL_MARKER_V1, mavlink.PROTOCOL_MARKER_V2)
"""The first byte of a frame."""


class FusionStatus(mavlink.MAVLink_message):  # type: ignore[misc]  # pymavlink has no types
    """ESTIMATOR_SENSOR_FUSION_STATUS of PX4 1.18, which pymavlink does not have yet: which instances of each source,
    GPS first, the filter is set to fuse, and which it fuses, a bit for each."""

    id, msgname, crc_extra = 514, "ESTIMATOR_SENSOR_FUSION_STATUS", 197
    unpacker, orders, lengths = struct.Struct("<9f9B9B"), (1, 2, 0), (9, 9, 9)

    def __init__(self, intended: Sequence[int], active: Sequence[int], test_ratio: Sequence[float]) -> None:
        super().__init__(self.id, self.msgname)
        self._fieldnames = ["intended", "active", "test_ratio"]
        self.intended, self.active, self.test_ratio = intended, active, test_ratio


mavlink.mavlink_map.setdefault(FusionStatus.id, FusionStatus)


class _Parser(mavlink.MAVLink):  # type: ignore[misc]  # pymavlink has no types
    """pymavlink's codec, which loses no link for good."""

    buf: bytearray
    buf_index: int
    checked: Callable[..., None]
    """Called with the stream of each signed frame, and whether it `is_signed` with our key and new."""
    _useless_in_a_row = 0

    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:  # noqa: N803  # its names
        """As pymavlink has it, but for three things. It stores a frame's timestamp before it checks the signature: one
        forged frame that is dated far ahead would lock the real sender out for good. It hears what a component has
        signed on each link of its own, so that what another link carried could be replayed beside it. And it asks only
        the first frame of a stream to be at most a minute old: a recording could be played ever more slowly.
        """
        stream: Stream = msgbuf[-13], srcSystem, srcComponent
        newest = self.signing.stream_timestamps
        before = newest.get(stream)
        of_the_same = (at for (_, *sender), at in newest.items() if sender == [srcSystem, srcComponent])
        newest[stream] = max(self.signing.timestamp - OLDEST_TICKS - 1, *of_the_same, 0)
        is_signed = bool(super().check_signature(msgbuf, srcSystem, srcComponent))
        if not is_signed and before is None:
            newest.pop(stream, None)
        elif not is_signed:
            newest[stream] = before
        self.checked(stream, is_signed=is_signed)
        return is_signed

    def parse_char(self, c: Sequence[int]) -> Any:
        """The next message in what has arrived; after many useless ones, also from within the last of those.

        A damaged frame, or one that is not known, is dropped with all the bytes that it claims. Where all frames are as
        long as that, each begins within another one for ever.
        """
        message = super().parse_char(c)
        if message is None:
            return None
        frame = message.get_msgbuf()
        if message.get_msgId() >= 0:
            self._useless_in_a_row = 0
        elif frame[0] in MARKERS:  # pymavlink also returns the noise between frames
            self._useless_in_a_row += 1
        if self._useless_in_a_row > USELESS_FRAMES:
            self._useless_in_a_row = 0
            rest = self.buf[self.buf_index :]
            self.buf, self.buf_index = bytearray(frame[1:]) + rest, 0
        return message


class MavlinkCodec:
    """One end of one link: its identity, its sequence counter and its partly received frame."""

    def __init__(self, system_id: int, component_id: int, signer: Signer | None = None) -> None:
        """With a `Signer` all that goes out is signed, and nothing unsigned is decoded."""
        self.component_id = component_id
        self._mavlink = _Parser(None, srcSystem=system_id, srcComponent=component_id)
        self._mavlink.robust_parsing = True  # noise becomes BAD_DATA instead of an exception
        self._signer = signer
        if signer is not None:
            signer.attach(self._mavlink)

    @property
    def system_id(self) -> int:
        """The system id that messages are sent with."""
        return int(self._mavlink.srcSystem)

    @system_id.setter
    def system_id(self, system_id: int) -> None:
        self._mavlink.srcSystem = system_id

    @property
    def awaits_signed(self) -> bool:
        """Whether frames are signed, and none with a valid signature has arrived yet."""
        return self._signer is not None and not self._mavlink.signing.goodsig_count

    def encode(self, message: Message) -> bytes:
        """One MAVLink 2 frame with the next sequence number."""
        if self._signer is not None:
            self._signer.advance()
        frame = bytes(message.pack(self._mavlink))
        self._mavlink.seq = (self._mavlink.seq + 1) % 256
        return frame

    def store_timestamps(self) -> None:
        """To be called when nothing will be sent or decoded for a while."""
        if self._signer is not None:
            self._signer.store()

    def decode(self, data: bytes) -> list[Message]:
        """The messages completed by `data`, without noise and without messages that the dialect does not know.

        Noise passes the 16-bit checksum now and then: the caller still has to filter by system and component.
        """
        if not data:
            return []
        if self._signer is not None:
            self._signer.follow_clock()
        messages = self._mavlink.parse_buffer(data) or []
        if self._mavlink.buf_index > TRIM_BYTES:  # pymavlink only empties its buffer when a read ends with a frame
            del self._mavlink.buf[: self._mavlink.buf_index]
            self._mavlink.buf_index = 0
        return [message for message in messages if message.get_msgId() >= 0]
