"""What a scene does not call for is not done, and the plan says why."""

import dataclasses

import numpy as np
import pytest

from tests.scenes import (
    area_light,
    box,
    bumpy_sphere,
    floor,
    matte,
    mirror,
    perspective_camera,
    point_light,
    prepared_renderer,
    rectangle,
    render_batches,
    render_passes,
    snapshot,
    spot_light,
    sun_light,
    with_opacity,
)
from vir_addon.core import cost, light_plan
from vir_addon.core.errors import SceneError, UsageError
from vir_addon.core.light_plan import AUTO_METHODS
from vir_addon.core.passes import eye
from vir_addon.core.plan import plan, settings_for
from vir_addon.core.render import render
from vir_addon.core.scene import Mesh, World
from vir_addon.core.settings import Effect, Hardware, Method, PointGeneration, PointStorage, Settings

WIDTH, HEIGHT = 48, 27


def scene_with(*lights, **arguments):
    meshes = [floor(4.0), box("box", (0, 0, 0.5), (0.5, 0.5, 0.5))]
    camera = perspective_camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.3), WIDTH, HEIGHT)
    return snapshot(meshes, lights, camera, WIDTH, HEIGHT, **arguments)


def planned(scene, **settings):
    (only,) = plan(scene, Settings(**settings)).passes
    return only


SKIPPED = {
    "casts no shadow": (area_light(casts_shadow=False), 1.0),
    "has no strength": (area_light(strength=0.0), 1.0),
    "faces away": (area_light(eye=(0, 0, 5), target=(0, 0, 9)), 0.0),
    "does not shine on": (spot_light(eye=(0, 0, 5), target=(0, 0, 9)), 0.0),
    "light linking leaves it nothing": (area_light(receivers=np.zeros(2, bool)), 1.0),
    "nothing casts its shadow": (area_light(blockers=np.zeros(2, bool)), 1.0),
    "switched off for this light": (area_light(is_wanted=False), 1.0),
}


@pytest.mark.parametrize(
    ("switch", "kept", "gone"), [("soft_shadows", {"Lamp", "Spot"}, {"Key", "Sun"}), ("omni_shadows", {"Key", "Sun"}, {"Lamp", "Spot"})]
)
def test_effects_can_be_switched_off(switch, kept, gone):
    scene = scene_with(area_light(), sun_light(name="Sun"), point_light(name="Lamp"), spot_light(name="Spot"))
    lines = plan(scene, Settings(**{switch: False})).passes
    assert {line.light_name for line in lines if line.runs} == kept
    assert {line.light_name for line in lines if "switched off" in line.reason} == gone


def test_a_light_with_its_own_views_is_as_right_as_with_those_of_all(device):
    """Few views beside many: each light is looked up as often as the others, so the combined pass must not change its weight."""

    def lights(own_view_count):
        return area_light(name="Key"), area_light(name="Fill", eye=(3, -2, 4), own_view_count=own_view_count)

    alike, unlike = (render_passes(scene_with(*lights(count)), device, view_count=64) for count in (None, 24))
    (few,) = (line for line in plan(scene_with(*lights(24)), Settings(view_count=64)).passes if line.light_name == "Fill")
    assert few.view_count == 24
    for name in ("VIR Shadow Fill", "VIR Shadow"):
        assert np.sqrt(((alike[name] - unlike[name]) ** 2).mean()) < 0.02
    assert np.array_equal(alike["VIR Shadow Key"], unlike["VIR Shadow Key"])


@pytest.mark.parametrize("reason", SKIPPED)
def test_no_work_for_nothing(device, reason):
    light, surface_value = SKIPPED[reason]
    scene = scene_with(light)
    line = planned(scene)
    assert not line.runs and line.view_count == 0 and line.predicted_ms == 0
    assert reason in line.reason
    image = render_passes(scene, device)["VIR Shadow Key"]
    assert set(np.unique(image)) <= {1.0, surface_value}
    assert (image == surface_value).any() and image[-1, 0] == 1


WALL = rectangle("wall", (-4, 4, 0), (8, 0, 0), (0, 0, 4))
SHADE = rectangle("shade", (-1, -1, 1), (2, 0, 0), (0, 2, 0))
ASIDE = box("aside", (30, 0, 0.5), (0.5, 0.5, 0.5))
NO_MAP = {
    # what else there is -> whether the plan, and whether the renderer, finds something that may cast
    "a floor": ([], False, False),
    "a floor and a wall": ([WALL], False, False),
    "a shade over it": ([SHADE], True, True),
    "a box beside it": ([ASIDE], True, False),
}


