"""Nothing is left behind: on the GPU, in Blender, of threads. Everything that is alive is counted, before and after."""

import contextlib
import time
from types import SimpleNamespace

import pytest

bpy = pytest.importorskip("bpy")

from tests.blender.living import Living, threads  # noqa: E402  (bpy decides whether this file runs)
from tests.blender.test_preview_running import Viewport, tick, tick_until_idle  # noqa: E402
from tests.test_registration import blender_state, functions_of_the_extension  # noqa: E402
from vir_addon import blender  # noqa: E402
from vir_addon.blender import devices, frame_state, operators  # noqa: E402
from vir_addon.blender.preview import running  # noqa: E402
from vir_addon.blender.stepped_render import SteppedRender  # noqa: E402
from vir_addon.device.open import open_device  # noqa: E402


@pytest.fixture(scope="module", autouse=True)
def gpu():
    if bpy.app.version < (5, 2):
        pytest.skip("before 5.2 Blender has no GPU in background")
    open_device("gpu").close()
    import gpu

    return gpu


@pytest.fixture
def living(monkeypatch):
    return Living(monkeypatch)


@pytest.fixture
def room(scene, add):
    """A mirror beside a cube: everything that the extension can make has something to do."""
    add.mesh("Floor", [(-5, -5, 0), (5, -5, 0), (5, 5, 0), (-5, 5, 0)], [(0, 1, 2, 3)])
    cube = add.cube("Cube", location=(0, 0, 1))
    add.cube("Mirror", location=(3, 0, 1))
    material = bpy.data.materials.new("Mirror")
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Metallic"].default_value, shader.inputs["Roughness"].default_value = 1.0, 0.1
    bpy.data.objects["Mirror"].data.materials.append(material)
    cube.data.materials.append(bpy.data.materials.new("Paint"))
    add.light("Key", location=(1, -1, 5), data={"size": 1.0})
    add.light("Lamp", "POINT", location=(-2, -1, 4), data={"shadow_soft_size": 0.2})
    scene.camera.location.z, scene.camera.rotation_euler.x = 3.0, 1.3
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 48, 32, 100
    return scene


def settle(scene) -> None:
    scene.vir.view_count, scene.vir.map_resolution_px, scene.vir.use_reflections = 8, 64, True
    scene.vir.method = "AUTO"


class Window(Viewport):
    """Is drawn into, as a window is."""

    def __init__(self, gpu) -> None:
        super().__init__()
        self.gpu = gpu

    def draw(self) -> None:
        offscreen = self.gpu.types.GPUOffScreen(48, 32)
        with offscreen.bind():
            super().draw()
        offscreen.free()


@pytest.fixture
def window(gpu, monkeypatch, room):
    made = Window(gpu)
    monkeypatch.setattr(running, "draw_text", lambda _, text: made.texts.append(text))
    return made


def show_preview(scene, window, *, slices: int | None = None) -> None:
    """slices: until then, None: to its end"""
    scene.vir.use_preview = True
    window.draw()
    if slices is None:
        tick_until_idle()
    else:
        for _ in range(slices):
            tick()
    window.draw()


def hide_preview(scene, window) -> None:
    scene.vir.use_preview = False
    window.draw()
    tick()


@pytest.fixture
def running_threads() -> set[str]:
    """Other tests' devices, which share the process, have some, and those may end meanwhile."""
    return threads()


def wait_for_threads(expected: set[str]) -> None:
    """They end with what they are at."""
    end = time.monotonic() + 60.0
    while threads() - expected:
        assert time.monotonic() < end, threads() - expected
        time.sleep(0.01)


@contextlib.contextmanager
def enabled(scene):
    blender.register()
    settle(scene)
    try:
        yield
    finally:
        blender.unregister()


