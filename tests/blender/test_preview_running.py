"""Previews come and go with the scene's switch, and leave nothing: Blender's redraws and timer are played by the test."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from vir_addon import blender  # noqa: E402  (bpy decides whether this file runs)
from vir_addon.blender import devices, frame_state  # noqa: E402
from vir_addon.blender.extract import mesh_cache  # noqa: E402
from vir_addon.blender.preview import running  # noqa: E402
from vir_addon.core.errors import UsageError  # noqa: E402


@pytest.fixture
def scene(scene, add):
    if bpy.app.version < (5, 2):
        pytest.skip("before 5.2 Blender has no GPU in background")
    add.mesh("Floor", [(-5, -5, 0), (5, -5, 0), (5, 5, 0), (-5, 5, 0)], [(0, 1, 2, 3)])
    add.cube("Cube", location=(0, 0, 1))
    add.light("Key", location=(1, -1, 5), data={"size": 1.0})
    blender.register()
    scene.vir.view_count, scene.vir.map_resolution_px = 8, 64
    bpy.context.view_layer.update()
    yield scene
    blender.unregister()


class Viewport:
    """The 3D viewport of Blender's window, which in background nobody draws."""

    def __init__(self) -> None:
        screen = bpy.context.window_manager.windows[0].screen
        area = next(area for area in screen.areas if area.type == "VIEW_3D")
        self.region = next(region for region in area.regions if region.type == "WINDOW")
        self.space = area.spaces.active
        projection = [(2, 0, 0, 0), (0, 3, 0, 0), (0, 0, -1.002, -0.2), (0, 0, -1, 0)]
        view = [(1, 0, 0, 0), (0, 0.4, 0.9, -3), (0, -0.9, 0.4, -8), (0, 0, 0, 1)]
        self.region_3d = SimpleNamespace(view_matrix=view, window_matrix=projection)
        self.texts: list[str] = []
        self.pictures: list[tuple[int, int]] = []

    def draw(self) -> None:
        context = SimpleNamespace(
            scene=bpy.context.scene,
            view_layer=bpy.context.view_layer,
            region=SimpleNamespace(as_pointer=self.region.as_pointer, width=48, height=32),
            space_data=self.space,
            region_data=self.region_3d,
        )
        running._draw_region(context)


@pytest.fixture
def viewport(scene, monkeypatch):
    made = Viewport()
    monkeypatch.setattr(running, "draw_text", lambda _, text: made.texts.append(text))
    overlay = SimpleNamespace(draw=lambda picture, *_: made.pictures.append(picture.size))
    monkeypatch.setattr(running, "Overlay", lambda: overlay)
    return made


def tick() -> float | None:
    """As Blender calls it, if it is registered; in background Blender calls none."""
    return running._tick() if bpy.app.timers.is_registered(running._tick) else None


def tick_until_idle() -> int:
    for count in range(5000):
        interval_s = tick()
        if interval_s is None or interval_s == running.IDLE_S:
            return count
        time.sleep(interval_s)
    raise AssertionError("it does not end")


def is_at_work() -> set[bool]:
    """One of handlers, timer and viewports each."""
    return {
        *(function in handlers for handlers, function in running._HANDLERS),
        bpy.app.timers.is_registered(running._tick),
        bool(running._running.viewports),
    }


def switch_on(scene, viewport) -> None:
    scene.vir.use_preview = True
    viewport.draw()
    tick_until_idle()
    viewport.draw()


def test_nothing_happens_until_it_is_switched_on(viewport):
    viewport.draw()
    assert is_at_work() == {False}
    assert not viewport.texts and not viewport.pictures


