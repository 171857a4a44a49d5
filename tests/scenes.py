"""Snapshots built from arrays: shapes, lights, cameras, and how they are rendered in one call. No bpy."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from vir_addon.core.material import BLACK, WHITE, Constant, Material, World
from vir_addon.core.pass_set import shadow_pass_name
from vir_addon.core.plan import plan
from vir_addon.core.render import Renderer, render
from vir_addon.core.scene import Camera, FilterShape, Instances, Light, LightShape, Mesh, OpacityMap, PixelFilter, SceneSnapshot
from vir_addon.core.settings import Method, PointStorage, Settings
from vir_addon.device.interface import Device

CENTRES_ONLY = PixelFilter(FilterShape.BOX, 0.0)
"""every eye sample at the pixel's centre: what a float64 computation can repeat exactly"""
METHODS = (Method.MVR, Method.IVIR, Method.MICRO)
"""what `auto` chooses from"""
METHODS_BUT_SLOW_IVIR = (Method.MVR, pytest.param(Method.IVIR, marks=pytest.mark.slow), Method.MICRO)
"""the same where points take tens of seconds"""
METHODS_AND_HYBRID = (*METHODS, Method.HYBRID)
"""those that promise the rasterizer's picture, of all kinds of light and on both devices; where it matters that a map has points and
rasterized triangles, or who releases both"""


# shapes


def rectangle(name: str, corner: Sequence[float], side_u: Sequence[float], side_v: Sequence[float]) -> Mesh:
    """Front where side_u x side_v points."""
    origin, u, v = (np.array(a, np.float64) for a in (corner, side_u, side_v))
    return Mesh(name, np.array([origin, origin + u, origin + u + v, origin + v], np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def floor(half_m: float = 10.0, height_m: float = 0.0) -> Mesh:
    return rectangle("floor", (-half_m, -half_m, height_m), (2 * half_m, 0, 0), (0, 2 * half_m, 0))


BOX_FACES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def box(name: str, centre: Sequence[float], half: Sequence[float], *, inside_out: bool = False, turn_rad: float = 0.0) -> Mesh:
    """Closed; outward normals unless inside out. Turned about its vertical axis."""
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    cosine, sine = np.cos(turn_rad), np.sin(turn_rad)
    corners = corners @ np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]]) + centre
    triangles = np.array([t for a, b, c, d in BOX_FACES for t in ((a, b, c), (a, c, d))], np.int32)
    if inside_out:
        triangles = triangles[:, ::-1].copy()
    return Mesh(name, corners.astype(np.float32), triangles, is_closed=not inside_out)


def disc(name: str, centre: Sequence[float], radius_m: float, segment_count: int = 256) -> Mesh:
    """Level, facing up, open."""
    angle = np.linspace(0, 2 * np.pi, segment_count, endpoint=False)
    rim = np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle), np.zeros(segment_count)], axis=1)
    k = np.arange(segment_count)
    triangles = np.stack([np.zeros(segment_count), 1 + k, 1 + (k + 1) % segment_count], axis=1)
    return Mesh(name, (np.concatenate([np.zeros((1, 3)), rim]) + centre).astype(np.float32), triangles.astype(np.int32))


def bumpy_sphere(
    name: str, centre: Sequence[float], radius_m: float, row_count: int, *, bump_share: float = 0.05, smooth: bool = True
) -> Mesh:
    """Closed, 2 * row_count columns: 4 row_count^2 triangles (those at the poles have no area). Normals of the sphere if smooth."""
    column_count = 2 * row_count
    polar, azimuth = np.meshgrid(
        np.linspace(0, np.pi, row_count + 1), np.linspace(0, 2 * np.pi, column_count, endpoint=False), indexing="ij"
    )
    radius = radius_m * (1 + bump_share * np.sin(9 * azimuth) * np.sin(7 * polar) * np.sin(polar) ** 2)
    directions = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=-1)
    directions[0], directions[-1] = (0, 0, 1), (0, 0, -1)
    first = np.arange(row_count)[:, None] * column_count
    column = np.arange(column_count)
    a, b = (first + column).ravel(), (first + (column + 1) % column_count).ravel()
    c, d = a + column_count, b + column_count
    triangles = np.stack([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)], axis=1).reshape(-1, 3)
    positions = (radius[..., None] * directions).reshape(-1, 3) + centre
    normals = directions.reshape(-1, 3).astype(np.float32) if smooth else None
    return Mesh(name, positions.astype(np.float32), triangles.astype(np.int32), normals, is_closed=True)


