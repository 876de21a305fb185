"""Positions in the SEI messages of Tesla's dashcam clips, made from what Tesla publishes, without a clip to try it on.

Since firmware 2025.44.25 (HW3 or later) each picture of a clip that is recorded while driving comes with a message of
`dashcam.proto`: a NAL unit of type SEI (H.264: 6; H.265: 39, 40) with a payload of type 5, of bytes 0x42, then 0x69,
then the protobuf (https://github.com/teslamotors/dashcam, sei_extractor.py and dashcam.proto).
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import av
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

from edge.errors import FeedError
from edge.feed import Feed
from sim.datasets.track import Fix

log = logging.getLogger(__name__)

_KIND = descriptor_pb2.FieldDescriptorProto
FIELDS = {
    "gear_state": (2, _KIND.TYPE_INT32),  # an enumeration
    "frame_seq_no": (3, _KIND.TYPE_UINT64),
    "vehicle_speed_mps": (4, _KIND.TYPE_FLOAT),
    "latitude_deg": (11, _KIND.TYPE_DOUBLE),
    "longitude_deg": (12, _KIND.TYPE_DOUBLE),
    "heading_deg": (13, _KIND.TYPE_DOUBLE),
}
"""Those of SeiMetadata that are used, their numbers and types in dashcam.proto."""
GEAR_REVERSE = 2
USER_DATA_UNREGISTERED = 5
NAL_HEADER = {"h264": 1, "hevc": 2}
"""Bytes, by FFmpeg's name of the codec."""


def read_clip(file: Path, feed: Feed) -> list[Fix]:
    """The position of each picture of a clip that comes with one, but while it drives in reverse. FeedError."""
    try:
        # Packets come in the order of decoding, a feed's rows in that of showing.
        found = [message for _, message in sorted(_packets(file), key=lambda one: one[0])]
    except (av.FFmpegError, IndexError) as error:
        raise FeedError(f"{file}: not a whole video: {error}") from None
    known = [(row, one) for row, one in zip(feed.rows, found, strict=False) if one is not None]
    lost = sum(max(0, after.frame_seq_no - before.frame_seq_no - 1) for (_, before), (_, after) in pairwise(known))
    if lost:
        log.warning("%s: %d pictures are missing in it, by their numbers", file.name, lost)
    return [
        Fix(
            row.stamp_ns,
            one.latitude_deg,
            one.longitude_deg,
            heading_deg=one.heading_deg,
            speed_mps=one.vehicle_speed_mps,
            source="gps",
        )
        for row, one in known
        if one.gear_state != GEAR_REVERSE
    ]


def _packets(file: Path) -> Iterator[tuple[int, Any]]:
    """The time of each picture in the stream's unit, and its message, None without one."""
    kind = _message_class()
    with av.open(str(file)) as video:
        stream = video.streams.video[0]
        codec, settings = stream.codec_context.name, stream.codec_context.extradata or b""
        if codec not in NAL_HEADER:
            return
        # lengthSizeMinusOne of avcC and hvcC (ISO/IEC 14496-15).
        length_bytes = (settings[4 if codec == "h264" else 21] & 3) + 1
        for packet in video.demux(stream):
            if packet.pts is not None:
                bodies = (_body(nal, codec) for nal in _nal_units(bytes(packet), length_bytes))
                yield packet.pts, next((_decoded(kind, body) for body in bodies if body), None)


def _nal_units(data: bytes, length_bytes: int) -> Iterator[bytes]:
    at = 0
    while at + length_bytes < len(data):
        end = at + length_bytes + int.from_bytes(data[at : at + length_bytes], "big")
        yield data[at + length_bytes : end]
        at = end


def _body(nal: bytes, codec: str) -> bytes:
    """The protobuf in a NAL unit; empty if it is none of Tesla's."""
    header = NAL_HEADER[codec]
    is_sei = nal[0] & 0x1F == 6 if codec == "h264" else (nal[0] >> 1) & 0x3F in (39, 40)
    if not is_sei or len(nal) <= header + 2 or nal[header] != USER_DATA_UNREGISTERED:
        return b""
    marked = nal[header + 2 : -1]  # without the payload's size, and the byte that ends the NAL unit
    body = marked.lstrip(b"\x42")
    if len(body) == len(marked) or body[:1] != b"\x69":
        return b""
    return body[1:].replace(b"\0\0\3", b"\0\0")  # bytes that keep a start code from appearing (H.264, 7.4.1)


def _decoded(kind: Any, body: bytes) -> Any:
    try:
        return kind.FromString(body)
    except DecodeError:
        return None


def _message_class() -> Any:
    """SeiMetadata with FIELDS; others of its fields are skipped."""
    file = descriptor_pb2.FileDescriptorProto(name="dashcam.proto", syntax="proto3")
    message = file.message_type.add(name="SeiMetadata")
    for name, (number, kind) in FIELDS.items():
        message.field.add(name=name, number=number, type=kind, label=_KIND.LABEL_OPTIONAL)
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(file.SerializeToString())
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("SeiMetadata"))
