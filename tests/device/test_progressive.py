"""A progressive render ends where a render ends, however it was sliced and whatever it showed before."""

from __future__ import annotations

import contextlib
from concurrent.futures import Executor, Future, ThreadPoolExecutor

import numpy as np
import pytest

from tests.device.test_memory import counted
from tests.scenes import (
    area_light,
    box,
    bumpy_sphere,
    floor,
    matte,
    mirror,
    perspective_camera,
    point_light,
    render_passes,
    snapshot,
    spot_light,
)
from vir_addon.core import progressive as progressive_render
from vir_addon.core.bounds import compute_bounds
from vir_addon.core.errors import SceneError
from vir_addon.core.material import World
from vir_addon.core.passes.accumulate import pass_image
from vir_addon.core.passes.eye import EyePass, GBuffer
from vir_addon.core.passes.scene_data import SceneData
from vir_addon.core.picture import Choice
from vir_addon.core.progressive import NEARBY_STEPS, ProgressiveRender
from vir_addon.core.settings import Effect, Method, ReflectionMethod, Settings
from vir_addon.device.owned import Owned

WIDTH, HEIGHT = 40, 24
OPTIONS = {"view_count": 16, "map_resolution_px": 128}
SETTINGS = Settings(**OPTIONS)
MESHES = [floor(3.0), box("box", (-0.9, 0.3, 0.5), (0.4, 0.5, 0.5), turn_rad=0.4), bumpy_sphere("ball", (0.8, 0.0, 0.8), 0.6, 12)]
FILL = point_light("Fill", (-1.0, -1.5, 2.0), 0.2)


def view(eye=(0.5, -6.0, 3.5), key_x=2.0, lights=None, size=(WIDTH, HEIGHT)):
    key = area_light("Key", (key_x, -2.0, 5.0))
    return snapshot(MESHES, [key, FILL] if lights is None else lights, perspective_camera(eye, (0.0, 0.0, 0.5), *size), *size)


class AtOnce(Executor):
    def submit(self, function, /, *arguments, **keywords):
        done: Future = Future()
        try:
            done.set_result(function(*arguments, **keywords))
        except BaseException as error:
            done.set_exception(error)
        return done


@pytest.fixture
def progressive(device):
    with contextlib.closing(ProgressiveRender(device, AtOnce())) as made:
        yield made


def finish(progressive: ProgressiveRender, budget_s: float = 0.0) -> int:
    """Returns how often it had to be called."""
    for calls in range(1, 5000):
        progressive.advance(budget_s)
        if progressive.is_done:
            return calls
    raise AssertionError("it does not end")


def drawn(progressive: ProgressiveRender) -> np.ndarray:
    texels = progressive.device.read(progressive.picture.shadows).astype(np.float64)
    return pass_image(texels[..., 0], texels[..., 1], texels[..., 2])


@pytest.mark.parametrize("budget_s", [0.0, 0.02, 60.0])
def test_it_ends_with_the_passes_of_a_render(device, progressive, budget_s):
    scene = view()
    passes = render_passes(scene, device, **OPTIONS)  # which compiles what it takes
    progressive.show(scene, SETTINGS)
    calls = finish(progressive, budget_s)
    # how many there are of a budget between depends on the machine
    assert calls == 1 if budget_s == 60 else calls > (5 if budget_s == 0 else 0)
    assert progressive.standing.views_done == progressive.standing.views_total == 32
    assert 0 < progressive.standing.error_estimate < 0.1
    np.testing.assert_allclose(drawn(progressive), passes["VIR Shadow"], atol=1e-6)
    for light_name in ("Key", "Fill", None):
        progressive.choice = Choice(light_name=light_name)
        assert not progressive.is_done
        assert progressive.advance(0.0) and progressive.is_done
        np.testing.assert_allclose(drawn(progressive), passes[f"VIR Shadow {light_name}" if light_name else "VIR Shadow"], atol=1e-6)