@pytest.mark.parametrize(
    "light", [area_light(), point_light(), spot_light(cone_rad=3.0), sun_light(eye=(0, -2, 5))], ids=lambda light: light.shape.value
)
@pytest.mark.parametrize("case", NO_MAP)
def test_no_map_where_nothing_casts(device, case, light):
    others, may_cast, casts = NO_MAP[case]
    camera = perspective_camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.3), WIDTH, HEIGHT)
    scene = snapshot([floor(4.0), *others], [light], camera, WIDTH, HEIGHT)
    work = plan(scene, Settings(map_resolution_px=64, view_count=8))
    (line,) = work.passes
    *_, progress = render(scene, work, device)
    (made,) = progress.statistics.passes
    assert line.runs and line.needs_maps == may_cast and ("no map needed" in line.reason) != may_cast
    assert (made.method == "none", made.map_resolution_px == 0, made.reason.count("no map needed")) == (not casts, not casts, not casts)
    assert ("splat or raster" in made.stage_ms) == casts
    image = progress.passes["VIR Shadow Key"]
    # the light lights all that is in the picture, from before it
    assert (image.min() < 0.9) if casts else (image == 1).all()


def test_kinds_of_light_are_named():
    scene = scene_with(area_light(), point_light("Bulb", radius_m=0.25), spot_light("Beam", cone_rad=np.radians(40)))
    lines = {line.light_name: line for line in plan(scene, Settings()).passes}
    assert all(line.runs for line in lines.values())
    assert "1 x 1 m rectangle" in lines["Key"].reason
    assert "point light of 0.25 m radius" in lines["Bulb"].reason
    assert "spot of 40 degrees" in lines["Beam"].reason


def test_faces_cost():
    """A lamp among what it lights takes a cube, and its prediction says so."""
    above, among = (planned(scene_with(point_light(eye=(0, 0, height))), method=Method.MVR) for height in (9.0, 0.5))
    assert among.predicted_ms > 1.5 * above.predicted_ms


def test_light_without_size_gets_one_view():
    for light in (area_light(size_m=(0.0, 0.0)), point_light(radius_m=0.0), spot_light(radius_m=0.0)):
        line = planned(scene_with(light), view_count=64)
        assert line.runs and line.view_count == 1 and "one view" in line.reason
    assert planned(scene_with(area_light(size_m=(1.0, 0.0))), view_count=64).view_count == 64


def test_one_map_whatever_the_number_of_views():
    few, many = (planned(scene_with(area_light()), method=Method.PCSS, view_count=count) for count in (8, 256))
    assert few == many and few.view_count == 1
    assert "one map, 32 + 64 samples" in few.reason
    hard = planned(scene_with(area_light(size_m=(0, 0))), method=Method.PCSS)
    assert "hard shadow" in hard.reason and "samples" not in hard.reason
    assert planned(scene_with(area_light()), method=Method.PCSS, filter_sample_count=128).predicted_ms > few.predicted_ms


def test_unknown_light_is_answered_with_those_there_are():
    with pytest.raises(UsageError, match=r"'Sun'.*'Fill', 'Key'"):
        plan(scene_with(area_light(), area_light("Fill")), Settings(light_names=("Sun",)))


def test_a_light_of_other_frames_is_white_if_it_is_asked_for(device):
    scene = dataclasses.replace(scene_with(area_light()), lights_elsewhere=("Fill", "Lamp.001", "Lamp_001"))
    settings = Settings(light_names=("Key", "Lamp.001"), view_count=8)
    key, lamp = plan(scene, settings).passes
    assert key.runs and not lamp.runs and "not rendered in this frame" in lamp.reason
    assert lamp.pass_name == "VIR Shadow Lamp_001_2", "as in frames that have the other one as well"
    assert [note for note in plan(scene, settings).notes if "'Lamp.001'" in note and "white" in note]
    passes = render_passes(scene, device, light_names=("Key", "Lamp.001"), view_count=8)
    assert sorted(passes) == ["VIR Shadow", "VIR Shadow Key", lamp.pass_name]
    assert passes["VIR Shadow Key"].min() < 0.1 and (passes[lamp.pass_name] == 1).all()
    np.testing.assert_array_equal(passes["VIR Shadow"], render_passes(scene, device, light_names=("Key",), view_count=8)["VIR Shadow"])
    assert [planned.light_name for planned in plan(scene, Settings()).passes] == ["Key"]
    with pytest.raises(UsageError, match=r"'Sun'.*'Fill', 'Key', 'Lamp"):
        plan(scene, Settings(light_names=("Fill", "Sun")))


