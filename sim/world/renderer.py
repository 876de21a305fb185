"""One offscreen camera in a world: pose in, picture out. Software rendering; needs no display and no GPU.

Each renderer owns an offscreen buffer of Panda3D's one engine, and only its own buffer is drawn by `render`: several
renderers may live in a process, used from one thread.
"""

from __future__ import annotations

import ctypes

import numpy as np
from numpy.typing import NDArray
from panda3d.core import (
    Camera,
    FrameBufferProperties,
    GraphicsBuffer,
    GraphicsEngine,
    GraphicsOutput,
    GraphicsPipe,
    GraphicsPipeSelection,
    NodePath,
    PerspectiveLens,
    Texture,
    WindowProperties,
    load_prc_file_data,
)  # fmt: skip

from edge.errors import ConfigError
from sim import Pose
from sim.world.light import Light
from sim.world.scene import build_fog, build_moving, build_sky, build_static
from sim.world.sensor import CAMERA_HIGH_M, Sensor
from sim.world.sky import sky_picture
from sim.world.street import World
from sim.world.traffic import Traffic

NEAR_M, FAR_M = 0.5, 420.0

# Before the first pipe is made. The empty cache folder keeps Panda3D from writing to ~/.cache.
load_prc_file_data(
    "lookback",
    "load-display p3tinydisplay\nwindow-type offscreen\nnotify-level error\nmodel-cache-dir\n"
    "audio-library-name null\nsync-video false\n",
)


class Renderer:
    """A front or rear camera of a given size (width, height) and horizontal field of view."""

    def __init__(
        self,
        world: World,
        traffic: Traffic,
        light: Light,
        *,
        view: str,
        size: tuple[int, int],
        fov_deg: float,
        seed: int,
        mounted_deg: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """mounted_deg: by which it looks down and to the right of where it should."""
        self._turn_deg, self._mounted_deg = 0.0 if view == "front" else 180.0, mounted_deg
        self._size = size
        self._sensor = Sensor(light, view, size, fov_deg, seed)
        self._root = NodePath("world")
        static = build_static((*world.things, *traffic.parked), light, world.lamps_m, traffic.window_seed)
        static.reparent_to(self._root)
        self._cars = [(car, build_moving(car.things, light)) for car in (*traffic.moving, traffic.ahead) if car]
        for _, node in self._cars:
            node.reparent_to(self._root)
        self._camera = self._root.attach_new_node(_perspective_camera(size, fov_deg))
        self._sky = build_sky(sky_picture(light, world.route.seed, seed))
        self._sky.reparent_to(self._root)
        build_fog(light).reparent_to(self._camera)
        self._buffer, self._target = _open_buffer(size)
        self._buffer.set_clear_color((*light.sky_top, 1))
        self._buffer.make_display_region().set_camera(self._camera)

    def render(self, pose: Pose, time_s: float) -> NDArray[np.uint8]:
        """What the camera sees at a time of the drive, (H, W, 3) uint8 BGR."""
        return self.develop(self.render_scene(pose, time_s), time_s)

    def develop(self, scene: NDArray[np.uint8], time_s: float) -> NDArray[np.uint8]:
        """A scene, (H, W, 3) uint8 BGR, as the sensor gives it at a time of the drive."""
        return self._sensor.develop(scene, time_s)

    def render_scene(self, pose: Pose, time_s: float) -> NDArray[np.uint8]:
        """The scene before the sensor, (H, W, 3) uint8 BGR."""
        self._camera.set_pos(pose.east_m, pose.north_m, CAMERA_HIGH_M)
        sign = 1.0 if self._turn_deg == 0.0 else -1.0  # what lifts the nose lowers the rear
        down_deg, right_deg = self._mounted_deg
        turn_deg, pitch_deg = self._turn_deg - right_deg - pose.heading_deg, sign * pose.pitch_deg - down_deg
        self._camera.set_hpr(turn_deg, pitch_deg, sign * pose.roll_deg)
        self._sky.set_pos(pose.east_m, pose.north_m, CAMERA_HIGH_M)
        self._place_cars(time_s)
        self._buffer.set_active(True)
        GraphicsEngine.get_global_ptr().render_frame()
        self._buffer.set_active(False)
        pixels = np.frombuffer(self._target.get_ram_image_as("BGR"), np.uint8)
        return np.ascontiguousarray(pixels.reshape(self._size[1], self._size[0], 3)[::-1])

    def _place_cars(self, time_s: float) -> None:
        for car, node in self._cars:
            if not car.on_road(time_s):
                node.hide()
                continue
            east, north, heading = car.position(time_s)
            node.show()
            node.set_pos(east, north, 0)
            node.set_h(-float(np.degrees(heading)))

    def close(self) -> None:
        """Give the buffer and the geometry back; more than once is harmless."""
        GraphicsEngine.get_global_ptr().remove_window(self._buffer)
        self._root.remove_node()


def _perspective_camera(size: tuple[int, int], fov_deg: float) -> Camera:
    lens = PerspectiveLens()
    lens.set_aspect_ratio(size[0] / size[1])
    lens.set_fov(fov_deg)
    lens.set_near_far(NEAR_M, FAR_M)
    return Camera("camera", lens)


def _open_buffer(size: tuple[int, int]) -> tuple[GraphicsBuffer, Texture]:
    """An offscreen buffer, and the texture that its pictures are copied to; ConfigError without libX11."""
    try:
        ctypes.CDLL("libX11.so.6")  # Panda3D's wheel is linked to it and lacks it; no function of it is called
    except OSError as error:
        raise ConfigError(f"the simulator's renderer needs {error}; Debian, Ubuntu: apt-get install libx11-6") from None
    # By name: the default pipe is the X11 one, which complains where there is no display.
    pipe = GraphicsPipeSelection.get_global_ptr().make_pipe("TinyOffscreenGraphicsPipe", "p3tinydisplay")
    properties = FrameBufferProperties()
    properties.set_rgba_bits(8, 8, 8, 8)
    properties.set_depth_bits(24)
    buffer = GraphicsEngine.get_global_ptr().make_output(
        pipe, "camera", 0, properties, WindowProperties.size(*size), GraphicsPipe.BF_refuse_window
    )
    target = Texture()
    buffer.add_render_texture(target, GraphicsOutput.RTM_copy_ram, GraphicsOutput.RTP_color)
    buffer.set_active(False)
    return buffer, target