SLOW_TO_GATHER = {
    Method.IVIR: {"buffer_triangles", "cut_parts", "buffer_tiles"},
    Method.MICRO: {"gather_triangles", "rasterize_small_triangles"},
}
OF_THE_EYE = {"visibility", "surface"}, {"visibility", "surface_with_triangles"}
"""without reflections, and with them"""
OF_RASTERIZED_MAPS = {"reflection_texels", "reflection_levels"}
OF_MAPS = {
    ReflectionMethod.MVR: OF_RASTERIZED_MAPS,
    # the mirrored view of the floor is rasterized whatever cubes are
    ReflectionMethod.EPR: OF_RASTERIZED_MAPS
    | {"collect_reflected", "splat_triangles_of_cloud", "splat_tiles_of_cloud", "reflection_texels_of_cloud"},
}
OF_RAYS = {"reflect", "march_reflections", "hit_materials", "light_by_surroundings", "light_by_emitters", "light_hits", "resolve"}
SLOW_TO_TRANSLATE = set.union(*SLOW_TO_GATHER.values(), *OF_THE_EYE, *OF_MAPS.values(), OF_RAYS)


@contextlib.contextmanager
def fresh_kernels(device):
    """As if nothing had been compiled."""
    before = device._kernels, device._started
    device._kernels, device._started = {}, set()
    try:
        yield device._kernels
    finally:
        device._kernels, device._started = before


def test_kernels_that_are_not_compiled_yet_get_slices_of_their_own(device, progressive):
    with fresh_kernels(device):
        scene = view()
        progressive.show(scene, SETTINGS)
        counts = [0]
        while not progressive.is_done:
            progressive.advance(60.0)
            counts.append(device.kernel_count)
        assert counts[-1] > 8
        # until the first batch is drawn; a step has one kernel, or some that go together
        assert max(np.diff(counts)) <= 3
        progressive.show(view(key_x=-1.0), SETTINGS)
        assert finish(progressive, 60.0) == 1


def test_a_kernel_that_is_needed_later_ends_the_slice_it_is_compiled_in(device, progressive):
    """As those of tiles that settle, which come after the first batch."""
    scene = view()
    progressive.show(scene, SETTINGS)
    finish(progressive)
    progressive.show(view(key_x=-1.0), SETTINGS)
    while progressive.standing.views_done == 0:
        progressive.advance(0.0)
    with fresh_kernels(device):
        most = 0
        while not progressive.is_done:
            before = device.translation_count
            progressive.advance(60.0)
            most = max(most, device.translation_count - before)
    assert 0 < most <= 4, "one step's"


def test_slices_leave_room_for_a_step_that_takes_longer(device, progressive, monkeypatch):
    """Every step but one takes a tenth of the slice, that one, whichever it is, six."""
    clock = [0.0]
    monkeypatch.setattr("vir_addon.core.progressive.time.perf_counter", lambda: clock[0])
    render_passes(view(), device, **OPTIONS)  # which compiles what it takes
    send = progressive_render.send_step
    for slow in range(10, 30):
        steps = [0]

        def timed(*given, steps=steps, slow=slow):
            steps[0] += 1
            clock[0] += 0.6 if steps[0] == slow else 0.1
            return send(*given)

        with monkeypatch.context() as patch:
            patch.setattr(progressive_render, "send_step", timed)
            progressive.show(view(key_x=0.1 * slow), SETTINGS)
            slices = []
            while not progressive.is_done:
                before = clock[0]
                progressive.advance(1.0)
                slices.append(clock[0] - before)
        assert steps[0] > slow and max(slices) <= 1.0 + 1e-9 and len(slices) < steps[0] / 2


