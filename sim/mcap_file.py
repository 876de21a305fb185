"""`lookback mcap`: a feed as an MCAP file with Foxglove's schemas, and back; Foxglove opens it as it is.

    /camera    foxglove.CompressedImage, JSON: the picture file's own bytes
    /position  foxglove.LocationFix, JSON: where the position is known
    /row       lookback.Row, JSON: what else the feed's row knows
    /feed      lookback.Feed, JSON: the feed's header, once

A file that was cut short (a crash, a full disk) is read up to where it ends.
"""

from __future__ import annotations

import argparse
import base64
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeAlias

import cv2
import msgspec
import numpy as np

from edge.camera.feed import Feed, FeedHeader, FeedImages, FeedRow, FeedWriter, read_feed
from edge.camera.feed_rows import MEASURES
from edge.errors import ConfigError, FeedError

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
    "/row": (
        "lookback.Row",
        {name: {"type": "number"} for name in MEASURES[2:]},
    ),
    "/feed": ("lookback.Feed", {"name": {"type": "string"}, "view": {"type": "string"}}),
}
Fields: TypeAlias = dict[str, Any]


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `lookback mcap` to the command line; an entry point of `lookback.commands`."""
    actions = commands.add_parser("mcap", help="feeds as MCAP files, and back").add_subparsers(required=True)
    write = actions.add_parser("write", help="write a feed as an MCAP file for Foxglove")
    write.add_argument("feed", type=Path, metavar="FEED")
    write.add_argument("-o", "--output", type=Path, required=True, metavar="FILE")
    write.set_defaults(run=lambda args: _write(read_feed(args.feed), args.output))
    read = actions.add_parser("read", help="make a feed of such a file again")
    read.add_argument("file", type=Path, metavar="FILE")
    read.add_argument("-o", "--output", type=Path, required=True, metavar="FEED")
    read.set_defaults(run=lambda args: _read(args.file, args.output))


def _write(feed: Feed, path: Path) -> int:
    try:
        from mcap.writer import Writer
    except ModuleNotFoundError as error:
        raise ConfigError(f"MCAP needs {error.name}: pip install 'lookback[desk]'") from None
    try:
        with path.open("xb") as stream:
            writer: Any = Writer(stream)
            writer.start(profile="", library="lookback")
            channels = {topic: _register(writer, topic) for topic in SCHEMAS}
            for topic, stamp_ns, fields in _messages(feed):
                writer.add_message(channels[topic], stamp_ns, msgspec.json.encode(fields), stamp_ns)
            writer.finish()
    except OSError as error:
        raise FeedError(f"{path}: cannot write it: {error.strerror}") from None
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
            unknown = {"position_covariance": [0.0] * 9, "position_covariance_type": 0}
            yield "/position", row.stamp_ns, {"timestamp": stamp, "frame_id": FRAME, **where, **unknown}
        known = {name: getattr(row, name) for name in MEASURES[2:]}
        yield "/row", row.stamp_ns, {**known, "extra": dict(row.extra)}


def _picture(feed: Feed, images: FeedImages, index: int) -> tuple[str, bytes]:
    """The picture file as it is; a video's frame as a JPEG."""
    if not feed.header.video:
        file = feed.path / feed.rows[index].file
        kind = "png" if file.suffix.lower() == ".png" else "jpeg"
        return kind, file.read_bytes()
    return "jpeg", cv2.imencode(".jpg", images.read(index), [cv2.IMWRITE_JPEG_QUALITY, 92])[1].tobytes()


def _read(path: Path, output: Path) -> int:
    header, rows = None, list[tuple[FeedRow, bytes]]()
    for topic, stamp_ns, fields in _read_messages(path):
        if topic == "/feed":
            header = msgspec.convert(fields, FeedHeader)
        elif topic == "/camera":
            rows.append((FeedRow("", stamp_ns), base64.b64decode(fields["data"])))
        elif rows and rows[-1][0].stamp_ns == stamp_ns:
            rows[-1] = (_with_fields(rows[-1][0], topic, fields), rows[-1][1])
    if header is None or not rows:
        raise FeedError(f"{path}: no feed in it; for other recordings there is `lookback sim import rosbag`")
    extra = tuple(dict.fromkeys(key for row, _ in rows for key in row.extra))
    with FeedWriter(output, header, extra) as writer:
        for row, data in rows:
            image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
            if image is None:
                raise FeedError(f"{path}: the picture of {row.stamp_ns} ns is damaged")
            known = {name: getattr(row, name) for name in MEASURES}
            writer.write(np.asarray(image, dtype=np.uint8), row.stamp_ns, **known, extra=row.extra)
    print(f"{output}: {len(rows)} frames")
    return 0


def _with_fields(row: FeedRow, topic: str, fields: Fields) -> FeedRow:
    known = {name: getattr(row, name) for name in MEASURES}
    if topic == "/position":
        known |= {"lat_deg": fields["latitude"], "lon_deg": fields["longitude"]}
    elif topic == "/row":
        known |= {name: fields[name] for name in MEASURES[2:]}
    return FeedRow(row.file, row.stamp_ns, **known, extra=fields.get("extra", row.extra))


def _read_messages(path: Path) -> Iterator[tuple[str, int, Fields]]:
    """All whole messages of our topics, in the order in which they were written."""
    try:
        from mcap.exceptions import McapError
        from mcap.reader import NonSeekingReader
    except ModuleNotFoundError as error:
        raise ConfigError(f"MCAP needs {error.name}: pip install 'lookback[desk]'") from None
    count = 0
    try:
        with path.open("rb") as stream:
            # Not by the index at its end, which a file that was cut short has not; and not sorted, which needs all.
            for _, channel, message in NonSeekingReader(stream).iter_messages(list(SCHEMAS), log_time_order=False):
                count += 1
                yield channel.topic, message.log_time, msgspec.json.decode(message.data)
    except OSError as error:
        raise FeedError(f"{path}: cannot read it: {error.strerror}") from None
    except (McapError, struct.error, msgspec.DecodeError) as error:  # struct's: a record without its end
        if not count:
            raise FeedError(f"{path}: not an MCAP file: {error}") from None
