"""A renderer made from another takes over what is still right, and gives the passes of one that was made from nothing."""

import contextlib
import dataclasses

import numpy as np
import pytest

from tests.device.test_memory import counted
from tests.scenes import area_light, box, bumpy_sphere, floor, perspective_camera, point_light, render_batches, snapshot, sun_light
from vir_addon.core.plan import plan
from vir_addon.core.render import Renderer
from vir_addon.core.settings import Settings

WIDTH, HEIGHT = 48, 27
SETTINGS = Settings(view_count=32, map_resolution_px=256)
CAMERA = perspective_camera((0.5, -6.0, 3.5), (0.0, 0.0, 0.5), WIDTH, HEIGHT)
MESHES = [floor(3.0), box("box", (-0.9, 0.3, 0.5), (0.4, 0.5, 0.5), turn_rad=0.4), bumpy_sphere("ball", (0.8, 0.0, 0.8), 0.6, 12)]
KEY, FILL = area_light("Key", (2.0, -2.0, 5.0)), area_light("Fill", (-3.0, -2.0, 4.0), size_m=(2.0, 2.0))
BEFORE = snapshot(MESHES, [KEY, FILL], CAMERA, WIDTH, HEIGHT)


def moved_ball():
    transforms = np.tile(np.eye(4), (3, 1, 1))
    transforms[2, :3, 3] = 0.3, -0.4, 0.1
    return transforms


def dented_ball():
    mesh = MESHES[2]
    return [*MESHES[:2], dataclasses.replace(mesh, positions_os=mesh.positions_os * np.float32((1, 1, 0.7)))]


MOVED_KEY = area_light("Key", (1.0, -3.0, 4.0))
AFTER = {
    "nothing": (BEFORE, {"geometry", "scene data", "eye", "Key", "Fill"}),
    "a light moved": (snapshot(MESHES, [MOVED_KEY, FILL], CAMERA, WIDTH, HEIGHT), {"geometry", "scene data", "eye", "Fill"}),
    "a light removed": (snapshot(MESHES, [FILL], CAMERA, WIDTH, HEIGHT), {"geometry", "scene data", "eye", "Fill"}),
    "a light added": (
        snapshot(MESHES, [KEY, FILL, sun_light("Sun")], CAMERA, WIDTH, HEIGHT),
        {"geometry", "scene data", "eye", "Key", "Fill"},
    ),
    "another view": (
        snapshot(MESHES, [KEY, FILL], perspective_camera((2.0, -5.0, 3.5), (0.0, 0.0, 0.5), WIDTH, HEIGHT), WIDTH, HEIGHT),
        {"geometry"},
    ),
    "an object moved": (snapshot(MESHES, [KEY, FILL], CAMERA, WIDTH, HEIGHT, transforms=moved_ball()), {"geometry"}),
    "an object changed": (snapshot(dented_ball(), [KEY, FILL], CAMERA, WIDTH, HEIGHT), set()),
    "another size": (snapshot(MESHES, [KEY, FILL], CAMERA, 40, 24), {"geometry"}),
}


def shared_parts(one: Renderer, other: Renderer) -> set[str]:
    parts = {"geometry"} if one.scene_data.geometry is other.scene_data.geometry else set()
    parts |= {"scene data"} if one.scene_data is other.scene_data else set()
    parts |= {"eye"} if one.eye is other.eye else set()
    return parts | {work.light.name for work in one.works if any(work is each for each in other.works)}


@pytest.fixture(scope="module")
def from_nothing(device):
    passes = {}
    for name, (scene, _) in AFTER.items():
        with contextlib.closing(Renderer(scene, plan(scene, SETTINGS), device)) as renderer:
            device.run(renderer.prepare)
            render_batches(renderer)
            passes[name] = renderer.read_passes()
    return passes


@pytest.mark.parametrize("change", AFTER)
@pytest.mark.parametrize("batches_before", [0, 2, 4])
def test_passes_are_those_of_a_renderer_made_from_nothing(device, from_nothing, monkeypatch, change, batches_before):
    scene, expected = AFTER[change]
    with counted(device, monkeypatch) as holdings:
        previous = Renderer(BEFORE, plan(BEFORE, SETTINGS), device)
        device.run(previous.prepare)
        for batch in range(batches_before):
            device.run(previous.render_batch, batch)
        renderer = Renderer(scene, plan(scene, SETTINGS), device, previous=previous)
        previous.close()
        device.run(renderer.prepare)
        assert shared_parts(renderer, previous) == expected
        render_batches(renderer)
        passes = renderer.read_passes()
        assert list(passes) == list(from_nothing[change])
        for name, image in passes.items():
            np.testing.assert_array_equal(image, from_nothing[change][name], err_msg=name)
        renderer.close()
        assert not holdings.live and not holdings.released_twice


