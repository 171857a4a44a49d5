"""The view window against Blender's own projection matrix, picture sizes against pictures that Blender writes."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

bpy = pytest.importorskip("bpy")

from vir_addon.blender.extract.camera import compute_window, extract_camera, extract_picture, extract_pixel_filter  # noqa: E402
from vir_addon.core.errors import SceneError  # noqa: E402
from vir_addon.core.passes.eye import clip_from_view  # noqa: E402
from vir_addon.core.scene import FilterShape  # noqa: E402

LENS = st.floats(1.0, 300.0)
SENSOR = st.floats(1.0, 80.0)
SHIFT = st.floats(-2.0, 2.0)
PIXELS = st.integers(4, 4000)
ASPECT = st.floats(1.0, 4.0)


def window_of_projection(projection: np.ndarray, is_orthographic: bool) -> np.ndarray:
    """left, right, bottom, top of the plane at distance 1 (perspective) or in metres (orthographic)"""
    view_from_clip = np.linalg.inv(projection)
    corners = [view_from_clip @ (*corner, 0.0, 1.0) for corner in ((-1.0, -1.0), (1.0, 1.0))]
    low, high = (corner[:2] / (corner[3] if is_orthographic else -corner[2]) for corner in corners)
    return np.array([low[0], high[0], low[1], high[1]])


@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    kind=st.sampled_from(["PERSP", "ORTHO"]),
    fit=st.sampled_from(["AUTO", "HORIZONTAL", "VERTICAL"]),
    lens=LENS,
    ortho_scale=st.floats(0.01, 100.0),
    sensor=st.tuples(SENSOR, SENSOR),
    shift=st.tuples(SHIFT, SHIFT),
    resolution=st.tuples(PIXELS, PIXELS),
    aspect=st.tuples(ASPECT, ASPECT),
)
def test_window_is_that_of_blenders_projection(scene, kind, fit, lens, ortho_scale, sensor, shift, resolution, aspect):
    data = scene.camera.data
    data.type, data.sensor_fit = kind, fit
    data.lens, data.ortho_scale = lens, ortho_scale
    data.sensor_width, data.sensor_height = sensor
    data.shift_x, data.shift_y = shift
    render = scene.render
    render.pixel_aspect_x, render.pixel_aspect_y = aspect
    depsgraph = bpy.context.evaluated_depsgraph_get()
    width_px, height_px = resolution
    projection = scene.camera.calc_matrix_camera(
        depsgraph, x=width_px, y=height_px, scale_x=render.pixel_aspect_x, scale_y=render.pixel_aspect_y
    )
    expected = window_of_projection(np.array(projection, dtype=np.float64), kind == "ORTHO")
    window = np.array(compute_window(data, render, width_px, height_px))
    size = max(expected[1] - expected[0], expected[3] - expected[2])
    assert np.allclose(window, expected, rtol=1e-4, atol=2e-4 * size * (1.0 + max(map(abs, shift))))


def test_window_and_clip_of_a_common_camera(scene, take):
    scene.camera.data.clip_start, scene.camera.data.clip_end = 0.5, 50.0
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 1920, 1080, 50
    taken = take()
    half_width = 0.5 * 36.0 / 50.0
    assert (taken.width_px, taken.height_px) == (960, 540)
    assert taken.camera.window == pytest.approx((-half_width, half_width, -half_width * 9 / 16, half_width * 9 / 16))
    assert (taken.camera.clip_start_m, taken.camera.clip_end_m) == (0.5, 50.0)
    assert not taken.camera.is_orthographic


def test_resolution_argument_replaces_the_frame(take):
    taken = take(resolution=(100, 200))
    left, right, bottom, top = taken.camera.window
    assert (taken.width_px, taken.height_px) == (100, 200)
    assert (right - left) / (top - bottom) == pytest.approx(0.5)


def test_camera_keeps_its_place_without_its_scale(scene, add, take):
    parent = add.object("Parent", None, scale=(3.0, 3.0, 3.0), rotation_euler=(0.0, 0.0, math.pi / 2))
    scene.camera.parent = parent
    scene.camera.scale = (0.5, 0.5, 7.0)
    taken = take()
    rotation = taken.camera.world_from_view[:3, :3]
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.allclose(rotation[:, 2], (1.0, 0.0, 0.0), atol=1e-6), "looks along -z"
    assert np.allclose(taken.camera.world_from_view[:3, 3] + taken.world_origin_m, (30.0, 0.0, 0.0), atol=1e-4)


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize("mirrors", [1.0, -1.0])
def test_sheared_camera_shows_what_lies_along_its_own_axes(scene, add, take, kind, mirrors):
    """At any place of the frame, (u, v) from its middle: what lies along u X + v Y - Z, the axes' lengths taken out."""
    scene.camera.parent = add.object("Parent", None, scale=(mirrors, 2.0, 5.0))
    scene.camera.rotation_euler, scene.camera.location = (1.0, 0.4, 0.3), (1.0, 2.0, -3.0)
    data = scene.camera.data
    data.type, data.shift_x, data.lens, data.ortho_scale = kind, 0.1, 30.0, 7.0
    taken = take()
    camera = taken.camera
    assert not taken.notes and abs(camera.skew) > 0.01
    rotation = camera.world_from_view[:3, :3]
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9) and np.linalg.det(rotation) > 0
    matrix = np.array(scene.camera.matrix_world, np.float64)
    x, y, z = (matrix[:3, :3] / np.linalg.norm(matrix[:3, :3], axis=0)).T
    left, right, bottom, top = compute_window(data, scene.render, taken.width_px, taken.height_px)
    clip_from_world = clip_from_view(camera, camera.clip_start_m, camera.clip_end_m) @ np.linalg.inv(camera.world_from_view)
    for across, up in ((-1, -1), (1, -1), (0.3, 0.6), (-0.7, 1)):
        u, v = (left + right + across * (right - left)) / 2, (bottom + top + up * (top - bottom)) / 2
        for depth in (1.0, 5.0):
            aside = u * x + v * y
            place = matrix[:3, 3] + (aside - depth * z if kind == "ORTHO" else depth * (aside - z))
            clip = clip_from_world @ [*place, 1]
            assert np.allclose(clip[:2] / clip[3], (across, up), atol=1e-5)
    scene.camera.parent.scale = (5.0, 5.0, 5.0)
    assert take().camera.skew == 0