def leaves(name: str, centre: Sequence[float], extent_m: float, leaf_count: int, size_m: float, seed: int = 7) -> Mesh:
    """Open two-sided triangles, thin, in every direction."""
    generator = np.random.default_rng(seed)
    middle = np.array(centre) + generator.uniform(-extent_m / 2, extent_m / 2, (leaf_count, 3))
    along, across = generator.normal(size=(2, leaf_count, 3))
    along *= size_m / np.linalg.norm(along, axis=1, keepdims=True)
    across *= 0.3 * size_m / np.linalg.norm(across, axis=1, keepdims=True)
    positions = np.stack([middle - along, middle + along, middle + across], axis=1).reshape(-1, 3)
    return Mesh(name, positions.astype(np.float32), np.arange(3 * leaf_count, dtype=np.int32).reshape(-1, 3))


def with_opacity(mesh: Mesh, texels: np.ndarray, uvs: Sequence[Sequence[float]], **fields: Any) -> Mesh:
    """texels: (height, width) opacities from 0 to 1, row 0 at the bottom"""
    opacity = np.linspace(0, 1, 256, dtype=np.float32)
    opacity_map = OpacityMap("material", np.round(np.asarray(texels) * 255).astype(np.uint8), **{"opacity": opacity, **fields})
    return dataclasses.replace(mesh, opacity_map=opacity_map, uvs=np.array(uvs, np.float32), is_closed=False)


# placing


def looking(eye: Sequence[float], target: Sequence[float], up: Sequence[float] = (0.0, 0.0, 1.0)) -> np.ndarray:
    """(4, 4) world_from_view at `eye`; straight up and down work too."""
    forward = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-6:
        right = np.array([1.0, 0.0, 0.0])
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, np.cross(right, forward), -forward, eye], axis=1)
    return matrix


def area_light(
    name: str = "Key",
    eye: Sequence[float] = (0.0, 0.0, 5.0),
    target: Sequence[float] = (0.0, 0.0, 0.0),
    size_m: tuple[float, float] = (1.0, 1.0),
    *,
    shape: LightShape = LightShape.RECTANGLE,
    spread_rad: float = np.pi,
    **fields: Any,
) -> Light:
    fields = {"strength": 100.0, "casts_shadow": True, **fields}
    return Light(name, shape, looking(eye, target), *size_m, spread_rad, **fields)


def point_light(name: str = "Key", eye: Sequence[float] = (0.0, 0.0, 5.0), radius_m: float = 0.5, **fields: Any) -> Light:
    fields = {"strength": 100.0, "casts_shadow": True, **fields}
    return Light(name, LightShape.POINT, looking(eye, (eye[0], eye[1], eye[2] - 1)), 2 * radius_m, 2 * radius_m, np.pi, **fields)


def spot_light(
    name: str = "Key",
    eye: Sequence[float] = (0.0, 0.0, 5.0),
    target: Sequence[float] = (0.0, 0.0, 0.0),
    radius_m: float = 0.5,
    cone_rad: float = 1.0,
    **fields: Any,
) -> Light:
    fields = {"strength": 100.0, "casts_shadow": True, **fields}
    return Light(name, LightShape.SPOT, looking(eye, target), 2 * radius_m, 2 * radius_m, np.pi, cone_rad=cone_rad, **fields)