def test_without_surfaces_it_says_what_is_left_out(scene, viewport):
    smoke = bpy.data.objects.new("Smoke", bpy.data.volumes.new("Smoke"))
    scene.collection.objects.link(smoke)
    switch_on(scene, viewport)
    cube, floor = bpy.data.objects["Cube"], bpy.data.objects["Floor"]
    for each in (cube, floor):
        scene.collection.objects.unlink(each)
    bpy.context.view_layer.update()
    switch_on(scene, viewport)
    assert viewport.texts[-1].startswith("VIR: no surface that is rendered; Smoke: volumes are not")
    bpy.data.objects.remove(smoke)
    scene.collection.objects.link(cube)
    bpy.context.view_layer.update()
    switch_on(scene, viewport)
    assert "8 of 8 views" in viewport.texts[-1]
    scene.collection.objects.unlink(cube)
    bpy.context.view_layer.update()
    switch_on(scene, viewport)
    assert viewport.texts[-1] == "VIR: no surface that is rendered"


def test_on_and_off(scene, viewport):
    switch_on(scene, viewport)
    assert is_at_work() == {True}
    assert "8 of 8 views" in viewport.texts[-1] and viewport.pictures
    scene.vir.use_preview = False
    viewport.draw()
    tick()
    assert is_at_work() == {False}
    drawn = len(viewport.pictures)
    viewport.draw()
    assert len(viewport.pictures) == drawn


def test_off_without_a_redraw(scene, viewport):
    switch_on(scene, viewport)
    scene.vir.use_preview = False
    tick()
    assert is_at_work() == {False}


def test_overlays_hidden_in_the_viewport(scene, viewport):
    switch_on(scene, viewport)
    viewport.space.overlay.show_overlays = False
    try:
        viewport.draw()
        tick()
        assert is_at_work() == {False}
    finally:
        viewport.space.overlay.show_overlays = True


@pytest.mark.parametrize(
    "change",
    [
        lambda scene: setattr(bpy.data.objects["Key"].location, "x", 3.0),
        lambda scene: setattr(bpy.data.objects["Cube"].location, "x", 1.0),
        lambda scene: bpy.data.objects.remove(bpy.data.objects["Cube"]),
        lambda scene: scene.frame_set(7) or setattr(bpy.data.objects["Key"].data, "size", 2.0),
        lambda scene: setattr(scene.vir, "view_count", 16),
    ],
    ids=["light", "object", "removed", "frame", "setting"],
)
def test_a_change_starts_anew(scene, viewport, change):
    switch_on(scene, viewport)
    (shown,) = running._running.viewports.values()
    taken, settings = shown.preview.render.snapshot, shown.preview.render.settings
    change(scene)
    bpy.context.view_layer.update()
    tick()
    tick_until_idle()
    assert shown.preview.render.snapshot is not taken or shown.preview.render.settings != settings
    assert shown.preview.is_done and not shown.problem


def test_another_view_shows_nothing_of_this_one(scene, viewport):
    switch_on(scene, viewport)
    drawn = len(viewport.pictures)
    viewport.region_3d.view_matrix = [*viewport.region_3d.view_matrix[:2], (0, -0.9, 0.4, -9), (0, 0, 0, 1)]
    viewport.draw()
    assert len(viewport.pictures) == drawn
    tick_until_idle()
    viewport.draw()
    assert len(viewport.pictures) == drawn + 1


def test_a_problem_is_said_and_mended(scene, viewport):
    light = bpy.data.objects["Key"]
    light.hide_render = True
    bpy.context.view_layer.update()
    switch_on(scene, viewport)
    assert "no light" in viewport.texts[-1]
    assert not viewport.pictures
    light.hide_render = False
    bpy.context.view_layer.update()
    tick_until_idle()
    viewport.draw()
    assert "8 of 8 views" in viewport.texts[-1] and viewport.pictures


