"""Which frames are places."""

from __future__ import annotations

from collections.abc import Sequence

from edge.config import SamplingConfig
from edge.feed.sampling import Sampler


def taken(config: SamplingConfig, frames: Sequence[tuple[float, float | None]]) -> list[int]:
    sampler = Sampler(config)
    return [index for index, (time_s, meters) in enumerate(frames) if sampler.is_place(round(time_s * 1e9), meters)]


def test_by_distance_a_place_every_two_meters_and_none_while_standing() -> None:
    frames = [(i * 0.1, min(i * 0.5, 5.0)) for i in range(30)]
    assert taken(SamplingConfig(spacing_m=2.0), frames) == [0, 4, 8]


def test_by_distance_falls_back_to_time_where_it_is_unknown() -> None:
    frames = [(i * 0.1, None if i < 10 else float(i)) for i in range(20)]
    assert taken(SamplingConfig(spacing_m=2.0, interval_s=0.5), frames) == [0, 5, 10, 12, 14, 16, 18]


def test_distance_that_is_counted_anew_starts_a_new_place() -> None:
    assert taken(SamplingConfig(spacing_m=2.0), [(0, 100.0), (1, 101.0), (2, 0.0), (3, 1.0), (4, 2.0)]) == [0, 2, 4]


def test_a_distance_that_goes_back_by_less_than_a_meter_is_no_new_count() -> None:
    """Two cameras ask in turns, and one that was extrapolated while braking is behind the next: no place is twice."""
    frames = [(0, 100.0), (1, 102.0), (2, 101.64), (3, 101.9), (4, 103.5), (5, 104.0)]
    assert taken(SamplingConfig(spacing_m=2.0), frames) == [0, 1, 5]


def test_by_time() -> None:
    frames = [(i * 0.2, float(i)) for i in range(10)]
    assert taken(SamplingConfig(by="time", interval_s=0.5), frames) == [0, 3, 6, 9]


def test_by_frames() -> None:
    assert taken(SamplingConfig(by="frames", spacing_frames=3), [(0, None)] * 8) == [0, 3, 6]


def test_time_that_goes_back_starts_anew() -> None:
    assert taken(SamplingConfig(by="time", interval_s=1.0), [(10, None), (10.5, None), (2, None), (2.5, None)]) == [
        0,
        2,
    ]


def test_spacing_holds_on_average_whatever_the_frame_rate() -> None:
    frames = [(i * 0.1, i * 0.7) for i in range(1000)]
    assert len(taken(SamplingConfig(spacing_m=2.0), frames)) == 350  # 700 m
    assert len(taken(SamplingConfig(spacing_m=2.0), [(i, i * 1.99995) for i in range(100)])) == 100


def test_a_jump_is_one_place_not_many() -> None:
    frames = [(0.0, 0.0), (1.0, 100.0), (2.0, 101.0), (3.0, 102.0)]
    assert taken(SamplingConfig(spacing_m=2.0), frames) == [0, 1, 3]


def test_the_first_known_distance_starts_the_count() -> None:
    frames = [(0.0, None), (1.0, 1.6), (2.0, 2.2), (3.0, 3.7)]
    assert taken(SamplingConfig(spacing_m=2.0, interval_s=0.5), frames) == [0, 1, 3]


def test_places_passed_without_a_frame_are_counted() -> None:
    sampler = Sampler(SamplingConfig(spacing_m=2.0))
    distances_m = (0.0, 2.0, 3.9, 4.1, 9.9, 10.1, 12.0, 0.0, 7.0)
    passed = {distance_m: sampler.missed for distance_m in distances_m if sampler.is_place(0, distance_m)}
    assert passed == {2.0: 0, 4.1: 0, 9.9: 1, 10.1: 0, 12.0: 0, 0.0: 0, 7.0: 2}, (
        "at 6, and after a new count at 2 and 4"
    )