def test_a_long_step_of_every_batch_is_expected_where_it_comes(device, progressive, monkeypatch):
    """However many short ones lie between, which share their slices."""
    clock = [0.0]
    monkeypatch.setattr("vir_addon.core.progressive.time.perf_counter", lambda: clock[0])
    lights = [area_light(f"Light {number}", (number - 5.0, -2.0, 5.0)) for number in range(10)]
    scene, settings = view(lights=lights), Settings(view_count=8, map_resolution_px=64, batch_view_count=2)
    render_passes(scene, device, view_count=8, map_resolution_px=64, batch_view_count=2)
    send = progressive_render.send_step

    def timed(*given):
        is_long = progressive._is_rendering and len(progressive._batch_s) == 30
        clock[0] += 0.9 if is_long else 0.02
        return send(*given)

    monkeypatch.setattr(progressive_render, "send_step", timed)
    progressive.show(scene, settings)
    slices = []
    while not progressive.is_done:
        before, batches = clock[0], progressive._batches_done
        progressive.advance(1.0)
        if batches > 0:
            slices.append(clock[0] - before)
    assert progressive.plan.batch_count > 3
    assert 0.9 <= max(slices) < 0.9 + 1e-9
    # the long one alone, those near to it, and the others
    assert len(slices) <= progressive.plan.batch_count * (1 + 2 * NEARBY_STEPS + 3)


@pytest.mark.parametrize(("method", "maps"), [(Method.IVIR, ReflectionMethod.EPR), (Method.MICRO, ReflectionMethod.MVR)])
@pytest.mark.parametrize(
    ("lights", "effects"),
    [
        ([area_light("Key"), FILL], (Effect.SHADOW, Effect.REFLECTION)),
        ([point_light("Bulb", radius_m=0.0)], (Effect.SHADOW, Effect.REFLECTION)),
        ([area_light("Key"), FILL], (Effect.SHADOW,)),
        ([point_light("Bulb", radius_m=0.0)], (Effect.SHADOW,)),
    ],
    ids=["sized, reflected", "hard, reflected", "sized", "hard"],
)
def test_a_step_translates_one_kernel_of_those_that_take_long(device, progressive, method, maps, lights, effects):
    """Mesa does so when a kernel is compiled and once more when it is first run, each of a tenth to a third of a second."""
    ball, lamp = bumpy_sphere("mirror", (0.0, 1.2, 0.7), 0.7, 12), box("lamp", (-1.5, -1.0, 2.0), (0.2, 0.2, 0.1))
    materials = [*3 * [matte()], mirror(), matte(emission=(3.0, 3.0, 3.0))]
    camera = perspective_camera((0.5, -6.0, 3.5), (0.0, 0.0, 0.5), WIDTH, HEIGHT)
    world = World((0.2, 0.2, 0.2))
    scene = snapshot([*MESHES, ball, lamp], lights, camera, WIDTH, HEIGHT, materials=materials, world=world)
    settings = Settings(**OPTIONS, method=method, reflection_method=maps, effects=effects)
    with fresh_kernels(device) as kernels:
        progressive.show(scene, settings)
        before = 0
        slow: list[str] = []
        while not progressive.is_done:
            progressive.advance(0.0)
            slow = [name for name, _ in kernels if name in SLOW_TO_TRANSLATE]
            slow += [kernel.declaration.name for kernel in device._started if kernel.declaration.name in SLOW_TO_TRANSLATE]
            assert len(slow) - before <= 1, slow
            before = len(slow)
        reflects = Effect.REFLECTION in effects
        of_effects = OF_MAPS[maps] | OF_RAYS if reflects else {"resolve"}
        assert {name for name in slow if slow.count(name) > 1} == of_effects | SLOW_TO_GATHER[method] | OF_THE_EYE[reflects]