@pytest.mark.parametrize("is_drivers", [False, True])
def test_a_lost_device_is_said_and_another_one_opened_when_something_changes(scene, viewport, monkeypatch, capsys, is_drivers):
    switch_on(scene, viewport)
    (shown,) = running._running.viewports.values()
    device, tries = shown.preview.render.device, []

    def refuse():
        raise RuntimeError("the GPU is gone")

    def lost(*_):
        tries.append(1)
        device.run(refuse) if is_drivers else refuse()

    monkeypatch.setattr(shown.preview.render, "_step", lost)
    monkeypatch.setattr(shown.preview.render, "close", lost)
    bpy.data.objects["Key"].location.x = 3.0
    bpy.context.view_layer.update()
    for _ in range(5):
        tick()
    assert tries == [1, 1]
    viewport.draw()
    assert ("the graphics device failed or was lost (the GPU is gone): " in viewport.texts[-1]) == is_drivers
    assert ("internal error, see the console: RuntimeError: the GPU is gone" in viewport.texts[-1]) != is_drivers
    assert is_drivers or "the GPU is gone" in capsys.readouterr().err
    scene.vir.use_preview = False
    viewport.draw()
    tick()
    switch_on(scene, viewport)
    (shown,) = running._running.viewports.values()
    assert "8 of 8 views" in viewport.texts[-1] and shown.preview.render.device is not device
    device.close()


def test_what_the_scene_is_refused_for_costs_no_device(scene, viewport, monkeypatch):
    switch_on(scene, viewport)
    (shown,) = running._running.viewports.values()
    preview = shown.preview

    def refuse(*_):
        raise UsageError("too much")

    with monkeypatch.context() as patch:
        patch.setattr(preview.render, "_step", refuse)
        bpy.data.objects["Key"].location.x = 3.0
        bpy.context.view_layer.update()
        tick_until_idle()
    assert shown.problem == "too much" and shown.preview is preview


def test_a_preview_that_cannot_be_closed_goes_all_the_same(scene, viewport, monkeypatch, capsys):
    switch_on(scene, viewport)
    (shown,) = running._running.viewports.values()
    closing = shown.preview.close

    def close():
        closing()
        raise RuntimeError("nothing can be released")

    monkeypatch.setattr(shown.preview, "close", close)
    running.stop()
    assert is_at_work() == {False} and "nothing can be released" in capsys.readouterr().err


def test_redraws_are_timed_without_what_blender_does_besides(scene, viewport, monkeypatch):
    clock = SimpleNamespace(now_s=1e3)
    monkeypatch.setattr(running, "time", SimpleNamespace(perf_counter=lambda: clock.now_s))
    scene.vir.use_preview = True
    viewport.draw()
    assert tick() != running.IDLE_S
    timed = []
    for wait_s in (0.05, 60.0):
        while not running._running.is_redraw_timed:
            clock.now_s += 10.0
            (shown,) = running._running.viewports.values()
            shown.is_outdated = True
            bpy.data.objects["Key"].location.x += 0.1
            bpy.context.view_layer.update()
            tick()
        clock.now_s += wait_s
        tick()
        timed.append(running._running.redraw_s)
    assert timed == pytest.approx([0.05, running.LONGEST_REDRAW_S])
    # after the last one nothing is due soon
    tick_until_idle()
    before = running._running.redraw_s
    clock.now_s += running.IDLE_S
    tick()
    assert running._running.redraw_s == before
    running.stop()
    assert running._running.redraw_s == 0.0


def test_it_says_that_the_scene_is_read_and_shows_what_was_before(scene, viewport, monkeypatch):
    switch_on(scene, viewport)
    bpy.data.objects["Cube"].location.x = 1.0
    bpy.context.view_layer.update()
    drawn = len(viewport.pictures)
    viewport.draw()
    assert "reading the scene" in viewport.texts[-1] and "of before" in viewport.texts[-1]
    assert len(viewport.pictures) == drawn + 1
    tick_until_idle()
    viewport.draw()
    assert "8 of 8 views" in viewport.texts[-1]


def test_it_says_which_large_mesh_it_is_about_to_read(scene, viewport, monkeypatch):
    """Before it begins: nothing is drawn while it does."""
    monkeypatch.setattr(mesh_cache, "LARGE_MESH_CORNERS", 20)  # the cube has 24
    scene.vir.use_preview, scene.vir.preview_slice_ms = True, 2000
    viewport.draw()
    said = []
    while tick() != running.IDLE_S:
        (shown,) = running._running.viewports.values()
        said.append((shown.said, shown.preview.cache.read_count))
        viewport.draw()
    assert ("VIR: reading Cube", 1) in said and {count for _, count in said} == {1, 2}
    assert "8 of 8 views" in viewport.texts[-1]