def test_none_but_lights_of_other_frames(device):
    scene = dataclasses.replace(scene_with(), lights_elsewhere=("Key",))
    for names in (None, ("Key",)):
        passes = render_passes(scene, device, light_names=names, view_count=8)
        assert sorted(passes) == ["VIR Shadow", *(["VIR Shadow Key"] if names else [])]
        assert all((pixels == 1).all() for pixels in passes.values())
    assert plan(scene, Settings(light_names=("Key",), effects=frozenset({Effect.REFLECTION}))).passes == ()


def test_no_light_at_all():
    with pytest.raises(SceneError, match="no light"):
        plan(scene_with(), Settings())


def light_for(method):
    """One that it can do."""
    return point_light() if method is Method.EPR else area_light()


@pytest.mark.parametrize("method", list(Method))
def test_method_is_decided(method):
    line = planned(scene_with(light_for(method)), method=method)
    assert line.method is not Method.AUTO
    assert (line.points is None) == (not line.method.uses_points)
    assert line.method.value in line.reason


def fine_scene(row_count, *lights):
    meshes = [floor(4.0), bumpy_sphere("ball", (0, 0, 1.0), 0.8, row_count)]
    camera = perspective_camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.3), WIDTH, HEIGHT)
    return snapshot(meshes, lights or [area_light()], camera, WIDTH, HEIGHT)


MORE_WORK = {
    "views": ({"view_count": 16}, {"view_count": 64}),
    "texels": ({"map_resolution_px": 256}, {"map_resolution_px": 1024}),
    "generations": ({"points": PointStorage.BUFFERED}, {"points": PointStorage.BUFFERLESS}),
}


@pytest.mark.parametrize(("method", "more"), [*((Method.IVIR, more) for more in MORE_WORK), (Method.MVR, "views"), (Method.MVR, "texels")])
def test_more_work_is_predicted_to_take_longer(method, more):
    few, many = (planned(fine_scene(40), method=method, **arguments).predicted_ms for arguments in MORE_WORK[more])
    assert 0 < few < many


def test_rasterizing_is_predicted_to_take_as_long_as_there_are_views():
    # that also have four times the eye samples
    few, many = (planned(fine_scene(40), method=Method.MVR, view_count=view_count).predicted_ms for view_count in (512, 2048))
    assert many == pytest.approx(4 * few)


@pytest.mark.parametrize("method", [Method.MVR, Method.IVIR])
def test_more_triangles_are_predicted_to_take_longer(method):
    predicted = [planned(fine_scene(row_count), method=method).predicted_ms for row_count in (10, 40, 160)]
    assert predicted == sorted(predicted) and predicted[-1] > 1.1 * predicted[0]


def below_a_lamp(thickness):
    """A box of so many times its width and height as depth, whose upper side is near a lamp."""
    scene = scene_with(point_light(eye=(0.0, 0.0, 2.2), radius_m=0.1))
    scene.instances.world_from_object[1] = np.diag((2.0, 2.0 * thickness, 2.0, 1.0))
    return scene


def test_flattened_casters_are_as_large_as_they_are():
    """Their determinant, the volume, vanishes and their surfaces do not: ivir was to take half a second for a lamp in such a box, and took
    minutes."""
    flat_ms, thick_ms = (planned(below_a_lamp(thickness), method=Method.IVIR).predicted_ms for thickness in (1e-7, 0.5))
    assert flat_ms > 0.5 * thick_ms


@pytest.mark.parametrize("hardware", Hardware)
@pytest.mark.parametrize(("resolution_px", "chosen"), [(64, Method.IVIR), (256, Method.MICRO)])
def test_points_are_for_triangles_far_smaller_than_texels(hardware, resolution_px, chosen):
    """With a software rasterizer `micro` takes 1.4 times the processor time of `ivir` for the coarse maps, and 0.6 times for the others."""
    assert planned(fine_scene(300), hardware=hardware, view_count=16, map_resolution_px=resolution_px).method is chosen


