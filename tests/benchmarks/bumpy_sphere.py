"""The named surface of the depth-map bench: a bumpy sphere of any number of triangles, closed, of even density, without Blender."""

from __future__ import annotations

import math

import numpy as np

from vir_addon.core.scene import Camera, Instances, Light, LightShape, Mesh, PixelFilter, SceneSnapshot

LIGHT_NAME = "Key"
BUMP_HEIGHT_M = 0.04
BUMPS_PER_M = 11.0


def _octahedron_directions(cells: int) -> np.ndarray:
    """((cells + 1)^2, 3) unit vectors: a square grid folded into an octahedron, blown up into a sphere. `cells` is even."""
    steps = np.arange(cells + 1) * 2 - cells
    y, x = (grid.ravel().astype(np.float64) / cells for grid in np.meshgrid(steps, steps, indexing="ij"))
    z = 1 - np.abs(x) - np.abs(y)
    below = z < 0
    sign_x, sign_y = np.where(x < 0, -1.0, 1.0), np.where(y < 0, -1.0, 1.0)
    folded_x = np.where(below, (1 - np.abs(y)) * sign_x, x)
    folded_y = np.where(below, (1 - np.abs(x)) * sign_y, y)
    p = np.stack([folded_x, folded_y, z], axis=-1)
    return p / np.linalg.norm(p, axis=-1, keepdims=True)


def _octahedron_triangles(cells: int) -> np.ndarray:
    """(2 cells^2, 3) int64: every cell in two triangles, the grid's border sewn to itself, so that the surface is closed."""
    row, column = np.divmod(np.arange((cells + 1) ** 2), cells + 1)
    on_end, on_side = (row == 0) | (row == cells), (column == 0) | (column == cells)
    shared_column = np.where(on_end, np.minimum(column, cells - column), column)
    shared_row = np.where(on_side, np.minimum(row, cells - row), row)
    is_corner = on_end & on_side
    shared = np.where(is_corner, 0, shared_row * (cells + 1) + shared_column)

    j, i = (grid.ravel() for grid in np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij"))
    a = j * (cells + 1) + i
    b, c, d = a + 1, a + cells + 2, a + cells + 1
    # the diagonal runs along the octahedron's edges in every quarter, so no triangle is folded
    rising = ((i < cells // 2) != (j < cells // 2))[:, None]
    first = np.where(rising, np.stack([a, b, c], axis=-1), np.stack([a, b, d], axis=-1))
    second = np.where(rising, np.stack([a, c, d], axis=-1), np.stack([b, c, d], axis=-1))
    return shared[np.stack([first, second], axis=1).reshape(-1, 3)]


def bumpy_sphere(triangle_count: int) -> Mesh:
    """About `triangle_count` triangles (the nearest 8 k^2), radius about 1 m."""
    cells = 2 * max(1, round(math.sqrt(triangle_count / 8)))
    directions = _octahedron_directions(cells)
    bumps = np.sin(BUMPS_PER_M * directions).prod(axis=-1, keepdims=True)
    used, triangles = np.unique(_octahedron_triangles(cells), return_inverse=True)
    positions = (directions * (1 + BUMP_HEIGHT_M * bumps))[used]
    return Mesh(
        f"bumpy sphere of {2 * cells**2:,} triangles",
        positions.astype(np.float32),
        triangles.reshape(-1, 3).astype(np.int32),
        directions[used].astype(np.float32),
        is_closed=True,
    )


def _look(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(4, 4) float64 world_from_view: at `eye`, looking at `target`, z up."""
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, np.cross(back, right), back, eye], axis=-1)
    return matrix


def sphere_snapshot(triangle_count: int, width_px: int, height_px: int, *, has_floor: bool) -> SceneSnapshot:
    """The sphere, over a floor or over nothing, under a square light of 1 m."""
    meshes = [bumpy_sphere(triangle_count)]
    if has_floor:
        corners = np.array([[-10, -10, -1.2], [10, -10, -1.2], [10, 10, -1.2], [-10, 10, -1.2]], np.float32)
        meshes.append(Mesh("floor", corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32)))
    count = len(meshes)
    instances = Instances(
        mesh_index=np.arange(count, dtype=np.int32),
        world_from_object=np.tile(np.eye(4, dtype=np.float32), (count, 1, 1)),
        object_index=np.arange(count, dtype=np.int32),
        object_names=("sphere", "floor")[:count],
        visible_to_camera=np.ones(count, bool),
        casts_shadow=np.ones(count, bool),
        stable_id=np.arange(1, count + 1, dtype=np.uint32),
    )
    target = np.zeros(3)
    light = Light(LIGHT_NAME, LightShape.RECTANGLE, _look(np.array([2.0, -2.0, 3.5]), target), 1.0, 1.0, math.pi, 100.0, True)
    half_width = 0.25
    half_height = half_width * height_px / width_px
    camera = Camera(
        "camera", False, _look(np.array([0.0, -7.0, 3.0]), target), (-half_width, half_width, -half_height, half_height), 0.1, 100.0
    )
    return SceneSnapshot(
        scene_name="bumpy sphere",
        view_layer_name="ViewLayer",
        frame=1,
        width_px=width_px,
        height_px=height_px,
        meshes=tuple(meshes),
        instances=instances,
        lights=(light,),
        camera=camera,
        pixel_filter=PixelFilter(),
        world_origin_m=np.zeros(3),
    )