def test_it_says_that_shaders_are_compiled(scene, viewport):
    """A device that is new has none."""
    devices.close_devices()
    scene.vir.use_preview, scene.vir.preview_slice_ms = True, 1
    viewport.draw()
    asked = []
    while tick() != running.IDLE_S:
        if any(shown.said != viewport.texts[-1] for shown in running._running.viewports.values()):
            viewport.draw()
            asked += [viewport.texts[-1]]
    said = list(dict.fromkeys(text.rpartition(", ")[2] for text in asked if text.startswith("VIR: preparing, ")))
    counts = [int(text.removesuffix(" compiled").removesuffix("s").removesuffix(" shader")) for text in said]
    assert len(counts) > 2 and counts == sorted(set(counts))


@pytest.mark.parametrize(
    ("shown", "light_name", "use_reflections", "said"),
    [
        ("ALL", "Key", False, "this light has no pass to show"),
        ("ALL", "Key", True, "this light has no pass to show, and nothing reflects"),
        ("REFLECTION", None, True, "nothing reflects"),
    ],
)
def test_why_there_is_nothing_to_show(scene, viewport, add, shown, light_name, use_reflections, said):
    add.light("Other", location=(2, -1, 5), data={"size": 1.0})
    bpy.data.objects["Key"].data.use_shadow = False
    scene.vir.use_reflections, scene.vir.preview_pass = use_reflections, shown
    if light_name:
        scene.vir.preview_light = light_name
    bpy.context.view_layer.update()
    switch_on(scene, viewport)
    assert viewport.texts[-1] == f"VIR: {said}"


def test_a_light_that_is_renamed_is_still_the_one_that_is_shown(scene, viewport, add):
    add.light("Other", location=(2, -1, 5), data={"size": 1.0})
    scene.vir.preview_light = "Key"
    bpy.context.view_layer.update()
    switch_on(scene, viewport)
    bpy.data.objects["Key"].name = "Main"
    bpy.context.view_layer.update()
    viewport.draw()
    tick_until_idle()
    (shown,) = running._running.viewports.values()
    assert shown.preview.render.choice.light_name == "Main" and not shown.problem
    assert shown.preview.picture is not None and scene.vir.preview_light_now == "Main"