def test_auto_chooses_by_what_will_render(monkeypatch):
    draws_for_nothing = dataclasses.replace(cost.RATES[Hardware.GPU], raster_triangle=0.0, raster_texel=0.0, raster_draw=0.0)
    monkeypatch.setitem(cost.RATES, Hardware.GPU, draws_for_nothing)
    assert {hardware: planned(fine_scene(300), hardware=hardware).method for hardware in Hardware} == {
        Hardware.SOFTWARE: Method.MICRO,
        Hardware.GPU: Method.MVR,
    }


@pytest.mark.parametrize(
    "light",
    [
        area_light(eye=(1.0, -1.0, 3.0)),
        area_light(eye=(10.0, -10.0, 40.0)),
        sun_light(angle_rad=0.1),
        spot_light(eye=(0, 0, 5), target=(0, 0, 0)),
        point_light(eye=(0.5, -0.5, 2.5)),
    ],
    ids=["near", "far", "sun", "spot", "lamp"],
)
def test_the_plan_knows_how_fine_maps_will_be(device, monkeypatch, light):
    """To a factor of two; all predictions of points and texels are made from that. Of a face that little is seen in it may not know."""
    heard, estimate_methods = [], cost.estimate_methods
    monkeypatch.setattr(
        cost, "estimate_methods", lambda *arguments, **named: heard.append(arguments) or estimate_methods(*arguments, **named)
    )
    with prepared_renderer(scene_with(light), device, method=Method.MVR) as renderer:
        tangents = [fitted.views.texel_tangent for fitted, _, method in renderer.works[0].faces if method is not None]
    ((*_, likely, _),) = heard
    assert 0 <= len(tangents) - len(likely) <= light.shape.is_omni
    assert 0.5 < np.mean([face.texel_tangent for face in likely]) / np.mean(np.sqrt(np.prod(tangents, axis=1))) < 2


def test_settings_follow_the_device(device):
    software = "llvmpipe" in device.description
    assert settings_for(device, Settings(hardware=Hardware.GPU)).hardware is (Hardware.SOFTWARE if software else Hardware.GPU)


def test_predictions_add_up():
    """Of all passes that run, and of the eye, which is there once."""
    lights = [area_light("Key"), area_light("Fill", strength=0.0), area_light("Rim", (3, 0, 3))]
    alone = [plan(fine_scene(40, light), Settings()) for light in lights]
    eye_ms = alone[0].predicted_ms - alone[0].passes[0].predicted_ms
    assert eye_ms > 0
    together = plan(fine_scene(40, *lights), Settings())
    assert together.predicted_ms == pytest.approx(sum(one.passes[0].predicted_ms for one in alone) + eye_ms)


@pytest.mark.parametrize(
    ("size", "counts"),
    [((960, 540), (1, 1)), ((1920, 1080), (1, 2)), ((2560, 1440), (2, 4)), ((3840, 2160), (4, 8)), ((4096, 2160), (16, 32))],
)
def test_the_eye_is_rasterized_more_often_in_large_pictures(size, counts):
    scene = dataclasses.replace(fine_scene(40), width_px=size[0], height_px=size[1])
    for eye_sample_count, count in zip((16, 32), counts, strict=True):
        assert predicted_rasterization_count(scene, eye_sample_count) == pytest.approx(count)


def predicted_rasterization_count(scene, eye_sample_count, **settings):
    """What is not G-buffers, in times of one rasterization"""
    rates = cost.RATES[Hardware.SOFTWARE]
    buffers_ns = eye_sample_count * scene.width_px * scene.height_px * rates.eye_pixel
    eye_ms = cost.eye_ms(scene, Settings(hardware=Hardware.SOFTWARE, **settings), eye_sample_count)
    return (eye_ms * 1e6 - buffers_ns) / (scene.instanced_triangle_count * rates.raster_triangle)