def test_mirrored_camera_gives_a_mirrored_window(scene, take):
    scene.camera.data.shift_x = 0.25
    upright = take().camera
    scene.camera.scale.x = -1.0
    mirrored = take().camera
    assert np.allclose(upright.world_from_view, mirrored.world_from_view, atol=1e-6)
    assert np.linalg.det(mirrored.world_from_view[:3, :3]) == pytest.approx(1.0)
    assert mirrored.window == pytest.approx((-upright.window[0], -upright.window[1], *upright.window[2:]))


@pytest.mark.parametrize("kind", ["PANO"])
def test_panoramic_camera_is_refused_in_words(scene, take, kind):
    scene.camera.data.type = kind
    with pytest.raises(SceneError, match="'Camera' is panoramic"):
        take()


def test_camera_without_size_is_refused_in_words(scene, take):
    scene.camera.scale = (0.0, 0.0, 0.0)
    with pytest.raises(SceneError, match="scale of zero"):
        take()


def test_an_object_that_is_no_camera_is_refused_in_words(scene, add):
    light = add.light("Lamp")
    picture = extract_picture(scene.render, None)
    with pytest.raises(SceneError, match="'Lamp' is a light"):
        extract_camera(light, scene.render, picture, np.zeros(3))


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    size=st.tuples(st.integers(8, 400), st.integers(8, 400)),
    percentage=st.integers(30, 120),
    border=st.tuples(*[st.floats(0.0, 1.0)] * 4),
)
def test_cropped_size_is_that_of_the_picture_blender_makes(scene, rendered_size, size, percentage, border):
    render = scene.render
    render.resolution_x, render.resolution_y = size
    render.resolution_percentage = percentage
    render.use_border = render.use_crop_to_border = True
    render.border_min_x, render.border_max_x = sorted(border[:2])
    render.border_min_y, render.border_max_y = sorted(border[2:])
    expected = rendered_size()
    if expected is None:
        with pytest.raises(SceneError, match="border holds no pixel"):
            extract_picture(render, None)
    else:
        picture = extract_picture(render, None)
        assert (picture.width_px, picture.height_px) == expected


