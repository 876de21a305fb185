"""`lookback dev mcap`: convert feeds to MCAP files with Foxglove's schemas, and back. They are read in place of feeds.

    /camera    foxglove.CompressedImage, JSON: the picture file's own bytes
    /position  foxglove.LocationFix, JSON: where the position is known
    /row       lookback.Row, JSON: the other values of the feed's row
    /feed      lookback.Feed, JSON: the feed's header, once

A file that was cut short (a crash, a full disk) is read up to where it ends.
"""

from __future__ import annotations

import argparse
import base64
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.errors import FeedError
from edge.feed import Feed, FeedHeader, FeedImages, FeedOptions, FeedRow, decode_picture, read_feed
from edge.feed.format import MEASURES, SOURCE
from edge.feed.writer import FeedWriter
from edge.geodesy import PositionSource
from sim.datasets.pictures import PicturesInOrder
from sim.output import needing, refusing

FRAME = "camera"
STAMP = {"type": "object", "title": "time", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
SCHEMAS: dict[str, tuple[str, dict[str, Any]]] = {
    "/camera": (
        "foxglove.CompressedImage",
        {
            "timestamp": STAMP,
            "frame_id": {"type": "string"},
            "data": {"type": "string", "contentEncoding": "base64"},
            "format": {"type": "string"},
        },
    ),
    "/position": (
        "foxglove.LocationFix",
        {
            "timestamp": STAMP,
            "frame_id": {"type": "string"},
            **{name: {"type": "number"} for name in ("latitude", "longitude", "altitude")},
            "position_covariance": {"type": "array", "items": {"type": "number"}, "minItems": 9, "maxItems": 9},
            "position_covariance_type": {"type": "integer"},
        },
    ),
    "/row": ("lookback.Row", {**{name: {"type": "number"} for name in MEASURES[2:]}, SOURCE: {"type": "string"}}),
    "/feed": ("lookback.Feed", {"name": {"type": "string"}, "view": {"type": "string"}}),
}
Fields: TypeAlias = dict[str, Any]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback dev mcap`."""
    actions = parser.add_subparsers(required=True)
    write = actions.add_parser("write", help="convert a feed to an MCAP file for Foxglove")
    write.add_argument("feed", type=Path, metavar="FEED")
    write.add_argument("-o", "--output", type=Path, required=True, metavar="FILE")
    write.set_defaults(run=lambda args: _write(read_feed(args.feed), args.output))
    read = actions.add_parser("read", help="write such a file as a feed")
    read.add_argument("file", type=Path, metavar="FILE")
    read.add_argument("-o", "--output", type=Path, required=True, metavar="FEED")
    read.set_defaults(run=lambda args: _read(args.file, args.output))


def _write(feed: Feed, path: Path) -> int:
    with needing("MCAP", "desk"):
        from mcap.writer import Writer
    with refusing(FeedError, f"{path}: cannot write it"), path.open("xb") as stream:
        writer: Any = Writer(stream)
        writer.start(profile="", library="lookback")
        channels = {topic: _register(writer, topic) for topic in SCHEMAS}
        for topic, stamp_ns, fields in _messages(feed):
            writer.add_message(channels[topic], stamp_ns, msgspec.json.encode(fields), stamp_ns)
        writer.finish()
    print(f"{path}: {len(feed.rows)} frames")
    return 0


def _register(writer: Any, topic: str) -> int:
    name, properties = SCHEMAS[topic]
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": name, "type": "object"}
    data = msgspec.json.encode({**schema, "properties": properties})
    schema_id = writer.register_schema(name=name, encoding="jsonschema", data=data)
    return int(writer.register_channel(topic=topic, message_encoding="json", schema_id=schema_id))


def _messages(feed: Feed) -> Iterator[tuple[str, int, Fields]]:
    images = FeedImages(feed)
    yield "/feed", feed.rows[0].stamp_ns, msgspec.to_builtins(msgspec.structs.replace(feed.header, video=""))
    for index, row in enumerate(feed.rows):
        stamp = {"sec": row.stamp_ns // 10**9, "nsec": row.stamp_ns % 10**9}
        kind, data = _picture(feed, images, index)
        picture = {"timestamp": stamp, "frame_id": FRAME, "format": kind, "data": base64.b64encode(data).decode()}
        yield "/camera", row.stamp_ns, picture
        if row.lat_deg is not None and row.lon_deg is not None:
            where = {"latitude": row.lat_deg, "longitude": row.lon_deg, "altitude": row.alt_m or 0.0}
            yield "/position", row.stamp_ns, {"timestamp": stamp, "frame_id": FRAME, **where, **_covariance(row)}
        known = {name: getattr(row, name) for name in (*MEASURES[2:], SOURCE)}
        yield "/row", row.stamp_ns, {**known, "extra": dict(row.extra)}


def _covariance(row: FeedRow) -> Fields:
    """That of a LocationFix: approximated, and nothing known of the altitude; all zero where not known."""
    per_axis = (row.position_sigma_m or 0.0) ** 2 / 2
    diagonal = [per_axis, 0.0, 0.0, 0.0, per_axis, 0.0, 0.0, 0.0, 0.0]
    return {"position_covariance": diagonal, "position_covariance_type": int(per_axis > 0)}


def _picture(feed: Feed, images: FeedImages, index: int) -> tuple[str, bytes]:
    """The picture file as it is; a video's frame as a JPEG."""
    if not feed.header.video and feed.pictures is None:
        file = feed.path / feed.rows[index].file
        kind = "png" if file.suffix.lower() == ".png" else "jpeg"
        return kind, file.read_bytes()
    return "jpeg", cv2.imencode(".jpg", images.read(index), [cv2.IMWRITE_JPEG_QUALITY, 92])[1].tobytes()


class _Picture(msgspec.Struct):
    data: bytes  # in base64


class _Where(msgspec.Struct):
    latitude: float
    longitude: float


class _Row(msgspec.Struct):
    alt_m: float | None = None
    heading_deg: float | None = None
    speed_mps: float | None = None
    distance_m: float | None = None
    position_sigma_m: float | None = None
    position_source: PositionSource = "unknown"
    extra: dict[str, str] = {}


Message: TypeAlias = _Picture | _Where | _Row | FeedHeader
MESSAGES: Mapping[str, Any] = {"/camera": _Picture, "/position": _Where, "/row": _Row, "/feed": FeedHeader}


def _pictures(path: Path) -> PicturesInOrder:
    return PicturesInOrder(str(path), lambda: _read_messages(path, ["/camera"]), _decoded)


def _decoded(where: str, message: tuple[int, Message]) -> NDArray[np.uint8]:
    """A picture, (H, W, 3) uint8 BGR. FrameError, which begins with `where`."""
    return decode_picture(where, _data_of(message))


def _data_of(message: tuple[int, Message]) -> bytes:
    """The file of a picture as it was recorded."""
    assert isinstance(message[1], _Picture)
    return message[1].data


def open_feed(path: Path, options: FeedOptions) -> Feed:
    """Such a file as a feed; the entry point of `lookback.feeds`. FeedError, or ConfigError without the library."""
    if options != FeedOptions():
        raise FeedError(f"{path}: an MCAP file has no use for --view and --video")
    header, rows = None, list[FeedRow]()
    for stamp_ns, message in _read_messages(path, list(MESSAGES)):
        if isinstance(message, FeedHeader):
            header = message
        elif isinstance(message, _Picture):
            if rows and stamp_ns <= rows[-1].stamp_ns:
                raise FeedError(f"{path}: /camera: a picture of {stamp_ns} ns comes after one of {rows[-1].stamp_ns}")
            rows.append(FeedRow("", stamp_ns))
        elif rows and rows[-1].stamp_ns == stamp_ns:
            rows[-1] = _with_message(rows[-1], message)
    if header is None or not rows:
        raise FeedError(f"{path}: no feed in it; a recording of ROS 2 is read by `lookback import`")
    return Feed(path, header, tuple(rows), lambda: _pictures(path))


def is_feed(path: Path) -> bool:
    """Whether such a file was written here, by the name in its first record; others are of ROS 2."""
    with refusing(FeedError, f"{path}: cannot read it"), path.open("rb") as stream:
        return b"lookback" in stream.read(64)


def _with_message(row: FeedRow, message: _Where | _Row) -> FeedRow:
    if isinstance(message, _Where):
        return replace(row, lat_deg=message.latitude, lon_deg=message.longitude)
    return replace(row, **msgspec.structs.asdict(message))


def _read(path: Path, output: Path) -> int:
    feed, pictures = open_feed(path, FeedOptions()), _pictures(path)
    extra = tuple(dict.fromkeys(key for row in feed.rows for key in row.extra))
    with FeedWriter(output, feed.header, extra) as writer:
        for index, row in enumerate(feed.rows):
            writer.write(_data_of(pictures.message(index)), row)
    print(f"{output}: {len(feed.rows)} frames")
    return 0


def _read_messages(path: Path, topics: Sequence[str]) -> Iterator[tuple[int, Message]]:
    """Stamp and content of all whole messages of some topics, in the order in which they were written."""
    with needing("MCAP", "desk"):
        from mcap.exceptions import McapError
        from mcap.reader import NonSeekingReader
    is_mcap = False
    try:
        with path.open("rb") as stream:
            # Not by the index at its end, which a file that was cut short has not; and not sorted, which needs all.
            for _, channel, message in NonSeekingReader(stream).iter_messages(topics, log_time_order=False):
                is_mcap = True
                if channel.message_encoding == "json":  # a topic of ROS may have the same name
                    yield message.log_time, msgspec.json.decode(message.data, type=MESSAGES[channel.topic])
    except OSError as error:
        raise FeedError(f"{path}: cannot read it: {error.strerror}") from None
    except msgspec.DecodeError as error:
        raise FeedError(f"{path}: {channel.topic}: {error}") from None
    except (McapError, struct.error) as error:  # struct's: a record without its end
        if not is_mcap:
            raise FeedError(f"{path}: not an MCAP file: {error}") from None
    except Exception as error:  # of the library, and of what it unpacks with, which check little of what they read
        raise FeedError(f"{path}: damaged, it cannot be read: {type(error).__name__}: {error}") from None