@pytest.mark.parametrize("samples_per_px", [6, 4, 3, 1])
def test_the_eye_is_rasterized_as_often_as_predicted(device, monkeypatch, samples_per_px):
    """With as many texels for its visibility as it takes with so many samples a pixel"""
    margin_px = 2
    texels = samples_per_px**2 * (WIDTH + 2 * margin_px) * (HEIGHT + 2 * margin_px)
    rasterized, rasterizing = [], eye.EyePass._rasterizing
    monkeypatch.setattr(eye.EyePass, "_rasterizing", lambda *arguments: rasterized.append(arguments) or rasterizing(*arguments))
    scene = scene_with(area_light())
    with prepared_renderer(scene, device, view_count=128, map_resolution_px=16, visibility_texel_count=texels) as renderer:
        render_batches(renderer)
        assert renderer.plan.eye_sample_count == 64
    assert len(rasterized) == -(-64 // samples_per_px**2)
    assert predicted_rasterization_count(scene, 64, visibility_texel_count=texels) == pytest.approx(len(rasterized))


@pytest.mark.parametrize("row_count", [4, 400])
def test_auto_takes_what_is_predicted_to_be_faster(row_count):
    scene = fine_scene(row_count)
    by_method = {method: planned(scene, method=method).predicted_ms for method in AUTO_METHODS}
    line = planned(scene)
    assert line.predicted_ms == min(by_method.values()) == by_method[line.method]
    assert "times faster" in line.reason


def test_maps_larger_than_the_device_allows_are_refused_with_the_largest_that_work(device, monkeypatch):
    scene = scene_with(area_light())
    monkeypatch.setattr(device, "max_texture_size_px", 4096)
    monkeypatch.setattr(device, "create_texture", None)
    with pytest.raises(UsageError, match=r"2048 px is 16384 px high.*4096 px.*a map resolution of 512"):
        render_passes(scene, device, map_resolution_px=2048, view_count=64)
    monkeypatch.undo()
    monkeypatch.setattr(device, "max_texture_size_px", 4096)
    assert "VIR Shadow Key" in render_passes(scene, device, map_resolution_px=512, view_count=64)


@pytest.mark.parametrize("size", [(300, 20), (20, 300)])
@pytest.mark.parametrize("effects", [(Effect.SHADOW,), (Effect.REFLECTION,)])
def test_pictures_larger_than_the_device_allows_are_refused_with_the_largest_that_work(device, monkeypatch, size, effects):
    camera = perspective_camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.3), *size)
    meshes = [floor(4.0), box("box", (0, 0, 0.5), (0.5, 0.5, 0.5))]
    scene = snapshot(meshes, [area_light()], camera, *size, materials=[matte(), mirror()], world=World())
    arguments = {"effects": effects, "view_count": 8, "map_resolution_px": 32, "reflection_sample_count": 4}
    limit_px = max(plan(scene, Settings(**arguments)).visibility_px)
    assert limit_px > 300, "margins"
    monkeypatch.setattr(device, "max_texture_size_px", limit_px - 1)
    with monkeypatch.context() as patched:
        patched.setattr(device, "create_texture", None)
        with pytest.raises(UsageError, match=rf"{size[0]} x {size[1]} px, .* 299 px in width.*lower resolution.*region that crops"):
            render_passes(scene, device, **arguments)
    monkeypatch.setattr(device, "max_texture_size_px", limit_px)
    for image in render_passes(scene, device, **arguments).values():
        assert image.shape[1::-1] == size and np.ptp(image) > 0


def test_a_picture_of_any_size_that_needs_nothing_is_not_refused(device, monkeypatch):
    scene = scene_with(area_light(casts_shadow=False))
    monkeypatch.setattr(device, "max_texture_size_px", 16)
    assert render_passes(scene, device)["VIR Shadow Key"].min() == 1.0


OUT_OF_RANGE = [
    {"view_count": 0},
    {"view_count": 5000},
    {"map_resolution_px": 8},
    {"replay_buffer_mib": 0},
    {"blocker_sample_count": 0},
    {"filter_sample_count": 129},
]


@pytest.mark.parametrize("arguments", OUT_OF_RANGE)
def test_settings_out_of_range(arguments):
    with pytest.raises(UsageError):
        Settings(**arguments)


@pytest.mark.parametrize("method", Method)
def test_points_are_of_a_method_that_makes_some(method):
    """What would be ignored is refused; with auto it decides how ivir would be done."""
    if method in (Method.IVIR, Method.HYBRID, Method.VWSS, Method.EPR, Method.AUTO):
        assert Settings(method=method, points=PointStorage.BUFFERLESS).points is PointStorage.BUFFERLESS
    else:
        with pytest.raises(UsageError, match=f"bufferless with the method {method.value}.*ivir"):
            Settings(method=method, points=PointStorage.BUFFERLESS)
    assert Settings(method=method, points=PointStorage.BUFFERED).method is method


