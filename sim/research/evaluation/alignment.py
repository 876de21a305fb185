"""Videos as phones write them, laid over the tracks of receivers: how far off they lie, and whether sigma is true.

    python -m sim.research.evaluation.alignment --seeds 7001 7002 --cache FOLDER [--page docs/recordings.md]

Each road is driven in another light, at another speed, with a front or a rear camera that turns up to 6 m ahead of the
antenna, as of a bus, or 1 m behind it. Of eight videos four have the creation time of a phone with Android; the
others have none. The frame rate of all falls to a third half-way. Drives are kept in FOLDER. --page writes the table
between the marks of a page.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory

import av
import numpy as np

import edge
from edge.errors import FeedError
from edge.feed import Feed, FeedImages, read_feed
from edge.geodesy import east_north_of, moved
from sim.datasets import Traverse, open_dataset
from sim.research.evaluation.tables import options, publish
from sim.world.recording import record_drive
from sim.world.scenario import LightName, Scenario

BEGUN = datetime(2026, 5, 4, 12, 30, 20, tzinfo=timezone.utc)
"""When the first picture was taken, by the satellites' time."""
LEAD_S = 6.0
"""By so much the track was switched on earlier."""
AHEAD_M = -1.0, 0.0, 2.0, 6.0
LIGHTS: tuple[LightName, ...] = ("day", "night", "dusk", "rain")


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


def write_track(feed: Feed, file: Path, shift_s: float = 0.0, seed: int = 0) -> None:
    """A GPX track of a position a second, as noisy as a receiver's, from LEAD_S before the drive on (standing)."""
    rng = np.random.default_rng(seed)
    stamps_s = np.array([row.stamp_ns for row in feed.rows]) / 1e9
    at_s = np.arange(-LEAD_S, stamps_s[-1] + 5.0)
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


@dataclass(frozen=True)
class Laid:
    """A video that was laid over its track: how far off, by which sigma, in s, and its positions' errors in m."""

    off_s: float
    sigma_s: float
    errors_m: tuple[float, ...]


def lay(number: int, seed: int, length_m: float, cache: Path) -> Laid | None:
    """The drive of a number over a road; None where the video was refused."""
    scenario = Scenario(
        seed=seed,
        length_m=length_m,
        speed_mps=6.0 + number % 5,
        stops=number % 2,
        drive_seed=number + 1,
        light=LIGHTS[number % 4],
        view=("front", "rear")[number // 2 % 2],
        shaking=1.0,
        width=160,
        height=120,
        camera_ahead_m=AHEAD_M[number // 5 % 4],
    )
    drive = cache / f"{seed}-{number}-{length_m:g}"
    if not drive.exists():
        record_drive(scenario, drive, fps=10.0)
    truth = read_feed(drive)
    with TemporaryDirectory() as passing:
        video = Path(passing) / "out.mp4"
        write_phone_video(truth, video, of_android(truth) if number // 4 % 2 else None)
        write_track(truth, video.with_suffix(".gpx"), seed=number)
        try:
            traverse = open_dataset("video-log", video)
        except FeedError:
            return None
        traverse.pictures.close()
    found = traverse.alignment
    assert found is not None
    assert found.sigma_s is not None
    return Laid(found.offset_s - LEAD_S, found.sigma_s, tuple(errors_m(traverse, truth)))


def rows(seeds: Sequence[int], length_m: float, cache: Path) -> Iterator[str]:
    """The table: all videos, and those with and without a creation time."""
    tried = [lay(number, seed, length_m, cache) for number, seed in enumerate(seeds)]
    command = f"python -m sim.research.evaluation.alignment --seeds {seeds[0]} ... {seeds[-1]}"
    yield f"`{command}` of version {edge.__version__}:"
    yield ""
    yield (
        "| creation time | videos, refused | off, median / largest | sigma, median | within one sigma, two"
        " | largest, in sigmas | position error, median of all / of the worst video |"
    )
    yield "|---|---|---|---|---|---|---|"
    for name, group in (("none", 0), ("as of Android", 1)):
        yield _row(name, [one for number, one in enumerate(tried) if number // 4 % 2 == group])


def _row(name: str, tried: Sequence[Laid | None]) -> str:
    laid = [one for one in tried if one is not None]
    if not laid:
        return f"| {name} | {len(tried)}, {len(tried)} | - | - | - | - | - |"
    off_s, sigmas_s = (np.array([getattr(one, what) for one in laid]) for what in ("off_s", "sigma_s"))
    off_s, medians_m = np.abs(off_s), [np.median(one.errors_m) for one in laid]
    over = off_s / sigmas_s
    return (
        f"| {name} | {len(tried)}, {len(tried) - len(laid)} | {np.median(off_s):.2f} / {off_s.max():.2f} s"
        f" | {np.median(sigmas_s):.2f} s | {(over < 1).sum()}, {(over < 2).sum()} of {len(laid)} | {over.max():.1f}"
        f" | {np.median(np.concatenate([one.errors_m for one in laid])):.1f} / {max(medians_m):.1f} m |"
    )


def main() -> None:
    """Print the table for the seeds."""
    args = options(__doc__, 600.0).parse_args()
    publish("alignment", rows(args.seeds, args.length, args.cache), args.page)


if __name__ == "__main__":
    main()
