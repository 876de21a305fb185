"""Shapes to Panda3D geometry: surfaces cut into cells with the light of each corner, grouped by picture."""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from panda3d.core import (
    Geom,
    GeomEnums,
    GeomNode,
    GeomTriangles,
    GeomVertexData,
    GeomVertexFormat,
    NodePath,
    SamplerState,
    Texture,
    TransparencyAttrib,
)  # fmt: skip

from sim.world.light import Light, illuminate
from sim.world.plants import Picture
from sim.world.sky import HORIZON
from sim.world.solids import Surface, Thing

CELL_M = 4.5
"""Light is worked out at corners no further apart than this."""
GROUP_M = 45.0
"""Surfaces of one picture within a square of this size are drawn, or left out of view, together."""
LIT_WINDOW = (1.0, 0.86, 0.58)

SNOW_TOP: Picture = np.full((8, 8, 4), (230, 233, 240, 255), np.uint8)


def build_static(things: Iterable[Thing], light: Light, lamps_m: NDArray[np.float64], window_seed: int) -> NodePath:
    """All that stands still, with the light of the condition in its colors."""
    rng = np.random.default_rng([window_seed, 5])
    root = NodePath("street")
    _draw_in_order(root)
    groups: dict[tuple[int, int, int], list[tuple[Thing, Surface]]] = defaultdict(list)
    glowing: dict[int, list[tuple[Thing, Surface]]] = defaultdict(list)
    pictures: dict[int, Picture] = {}
    for thing in things:
        picture = _picture(thing, light)
        pictures[id(picture)] = picture
        for surface in thing.surfaces:
            east, north, _ = surface.corners_m.mean(axis=0)
            groups[id(picture), int(east // GROUP_M), int(north // GROUP_M)].append((thing, surface))
        lit = [(thing, window) for window in thing.windows if rng.random() < light.lit_share]
        if lit:
            glowing[id(picture)] += lit
    textures = {key: upload(picture) for key, picture in pictures.items()}
    for (key, *_), members in groups.items():
        _attach(root, members, textures[key], light, lamps_m)
    for key, members in glowing.items():
        _attach_glowing(root, members, textures[key])
    return root


def build_moving(things: Sequence[Thing], light: Light) -> NodePath:
    """A car at the origin in the light of the open road, its lamps on when it is dark."""
    root = NodePath("car")
    _draw_in_order(root)
    for thing in things:
        texture = upload(thing.picture)
        members = [(thing, surface) for surface in thing.surfaces]
        _attach(root, members, texture, light, np.empty((0, 3)))
        if light.headlight and thing.windows:
            bright = [(thing, replace(window, color=(1.0, 1.0, 1.0))) for window in thing.windows]
            _attach_glowing(root, bright, texture, color=(1.0, 1.0, 1.0))
    return root


def _draw_in_order(root: NodePath) -> None:
    """Draw as the scene lists it; Panda3D's own order follows addresses, so that equal depths would differ by run."""
    root.set_bin("fixed", 0)


def _picture(thing: Thing, light: Light) -> Picture:
    if light.snow and thing.upward:
        return SNOW_TOP
    return thing.snow if light.snow and thing.snow is not None else thing.picture


def upload(picture: Picture) -> Texture:
    """An RGBA picture, row 0 at the top, as a mipmapped texture that repeats."""
    texture = Texture()
    texture.setup_2d_texture(picture.shape[1], picture.shape[0], Texture.T_unsigned_byte, Texture.F_rgba)
    texture.set_ram_image_as(np.ascontiguousarray(picture[::-1]).tobytes(), "RGBA")
    texture.set_minfilter(SamplerState.FT_nearest_mipmap_nearest)
    texture.set_magfilter(SamplerState.FT_nearest)
    return texture


def _attach(
    root: NodePath,
    members: Sequence[tuple[Thing, Surface]],
    texture: Texture,
    light: Light,
    lamps_m: NDArray[np.float64],
) -> None:
    """One Geom of surfaces that share a picture."""
    snowed = light.snow and members[0][0].upward
    cells = [cut(surface, snowed) for _, surface in members]
    points, normals, uv, colors = (np.concatenate(parts) for parts in zip(*cells, strict=True))
    if members[0][0].flat:
        # Leaves and pickets face every way; take the light from above for both sides.
        normals = np.broadcast_to(np.array((0.0, 0.0, 1.0)), normals.shape)
    shine = illuminate(light, points, normals, lamps_m)
    node = root.attach_new_node(_geom_node(points, uv, np.clip(colors * shine, 0, 1)))
    node.set_texture(texture)
    if members[0][0].flat:
        node.set_two_sided(True)
        node.set_transparency(TransparencyAttrib.M_binary)


def _attach_glowing(
    root: NodePath,
    members: Sequence[tuple[Thing, Surface]],
    texture: Texture,
    color: tuple[float, float, float] = LIT_WINDOW,
) -> None:
    """Lit windows: the wall's own picture, brightened, in the color of lamps."""
    points = np.concatenate([surface.corners_m for _, surface in members])
    uv = np.concatenate([surface.uv for _, surface in members])
    node = root.attach_new_node(_geom_node(points, uv, np.broadcast_to(np.array(color), points.shape)))
    if color is LIT_WINDOW:
        # Glass by day is dark; lit, it is the room that is seen.
        node.set_texture_off(1)
    else:
        node.set_texture(texture)


def cut(surface: Surface, plain: bool = False) -> tuple[NDArray[np.float64], ...]:
    """A surface as cells of at most CELL_M: points, normals (N, 3), uv (N, 2), colors (N, 3); four points a cell."""
    a, b, _, d = surface.corners_m
    along, up = b - a, d - a
    columns, rows = (max(1, math.ceil(_length(side) / CELL_M)) for side in (along, up))
    (ax, ay, az), (ux, uy, uz) = along.tolist(), up.tolist()  # a world has thousands: np.cross takes ten times as long
    normal = np.array((ay * uz - az * uy, az * ux - ax * uz, ax * uy - ay * ux))
    normal /= max(_length(normal), 1e-9)
    s, t = _shares(columns, rows)

    def blend(corners: NDArray[np.float64]) -> NDArray[np.float64]:
        low, high = corners[0] + s * (corners[1] - corners[0]), corners[3] + s * (corners[2] - corners[3])
        return np.asarray(low + t * (high - low))

    points = blend(surface.corners_m)
    color = np.ones(3) if plain else np.array(surface.color)
    return points, np.tile(normal, (len(points), 1)), blend(surface.uv), np.tile(color, (len(points), 1))


def _length(vector: NDArray[np.float64]) -> float:
    return math.sqrt(vector.dot(vector))


@lru_cache
def _shares(columns: int, rows: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where the corners of the cells of a surface lie between its sides, (4 columns rows, 1) each."""
    i, j = (index.ravel()[:, None] for index in np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"))
    s = (i + np.array((0, 1, 1, 0))).ravel()[:, None] / columns
    t = (j + np.array((0, 0, 1, 1))).ravel()[:, None] / rows
    return s, t


def _geom_node(points: NDArray[np.float64], uv: NDArray[np.float64], colors: NDArray[np.float64]) -> GeomNode:
    """Vertices, four a cell in order around it, as two triangles each."""
    count = len(points)
    data = GeomVertexData("", GeomVertexFormat.get_v3c4t2(), Geom.UH_static)
    data.unclean_set_num_rows(count)
    layout = np.dtype([("point", "<f4", 3), ("color", "u1", 4), ("uv", "<f4", 2)])
    vertices = np.zeros(count, layout)
    vertices["point"], vertices["uv"] = points, uv
    vertices["color"][:, :3], vertices["color"][:, 3] = colors * 255, 255
    data.modify_array_handle(0).copy_data_from(vertices.tobytes())
    corners = (np.arange(0, count, 4)[:, None] + np.array((0, 1, 2, 0, 2, 3))).astype("<u4")
    triangles = GeomTriangles(Geom.UH_static)
    triangles.set_index_type(GeomEnums.NT_uint32)
    indices = triangles.modify_vertices()
    indices.unclean_set_num_rows(corners.size)
    indices.modify_handle().copy_data_from(corners.tobytes())
    geom = Geom(data)
    geom.add_primitive(triangles)
    node = GeomNode("")
    node.add_geom(geom)
    return node


SKY_M = 300.0
SKY_HIGH_M = 235.0
FOG_BIN_ORDER = 100
FOG_CARDS_M = (22.0, 38.0, 58.0, 85.0, 120.0, 170.0, 240.0)


def build_sky(panorama: Picture) -> NodePath:
    """A ring to be kept around the camera, behind all else."""
    turns = np.linspace(0, 2 * np.pi, 33)
    low = -SKY_HIGH_M * HORIZON / (1 - HORIZON)
    points, uv = [], []
    for a, b in itertools.pairwise(turns):
        for angle, z in ((a, low), (b, low), (b, SKY_HIGH_M), (a, SKY_HIGH_M)):
            points.append((SKY_M * np.sin(angle), SKY_M * np.cos(angle), z))
            uv.append((angle / (2 * np.pi), (z - low) / (SKY_HIGH_M - low)))
    node = NodePath(_geom_node(np.array(points), np.array(uv), np.ones((len(points), 3))))
    node.set_texture(upload(panorama))
    node.set_bin("background", 0)
    node.set_depth_write(False)
    node.set_depth_test(False)
    node.set_two_sided(True)
    return node


def build_fog(light: Light) -> NodePath:
    """Veils across the camera's view, each for the air since the one before; the rasterizer has no fog of its own."""
    root = NodePath("fog")
    before_m = 0.0
    for order, distance_m in enumerate(FOG_CARDS_M):
        half = 2 * distance_m
        corners = np.array(
            [(-half, distance_m, -half), (half, distance_m, -half), (half, distance_m, half), (-half, distance_m, half)]
        )
        node = root.attach_new_node(_geom_node(corners, np.zeros((4, 2)), np.broadcast_to(np.array(light.fog), (4, 3))))
        node.set_alpha_scale(1 - float(np.exp(-light.fog_per_m * (distance_m - before_m))))
        node.set_transparency(TransparencyAttrib.M_alpha)
        node.set_depth_write(False)
        node.set_bin("fixed", FOG_BIN_ORDER - order)
        before_m = distance_m
    return root