def sun_light(
    name: str = "Key",
    eye: Sequence[float] = (0.0, 0.0, 5.0),
    target: Sequence[float] = (0.0, 0.0, 0.0),
    angle_rad: float = 0.1,
    **fields: Any,
) -> Light:
    fields = {"strength": 3.0, "casts_shadow": True, **fields}
    size = 2 * np.tan(angle_rad / 2)
    return Light(name, LightShape.SUN, looking(eye, target), size, size, np.pi, **fields)


def perspective_camera(eye: Sequence[float], target: Sequence[float], width: int, height: int, half_width: float = 0.5) -> Camera:
    """half_width: tangent of half the horizontal angle of view"""
    top = half_width * height / width
    return Camera("Camera", False, looking(eye, target), (-half_width, half_width, -top, top), 0.1, 200.0)


def camera_from_above(centre: Sequence[float], width_m: float, width: int, height: int, height_m: float = 20.0) -> Camera:
    """Orthographic, x to the right, y up in the picture."""
    top = width_m / 2 * height / width
    eye = (centre[0], centre[1], height_m)
    matrix = looking(eye, (centre[0], centre[1], 0.0))
    return Camera("Camera", True, matrix, (-width_m / 2, width_m / 2, -top, top), 0.01, 2 * height_m)


def snapshot(
    meshes: Sequence[Mesh],
    lights: Sequence[Light],
    camera: Camera,
    width: int,
    height: int,
    *,
    transforms: np.ndarray | None = None,
    casts_shadow: Sequence[bool] | None = None,
    visible_to_camera: Sequence[bool] | None = None,
    stable_ids: Sequence[int] | None = None,
    stays: Sequence[bool] | None = None,
    pixel_filter: PixelFilter = CENTRES_ONLY,
    materials: Sequence[Material] = (),
    world: World | None = None,
) -> SceneSnapshot:
    """One instance of every mesh, of the material of the same number if there are any."""
    count = len(meshes)

    def flags(given: Sequence[bool] | None) -> np.ndarray:
        return np.ones(count, bool) if given is None else np.array(given, bool)

    instances = Instances(
        mesh_index=np.arange(count, dtype=np.int32),
        world_from_object=np.tile(np.eye(4, dtype=np.float32), (count, 1, 1)) if transforms is None else transforms.astype(np.float32),
        object_index=np.arange(count, dtype=np.int32),
        object_names=tuple(mesh.name for mesh in meshes),
        visible_to_camera=flags(visible_to_camera),
        casts_shadow=flags(casts_shadow),
        stable_id=np.array([101 * (k + 1) for k in range(count)] if stable_ids is None else stable_ids, np.uint32),
        material_set=np.arange(count, dtype=np.int32) if materials else None,
        stays=flags(stays),
    )
    ordered = tuple(sorted(lights, key=lambda light: light.name))
    return SceneSnapshot(
        "Scene",
        "ViewLayer",
        1,
        width,
        height,
        tuple(meshes),
        instances,
        ordered,
        camera,
        pixel_filter,
        np.zeros(3),
        materials=tuple(materials),
        material_sets=tuple((index,) for index in range(len(materials))),
        world=world,
    )


# materials


def mirror(reflectance: Sequence[float] = (1.0, 1.0, 1.0), roughness: float = 0.0) -> Material:
    """Reflects the same share in all directions."""
    return Material(
        "mirror",
        diffuse=BLACK,
        dielectric_weight=BLACK,
        metal_weight=WHITE,
        metal=Constant(tuple(reflectance)),
        has_metal_fresnel=False,
        roughness=Constant(3 * (roughness,)),
    )


def matte(albedo: Sequence[float] = (0.8, 0.8, 0.8), emission: Sequence[float] = (0.0, 0.0, 0.0)) -> Material:
    return Material("matte", diffuse=Constant(tuple(albedo)), dielectric_weight=BLACK, emission=Constant(tuple(emission)))


