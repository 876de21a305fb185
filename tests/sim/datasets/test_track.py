from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from edge.errors import FeedError
from edge.feed import Feed, FeedHeader
from sim.datasets.track import Track, TrackFix
from sim.datasets.track_files import TRACKS
from sim.traverse import driven_m
from tests.common import S

EPOCH = 1_714_557_600 * S


def stamps(*seconds: float) -> np.ndarray:
    return np.array([EPOCH + round(second * S) for second in seconds], dtype=np.int64)


def test_headings_turn_the_short_way_through_north() -> None:
    fixes = [TrackFix(EPOCH + i * S, 51.0, -1.0, heading_deg=heading) for i, heading in enumerate((350, 10, 30, 350))]
    headings = [fix.heading_deg for fix in Track("log", fixes).at(stamps(0.25, 0.5, 1.5, 2.5))]
    assert headings == pytest.approx([355, 0, 20, 10])


def test_what_some_fixes_lack_is_not_made_up() -> None:
    fixes = [TrackFix(EPOCH, 51.0, -1.0, alt_m=100.0), TrackFix(EPOCH + S, 51.0002, -1.0)]
    row = Track("log", fixes).rows("pictures", ["0.png"], stamps(0.5).tolist())[0]
    assert row.lat_deg == pytest.approx(51.0001)
    assert (row.alt_m, row.heading_deg, row.speed_mps) == (None, None, None)


def test_fixes_are_sorted_and_the_first_of_equal_stamps_counts_and_zero_is_no_position() -> None:
    fixes = [
        TrackFix(EPOCH + 2 * S, 51.2, -1.0),
        TrackFix(EPOCH, 51.0, -1.0),
        TrackFix(EPOCH, 40.0, -1.0),
        TrackFix(EPOCH - S, 0.0, 0.0),
    ]
    assert [fix.lat_deg for fix in Track("log", fixes).fixes] == [51.0, 51.2]
    with pytest.raises(FeedError, match=r"^log: 1 position\(s\) in it, and two at least are needed"):
        Track("log", fixes[1:])


def test_nanoseconds_since_1970_keep_their_precision() -> None:
    track = Track("log", [TrackFix(EPOCH, 51.0, -1.0), TrackFix(EPOCH + S, 51.0, -1.0, speed_mps=math.nan)])
    assert [fix.stamp_ns for fix in track.at(np.array([EPOCH + 1, EPOCH + 3]))] == [EPOCH + 1, EPOCH + 3]


@pytest.mark.parametrize("period_s", [0.02, 0.2, 1.0])
def test_a_car_at_a_red_light_drives_nowhere_though_its_receiver_wanders(period_s: float) -> None:
    random = np.random.default_rng(2)
    seconds = np.arange(0, 100, period_s)
    true_m = np.interp(seconds, [0, 10, 70, 80, 100], [0, 50, 50, 100, 100])
    measured_m = true_m[:, None] * [0, 1] + random.uniform(-0.25, 0.25, (len(seconds), 2))
    fixes = [
        TrackFix(int(stamp), 51.0 + north / 111_250, -1.0 + east / 70_190)
        for stamp, (east, north) in zip(stamps(*seconds), measured_m, strict=True)
    ]
    pictures = np.arange(0, 99, 0.1)
    rows = Track("log", fixes).rows("pictures", [""] * len(pictures), stamps(*pictures).tolist())
    driven = driven_m(Feed(Path("log"), FeedHeader("log", "front", 1, 1), rows))
    assert driven is not None
    assert driven[-1] == pytest.approx(100, abs=6)
    standing = slice(110, 690)  # from 11 s to 69 s
    assert np.hypot(*np.diff(measured_m[(seconds > 11) & (seconds < 69)], axis=0).T).sum() > 14  # says the receiver
    assert driven[standing][-1] - driven[standing][0] < 2.0
    north_m = (np.array([row.lat_deg for row in rows], dtype=np.float64) - 51.0) * 111_250
    away_m = np.abs(north_m - np.interp(pictures, [0, 10, 70, 80, 100], [0, 50, 50, 100, 100]))
    # What counts as standing, what is driven in a period, and what the receiver is off.
    assert away_m.max() < 1.0 + 5.0 * period_s + 0.5
    assert away_m[standing].max() < 1.5


DAY_S = 86_400


def driven(times_s: list[float]) -> list[TrackFix]:
    """Positions 10 m apart, at these times."""
    return [
        TrackFix(EPOCH + round(time_s * S), 51.0 + 1e-4 * row, -1.0, source="gps") for row, time_s in enumerate(times_s)
    ]


@pytest.mark.parametrize("wrong", [[0], [0, 1, 2], [50], [99], [20, 21, 60]])
@pytest.mark.parametrize("off_s", [-4 * 365 * DAY_S, -3600, -10, 10, 3600, 30 * DAY_S])
def test_positions_whose_time_jumps_are_dropped_and_named(
    wrong: list[int], off_s: int, caplog: pytest.LogCaptureFixture
) -> None:
    fixes = driven([row + off_s * (row in wrong) for row in range(100)])
    found = Track("drive.gpx", fixes)
    left = {fix.lat_deg for fix in fixes} - {fix.lat_deg for fix in found.fixes}
    is_at_end = (wrong[0] == 0 and off_s < 0) or (wrong == [99] and off_s > 0)
    if is_at_end and abs(off_s) < DAY_S:  # a halt, for all that is known
        assert not left and not caplog.messages
    else:
        assert left == {fixes[row].lat_deg for row in wrong}
        assert caplog.messages[0].startswith(
            f"drive.gpx: {len(wrong)} of 100 positions are dropped, whose times jump against those beside them: 20"
        )


def test_messages_that_changed_places_are_kept_and_so_are_drives_in_another_order() -> None:
    swapped = [float(row) for row in range(100)]
    swapped[40], swapped[41] = swapped[41], swapped[40]
    assert len(Track("log", driven(swapped)).fixes) == 100
    evening_first = [*range(30_000, 30_050), *range(50)]
    assert len(Track("log", driven([float(one) for one in evening_first])).fixes) == 100


def test_more_than_a_day_is_no_drive() -> None:
    with pytest.raises(FeedError, match=r"^log: its positions are from 20.* UTC, and one drive is a day at most"):
        Track("log", driven([*range(50), *range(3 * DAY_S, 3 * DAY_S + 50)]))
    with pytest.raises(FeedError, match="one drive is a day at most"):
        Track("log", driven([1000.0 * row for row in range(100)]))


@pytest.mark.parametrize("year", [1, 9999])
def test_a_year_that_fits_no_stamp_is_one_line_or_dropped(
    year: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A receiver before its first fix says such; numpy raised OverflowError."""
    pytest.importorskip("gpxpy")
    times = [f"{year:04}-12-31T12:00:{second:02}Z" for second in range(30)]
    honest = [f"2026-05-04T12:00:{second:02}Z" for second in range(30)]

    def track(of: list[str]) -> Track:
        points = "".join(
            f'<trkpt lat="{51 + k * 1e-5}" lon="-1"><time>{time}</time></trkpt>' for k, time in enumerate(of)
        )
        file = tmp_path / "drive.gpx"
        file.write_text(f'<gpx version="1.1" creator="test"><trk><trkseg>{points}</trkseg></trk></gpx>')
        return Track(file.name, TRACKS[".gpx"](file, file.read_bytes()))

    with pytest.raises(FeedError, match="of a year that no clock of a drive has"):
        track(times)
    assert len(track([times[0], *honest[1:]]).fixes) == len(honest) - 1
    assert "1 of 30 positions are dropped" in caplog.text
