"""Videos as phones write them, and tracks as receivers do, of simulated drives."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timedelta, timezone
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from edge.feed import Feed, FeedImages
from edge.geodesy import east_north_of, moved
from sim.datasets import Traverse

BEGUN = datetime(2026, 5, 4, 12, 30, 20, tzinfo=timezone.utc)
"""When the first picture was taken, by the satellites' time."""
LEAD_S = 6.0
"""By so much the track was switched on earlier."""


def write_phone_video(feed: Feed, file: Path, metadata: Mapping[str, str] | None = None, *, gray: bool = False) -> None:
    """An MP4 of all pictures, and of every third from its middle on; gray: of a camera that shows nothing."""
    images = FeedImages(feed)
    with av.open(str(file), "w", options={"movflags": "use_metadata_tags"}) as container:
        container.metadata.update(metadata or {})
        stream = container.add_stream("libx264", rate=30, options={"preset": "ultrafast"})
        stream.width, stream.height, stream.pix_fmt = feed.header.width, feed.header.height, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        for index, row in enumerate(feed.rows):
            if index < len(feed.rows) // 2 or index % 3 == 0:
                image = (
                    np.full((feed.header.height, feed.header.width, 3), 90, np.uint8) if gray else images.read(index)
                )
                frame = av.VideoFrame.from_ndarray(image, "bgr24")
                frame.pts, frame.time_base = row.stamp_ns // 1_000_000, Fraction(1, 1000)
                container.mux(stream.encode(frame))
        container.mux(stream.encode())


def of_android(feed: Feed) -> dict[str, str]:
    """What a phone with Android writes into a video: when it ended, in whole seconds."""
    ended = BEGUN + timedelta(seconds=feed.rows[-1].stamp_ns / 1e9)
    return {"com.android.version": "14", "creation_time": ended.strftime("%Y-%m-%dT%H:%M:%SZ")}


def write_track(
    feed: Feed, file: Path, shift_s: float = 0.0, seed: int = 0, *, lead_s: float = LEAD_S, more_s: float = 5.0
) -> None:
    """A GPX track of a position a second, as noisy as a receiver's, from lead_s before the drive on (standing)."""
    rng = np.random.default_rng(seed)
    stamps_s = np.array([row.stamp_ns for row in feed.rows]) / 1e9
    at_s = np.arange(-lead_s, stamps_s[-1] + more_s)
    wander_m, points = rng.normal(0, 1.5, 2), []
    for time_s in at_s:
        wander_m += rng.normal(0, 0.2, 2) - 0.01 * wander_m
        lat_deg, lon_deg = (
            np.interp(time_s, stamps_s, [getattr(row, name) for row in feed.rows]) for name in ("lat_deg", "lon_deg")
        )
        at = moved(float(lat_deg), float(lon_deg), *(wander_m + rng.normal(0, 0.1, 2)).tolist())
        time = (BEGUN + timedelta(seconds=float(time_s) + shift_s)).isoformat()
        points.append(f'<trkpt lat="{at[0]:.7f}" lon="{at[1]:.7f}"><time>{time}</time></trkpt>')
    track = f"<trk><trkseg>{''.join(points)}</trkseg></trk>"
    file.write_text(f'<gpx version="1.1" creator="test" xmlns="http://www.topografix.com/GPX/1/1">{track}</gpx>')


def errors_m(traverse: Traverse, truth: Feed) -> list[float]:
    """How far each picture's position is from where it was taken, m; of pictures that have one."""
    known = {row.stamp_ns: row for row in truth.rows}
    found = []
    for row in traverse.rows:
        at_ns = row.stamp_ns - traverse.rows[0].stamp_ns
        true = known[min(known, key=lambda stamp_ns, at_ns=at_ns: abs(stamp_ns - at_ns))]  # type: ignore[misc]
        if row.lat_deg is not None and row.lon_deg is not None:
            assert true.lat_deg is not None
            assert true.lon_deg is not None
            found.append(float(np.hypot(*east_north_of(row.lat_deg, row.lon_deg, (true.lat_deg, true.lon_deg), 0.0))))
    return found
