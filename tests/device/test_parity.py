"""Both devices make the same pictures of the same scene, and leave each other alone."""

from __future__ import annotations

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from tests.device.kernels import ATOMIC_MIN
from tests.scenes import METHODS_AND_HYBRID, point_light, render_pass, spot_light, sun_light
from vir_addon.core.bounds import compute_bounds, cullable_instances
from vir_addon.core.errors import UsageError
from vir_addon.core.fit import fit_light, light_hull
from vir_addon.core.methods.base import FaceJob
from vir_addon.core.methods.hybrid import HybridRasterization
from vir_addon.core.methods.ivir import ImprovedViewIndependentRasterization
from vir_addon.core.methods.micro import MicroTriangleRasterization
from vir_addon.core.methods.mvr import MultiviewRasterization
from vir_addon.core.methods.shared import SharedByFaces
from vir_addon.core.passes.eye import EyePass
from vir_addon.core.passes.scene_data import SceneData
from vir_addon.core.passes.shadow_maps import DepthMaps, face_table
from vir_addon.core.reach import select_receivers
from vir_addon.core.sampling import light_samples
from vir_addon.core.scene import Camera, Instances, Light, LightShape, Mesh, PixelFilter, SceneSnapshot
from vir_addon.core.settings import Method, PointGeneration, PointStorage, Settings
from vir_addon.device.interface import EMPTY_DEPTH_BITS, TextureFormat
from vir_addon.device.open import open_device

VIEW_COUNT = 4
MAP_SIZE_PX = 256
ROUNDING = 4e-6
"""of a depth: some units in the last place of float32 for another order of the same operations"""
FEW = 2e-4
"""share of texels that may differ more, where a triangle's edge passes a texel's centre"""


def displaced_sphere(row_count: int, column_count: int) -> Mesh:
    polar, azimuth = np.meshgrid(
        np.linspace(0, np.pi, row_count + 1), np.linspace(0, 2 * np.pi, column_count, endpoint=False), indexing="ij"
    )
    radius = 1 + 0.05 * np.sin(9 * azimuth) * np.sin(7 * polar)
    directions = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=-1)
    first = np.arange(row_count)[:, None] * column_count
    column = np.arange(column_count)
    a, b = (first + column).ravel(), (first + (column + 1) % column_count).ravel()
    c, d = a + column_count, b + column_count
    triangles = np.stack([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)], axis=1).reshape(-1, 3)
    positions = (radius[..., None] * directions).reshape(-1, 3) + np.array([0, 0, 1.2])
    return Mesh(
        "sphere", positions.astype(np.float32), triangles.astype(np.int32), directions.reshape(-1, 3).astype(np.float32), is_closed=True
    )


def looking(eye: list[float], target: list[float]) -> np.ndarray:
    """(4, 4) world_from_view"""
    forward = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
    right = np.cross(forward, [0, 0, 1]) / np.linalg.norm(np.cross(forward, [0, 0, 1]))
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, np.cross(right, forward), -forward, eye], axis=1)
    return matrix


