"""The rendered world, held against a pinhole camera worked out by hand."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("panda3d")

from sim import Pose
from sim.world.drive import plan_drive
from sim.world.light import LIGHTS, Light
from sim.world.renderer import Renderer
from sim.world.route import generate_route
from sim.world.scenario import Scenario
from sim.world.sensor import CAMERA_HIGH_M
from sim.world.solids import Plot, Thing, house
from sim.world.street import World, build_world
from sim.world.traffic import Traffic, build_traffic
from sim.world.walls import Wall

SMALL = Scenario(seed=2, length_m=200.0, width=160, height=120)
FLAT = Light(0, 90, (0, 0, 0), (1, 1, 1), (0.5, 0.5, 0.5), (0.5, 0.5, 0.5), (0.5, 0.5, 0.5), 0.0)
COLORS = {"front": (1.0, 0.0, 0.0), "north end": (0.0, 1.0, 0.0), "back": (0.0, 0.0, 1.0), "south end": (1.0, 1.0, 0.0)}


@pytest.fixture(scope="module")
def small_world() -> World:
    return build_world(generate_route(SMALL.seed, SMALL.length_m))


def pictures(world: World, light: str, times_s: Sequence[float] = (12.0,), seed: int = 1) -> list[NDArray[np.uint8]]:
    """What the front camera of a drive through the world sees at some times."""
    drive = plan_drive(world.route, seed=seed)
    renderer = Renderer(
        world, build_traffic(drive), LIGHTS[light], view="front", size=(160, 120), fov_deg=80, seed=seed
    )
    images = [renderer.render(drive.pose(time_s), time_s) for time_s in times_s]
    renderer.close()
    return images


def one_house() -> Thing:
    """Eight meters wide, six deep and six high, each face of one color; its front looks east to a road due north."""
    walls = [
        Wall(np.ones((64, 32, 3), np.float32) * np.array(color, np.float32), width, 6.0, np.random.default_rng(0))
        for color, width in zip(COLORS.values(), (8.0, 6.0, 8.0, 6.0), strict=True)
    ]
    # Left of a road to the north: x runs north along it, y west, away from it.
    return house(Plot((-8.0, 96.0), (0.0, 1.0), (-1.0, 0.0)), walls)


@pytest.fixture
def house_cameras() -> Iterator[dict[str, Renderer]]:
    route = generate_route(1, 200.0)
    world = World(route, (one_house(),), np.empty((0, 3)))
    cameras = {
        view: Renderer(world, Traffic((), (), 0), FLAT, view=view, size=(320, 240), fov_deg=80, seed=1)
        for view in ("front", "rear")
    }
    yield cameras
    for camera in cameras.values():
        camera.close()


def seen(renderer: Renderer, view: str, north_m: float, point: tuple[float, float, float]) -> str | None:
    """Which face of the house is at the pixel where a pinhole at 0, north_m has a point; None if none is.

    Upright faces get 0.85 of the sky light.
    """
    ahead = (point[1] - north_m) * (1 if view == "front" else -1)
    right = point[0] * (1 if view == "front" else -1)
    focal = 160 / np.tan(np.radians(40))
    column, row = 160 + focal * right / ahead, 120 - focal * (point[2] - CAMERA_HIGH_M) / ahead
    image = renderer.render_scene(Pose(0.0, north_m, 0.0, 0.0, 0.0), 0.0)
    pixel = image[int(row), int(column), ::-1] / 255
    return next((name for name, color in COLORS.items() if np.abs(pixel - 0.85 * np.array(color)).max() < 0.1), None)


def test_front_and_rear_camera_see_different_ends_of_one_house(house_cameras: dict[str, Renderer]) -> None:
    near_end, far_end, front = (-11.0, 96.0, 3.0), (-11.0, 104.0, 3.0), (-8.0, 100.0, 3.0)
    # Coming from the south, and looking back from the north.
    assert seen(house_cameras["front"], "front", 70.0, near_end) == "south end"
    assert seen(house_cameras["front"], "front", 70.0, front) == "front"
    assert seen(house_cameras["rear"], "rear", 130.0, far_end) == "north end"
    assert seen(house_cameras["rear"], "rear", 130.0, front) == "front"
    # The front camera never sees the far end, nor the rear camera the near one, from there.
    assert seen(house_cameras["front"], "front", 70.0, far_end) != "north end"
    assert seen(house_cameras["rear"], "rear", 130.0, near_end) != "south end"


def test_a_house_appears_where_a_pinhole_has_it(house_cameras: dict[str, Renderer]) -> None:
    scene = house_cameras["front"].render_scene(Pose(0.0, 70.0, 0.0, 0.0, 0.0), 0.0)
    rows, columns = np.nonzero((scene[..., 2] > 200) & (scene[..., 0] < 60))
    focal = 160 / np.tan(np.radians(40))
    # Upper left corner of the near end: 14 m left, 26 m ahead, 4.6 m above the camera.
    assert columns.min() == pytest.approx(160 - focal * 14 / 26, abs=1.5)
    assert rows.min() == pytest.approx(120 - focal * 4.6 / 26, abs=1.5)
    assert rows.max() == pytest.approx(120 + focal * 1.4 / 26, abs=1.5)


def test_what_stands_is_the_same_on_every_drive_and_parked_cars_are_not(small_world: World) -> None:
    route = small_world.route
    first, second = (build_traffic(plan_drive(route, seed=seed)) for seed in (1, 2))
    corners = [np.concatenate([s.corners_m for thing in t.parked for s in thing.surfaces]) for t in (first, second)]
    assert corners[0].shape != corners[1].shape or not np.allclose(corners[0], corners[1])
    again = build_world(route)
    assert len(again.things) == len(small_world.things)
    for a, b in zip(again.things, small_world.things, strict=True):
        assert np.array_equal(a.picture, b.picture)
        assert all(np.array_equal(s.corners_m, t.corners_m) for s, t in zip(a.surfaces, b.surfaces, strict=True))


def test_nothing_stands_on_the_road(small_world: World) -> None:
    for thing in small_world.things:
        for surface in thing.surfaces:
            if np.ptp(surface.corners_m[:, 2]) > 1.0 and surface.corners_m[:, 2].min() < 2.5:
                assert small_world.route.clearance_m(surface.corners_m[:, :2]) > 4.2


def test_lights_differ_as_they_should(small_world: World) -> None:
    images = {light: pictures(small_world, light)[0].astype(float) for light in LIGHTS}
    means = {light: image.mean() for light, image in images.items()}
    assert means["night"] < 0.85 * means["day"]
    assert means["dusk"] < means["day"]
    ground = {light: image[90:].mean() for light, image in images.items()}
    assert ground["snow"] > 1.3 * ground["day"]
    assert ground["rain"] < ground["day"]
    sky = {light: image[:20, 60:100].mean() for light, image in images.items()}
    assert sky["night"] < 0.5 * sky["day"]


def test_a_sensor_is_noisier_at_night(small_world: World) -> None:
    def noise(light: str) -> float:
        # Two moments before the start, while the vehicle stands: only the sensor differs.
        pair = pictures(small_world, light, (-50.0, -49.999))
        return float(np.std(pair[0][60:].astype(float) - pair[1][60:]))

    assert noise("night") > 2 * noise("day")


def test_lamps_light_what_is_near_them(small_world: World) -> None:
    night = replace(LIGHTS["night"], noise=0.0)
    views = []
    for light in (night, replace(night, lamps=0.0)):
        lamp = np.array([[0.0, 100.0, 6.0]])
        world = World(small_world.route, (one_house(),), lamp)
        renderer = Renderer(world, Traffic((), (), 0), light, view="front", size=(320, 240), fov_deg=80, seed=1)
        views.append(renderer.render_scene(Pose(0.0, 80.0, 0.0, 0.0, 0.0), 0.0).astype(int))
        renderer.close()
    brighter = (views[0] - views[1]).max(axis=2)
    assert brighter.max() > 25
    assert (brighter[:60] == 0).mean() > 0.5  # not the sky


def test_moving_cars_come_toward_the_vehicle_on_the_other_lane() -> None:
    drive = plan_drive(generate_route(2, 400.0), "reverse", seed=5)
    cars = build_traffic(drive).moving
    assert len(cars) >= 3
    for car in cars:
        ahead = [car.start_m - car.speed_mps * t - drive.distance_m(t) for t in np.arange(0, drive.duration_s, 0.5)]
        assert np.all(np.diff(ahead) < 0)
        meet_s = float(np.interp(0, -np.array(ahead), np.arange(0, drive.duration_s, 0.5)))
        pose, (east, north, heading) = drive.pose(meet_s), car.position(meet_s)
        assert np.hypot(east - pose.east_m, north - pose.north_m) == pytest.approx(3.5, abs=0.6)
        assert np.cos(heading - np.radians(pose.heading_deg)) < -0.99


def test_a_car_ahead_stays_ahead_and_only_where_it_is_wanted() -> None:
    drive = plan_drive(generate_route(2, 400.0), "reverse", seed=5)
    assert build_traffic(drive).ahead is None
    ahead = build_traffic(drive, 12.0).ahead
    assert ahead is not None
    for time_s in (5.0, 20.0):
        pose, (east_m, north_m, _) = drive.pose(time_s), ahead.position(time_s)
        assert np.hypot(east_m - pose.east_m, north_m - pose.north_m) == pytest.approx(12.0, abs=0.7)


def test_the_horizon_sinks_when_the_nose_rises(house_cameras: dict[str, Renderer]) -> None:
    level, up = (Pose(0.0, 70.0, 0.0, 0.0, 0.0, pitch_deg=pitch_deg) for pitch_deg in (0.0, 3.0))
    for name, sign in (("front", 1), ("rear", -1)):
        before, after = (house_cameras[name].render_scene(pose, 0.0).astype(np.float32) for pose in (level, up))
        px = sign * 3.0 / 80.0 * before.shape[1]
        down = np.roll(before, round(px), axis=0)[20:-20]
        assert np.abs(down - after[20:-20]).mean() < np.abs(before - after)[20:-20].mean()


def test_two_renderers_live_side_by_side(house_cameras: dict[str, Renderer]) -> None:
    pose = Pose(0.0, 70.0, 0.0, 0.0, 0.0)
    alone = house_cameras["front"].render_scene(pose, 0.0)
    house_cameras["rear"].render_scene(pose, 0.0)
    assert np.array_equal(house_cameras["front"].render_scene(pose, 0.0), alone)


def test_rendering_is_silent_and_writes_nothing_into_the_home_folder(tmp_path: Path) -> None:
    code = "from sim.world.scenario import Scenario as S; from sim.world.camera import open_renderer as o\n"
    code += "s = S(length_m=200.0, width=64, height=48); d = s.drive(); o(s, d).render(d.pose(3.0), 3.0)"
    environment = {**os.environ, "HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    environment.pop("DISPLAY", None)
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=Path(__file__).parents[3], capture_output=True, check=True
    )
    assert (done.stdout, done.stderr) == (b"", b"")
    assert list(tmp_path.iterdir()) == []


def test_a_street_that_repeats_looks_the_same_one_period_on() -> None:
    route = generate_route(2, 200.0, 54.0)
    street = Renderer(build_world(route), Traffic((), (), 0), FLAT, view="front", size=(160, 120), fov_deg=80, seed=1)
    heading_deg = float(np.degrees(route.at(0.0)[2]))
    here, period_on, between = (
        street.render_scene(Pose(*route.at(at_m)[:2], heading_deg, 0.0, 0.0), 0.0).astype(float)
        for at_m in (40.0, 94.0, 70.0)
    )
    street.close()
    same, other = (np.abs(one - here)[:60].mean() for one in (period_on, between))  # above the road
    assert same < 0.1 * other