def test_a_step_takes_little_memory(device, progressive, monkeypatch):
    """Of textures as large as the picture as many as fit, and the one that is created last."""
    size, limit = (WIDTH * 4, HEIGHT * 4), 3 * 16 * 16 * WIDTH * HEIGHT
    monkeypatch.setattr("vir_addon.core.steps.ALLOCATED_A_STEP", limit, raising=False)
    ball = bumpy_sphere("mirror", (0.0, 1.2, 0.7), 0.7, 12)
    camera = perspective_camera((0.5, -6.0, 3.5), (0.0, 0.0, 0.5), *size)
    materials = [*3 * [matte()], mirror()]
    scene = snapshot([*MESHES, ball], [FILL], camera, *size, materials=materials, world=World((0.2, 0.2, 0.2)))
    created, create, upload = [0], device.create_texture, device.upload_texture

    def noted(make, *arguments):
        texture = make(*arguments)
        # maps have sizes of their own
        created[0] += texture.byte_count if (texture.width, texture.height) == size else 0
        return texture

    monkeypatch.setattr(device, "create_texture", lambda *arguments: noted(create, *arguments))
    monkeypatch.setattr(device, "upload_texture", lambda *arguments: noted(upload, *arguments))
    options = {**OPTIONS, "effects": (Effect.SHADOW, Effect.REFLECTION), "visibility_texel_count": 0}
    render_passes(scene, device, **options)  # which compiles what it takes: a step more for each
    progressive.show(scene, Settings(**options))
    of_steps = []
    while not progressive.is_done:
        before = created[0]
        progressive.advance(0.0)
        of_steps.append(created[0] - before)
    assert max(of_steps) <= limit + 16 * 16 * WIDTH * HEIGHT


def test_the_kernel_for_probed_tiles_of_the_eye_is_compiled_between_pauses(device):
    """Which tiles are only probed is known after some batches: nothing else is being compiled any more."""
    scene = view()
    with Owned() as owned:
        scene_data = owned.own(SceneData(scene, device))
        eye = owned.own(EyePass(scene_data, compute_bounds(scene), np.zeros((1, 2))))
        device.run(eye.render, [0], 0)
        eye.want_only(np.zeros_like(eye.tiles.is_walked))
        with fresh_kernels(device):
            # before it is compiled, after, and once it has been run on nothing
            assert [sum(1 for _ in eye.rendering([0], batch)) for batch in (1, 2)] == [3, 0]


def test_a_kernel_is_first_run_on_nothing_in_a_step_of_its_own(device):
    """Translating one may take as long as walking the picture."""
    scene = view()
    with Owned() as owned, fresh_kernels(device):
        eye = owned.own(EyePass(owned.own(SceneData(scene, device)), compute_bounds(scene), np.zeros((1, 2))))
        untouched = np.full((HEIGHT, WIDTH, 4), 7.0, np.float32)
        buffer = GBuffer(*(owned.own(device.upload_texture(untouched)) for _ in GBuffer._fields))
        device.run(eye.render, [0], 0)
        device._started.clear()
        drawing = eye.tiles.walked.walking(eye.surface, **{**eye._bindings(0, 0), **buffer._asdict()})
        device.run(next, drawing)
        assert device.has_run(eye.surface)
        np.testing.assert_array_equal(device.read(buffer.positions), untouched)
        assert device.run(list, drawing) == []
        np.testing.assert_array_equal(device.read(buffer.positions), device.read(eye.buffers[0].positions))
        again = eye.tiles.walked.walking(eye.surface, **{**eye._bindings(0, 0), **buffer._asdict()})
        assert device.run(list, again) == [], "the driver knows it"


CHANGES = {
    "the light": view(key_x=-1.0),
    "the view": view(eye=(3.0, -5.0, 3.0)),
    "the size": view(size=(24, 16)),
    "the lights": view(lights=[FILL, spot_light("Spot", (2.0, 0.0, 4.0), radius_m=0.1)]),
    "nothing": view(),
}


@pytest.mark.parametrize("steps_before", [1, 4, 9, 30, 10_000])
@pytest.mark.parametrize("change", CHANGES)
def test_a_change_at_any_time(device, progressive, change, steps_before):
    progressive.show(view(), SETTINGS)
    for _ in range(steps_before):
        if not progressive.is_done:
            progressive.advance(0.0)
    scene = CHANGES[change]
    progressive.show(scene, SETTINGS)
    assert not progressive.is_done
    finish(progressive, 0.01)
    assert progressive.picture_of is scene
    np.testing.assert_allclose(drawn(progressive), render_passes(scene, device, **OPTIONS)["VIR Shadow"], atol=1e-6)