def test_what_is_compared_with_need_not_have_been_drawn(scene, viewport):
    scene.vir.use_preview, scene.vir.preview_display = True, "DIFFERENCE"
    viewport.draw()
    tick_until_idle()
    bpy.data.objects["Key"].location.x = 3.0
    bpy.context.view_layer.update()
    tick_until_idle()
    viewport.draw()
    (shown,) = running._running.viewports.values()
    ratios = []
    for picture in (shown.preview.reference, shown.preview.picture):
        sums = shown.preview.render.device.read(picture.shadows)
        height, width = sums.shape[:2]  # as fine as there was time for
        sums = sums.reshape(4, height // 4, 6, width // 6, 4).mean(axis=(1, 3))
        ratios.append(sums[..., 0] / np.maximum(sums[..., 1], 1e-9))
    assert np.abs(ratios[0] - ratios[1]).max() > 0.1


def test_it_waits_while_passes_are_rendered(scene, viewport, monkeypatch):
    switch_on(scene, viewport)
    (shown,) = running._running.viewports.values()
    bpy.data.objects["Key"].location.x = 3.0
    bpy.context.view_layer.update()
    with monkeypatch.context() as patch:
        patch.setattr(frame_state.state_of(scene), "running", object())
        assert tick() == running.IDLE_S
        assert shown.is_busy
    tick()
    tick_until_idle()
    assert not shown.is_busy


def test_a_viewport_that_is_closed(scene, viewport, monkeypatch):
    switch_on(scene, viewport)
    monkeypatch.setattr(running, "_viewport_regions", dict)
    tick()
    assert is_at_work() == {False}


def test_undo_reads_everything_again(scene, viewport):
    switch_on(scene, viewport)
    (cache,) = running._running.caches.values()
    read_count = cache.read_count
    bpy.app.handlers.undo_post[-1](scene)
    tick_until_idle()
    assert cache.read_count == read_count + 2


def test_another_file(scene, viewport):
    """Handlers of the old one are gone, and its viewports."""
    switch_on(scene, viewport)
    handlers = list(bpy.app.handlers.load_pre)
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    assert list(bpy.app.handlers.load_pre) == handlers, "changed while Blender walked it"
    running._tick()
    assert is_at_work() == {False}


def test_where_there_cannot_be_a_preview_the_viewport_says_why(scene, viewport, monkeypatch):
    """As after a file was opened in which a newer Blender has it switched on."""
    monkeypatch.setattr(running, "unavailable", lambda: "The preview needs something else")
    switch_on(scene, viewport)
    assert viewport.texts[-1] == "VIR: The preview needs something else" and not viewport.pictures


def test_all_viewports_that_have_something_new_are_drawn(monkeypatch):
    drawn = []
    regions = {number: SimpleNamespace(tag_redraw=lambda number=number: drawn.append(number)) for number in range(3)}
    viewports = {number: running.Shown((1, "Layer"), None, is_outdated=number != 1) for number in regions}
    monkeypatch.setattr(running, "_running", running._Running(viewports=viewports, redraw_s=1.0, asked_s=time.perf_counter()))
    running._ask_for_redraws(regions)
    assert not drawn, "it is not due"
    running._running.asked_s -= 10.0
    running._ask_for_redraws(regions)
    assert drawn == [0, 2]
    running._ask_for_redraws(regions)
    assert drawn == [0, 2]


def test_what_local_view_hides_is_not_asked_with_every_redraw_of_an_orbit(scene, viewport, monkeypatch):
    switch_on(scene, viewport)
    address, asked = viewport.region.as_pointer(), []
    clock = SimpleNamespace(now_s=1e3)
    monkeypatch.setattr(running, "time", SimpleNamespace(perf_counter=lambda: clock.now_s))

    class Item:
        session_uid = 7

        def visible_in_viewport_get(self, space):
            clock.now_s += 0.1
            asked.append(clock.now_s)
            return False

    space, layer = SimpleNamespace(local_view=object(), use_local_collections=False), SimpleNamespace(objects=[Item()])

    def draw(z: float) -> None:
        assert running._hidden_uids(address, space, SimpleNamespace(view_matrix=np.diag([1.0, 1.0, z, 1.0])), layer) == {7}

    draw(1.0)
    for z in (2.0, 3.0, 4.0):
        draw(z)
    assert len(asked) == 1
    # the view stays: something else may have had it drawn again
    draw(4.0)
    assert len(asked) == 2
    draw(5.0)
    space.use_local_collections = True
    draw(6.0)
    assert len(asked) == 3
    bpy.data.objects["Cube"].location.x = 1.0
    bpy.context.view_layer.update()
    draw(7.0)
    assert len(asked) == 4
    clock.now_s += 2.0
    draw(8.0)
    assert len(asked) == 5


def test_a_scene_that_is_deleted(scene, viewport):
    switch_on(scene, viewport)
    other = bpy.data.scenes.new("Other")
    bpy.context.window_manager.windows[0].scene = other
    bpy.data.scenes.remove(scene)
    tick()
    assert is_at_work() == {False}


def test_disabling_while_it_runs(scene, viewport):
    scene.vir.use_preview = True
    viewport.draw()
    for _ in range(4):
        tick()
    running.unregister()
    assert is_at_work() == {False}
    running.register()


def test_an_unexpected_error_is_printed_once(capsys):
    told = ""
    for _ in range(3):
        told = running._problem_text(ValueError("odd"), told)
    assert capsys.readouterr().err.count("ValueError: odd") == 1 and "ValueError: odd" in told