def test_cut_outs_are_not_splatted_unless_asked(monkeypatch):
    """A light that only an opaque box blocks keeps the choice."""
    card = with_opacity(rectangle("card", (-1, -1, 1), (2, 0, 0), (0, 2, 0)), np.eye(2), [(0, 0), (1, 0), (1, 1), (0, 1)])
    lights = [area_light("Both"), area_light("Opaque only", blockers=np.array([True, True, False]))]
    meshes = [floor(4.0), box("box", (0, 0, 0.5), (0.5, 0.5, 0.5)), card]
    camera = perspective_camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.3), WIDTH, HEIGHT)
    scene = snapshot(meshes, lights, camera, WIDTH, HEIGHT)
    estimates = {Method.IVIR: 1.0, Method.MICRO: 2.0, Method.MVR: 3.0, Method.HYBRID: 4.0}
    monkeypatch.setattr(cost, "estimate_methods", lambda *_, **__: estimates)
    lines = {line.light_name: line for line in plan(scene, Settings()).passes}
    assert lines["Both"].method is Method.MICRO and lines["Opaque only"].method is Method.IVIR
    asked = {line.light_name: line for line in plan(scene, Settings(method=Method.IVIR)).passes}
    assert asked["Both"].method is Method.IVIR and "half a texel" in asked["Both"].reason
    assert "half a texel" not in asked["Opaque only"].reason
    monkeypatch.undo()
    (both, _) = plan(scene, Settings(method=Method.HYBRID)).passes
    assert both.method is Method.HYBRID and "half a texel" not in both.reason


@pytest.mark.parametrize("method", [method for method in Method if method is not Method.AUTO])
def test_cut_outs_cost(method):
    """The rasterizer draws them for every view, whatever the method. This one is before a box, so maps are no larger for it."""
    card = with_opacity(rectangle("card", (-0.2, -0.2, 1.1), (0.4, 0, 0), (0, 0.4, 0)), np.eye(2), [(0, 0), (1, 0), (1, 1), (0, 1)])
    camera = perspective_camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.3), WIDTH, HEIGHT)
    meshes = [floor(4.0), box("box", (0, 0, 0.5), (1.5, 1.5, 0.5))]
    without, with_card = (
        planned(snapshot(shown, [light_for(method)], camera, WIDTH, HEIGHT), method=method) for shown in (meshes, [*meshes, card])
    )
    assert with_card.predicted_ms > without.predicted_ms


def test_more_views_never_bring_fewer_eye_samples():
    camera = perspective_camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.3), WIDTH, HEIGHT)
    scene = snapshot([floor(4.0), box("box", (0, 0, 0.5), (0.5, 0.5, 0.5))], [area_light()], camera, WIDTH, HEIGHT)
    counts = [plan(scene, Settings(view_count=count)).eye_sample_count for count in (3, 9, 32, 57, 63, 64, 65, 72, 100, 128, 200)]
    assert counts == sorted(counts) and counts[0] == 8 and counts[4:6] == [16] * 2 and counts[-2:] == [64] * 2


@pytest.mark.parametrize(
    ("view_count", "size_px", "batch_count", "eye_samples_per_batch"),
    [(8, (96, 54), 8, 2), (64, (96, 54), 8, 2), (128, (96, 54), 16, 4), (1024, (96, 54), 16, 4), (1024, (1920, 1080), 8, 4)],
)
def test_hard_shadows_come_in_batches_however_many_views_are_asked_for(view_count, size_px, batch_count, eye_samples_per_batch):
    """A batch's eye samples take memory each."""
    scene = dataclasses.replace(scene_with(area_light(size_m=(0, 0))), width_px=size_px[0], height_px=size_px[1])
    work = plan(scene, Settings(view_count=view_count))
    assert (work.batch_count, work.eye_samples_per_batch) == (batch_count, eye_samples_per_batch)