def passes_after(device, before, scene, batches_before):
    """Of a renderer that takes over what it can from one of another scene, and the names of the lights that it takes over."""
    with contextlib.closing(Renderer(before, plan(before, SETTINGS), device)) as previous:
        device.run(previous.prepare)
        for batch in range(batches_before):
            device.run(previous.render_batch, batch)
        renderer = Renderer(scene, plan(scene, SETTINGS), device, previous=previous)
        shared = shared_parts(renderer, previous) - {"geometry", "scene data", "eye"}
    with contextlib.closing(renderer):
        device.run(renderer.prepare)
        render_batches(renderer)
        return renderer.read_passes(), shared


def test_a_light_that_was_alone_settles_again_beside_others(device):
    """Alone, how much it delivers counts nowhere; beside others it does, and what gets it unevenly goes on."""
    lamp = point_light("Lamp", (-0.6, -0.8, 0.5), radius_m=0.3, strength=4.0)
    alone, both = (snapshot(MESHES, lights, CAMERA, 96, 54) for lights in ([lamp], [lamp, KEY]))
    passes, shared = passes_after(device, alone, both, SETTINGS.view_count // 8)
    expected, _ = passes_after(device, both, both, 0)
    assert not shared
    for name, image in passes.items():
        np.testing.assert_array_equal(image, expected[name], err_msg=name)
    fewer, shared = passes_after(device, both, alone, SETTINGS.view_count // 8)
    assert shared == {"Lamp"}
    np.testing.assert_array_equal(fewer["VIR Shadow Lamp"], expected["VIR Shadow Lamp"])


def test_a_sealed_light_is_taken_over(device):
    sealed = area_light("Sealed", (-0.9, 0.3, 0.5), (-0.9, 0.3, 0.0), size_m=(0.2, 0.2))
    before, scene = (snapshot(MESHES, [sealed, key], CAMERA, WIDTH, HEIGHT) for key in (KEY, MOVED_KEY))
    assert [line.is_sealed for line in plan(scene, SETTINGS).passes] == [False, True]
    passes, shared = passes_after(device, before, scene, 2)
    assert shared == {"Sealed"}
    assert set(np.unique(passes["VIR Shadow Sealed"])) == {0.0, 1.0}


def test_what_stopped_within_a_batch_is_made_again(device, from_nothing):
    with contextlib.closing(Renderer(BEFORE, plan(BEFORE, SETTINGS), device)) as previous:
        device.run(previous.prepare)
        device.run(previous.render_batch, 0)
        steps = previous.rendering(1)
        # the first light's maps are filled, and nobody has looked them up
        for _ in range(3):
            device.run(next, steps)
        steps.close()
        renderer = Renderer(BEFORE, plan(BEFORE, SETTINGS), device, previous=previous)
    with contextlib.closing(renderer):
        device.run(renderer.prepare)
        assert shared_parts(renderer, previous) == {"geometry", "scene data", "eye", "Key"}
        render_batches(renderer)
        for name, image in renderer.read_passes().items():
            np.testing.assert_array_equal(image, from_nothing["nothing"][name], err_msg=name)


def test_a_render_that_shares_runs_out_of_memory(device, monkeypatch):
    """Whatever there is no memory for: what was made is released, once, when both are closed."""
    scene, _ = AFTER["an object moved"]
    room_for = 0
    while True:
        with counted(device, monkeypatch) as holdings:
            previous = Renderer(BEFORE, plan(BEFORE, SETTINGS), device)
            device.run(previous.prepare)
            holdings.room_for = holdings.made_count + room_for
            made = [previous]
            failed = True
            with contextlib.suppress(Exception):
                made.append(Renderer(scene, plan(scene, SETTINGS), device, previous=previous))
                device.run(made[-1].prepare)
                failed = False
            for renderer in made:
                renderer.close()
            assert not holdings.live and not holdings.released_twice, room_for
        if not failed:
            break
        room_for += 1
    assert room_for > 10


def test_what_stopped_between_rasterizing_and_surfaces_is_made_again(device, from_nothing):
    with contextlib.closing(Renderer(BEFORE, plan(BEFORE, SETTINGS), device)) as previous:
        steps = previous.preparing()
        told = []
        previous.stopwatch._on_stage = lambda name, _: told.append(name)
        answer = None
        while "eye G-buffer" not in told:
            host_work = device.run(steps.send, answer)
            answer = host_work() if host_work is not None else None
        steps.close()
        renderer = Renderer(BEFORE, plan(BEFORE, SETTINGS), device, previous=previous)
    with contextlib.closing(renderer):
        device.run(renderer.prepare)
        render_batches(renderer)
        for name, image in renderer.read_passes().items():
            np.testing.assert_array_equal(image, from_nothing["nothing"][name], err_msg=name)