def scaled(scene: SceneSnapshot, factor: float) -> SceneSnapshot:
    """The same picture in another unit: suns have an angle and no size, and lamps the power that lights it as before."""
    meshes = tuple(
        dataclasses.replace(mesh, positions_os=(mesh.positions_os * np.float64(factor)).astype(np.float32)) for mesh in scene.meshes
    )
    placed = scene.instances.world_from_object.copy()
    placed[:, :3, 3] *= factor
    camera = scene.camera
    matrix = camera.world_from_view.copy()
    matrix[:3, 3] *= factor
    camera = dataclasses.replace(
        camera,
        world_from_view=matrix,
        window=tuple(side * factor for side in camera.window) if camera.is_orthographic else camera.window,
        clip_start_m=camera.clip_start_m * factor,
        clip_end_m=camera.clip_end_m * factor,
    )
    lights = []
    for light in scene.lights:
        matrix = light.world_from_light.copy()
        matrix[:3, 3] *= factor
        length, power = (1.0, 1.0) if light.shape is LightShape.SUN else (factor, factor**2)
        sizes = {"size_x_m": light.size_x_m * length, "size_y_m": light.size_y_m * length}
        lights.append(dataclasses.replace(light, world_from_light=matrix, strength=light.strength * power, **sizes))
    return dataclasses.replace(
        scene,
        meshes=meshes,
        instances=dataclasses.replace(scene.instances, world_from_object=placed),
        camera=camera,
        lights=tuple(lights),
    )


# rendering


def render_passes(scene: SceneSnapshot, device: Device, **settings: Any) -> dict[str, np.ndarray]:
    """Pass name -> (height, width) float32; keywords of Settings."""
    passes: dict[str, np.ndarray] = {}
    for progress in render(scene, plan(scene, Settings(**settings)), device):
        if progress.batches_done == progress.batches_total:
            passes = progress.passes
    return passes


def render_pass(scene: SceneSnapshot, device: Device, **settings: Any) -> np.ndarray:
    """The pass of the first light."""
    return render_passes(scene, device, **settings)[shadow_pass_name(scene.lights[0].name)]


@contextlib.contextmanager
def prepared_renderer(scene: SceneSnapshot, device: Device, **settings: Any):
    """Everything fitted and uploaded, no batch rendered yet."""
    with contextlib.closing(Renderer(scene, plan(scene, Settings(**settings)), device)) as renderer:
        device.run(renderer.prepare)
        yield renderer


def render_batches(renderer: Renderer) -> None:
    """All of them, without reading anything back."""
    for batch in range(renderer.plan.batch_count):
        renderer.device.run(renderer.render_batch, batch)


def error_against_rasterization(scene: SceneSnapshot, device: Device, method: Method, **settings: Any) -> float:
    """RMSE of the first light's pass against `mvr` with the same 64 views, in a scene with shadows."""
    images = [render_pass(scene, device, method=each, view_count=64, **settings) for each in (Method.MVR, method)]
    assert (images[0] < 0.9).mean() > 0.05
    return rmse(*images)


def check_portions(scene: SceneSnapshot, device: Device, least_count: int, **settings: Any) -> None:
    """A buffer of 1 MiB makes at least so many portions, and the same picture; so does having none, for methods that can."""
    settings = {"view_count": 16, "map_resolution_px": 512, "cull_hidden": False, **settings}
    whole = render_pass(scene, device, **settings)
    with prepared_renderer(scene, device, replay_buffer_mib=1, **settings) as renderer:
        assert renderer.works[0].statistics.portion_count >= least_count
    np.testing.assert_array_equal(render_pass(scene, device, replay_buffer_mib=1, **settings), whole)
    if settings["method"].may_be_bufferless:
        np.testing.assert_array_equal(render_pass(scene, device, points=PointStorage.BUFFERLESS, **settings), whole)


def rmse(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(np.mean((np.asarray(a, np.float64) - b) ** 2)))