def test_large_pictures_have_fewer_eye_samples_a_batch():
    """Two G-buffers of 1920 x 1080 more would take 190 MiB."""
    small = scene_with(area_light())
    large = dataclasses.replace(small, width_px=1920, height_px=1080)
    plans = [plan(scene, Settings(view_count=128)) for scene in (small, large)]
    assert [(work.eye_samples_per_batch, work.eye_sample_count) for work in plans] == [(4, 64), (2, 32)]


@pytest.mark.parametrize(("arguments", "view_count"), [({"map_resolution_px": 4096}, 64), ({"batch_view_count": 1}, 32)])
def test_smaller_batches_have_an_eye_sample_each(arguments, view_count):
    work = plan(scene_with(area_light()), Settings(view_count=view_count, **arguments))
    assert (work.eye_samples_per_batch, work.eye_sample_count) == (1, 32)


def test_hard_shadows_have_as_many_eye_samples_as_soft_ones():
    """They have one view, but edges that the same eye samples have to meet."""
    camera = perspective_camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.3), WIDTH, HEIGHT)
    meshes = [floor(4.0), box("box", (0, 0, 0.5), (0.5, 0.5, 0.5))]
    hard, soft = (snapshot(meshes, [light], camera, WIDTH, HEIGHT) for light in (area_light(size_m=(0, 0)), area_light()))
    for count in (64, 128, 256):
        works = [plan(scene, Settings(view_count=count)) for scene in (hard, soft)]
        assert works[0].passes[0].view_count == 1
        assert works[0].eye_sample_count == works[1].eye_sample_count == (16 if count == 64 else 64)
        assert all(work.batch_count * work.eye_samples_per_batch >= work.eye_sample_count for work in works)


def test_what_a_suns_views_cost_does_not_depend_on_where_its_object_stands():
    camera = perspective_camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.3), WIDTH, HEIGHT)
    meshes = [floor(4.0), bumpy_sphere("ball", (0, 0, 1.0), 1.0, 100)]
    near, far = (
        planned(snapshot(meshes, [sun_light(eye=(0.0, 0.0, height_m))], camera, WIDTH, HEIGHT), method=Method.IVIR) for height_m in (5, 500)
    )
    assert near.predicted_ms == pytest.approx(far.predicted_ms)


@pytest.mark.parametrize("method", [Method.IVIR, Method.MICRO])
def test_what_does_not_fit_into_its_memory_costs_more(method):
    """It is made again for every batch; rasterizing every view keeps nothing."""
    camera = perspective_camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.3), WIDTH, HEIGHT)
    scene = snapshot([floor(4.0), bumpy_sphere("ball", (0, 0, 1.0), 1.0, 200)], [area_light()], camera, WIDTH, HEIGHT)
    kept, made_again = (planned(scene, method=method, map_resolution_px=512, replay_buffer_mib=mib).predicted_ms for mib in (64, 1))
    assert made_again > 1.2 * kept
    ample, scarce = (planned(scene, method=Method.MVR, replay_buffer_mib=mib).predicted_ms for mib in (64, 1))
    assert scarce == ample


def test_eye_samples_are_predicted_besides_views():
    """Both numbers of views have eight eye samples, which cost the same however few views each looks up."""
    camera = perspective_camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.3), WIDTH, HEIGHT)
    # nothing casts a shadow on a floor alone
    lines = [planned(snapshot([floor(4.0)], [area_light()], camera, WIDTH, HEIGHT), view_count=count) for count in (8, 16)]
    assert not any(line.needs_maps for line in lines)
    assert 1.05 * lines[0].predicted_ms < lines[1].predicted_ms < 1.5 * lines[0].predicted_ms


def test_what_the_rasterizer_takes_for_points_is_predicted():
    """For triangles of a few points several times what the kernels take."""
    camera = perspective_camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.3), WIDTH, HEIGHT)
    scene = snapshot([floor(4.0), bumpy_sphere("ball", (0, 0, 1.0), 1.0, 100)], [area_light()], camera, WIDTH, HEIGHT)
    choices = {"method": Method.IVIR, "map_resolution_px": 256, "view_count": 1}
    by_kernels, by_rasterizer = (planned(scene, point_generation=each, **choices).predicted_ms for each in PointGeneration)
    assert 2 * by_kernels < by_rasterizer < 8 * by_kernels