@pytest.fixture(scope="module")
def snapshot():
    floor_positions = np.array([[-10, -10, 0], [10, -10, 0], [10, 10, 0], [-10, 10, 0]], np.float32)
    floor = Mesh("floor", floor_positions, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    placed = np.tile(np.eye(4, dtype=np.float32), (3, 1, 1))
    placed[1, :3, 3] = 1.5, 1.0, -0.3
    placed[1, 0, 0] = -0.7  # mirrored
    instances = Instances(
        np.array([0, 0, 1], np.int32),
        placed,
        np.arange(3, dtype=np.int32),
        ("sphere", "mirrored", "floor"),
        np.ones(3, bool),
        np.ones(3, bool),
        np.array([11, 22, 33], np.uint32),
    )
    light = Light("Key", LightShape.RECTANGLE, looking([2.0, -2.0, 5.0], [0, 0, 1]), 1.0, 1.0, np.pi, 100.0, True)
    camera = Camera("camera", False, looking([0.0, -8.0, 4.0], [0, 0, 0.8]), (-0.5, 0.5, -0.28125, 0.28125), 0.1, 100.0)
    return SceneSnapshot(
        "s", "ViewLayer", 1, 320, 180, (displaced_sphere(100, 100), floor), instances, (light,), camera, PixelFilter(), np.zeros(3)
    )


class Renderer:
    """The snapshot on one device."""

    def __init__(self, snapshot, device):
        self.snapshot, self.device, self.light = snapshot, device, snapshot.lights[0]
        self.scene_data = SceneData(snapshot, device)
        self.bounds = compute_bounds(snapshot)
        self.eye = EyePass(self.scene_data, self.bounds, np.array([[0.125, -0.25]]))
        self.eye.render([0], 0)
        self.positions, self.normals = device.read(self.eye.buffers[0].positions), device.read(self.eye.buffers[0].normals)
        self.samples = light_samples(self.light, VIEW_COUNT)

    def fit(self, receivers):
        faces, _ = fit_light(self.snapshot, self.light, self.samples, self.bounds, receivers, MAP_SIZE_PX)
        views = faces[0].views
        self.fitted = faces[0]
        self.maps = DepthMaps(self.device, views.map_width_px, views.map_height_px, VIEW_COUNT)

    def filled(self, method):
        method.prepare()
        method.fill(self.maps, range(VIEW_COUNT))
        method.release()
        return self.device.read(self.maps.texture)

    def job(self, settings):
        culled = cullable_instances(self.snapshot, self.bounds, light_hull(self.light, self.samples))
        table = face_table(self.fitted.views, self.light)
        shared = SharedByFaces(self.device, settings)
        return FaceJob(self.scene_data, self.fitted, table, culled, self.light, self.samples, settings, shared)

    def rasterized(self):
        return self.filled(MultiviewRasterization(self.job(Settings())))

    def micro(self):
        return self.filled(MicroTriangleRasterization(self.job(Settings())))

    def sampled(self, settings, storage, method=ImprovedViewIndependentRasterization):
        return self.filled(method(self.job(settings), storage))


@pytest.fixture(scope="module")
def renderers(snapshot, both):
    made = [Renderer(snapshot, device) for device in both]
    receivers = select_receivers(made[0].positions, made[0].normals, snapshot.lights[0])
    for renderer in made:
        renderer.fit(receivers)
    return made


def assert_same_depths(a, b):
    assert ((a == EMPTY_DEPTH_BITS) != (b == EMPTY_DEPTH_BITS)).mean() <= FEW
    covered = (a != EMPTY_DEPTH_BITS) & (b != EMPTY_DEPTH_BITS)
    assert covered.mean() > 0.05
    depths_a, depths_b = a.view(np.float32)[covered], b.view(np.float32)[covered]
    assert (np.abs(depths_a - depths_b) > ROUNDING * depths_a).mean() <= FEW


def test_eye_passes_agree(renderers):
    a, b = renderers
    same = a.positions[..., 3] == b.positions[..., 3]
    assert same.mean() >= 1 - FEW and 0.3 < (a.positions[..., 3] >= 0).mean() < 1
    assert set(np.unique(a.positions[..., 3])) == {-1, 0, 1, 2}
    np.testing.assert_allclose(a.positions[same], b.positions[same], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(a.normals[same][:, :3], b.normals[same][:, :3], atol=1e-5)
    assert (a.normals[same][:, 3] != b.normals[same][:, 3]).mean() < 0.01


def test_rasterized_depth_maps_agree(renderers):
    assert_same_depths(*[renderer.rasterized() for renderer in renderers])


def test_micro_triangle_depth_maps_agree(renderers):
    """Small ones of the sphere and, in ranges of one mesh, large ones of the box."""
    assert_same_depths(*[renderer.micro() for renderer in renderers])


@pytest.mark.parametrize("storage", PointStorage)
@pytest.mark.parametrize("watertight", [True, False])
def test_sampled_depth_maps_agree(renderers, storage, watertight):
    settings = Settings(watertight=watertight)
    assert_same_depths(*[renderer.sampled(settings, storage) for renderer in renderers])


@pytest.mark.parametrize("storage", PointStorage)
def test_hybrid_depth_maps_agree(renderers, storage):
    """At this threshold about half of the sphere's triangles are points."""
    settings = Settings(small_triangle_points=12)
    found = [renderer.sampled(settings, storage, HybridRasterization) for renderer in renderers]
    assert_same_depths(*found)
    assert 0.1 < (found[0][found[0] != EMPTY_DEPTH_BITS] & 1).mean() < 0.9


def test_what_a_device_lacks_is_refused_before_any_work(snapshot, both, monkeypatch):
    _, blender_device = both
    monkeypatch.setattr(blender_device, "create_texture", None)
    with pytest.raises(UsageError, match=r"vwss.*gpu.*the device moderngl"):
        render_pass(snapshot, blender_device, method=Method.VWSS, view_count=8, map_resolution_px=128)
    by_rasterizer = {"method": Method.IVIR, "point_generation": PointGeneration.RASTERIZER}
    with pytest.raises(UsageError, match=r"geometry shaders.*gpu.*the device moderngl, or the point generation compute"):
        render_pass(snapshot, blender_device, **by_rasterizer, view_count=8, map_resolution_px=128)


def test_a_device_repeats_itself(renderers):
    for renderer in renderers:
        first, second = (renderer.sampled(Settings(), PointStorage.BUFFERED) for _ in range(2))
        np.testing.assert_array_equal(first, second)


# in one process


def lowest_numbers(device, count, width=64):
    lowest = device.create_texture(width, 1, TextureFormat.R32UI)
    device.fill(lowest, EMPTY_DEPTH_BITS)
    device.compute_kernel(ATOMIC_MIN).dispatch_linear(count, lowest=lowest, invocation_count=count, width=width)
    read = device.read(lowest)[0]
    lowest.release()
    return read


def test_moderngl_is_used_from_many_threads_at_once(both):
    device, _ = both
    with ThreadPoolExecutor(6) as pool:
        counts = range(100, 200)
        for count, read in zip(counts, pool.map(lambda count: lowest_numbers(device, count), counts), strict=True):
            np.testing.assert_array_equal(np.sort(read), np.arange(1, 65))
            assert read[(count - 1) % 64] == 1


def blender_draws() -> np.ndarray:
    """Colours of a triangle that Blender's own shader draws off screen."""
    import gpu
    from gpu_extras.batch import batch_for_shader

    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    batch = batch_for_shader(shader, "TRIS", {"pos": [(-1, -1, 0), (1, -1, 0), (-1, 1, 0)]})
    offscreen = gpu.types.GPUOffScreen(32, 32, format="RGBA32F")
    with offscreen.bind():
        framebuffer = gpu.state.active_framebuffer_get()
        framebuffer.clear(color=(0.0, 0.0, 1.0, 1.0))
        shader.bind()
        shader.uniform_float("color", (1.0, 0.5, 0.25, 1.0))
        batch.draw(shader)
        colors = framebuffer.read_color(0, 0, 32, 32, 4, 0, "FLOAT")
    offscreen.free()
    return np.array(colors.to_list())


def test_blender_draws_the_same_before_and_after(renderers):
    import gpu

    before = blender_draws()
    np.testing.assert_allclose(before[0, 0], (1.0, 0.5, 0.25, 1.0))
    np.testing.assert_allclose(before[-1, -1], (0.0, 0.0, 1.0, 1.0))

    def state():
        return gpu.state.blend_get(), gpu.state.depth_test_get(), gpu.state.depth_mask_get()

    gpu.state.depth_mask_set(False)
    gpu.state.blend_set("ALPHA")
    state_before = state()
    for renderer in renderers:
        renderer.rasterized()
        renderer.device.fill(renderer.maps.target.depth, 0)
        renderer.device.finish()
    assert state() == state_before
    gpu.state.depth_mask_set(True)
    gpu.state.blend_set("NONE")
    np.testing.assert_array_equal(blender_draws(), before)


def test_opening_and_closing_moderngl_leaves_blender_s_gpu_alone(both):
    _, blender = both
    before = lowest_numbers(blender, 1000)
    second = open_device("moderngl")
    np.testing.assert_array_equal(lowest_numbers(second, 1000), before)
    second.close()
    np.testing.assert_array_equal(lowest_numbers(blender, 1000), before)
    assert blender_draws().shape == (32, 32, 4)


LAMPS = {
    "sun": sun_light(eye=(2.0, -2.0, 5.0)),
    "sphere in a cube": point_light(eye=(0.6, -1.6, 1.4), radius_m=0.2),
    "spot with a soft falloff": spot_light(eye=(2.0, -2.0, 5.0), target=(0.0, 0.0, 1.0), cone_blend=0.3, has_soft_falloff=True),
}


@pytest.mark.parametrize(
    ("name", "method"),
    [
        (name, method)
        for name, light in LAMPS.items()
        for method in (*METHODS_AND_HYBRID, Method.EPR, Method.PCSS)
        if light.shape.is_omni or method is not Method.EPR
    ],
)
def test_passes_of_lamps_agree(snapshot, both, name, method):
    scene = dataclasses.replace(snapshot, lights=(LAMPS[name],), width_px=96, height_px=54)
    a, b = (render_pass(scene, device, method=method, view_count=8, map_resolution_px=128) for device in both)
    assert a.std() > 0.1
    # a texel that either rounding may give to a triangle changes one sample of a few pixels
    assert (np.abs(a - b) > 1e-3).mean() < 0.01
    assert np.abs(a - b).mean() < 1e-3
