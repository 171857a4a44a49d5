"""Eye-based point rendering: its maps against the rasterizer's, its passes against those and float64, its sizes against eqs. 5 and 6."""

import dataclasses

import numpy as np
import pytest

from tests.core.test_point_coverage import leaves_scene, sphere_scene
from tests.core.test_vir import lit_by
from tests.ray_tracing import bracket_pass
from tests.scenes import (
    area_light,
    box,
    bumpy_sphere,
    camera_from_above,
    check_portions,
    error_against_rasterization,
    floor,
    perspective_camera,
    point_light,
    prepared_renderer,
    rectangle,
    render_batches,
    rmse,
    snapshot,
    spot_light,
    sun_light,
)
from vir_addon.core.errors import UsageError
from vir_addon.core.eye_pixels import eye_pixels
from vir_addon.core.fit import TEXELS_PER_EYE_PIXEL
from vir_addon.core.methods.base import FaceJob
from vir_addon.core.methods.mvr import MultiviewRasterization
from vir_addon.core.plan import plan
from vir_addon.core.settings import Method, PointStorage, Settings
from vir_addon.core.views import LADDER_STEPS_PER_OCTAVE, MAP_SIZE_STEP_PX
from vir_addon.device.interface import EMPTY_DEPTH_BITS

WIDTH, HEIGHT = 160, 90


def room_meshes():
    return [
        floor(3.0),
        rectangle("left wall", (-3, -3, 0), (0, 6, 0), (0, 0, 3)),
        rectangle("back wall", (-3, 3, 0), (6, 0, 0), (0, 0, 3)),
        box("pillar", (-1.8, 0.6, 1.2), (0.2, 0.2, 1.2), turn_rad=0.3),
        box("shelf", (1.9, 0.2, 1.6), (0.5, 0.8, 0.05)),
        bumpy_sphere("ball", (0.5, 0.8, 1.0), 0.5, 7, smooth=False),
    ]


def made(name, width=WIDTH, height=HEIGHT, camera=None):
    """A lamp among large objects, a spot over a closed surface of small triangles, a lamp over thin leaves."""
    meshes, light = {
        "room": lambda: (room_meshes(), point_light(eye=(0.0, 0.3, 1.9), radius_m=0.2)),
        "sphere": lambda: (sphere_scene()[0], spot_light(eye=(2.0, -2.0, 5.0), target=(0.0, 0.0, 1.0), radius_m=0.4)),
        "leaves": lambda: (leaves_scene()[0], point_light(eye=(0.5, -0.5, 4.0), radius_m=0.3)),
    }[name]()
    camera = camera or perspective_camera((0.2, -6.5, 2.6), (0.0, 0.0, 1.2), width, height, 0.45)
    return snapshot(meshes, [light], camera, width, height)


def rasterized(method, light, samples_m, settings):
    """What the hardware rasterizer draws into a method's maps."""
    job = FaceJob(method.scene_data, method.fitted, method.face_table, method.culled, light, samples_m, settings, method.shared)
    return MultiviewRasterization(job)


def depths(device, maps, method, selected):
    method.fill(maps, selected)
    return device.run(device.read, maps.texture).copy()


CASES = {
    # scene, width and map resolution; share of texels that points write, at least; of texels that may be missed. The rasterizer rounds
    # corners to 256ths of a texel, which thin leaves show; points of what is culled at random, what that leaves out.
    "room": ("room", 160, 512, 0.0, 1e-5),
    "sphere": ("sphere", 160, 512, 0.0, 1e-5),
    "leaves": ("leaves", 160, 512, 0.0, 4e-4),
    "small triangles": ("sphere", 160, 64, 0.5, 3e-3),
    "small maps": ("room", 960, 64, 0.2, 1e-3),
}