def test_culling_triangles_far_below_a_texel_is_predicted():
    camera = perspective_camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.3), WIDTH, HEIGHT)
    scene = snapshot([floor(4.0), bumpy_sphere("ball", (0, 0, 1.0), 1.0, 200)], [area_light()], camera, WIDTH, HEIGHT)
    choices = {"method": Method.IVIR, "map_resolution_px": 64}
    culled, whole = (planned(scene, stochastic_culling=is_culled, **choices).predicted_ms for is_culled in (True, False))
    assert culled < 0.8 * whole


def test_what_is_small_of_a_mesh_with_both_kinds_of_triangles_is_predicted_small():
    """A mesh of a fine ball and a large plate costs about what the two cost as meshes of their own."""
    camera = perspective_camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.3), WIDTH, HEIGHT)
    ball = bumpy_sphere("ball", (0, 0, 1.0), 1.0, 20, smooth=False)
    plates = box("plates", (0, 0, 1.0), (2.0, 2.0, 0.5))
    positions = np.concatenate([ball.positions_os, plates.positions_os])
    triangles = np.concatenate([ball.triangles, plates.triangles + ball.vertex_count]).astype(np.int32)
    both = Mesh("both", positions, triangles, is_closed=True)
    costs = [
        planned(
            snapshot([floor(4.0), *meshes], [area_light()], camera, WIDTH, HEIGHT), method=Method.MICRO, map_resolution_px=64
        ).predicted_ms
        for meshes in ((both,), (ball, plates))
    ]
    assert costs[0] == pytest.approx(costs[1], rel=0.2)


CHANGED = {
    "nothing": {},
    "a light moved": {"Lamp": point_light("Lamp", (1.0, 1.0, 3.0), 0.2)},
    "a light grew": {"Lamp": point_light("Lamp", (-1.0, 1.0, 3.0), 0.4)},
    "the first of those whose maps are kept is gone": {"Hard": None},
    "a light with more views": {"Key": area_light("Key", own_view_count=128)},
    "a light of another's pass name": {"Key": None, "Hard Spot": area_light("Key", (1.0, -3.0, 4.0))},
}


@pytest.mark.parametrize("change", CHANGED)
def test_lights_that_nothing_has_changed_for_are_not_planned_again(change, monkeypatch):
    """The plan is what it would be from nothing."""
    lights = [
        area_light("Key"),
        point_light("Hard", (2.0, -1.0, 3.0), radius_m=0.0),
        spot_light("Hard Spot", (-2.0, 0.0, 4.0), radius_m=0.0),
        point_light("Lamp", (-1.0, 1.0, 3.0), 0.2),
        area_light("Off", is_wanted=False),
    ]
    settings = Settings(view_count=32, map_resolution_px=512, replay_buffer_mib=1)
    scene = scene_with(*lights)
    before = plan(scene, settings)
    assert sum(line.kept_map_bytes > 0 for line in before.passes) == 1
    changed = (CHANGED[change].get(light.name, light) for light in scene.lights)
    after = dataclasses.replace(scene, lights=tuple(filter(None, changed)))
    asked, plan_light = [], light_plan._plan_light
    monkeypatch.setattr(light_plan, "_plan_light", lambda *given: asked.append(given[1].light.name) or plan_light(*given))
    found = plan(after, settings, (scene, before))
    again = set(asked)
    assert found == plan(after, settings)
    if change in ("nothing", "a light moved", "a light grew"):
        assert again == CHANGED[change].keys()


@pytest.mark.parametrize("change", ["the view", "the settings", "an object"])
def test_lights_are_planned_again_where_the_picture_has_changed(change):
    lights = [area_light("Key"), point_light("Lamp", (-1.0, 1.0, 3.0), 0.2)]
    settings = Settings(view_count=32, map_resolution_px=512)
    scene = after = scene_with(*lights)
    before = plan(scene, settings)
    if change == "the settings":
        settings = dataclasses.replace(settings, method=Method.IVIR)
    elif change == "the view":
        after = dataclasses.replace(scene, camera=perspective_camera((0.0, -6.0, 3.0), (0.0, 0.0, 9.0), WIDTH, HEIGHT))
    else:
        after = dataclasses.replace(scene, meshes=(*scene.meshes[:1], bumpy_sphere("ball", (0.0, 0.0, 1.0), 0.9, 200)))
    found = plan(after, settings, (scene, before))
    assert found == plan(after, settings) and found.passes != before.passes