@pytest.fixture
def rendered_size(scene, tmp_path):
    """Width and height of the file that Blender writes for the scene; None where it refuses."""

    class BlackEngine(bpy.types.RenderEngine):
        bl_idname = "VIR_BLACK"
        bl_label = "Black"

        def render(self, depsgraph):
            x, y = depsgraph.scene.render.border_min_x, depsgraph.scene.render.border_min_y
            assert 0.0 <= x <= 1.0 and 0.0 <= y <= 1.0

    def render() -> tuple[int, int] | None:
        scene.render.filepath = str(tmp_path / "picture.png")
        scene.render.image_settings.file_format = "PNG"
        try:
            bpy.ops.render.render(write_still=True)
        except RuntimeError:
            return None
        image = bpy.data.images.load(scene.render.filepath)
        size = tuple(image.size)
        bpy.data.images.remove(image)
        return size

    bpy.utils.register_class(BlackEngine)
    scene.render.engine = "VIR_BLACK"
    yield render
    scene.render.engine = "CYCLES"
    bpy.utils.unregister_class(BlackEngine)


def test_cropped_window_is_its_part_of_the_whole(scene, take):
    render = scene.render
    render.resolution_x, render.resolution_y = 100, 50
    left, right, bottom, top = take().camera.window
    render.use_border = render.use_crop_to_border = True
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.105, 0.505, 0.3, 0.9
    taken = take()
    assert (taken.width_px, taken.height_px) == (40, 30)
    column, row = (right - left) / 100, (top - bottom) / 50
    assert taken.camera.window == pytest.approx((left + 10 * column, left + 50 * column, bottom + 15 * row, bottom + 45 * row))
    assert not taken.notes


def test_border_that_does_not_crop_is_mentioned(scene, take):
    scene.render.resolution_x, scene.render.resolution_y = 100, 50
    scene.render.use_border, scene.render.border_max_x = True, 0.5
    taken = take()
    assert (taken.width_px, taken.height_px) == (100, 50)
    assert any("border" in note for note in taken.notes)


def test_filter_of_cycles(scene):
    scene.cycles.filter_width = 1.5
    for kind, shape, width_px in (
        ("BOX", FilterShape.BOX, 1.5),
        ("GAUSSIAN", FilterShape.GAUSSIAN, 4.5),
        ("BLACKMAN_HARRIS", FilterShape.BLACKMAN_HARRIS, 3.0),
    ):
        scene.cycles.pixel_filter_type = kind
        pixel_filter = extract_pixel_filter(scene, "CYCLES")
        assert (pixel_filter.shape, pixel_filter.width_px) == (shape, pytest.approx(width_px))


def test_filter_of_other_engines(scene):
    scene.render.filter_size = 1.2
    pixel_filter = extract_pixel_filter(scene, "BLENDER_EEVEE")
    assert (pixel_filter.shape, pixel_filter.width_px) == (FilterShape.BLACKMAN_HARRIS, pytest.approx(2.4))


def test_filter_is_that_of_the_chosen_engine_while_the_stand_in_runs(scene, take):
    scene.render.engine = "CYCLES"
    scene.cycles.pixel_filter_type = "BOX"
    assert take().pixel_filter.shape is FilterShape.BOX