def test_nothing_is_left_of_an_extension_that_was_enabled_twice_and_did_all_it_can(room, window, living, running_threads):
    before = blender_state()
    for _ in range(2):
        with enabled(room):
            for device in ("MODERNGL", "GPU"):
                room.vir.device = device
                assert bpy.ops.vir.render() == {"FINISHED"}
            show_preview(room, window)
            assert "8 of" in window.texts[-1] or "16 of" in window.texts[-1]
            bpy.data.objects["Cube"].location.x += 0.5
            bpy.context.view_layer.update()
            tick()  # it is in the middle of something
            at_work = living.count()
            assert all(at_work[kind] > 0 for kind in ("GPUTexture", "GPUShader", "GPUBatch", "context", "texture", "compute_shader"))
        assert not living.count()
        wait_for_threads(running_threads)
        assert blender_state() == before
        assert not any(bpy.app.timers.is_registered(function) for function in functions_of_the_extension())


@pytest.mark.parametrize("turns", [2, pytest.param(10, marks=pytest.mark.slow)])
def test_a_preview_that_comes_and_goes_again_and_again(room, window, living, running_threads, turns):
    with enabled(room):
        hidden = []
        for turn in range(turns + 1):
            # to its end at first, and then anywhere on the way there
            show_preview(room, window, slices=None if turn == 0 else 6 * turn)
            window.region_3d.view_matrix = [*window.region_3d.view_matrix[:2], (0, -0.9, 0.4, -8 - 0.1 * turn), (0, 0, 0, 1)]
            window.draw()
            tick()
            hide_preview(room, window)
            assert not running._running.viewports and not running._running.caches
            hidden.append(living.count())
        # of the device remain kernels and a fence
        assert all(count == hidden[0] for count in hidden), hidden
        assert hidden[0]["GPUTexture"] == 1 and not hidden[0]["GPUBatch"] and hidden[0]["GPUShader"] > 10
        wait_for_threads(running_threads)


@pytest.mark.parametrize("turns", [2, pytest.param(10, marks=pytest.mark.slow)])
@pytest.mark.parametrize("device_name", ["moderngl", "gpu"])
def test_renders_that_are_cancelled_again_and_again(room, living, running_threads, device_name, turns):
    with enabled(room):
        room.vir.device, room.vir.view_count = device_name.upper(), 32  # enough for all kernels to be asked for
        bpy.ops.vir.render()
        device = devices.get_device(device_name)

        def count():
            pool = getattr(device, "unused_textures", None)
            return living.count(tuple(handle for _, handle in pool._unused.values()) if pool is not None else ())

        left = count()
        assert left and not left["vertex_array"] and not left["GPUBatch"]
        room.vir.view_count = 256
        for turn in range(turns):
            made_count = living.made_count
            render = SteppedRender(operators.plan_frame(room), device_name)
            frame_state.state_of(room).running = render
            while living.made_count < made_count + 1 + 40 * turn / turns and not render.step():
                time.sleep(0.0 if device_name == "gpu" else 1e-4)
            assert bpy.ops.vir.cancel() == {"FINISHED"}
            render.join()
            frame_state.forget_running(render)
            assert render.is_done and not render.layers and render.error is None
            assert count() == left, turn
    assert not living.count()
    wait_for_threads(running_threads)


def test_draw_handlers_come_and_go(monkeypatch):
    """In background there are no viewports to draw in; the rest is as in a window."""
    handles: dict[object, tuple] = {}
    view = bpy.types.SpaceView3D

    class Counting:
        @staticmethod
        def draw_handler_add(*arguments):
            handle = view.draw_handler_add(*arguments)
            handles[handle] = arguments
            return handle

        @staticmethod
        def draw_handler_remove(handle, region_type):
            del handles[handle]
            view.draw_handler_remove(handle, region_type)

    types = SimpleNamespace(SpaceView3D=Counting)
    monkeypatch.setattr(running, "bpy", SimpleNamespace(app=SimpleNamespace(background=False, timers=bpy.app.timers), types=types))
    for _ in range(2):
        running.register()
        assert [arguments[2:] for arguments in handles.values()] == [("WINDOW", "POST_PIXEL")]
        running.unregister()
        assert not handles
