"""The header of a feed, `feed.toml`, parsed and checked."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from edge.camera.feed_rows import stays_inside
from edge.errors import FeedError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

View = Literal["front", "rear"]
Pixels = Annotated[int, msgspec.Meta(ge=1, le=16384)]


class FeedHeader(msgspec.Struct, frozen=True):
    """`feed.toml`; keys that are not listed here are ignored."""

    name: str
    view: View
    width: Pixels
    height: Pixels
    source: str = ""
    notes: str = ""
    video: str = ""


def read_header(file: Path) -> FeedHeader:
    """Read and check `feed.toml`; FeedError names it, and the key."""
    try:
        header = msgspec.convert(tomllib.loads(file.read_text(encoding="utf-8")), FeedHeader)
    except OSError as error:
        raise FeedError(f"{file}: cannot read it: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, msgspec.ValidationError, UnicodeDecodeError) as error:
        raise FeedError(f"{file}: {error}") from None
    if header.video and not stays_inside(header.video):
        raise FeedError(f"{file}: video: {header.video!r} leads out of the feed's folder")
    return header
