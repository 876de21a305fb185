"""Writes a feed frame by frame."""

from __future__ import annotations

import contextlib
import csv
import errno
import io
import os
from collections.abc import Sequence
from pathlib import Path

import cv2
import msgspec
import numpy as np
import tomli_w
from numpy.typing import NDArray

from edge.errors import FeedError
from edge.feed.format import MEASURES, SOURCE, FeedHeader, FeedRow

JPEG_QUALITY = 92
PNG_BEGINS = b"\x89PNG"


class FeedWriter:
    """Writes a feed frame by frame: picture first, then its row, so that a crash or a full disk leaves whole rows."""

    def __init__(
        self, path: Path, header: FeedHeader, extra_columns: tuple[str, ...] = (), *, begins: Sequence[int] = ()
    ) -> None:
        """Create the folder; FeedError if it already has a feed in it, or cannot be written.

        begins: the stamps in ns of all frames that will be written; what an interrupted writer left of these is kept.
        """
        self.path = path
        self._whole_bytes = 0
        self._extra_columns = extra_columns
        usual = {"lens": "pinhole", "distortion": ()}
        known = {key: one for key, one in msgspec.structs.asdict(header).items() if one not in (None, usual.get(key))}
        text = tomli_w.dumps(known)
        begun = self._count_begun(text, begins)
        self.count = begun or 0
        """Frames that are written."""
        if begun:
            self._file = (path / "frames.csv").open("r+b", buffering=0)
            self._file.truncate(self._whole_bytes)
            self._file.seek(self._whole_bytes)
            return
        if begun is None and (path / "frames.csv").exists():
            raise FeedError(f"{path}: a feed already exists here; name another folder")
        try:
            (path / "frames").mkdir(parents=True, exist_ok=True)
            (path / "feed.toml").write_text(text, encoding="utf-8")
            self._file = (path / "frames.csv").open("wb", buffering=0)
            self._append(["file", "stamp_ns", *MEASURES, SOURCE, *extra_columns])
        except OSError as error:
            raise FeedError(f"{path}: cannot write a feed here: {error.strerror}") from None

    def _count_begun(self, header: str, stamps_ns: Sequence[int]) -> int | None:
        """How many frames of this very feed are there already; None where there is none, another one, or all of it."""
        with contextlib.suppress(OSError, ValueError, IndexError):
            data = (self.path / "frames.csv").read_bytes()
            whole = data[: data.rfind(b"\n") + 1]
            there = [int(row.split(b",", 2)[1]) for row in whole.splitlines()[1:]]
            is_same = (self.path / "feed.toml").read_text(encoding="utf-8") == header
            if is_same and there == list(stamps_ns[: len(there)]) and len(there) < len(stamps_ns):
                self._whole_bytes = len(whole)
                return len(there)
        return None

    def write(self, image: NDArray[np.uint8] | bytes, row: FeedRow) -> None:
        """Append one frame; image (H, W, 3) uint8 BGR, or the bytes of a JPEG or PNG file, which are kept as they are.

        row: what is known of it; its `file` is named here. OSError when the disk is full: what was written stays whole.
        """
        if not isinstance(image, bytes):
            image = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
        name = f"frames/{self.count:06d}.{'png' if image.startswith(PNG_BEGINS) else 'jpg'}"
        try:
            (self.path / name).write_bytes(image)
            known = ["" if value is None else repr(float(value)) for value in (getattr(row, name) for name in MEASURES)]
            source = "" if row.lat_deg is None else row.position_source
            others = [row.extra.get(key, "") for key in self._extra_columns]
            self._append([name, str(row.stamp_ns), *known, source, *others])
        except OSError:
            (self.path / name).unlink(missing_ok=True)
            raise
        self.count += 1

    def _append(self, values: list[str]) -> None:
        """Append one row whole, or not at all."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerow(values)
        line = text.getvalue().encode()
        try:
            if self._file.write(line) != len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError:
            self._file.truncate(self._whole_bytes)
            self._file.seek(self._whole_bytes)
            raise
        self._whole_bytes += len(line)

    def __enter__(self) -> FeedWriter:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the row file; more than once is harmless."""
        self._file.close()
