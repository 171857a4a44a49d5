"""Asks a device what surfaces look like: one square, or any meshes, with given materials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tests.device.kernels import MATERIAL_FUNCTIONS
from tests.scenes import camera_from_above, snapshot
from vir_addon.core.material import Layer, LayerKind, Material, World
from vir_addon.core.passes.scene_data import SceneData
from vir_addon.core.passes.surface_data import SurfaceData
from vir_addon.core.scene import Mesh, SceneSnapshot
from vir_addon.device.interface import LINEAR_TEXTURE_WIDTH, Device, TextureFormat

UV, COLOR = Layer(LayerKind.UV), Layer(LayerKind.COLOR)
SQUARE_CORNERS = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], np.float32)
SQUARE_TRIANGLES = np.array([(0, 1, 2), (0, 2, 3)], np.int32)
UP = (0.0, 0.0, 1.0)


def square(name: str = "square", uvs: np.ndarray = SQUARE_CORNERS[:, :2], colors: np.ndarray | None = None) -> Mesh:
    """From (0, 0) to (1, 1) in the xy plane, uvs and colours by corner."""
    layers = {UV: uvs[SQUARE_TRIANGLES].astype(np.float32)}
    if colors is not None:
        layers[COLOR] = np.asarray(colors, np.float32)[SQUARE_TRIANGLES]
    return Mesh(name, SQUARE_CORNERS, SQUARE_TRIANGLES, layers=layers)


def scene_of(meshes: Sequence[Mesh], materials: Sequence[Material], world: World | None = None, **fields) -> SceneSnapshot:
    """One instance of every mesh, the k-th with the k-th material."""
    shown = snapshot(meshes, [], camera_from_above((0, 0), 4, 8, 8), 8, 8, **fields)
    return replace(
        shown,
        materials=tuple(materials),
        material_sets=tuple((k,) for k in range(len(materials))),
        world=world or World(),
        instances=replace(shown.instances, material_set=np.arange(len(meshes), dtype=np.int32)),
    )


class Answers:
    """Arrays of as many rows as there were queries, float64."""

    def __init__(self, rows: np.ndarray) -> None:
        self.diffuse, self.roughness = rows[:, 0, :3], rows[:, 0, 3]
        self.metal, self.metal_weight = rows[:, 1, :3], rows[:, 1, 3]
        self.normal, self.reflection_roughness = rows[:, 2, :3], rows[:, 2, 3]
        self.emitted, self.dielectric_weight = rows[:, 3, :3], rows[:, 3, 3]
        self.brdf, self.ior = rows[:, 4, :3], rows[:, 4, 3]
        self.reflection_color, self.world_red = rows[:, 5, :3], rows[:, 5, 3]


def ask(
    device: Device,
    shown: SceneSnapshot,
    *,
    instance=0,
    triangle=0,
    weights=(0.25, 0.25),
    to_eye=UP,
    to_light=UP,
    least_width=0.0,
    geometric=UP,
) -> Answers:
    """Every argument is one value or a row a query; weights: barycentric, of the second and third corner."""
    parts = [np.atleast_2d(part) for part in (np.c_[instance], np.c_[triangle], weights, to_eye, to_light, np.c_[least_width], geometric)]
    count = max(len(part) for part in parts)
    instance, triangle, weights, to_eye, to_light, least_width, geometric = (np.broadcast_to(p, (count, p.shape[1])) for p in parts)
    zeros = np.zeros((count, 1))
    queries = np.hstack([instance, triangle, weights, to_eye, zeros, to_light, least_width, geometric, zeros]).reshape(-1, 4)
    data, surfaces = SceneData(shown, device), SurfaceData(shown, device)
    given = device.upload_array(queries)
    answers = device.create_texture(LINEAR_TEXTURE_WIDTH, -(-6 * count // LINEAR_TEXTURE_WIDTH), TextureFormat.RGBA32F)
    try:
        device.compute_kernel(MATERIAL_FUNCTIONS, *surfaces.flags, *surfaces.world_flags).dispatch_linear(
            count, **data.bindings, **surfaces.bindings, queries=given, answers=answers, query_count=count
        )
        return Answers(device.read(answers).reshape(-1, 4)[: 6 * count].reshape(-1, 6, 4).astype(np.float64))
    finally:
        for owned in (given, answers, data, surfaces):
            owned.release()
