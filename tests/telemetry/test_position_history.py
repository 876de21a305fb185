"""The position at an exposure: interpolated, with its accuracy and what it rests on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from edge.config import GatesConfig
from edge.geodesy import VehiclePosition, east_north_of
from edge.telemetry.position_history import ExposureQueue, PositionHistory
from sim.vehicle.command import straight_line
from sim.vehicle.gps import GpsReport
from tests.common import S
from tests.telemetry.rig import Rig

SPEED_MPS = 8.0


def north(stamp_s: float, north_m: float, **changes: Any) -> VehiclePosition:
    """A position on the way north at 10 m/s."""
    options = {"sigma_m": 1.0, "source": "gps", **changes}
    known = {"alt_m": north_m, "heading_deg": 0.0, "speed_mps": 10.0, "north_mps": 10.0, **options}
    return VehiclePosition(round(stamp_s * S), north_m / 110_574.0, 10.0, **known)


def history(*positions: VehiclePosition, now_s: float = 1.2) -> PositionHistory:
    kept = PositionHistory(lambda: round(now_s * S))
    for position in positions:
        kept.add(position)
    return kept


def north_m(position: VehiclePosition | None) -> float:
    assert position is not None
    return east_north_of(position.lat_deg, position.lon_deg, (0.0, 10.0))[1]


def test_between_two_positions_it_is_interpolated() -> None:
    after = north(1.2, 12.0, heading_deg=20.0, sigma_m=3.0, speed_mps=12.0, north_mps=9.0, east_mps=8.0)
    kept = history(north(1.0, 10.0, heading_deg=350.0), after)
    found = kept.at(round(1.05 * S))
    assert found is not None
    assert north_m(found) == pytest.approx(10.5, abs=0.01)
    assert found.alt_m == pytest.approx(10.5)
    assert found.heading_deg == pytest.approx(357.5)
    assert (found.speed_mps, found.north_mps, found.east_mps) == pytest.approx((10.5, 9.75, 2.0))
    assert (found.sigma_m, found.source, found.stamp_ns) == (3.0, "gps", round(1.05 * S))


def test_where_none_follows_the_newest_is_moved_on_for_half_a_second() -> None:
    kept = history(north(1.0, 10.0))
    assert north_m(kept.at(round(1.4 * S))) == pytest.approx(14.0, abs=0.01)
    assert kept.at(round(1.6 * S)) is None
    assert kept.at(round(0.9 * S)) is None, "before the first"
    assert history().at(S) is None


def test_a_frame_waits_for_the_position_after_it_and_not_for_ever() -> None:
    assert history(north(1.0, 10.0)).is_awaited(round(1.1 * S))
    assert not history(north(1.0, 10.0)).is_awaited(S)
    assert not history(north(1.0, 10.0), now_s=2.2).is_awaited(round(1.1 * S))
    assert not history().is_awaited(S), "there is no autopilot"


def test_frames_get_their_positions_in_order_each_once_it_is_interpolated() -> None:
    kept, given = history(north(1.0, 10.0)), list[float | None]()
    waiting: ExposureQueue[float] = ExposureQueue(kept)

    def give(*, all_of_them: bool = False) -> None:
        given.extend(None if at is None else north_m(at) for _, at in waiting.known(all_of_them=all_of_them))

    for stamp_s in (1.0, 1.1, 1.15, 1.3):
        waiting.add(round(stamp_s * S), stamp_s)
    give()
    assert given == pytest.approx([10.0], abs=0.01)
    kept.add(north(1.2, 12.0))
    give()
    assert given == pytest.approx([10.0, 11.0, 11.5], abs=0.01)
    kept.clear()
    give(all_of_them=True)
    assert given[3:] == [None]


def test_across_a_jump_and_a_long_gap_it_is_not_known() -> None:
    jumped = history(north(1.0, 10.0), north(1.2, 52.0))
    assert jumped.at(round(1.1 * S)) is None
    assert north_m(jumped.at(round(1.2 * S))) == pytest.approx(52.0, abs=0.01)
    assert history(north(1.0, 10.0), north(4.0, 40.0)).at(2 * S) is None


@pytest.mark.parametrize(
    ("first", "second", "found"),
    [
        ("gps", "rtk_fixed", "rtk_fixed"),
        ("dead_reckoning", "gps", "dead_reckoning"),
        ("gps", "place_fixes", "place_fixes"),
        ("dead_reckoning", "place_fixes", "place_fixes"),
    ],
)
def test_the_worse_source_counts(first: Any, second: Any, found: str) -> None:
    position = history(north(1.0, 10.0, source=first), north(1.2, 12.0, source=second, sigma_m=None)).at(S + S // 10)
    assert position is not None
    assert (position.source, position.sigma_m) == (found, None)


def test_across_the_antimeridian() -> None:
    west = VehiclePosition(S, 0.0, 179.99999, 0.0, 90.0, 11.0, east_mps=11.0)
    east = VehiclePosition(S + S // 5, 0.0, -179.99999, 0.0, 90.0, 11.0, east_mps=11.0)
    found = history(west, east).at(S + S // 10)
    assert found is not None
    assert abs(found.lon_deg) == pytest.approx(180.0)


@pytest.mark.parametrize(("fix_type", "source"), [(3, "gps"), (4, "dgps"), (6, "rtk_fixed"), (8, "ppp")])
def test_positions_by_gps_have_its_accuracy_and_kind_of_fix(
    open_rig: Callable[..., Rig], fix_type: int, source: str
) -> None:
    rig = open_rig(gps_at=lambda now_s: GpsReport(fix_type=fix_type, accuracy_m=0.7))
    rig.run(12.0)
    exposed_ns = rig.now_ns - S - 37_000_000
    found = rig.connection.history.at(exposed_ns)
    assert found is not None
    assert found.source == source
    assert found.sigma_m == pytest.approx(0.7)
    true = straight_line(SPEED_MPS, 60.0, 1000.0)(exposed_ns / 1e9)
    off_m = east_north_of(found.lat_deg, found.lon_deg, true.geodetic())
    assert off_m == pytest.approx((0.0, 0.0), abs=0.2), "that of the exposure: 0.1 s are 0.8 m"


def test_without_gps_it_is_dead_reckoning_of_unknown_accuracy(open_rig: Callable[..., Rig]) -> None:
    rig = open_rig(gps=False)
    rig.run(12.0)
    found = rig.connection.history.at(rig.now_ns - S)
    assert found is not None
    assert (found.source, found.sigma_m) == ("dead_reckoning", None)


def test_after_a_fix_positions_rest_on_it_until_gps_is_used_again(open_rig: Callable[..., Rig]) -> None:
    rig = open_rig(emit="external_position", gps=False, gates=GatesConfig(risk=1.0, min_move_m=0.0))
    rig.run(12.0)
    assert rig.send_position(rig.fix())
    rig.run(2.0)
    found = rig.connection.history.at(rig.now_ns - S // 2)
    assert found is not None
    assert found.source == "place_fixes"
    rig.autopilot.gps = True
    rig.run(60.0, lambda: source_now(rig) == "gps")
    assert source_now(rig) == "gps"


def test_a_restart_of_ours_does_not_forget_what_the_position_rests_on(open_rig: Callable[..., Rig]) -> None:
    rig = open_rig(emit="external_position", gps=False, gates=GatesConfig(risk=1.0, min_move_m=0.0))
    rig.run(12.0)
    assert rig.send_position(rig.fix())
    rig.run(4.0)
    rig.crash()
    rig.connect()
    rig.run(6.0)
    assert source_now(rig) == "place_fixes"


def source_now(rig: Rig) -> str:
    found = rig.connection.history.at(rig.now_ns - S // 2)
    return "" if found is None else str(found.source)