@pytest.mark.parametrize(
    ("case", "is_watertight"),
    [
        pytest.param(case, is_watertight, marks=() if is_watertight or case in ("room", "leaves") else pytest.mark.slow)
        for case in CASES
        for is_watertight in (True, False)
    ],
)
def test_maps_are_the_rasterizer_s(device, case, is_watertight):
    """Splats have no holes, whatever their density, and points lie within their texel. With the published density nearly all are splats."""
    name, width, map_px, of_points_at_least, may_miss = CASES[case]
    covered = missed = deeper = of_points = 0
    settings = {"method": Method.EPR, "view_count": 64, "map_resolution_px": map_px, "watertight": is_watertight}
    with prepared_renderer(made(name, width, width * 9 // 16), device, **settings) as renderer:
        (work,) = renderer.works
        for _, _, method in work.faces:
            if method is None:
                continue
            maps = renderer.store.maps(8)
            truth = depths(device, maps, rasterized(method, work.light, work.samples_m, renderer.plan.settings), range(8))
            found = depths(device, maps, method, range(8))
            shows = truth != EMPTY_DEPTH_BITS
            footprint = max(method.fitted.views.texel_tangent)
            covered += shows.sum()
            missed += (shows & (found == EMPTY_DEPTH_BITS)).sum()
            deeper += (found.view(np.float32)[shows] > truth.view(np.float32)[shows] * (1 + 4 * footprint)).sum()
            of_points += (found[shows] & 1).sum()
    print(f"{case}: missed {missed / covered:.6f}, deeper {deeper / covered:.6f}, of points {of_points / covered:.3f} of {covered}")
    assert covered > 5_000
    assert missed <= may_miss * covered
    assert deeper <= 2 * may_miss * covered
    assert of_points >= of_points_at_least * covered or not is_watertight


@pytest.mark.parametrize("name", ["room", *(pytest.param(name, marks=pytest.mark.slow) for name in ("sphere", "leaves"))])
def test_passes_agree_with_multiview_rasterization(device, name):
    error = error_against_rasterization(made(name), device, Method.EPR, map_resolution_px=512)
    print(f"{name}: RMSE {error:.5f}")
    assert error <= 0.01


@pytest.mark.parametrize("radius_m", [0.0, 0.2])
def test_pass_lies_within_a_texel_of_the_truth(device, radius_m):
    light = point_light(eye=(0.0, 0.3, 1.9), radius_m=radius_m)
    width, height = 48, 27
    scene = dataclasses.replace(made("room", width, height), lights=(light,))
    with prepared_renderer(scene, device, method=Method.EPR, view_count=16, map_resolution_px=512) as renderer:
        render_batches(renderer)
        image = renderer.read_passes()["VIR Shadow Key"]
        (work,) = renderer.works
        positions = device.run(device.read, renderer.eye.buffers[0].positions)
        truth = bracket_pass(scene, work.light, work.samples_m, work.sample_weights, [fitted for fitted, _, _ in work.faces], positions)
    wrong = np.maximum(truth.low - image, image - truth.high) > 2e-3
    print(f"RMSE {rmse(image, truth.exact):.5f}, map {work.statistics.map_resolution_px}, {wrong.sum()} of {wrong.size} wrong")
    assert truth.exact[truth.surface].std() > 0.1
    assert wrong.mean() <= 2e-3
    assert rmse(image, truth.exact) < (0.06 if radius_m == 0 else 0.02)


def test_far_fewer_points_than_for_every_texel(device):
    """A picture of few pixels needs few points, and more as it grows."""
    counts = {}
    for method, width, height in ((Method.IVIR, 160, 90), (Method.EPR, 160, 90), (Method.EPR, 640, 360)):
        with prepared_renderer(made("room", width, height), device, method=method, view_count=8, map_resolution_px=256) as renderer:
            counts[method, width] = renderer.works[0].statistics.point_count
    print(counts)
    assert counts[Method.EPR, 160] < counts[Method.EPR, 640] < counts[Method.IVIR, 160]
    assert counts[Method.EPR, 160] < 0.2 * counts[Method.IVIR, 160]


@pytest.mark.parametrize("view_count", [2, pytest.param(16, marks=pytest.mark.slow)])
def test_portions_and_bufferless_make_the_same_picture(device, view_count):
    check_portions(made("room", 480, 270), device, 2, method=Method.EPR, view_count=view_count)


# eq. 6


def fitted_faces(device, scene, resolution_px=1024):
    with prepared_renderer(scene, device, method=Method.EPR, view_count=8, map_resolution_px=resolution_px) as renderer:
        positions = device.run(device.read, renderer.eye.buffers[0].positions)
        (work,) = renderer.works
        return [fitted for fitted, _, method in work.faces if method is not None], positions


def over_a_floor(half_width_m, width=64, height=64, light_height_m=4.0):
    """A lamp over a floor seen from above, with something that casts everywhere."""
    meshes = [floor(4.0), rectangle("screen", (-4, -4, 1), (8, 0, 0), (0, 8, 0))]
    camera = camera_from_above((0.0, 0.0), 2 * half_width_m, width, height)
    light = point_light(eye=(0.0, 0.0, light_height_m), radius_m=0.0)
    return snapshot(meshes, [light], camera, width, height, visible_to_camera=[True, False])


@pytest.mark.parametrize("light_height_m", [3.0, 4.0, 6.0])
def test_map_size_follows_its_equation(device, light_height_m):
    """From above all pixels are equally wide, and the farthest lit one, in the corner, decides."""
    half_width_m, pixels = 1.5, 64
    (fitted,), positions = fitted_faces(device, over_a_floor(half_width_m, pixels, pixels, light_height_m))
    views = fitted.views
    pixel_m = 2 * half_width_m / pixels
    farthest_m = np.hypot(light_height_m, np.linalg.norm(positions[..., :2], axis=-1).max())
    wanted = pixel_m / farthest_m / TEXELS_PER_EYE_PIXEL
    # a step of the ladder at most finer than wanted
    for tangent in views.texel_tangent:
        assert wanted * 2 ** (-1 / LADDER_STEPS_PER_OCTAVE) < tangent <= wanted * 1.000001
    window = 2 * half_width_m / light_height_m
    for size_px in (views.map_width_px, views.map_height_px):
        assert size_px % MAP_SIZE_STEP_PX == 0
        assert 0 <= size_px - window / views.texel_tangent[0] < 0.1 * size_px + MAP_SIZE_STEP_PX + 8


def test_no_map_is_larger_than_asked_for(device):
    (fitted,), _ = fitted_faces(device, over_a_floor(1.5, 512, 512), resolution_px=200)
    assert 200 / 2 ** (1 / LADDER_STEPS_PER_OCTAVE) - 8 < fitted.views.map_width_px <= 200


def test_sizes_change_in_steps_and_texels_with_the_ladder(device):
    """A camera that comes nearer in small steps: nothing changes from frame to frame but by MAP_SIZE_STEP_PX or a step of the ladder."""
    found = []
    for half_width_m in np.geomspace(1.5, 1.35, 12):
        (fitted,), _ = fitted_faces(device, over_a_floor(half_width_m))
        found.append((fitted.views.map_width_px, fitted.views.texel_tangent[0]))
    sizes, tangents = np.array(found).T
    assert set(np.abs(np.diff(sizes))) <= {0, MAP_SIZE_STEP_PX}
    steps = np.log2(tangents) * LADDER_STEPS_PER_OCTAVE
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert 1 <= len(set(np.round(steps))) <= 3


def test_size_alone_changes_nothing(device, monkeypatch):
    """With texels of the same size a map that reaches farther shows the same shadow: steps of the size cannot be seen."""
    scene, images, sizes_px = made("room"), [], []
    for step_px in (MAP_SIZE_STEP_PX, 112):
        monkeypatch.setattr("vir_addon.core.views.MAP_SIZE_STEP_PX", step_px)
        with prepared_renderer(scene, device, method=Method.EPR, view_count=16) as renderer:
            render_batches(renderer)
            images.append(renderer.read_passes()["VIR Shadow Key"])
            sizes_px.append(renderer.works[0].statistics.map_resolution_px)
    assert sizes_px[0] != sizes_px[1]
    np.testing.assert_array_equal(*images)


@pytest.mark.parametrize("is_orthographic", [False, True])
def test_pixels_of_the_eye_are_no_wider_than_they_are(is_orthographic):
    """Against what the camera's window says of neighbouring pixels."""
    scene = made("room", 64, 36, camera_from_above((0, 0), 3.0, 64, 36) if is_orthographic else None)
    left, right, bottom, top = scene.camera.window
    x = left + (np.arange(64) + 0.5) / 64 * (right - left)
    y = bottom + (np.arange(36) + 0.5) / 36 * (top - bottom)
    grid = np.stack(np.broadcast_arrays(x[None, :, None], y[:, None, None], -1.0)[:3], axis=-1)[..., 0, :]
    if is_orthographic:
        places, distances = grid, np.ones(grid.shape[:2])
    else:
        distances = np.linalg.norm(grid, axis=-1)
        places = grid / distances[..., None]  # a metre from the eye
    across = np.linalg.norm(np.diff(places, axis=1), axis=-1).min()
    up = np.linalg.norm(np.diff(places, axis=0), axis=-1).min()
    rotation, eye = scene.camera.world_from_view[:3, :3], scene.camera.world_from_view[:3, 3]
    claimed = eye_pixels(scene).widths_m(eye + 2.0 * np.array([[0.0, 0.0, -1.0]]) @ rotation.T)[0] / (1.0 if is_orthographic else 2.0)
    assert 0.8 * min(across, up) < claimed <= min(across, up) * 1.0001


# what it cannot do


@pytest.mark.parametrize("light", [sun_light("Other"), area_light("Other")])
def test_other_lights_are_refused_with_what_can(light):
    with pytest.raises(UsageError, match=r"'Other'.*the method ivir"):
        plan(lit_by(light), Settings(method=Method.EPR))


@pytest.mark.parametrize("storage", PointStorage)
def test_lamps_are_planned(storage):
    for light in (point_light(), spot_light()):
        (line,) = plan(lit_by(light), Settings(method=Method.EPR, points=storage)).passes
        assert line.runs and line.method is Method.EPR and line.points is storage