def test_a_light_that_has_not_changed_is_not_made_again(progressive):
    progressive.show(view(), SETTINGS)
    everything = finish(progressive)
    progressive.show(view(key_x=-1.0), SETTINGS)
    one_light = finish(progressive)
    progressive.show(view(key_x=-1.0), SETTINGS)
    nothing = finish(progressive)
    assert one_light < 0.6 * everything and nothing < 0.5 * one_light


def test_pictures_come_batch_by_batch_and_get_better(progressive):
    progressive.show(view(), SETTINGS)
    pictures, views, errors = [], [], []
    while not progressive.is_done:
        if progressive.advance(0.0):
            pictures.append(drawn(progressive))
            views.append(progressive.standing.views_done)
            errors.append(progressive.standing.error_estimate)
    assert len(pictures) == progressive.plan.batch_count >= 8
    assert views == sorted(views) and views[-1] == 32
    assert errors[0] == np.inf and errors[-1] < errors[1]
    distance = [np.abs(picture - pictures[-1]).mean() for picture in pictures]
    assert distance[0] > 2 * distance[len(distance) // 2] > 0


def test_small_batches(device, progressive):
    progressive.show(view(), Settings(**OPTIONS, batch_view_count=1))
    finish(progressive)
    assert progressive.plan.batch_count == 16
    np.testing.assert_allclose(drawn(progressive), render_passes(view(), device, **OPTIONS, batch_view_count=1)["VIR Shadow"], atol=1e-6)


@contextlib.contextmanager
def waiting_for_a_busy_host(device):
    """A render whose executor is at work on something else. That ends when this is left; then what was shown last appears."""
    with ThreadPoolExecutor(1) as executor, contextlib.closing(ProgressiveRender(device, executor)) as progressive:
        gate: Future = Future()
        executor.submit(gate.result)
        try:
            progressive.show(view(), SETTINGS)
            assert not progressive.advance(0.0)
            yield progressive
        finally:
            gate.set_result(None)
        finish(progressive, 0.01)
        assert progressive.picture is not None


def test_it_waits_for_the_host_without_waiting(device):
    """Slices return at once."""
    with waiting_for_a_busy_host(device) as progressive:
        assert progressive.is_waiting and not progressive.is_done
        assert not progressive.advance(0.001) and progressive.is_waiting


def test_host_work_that_nobody_waits_for_any_more_does_not_begin(device):
    with waiting_for_a_busy_host(device) as progressive:
        forgotten = progressive._pending
        progressive.show(view(key_x=-1.0), SETTINGS)
        assert forgotten is not None and forgotten.cancelled()


def test_what_cannot_be_shown_says_so_once_and_the_next_is_shown(progressive):
    progressive.show(view(), SETTINGS)
    finish(progressive)
    progressive.show(view(lights=[]), SETTINGS)
    with pytest.raises(SceneError, match="no light"):
        finish(progressive)
    assert finish(progressive) <= 1
    progressive.show(view(), SETTINGS)
    finish(progressive)
    assert progressive.picture is not None


def test_lights_without_a_pass_draw_nothing(progressive):
    progressive.show(view(lights=[area_light("Key", casts_shadow=False)]), SETTINGS)
    finish(progressive)
    assert progressive.picture is None and progressive.standing.views_total == 0


def test_closing_at_any_time_leaves_nothing(device, monkeypatch):
    stops = 0
    while True:
        with counted(device, monkeypatch) as holdings:
            progressive = ProgressiveRender(device, AtOnce())
            progressive.show(view(), SETTINGS)
            for _ in range(stops):
                progressive.advance(0.0)
            # a change halfway, and another
            progressive.show(CHANGES["the light"], SETTINGS)
            for _ in range(stops // 2):
                progressive.advance(0.0)
            was_done = progressive.is_done
            progressive.close()
            assert not holdings.live and not holdings.released_twice, stops
        if was_done:
            break
        stops += 7
    assert stops > 20
