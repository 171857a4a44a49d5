"""The command line as a farm sees it: files, channels, exit statuses, and nothing half-written."""

import contextlib
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import vir_addon
from vir_addon.__main__ import main
from vir_addon.cli.arguments import make_parser, settings_of
from vir_addon.cli.commands import jobs_of
from vir_addon.cli.interrupts import held_interrupts
from vir_addon.cli.progress import STAGE_TEXTS, ShownProgress
from vir_addon.core.settings import Effect, ReflectionFilter, Settings
from vir_addon.device.moderngl_device import ModernglComputeKernel, ModernglDevice

bpy = pytest.importorskip("bpy")
OpenEXR = pytest.importorskip("OpenEXR")

ROOT = Path(vir_addon.__file__).parents[1]
TIMEOUT_S = 120
PIXEL_ASPECT = 1.5
SIZE = ("--resolution", "64x36", "--views", "8", "--map-resolution", "128")


def build(path, *, camera=True, light=True, surfaces=True):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene

    def put(name, data, location, rotation=(0.0, 0.0, 0.0)):
        made = bpy.data.objects.new(name, data)
        made.location, made.rotation_euler = location, rotation
        scene.collection.objects.link(made)
        return made

    if not surfaces:
        put("Smoke", bpy.data.volumes.new("Smoke"), (0, 0, 0))
    for name, half, height in (("Floor", 4.0, 0.0), ("Board", 0.6, 1.0)) if surfaces else ():
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata([(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)], [], [(0, 1, 2, 3)])
        put(name, mesh, (0, 0, height))
    if light:
        area = bpy.data.lights.new("Key.001", "AREA")
        area.energy, area.size = 200.0, 1.0
        put("Key.001", area, (0, 0, 4))
    if camera:
        scene.camera = put("Camera", bpy.data.cameras.new("Camera"), (0, -7, 4), (1.05, 0, 0))
    scene.view_layers.new("Second.Layer")
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = PIXEL_ASPECT, 1.0
    bpy.ops.wm.save_as_mainfile(filepath=str(path))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("command line")


@pytest.fixture(scope="module")
def blend(folder):
    path = folder / "still.life.blend"
    build(path)
    return path


def vir(*arguments, **keywords):
    command = [sys.executable, "-m", "vir_addon", *map(str, arguments)]
    environment = {**os.environ, "COLUMNS": "200", **keywords.pop("environment", {})}
    return subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False, env=environment, **keywords)


@pytest.fixture(scope="module")
def rendered(blend, folder):
    output = folder / "new" / "passes"
    done = vir("render", blend, "--output", output, *SIZE, "--frames", "1-3:2", "--preview", "--stats", folder / "stats.json")
    assert done.returncode == 0, done.stderr
    return output


def test_render_writes_what_it_promises(rendered):
    names = sorted(path.name for path in rendered.iterdir())
    assert [name for name in names if name.endswith(".exr")] == ["still.life_0001.exr", "still.life_0003.exr"]
    assert sum(name.endswith(".png") for name in names) >= 2
    assert not [name for name in names if name.startswith(".")]
    with OpenEXR.File(str(rendered / "still.life_0001.exr"), separate_channels=True) as file:
        assert len(file.parts) == 1
        channels = file.parts[0].channels
        layers = ("ViewLayer", "Second_Layer")
        assert set(channels) == {f"{layer}.VIR Shadow{light}.V" for layer in layers for light in ("", " Key_001")}
        image = channels["ViewLayer.VIR Shadow Key_001.V"].pixels
        assert file.header()["pixelAspectRatio"] == PIXEL_ASPECT
    assert image.dtype == np.float32 and image.shape == (36, 64)
    assert image.min() < 0.1 and image.max() == 1


def test_statistics_are_complete(rendered, folder):
    stats = json.loads((folder / "stats.json").read_text())
    assert [frame["frame"] for frame in stats["frames"]] == [1, 3]
    layer = stats["frames"][0]["view_layers"]["ViewLayer"]
    assert (layer["object_count"], layer["instance_count"]) == (2, 2)
    assert (layer["unique_triangle_count"], layer["instanced_triangle_count"]) == (4, 4)
    assert "OpenGL" in layer["device"]
    assert {"extract", "upload", "eye G-buffer", "points", "splat or raster", "resolve", "read-back", "write"} <= set(
        layer["total_stage_ms"]
    )
    (made,) = layer["passes"]
    assert (made["light_name"], made["view_count"], made["map_resolution_px"]) == ("Key.001", 8, 128)
    assert made["method"].startswith(("mvr", "micro", "ivir")) and made["error_estimate"] > 0 and "point_count" in made


def test_what_is_left_out_is_counted_in_plan_and_statistics(folder, capsys):
    path, stats = folder / "broken mesh.blend", folder / "broken.json"
    build(path)
    mesh = bpy.data.meshes.new("Broken")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, math.nan), (2, 0, 0)], [], [(0, 1, 2), (2, 1, 3), (0, 1, 4), (1, 4, 3)])
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("Broken", mesh))
    for name in ("Smoke", "Fog"):
        bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, bpy.data.volumes.new(name)))
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    assert main(["plan", str(path)]) == 0
    printed = capsys.readouterr().out
    assert "6 triangles, 1 of them without area (6 with instances)" in printed
    assert "the triangles at them are missing (vertices: 1, triangles: 2)" in printed
    assert main(["render", str(path), "--output", str(folder / "broken"), *SIZE, "--stats", str(stats)]) == 0
    layer = json.loads(stats.read_text())["frames"][0]["view_layers"]["ViewLayer"]
    assert (layer["unique_triangle_count"], layer["flat_triangle_count"]) == (6, 1)
    assert (layer["left_out_object_count"], layer["left_out_instance_count"]) == (2, 2)
    assert (layer["dropped_vertex_count"], layer["dropped_triangle_count"]) == (1, 2)
    assert [text.split(":")[0] for text in layer["left_out"]] == ["Broken", "Fog", "Smoke"]


def test_a_light_that_a_frame_hides_is_white_there(blend, folder, capsys):
    path, output = folder / "blinking.blend", folder / "blinking"
    build(path)
    key, fill = bpy.data.objects["Key.001"], bpy.data.objects["Key.001"].copy()
    fill.name = "Fill"
    bpy.context.scene.collection.objects.link(fill)
    for frame in (1, 2):
        key.hide_render = frame == 2
        key.keyframe_insert("hide_render", frame=frame)
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    arguments = ["--frames", "1-2", "--lights", "Key.001", *SIZE]
    assert main(["render", str(path), "--output", str(output), *arguments]) == 0
    assert "'Key.001' is not rendered in this frame and view layer: its pass is white" in capsys.readouterr().out
    images = []
    for frame in (1, 2):
        with OpenEXR.File(str(output / f"blinking_{frame:04d}.exr"), separate_channels=True) as file:
            channels = file.parts[0].channels
            assert not [name for name in channels if "Fill" in name]
            images.append(channels["ViewLayer.VIR Shadow Key_001.V"].pixels)
    assert images[0].min() < 0.1 and (images[1] == 1).all()


def test_plan_says_why_and_does_nothing(blend, folder):
    before = sorted(folder.rglob("*"))
    done = vir("plan", blend)
    assert done.returncode == 0 and "Key.001" in done.stdout and "rectangle" in done.stdout
    assert sorted(folder.rglob("*")) == before


def test_plan_refuses_what_its_device_cannot_run(blend, monkeypatch, capsys):
    monkeypatch.setattr(ModernglDevice, "stores_from_fragments", False)
    assert main(["plan", str(blend), "--method", "vwss"]) == 2
    printed, errors = capsys.readouterr()
    assert "choose the device moderngl, or the method ivir" in errors and "as asked" not in printed


def test_doctor():
    done = vir("doctor")
    assert done.returncode == 0
    for word in ("bpy", "moderngl", "textures up to", "shaders"):
        assert word in done.stdout
    # nothing is wrong, so nothing may look like it: not what Blender prints while it looks for a version of OpenGL either
    assert not done.stderr


NO_DRIVER = {"__EGL_VENDOR_LIBRARY_FILENAMES": "/dev/null", "EGL_PLATFORM": "surfaceless"}
"""an empty list of vendors for EGL"""


def test_doctor_without_a_driver():
    """Blender itself would end the process."""
    done = vir("doctor", environment=NO_DRIVER)
    assert done.returncode == 4, (done.stdout, done.stderr)
    assert "device moderngl: not usable" in done.stdout and "device gpu: not usable" in done.stdout
    assert "no device is usable" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.parametrize("package", ["rich", "numpy"])
@pytest.mark.parametrize("command", ["doctor", "plan"])
def test_without_a_package_that_everything_needs(blend, command, package):
    script = """if True:
        import runpy, sys
        class Missing:
            package = sys.argv.pop()
            @classmethod
            def find_spec(cls, name, *_):
                if name.partition(".")[0] == cls.package:
                    raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        sys.meta_path.insert(0, Missing)
        runpy.run_module("vir_addon", run_name="__main__", alter_sys=True)
    """
    arguments = [command] if command == "doctor" else [command, str(blend)]
    whole = [sys.executable, "-c", script, *arguments, package]
    done = subprocess.run(whole, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    assert done.returncode == 4, (done.stdout, done.stderr)
    assert package in done.stderr and "install" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.skipif(bpy.app.version < (5, 2, 0), reason="has no GPU in background")
def test_what_the_driver_says_is_passed_on():
    """Only the refusals of a search that ends well are left out."""
    script = """if True:
        import os, bpy, gpu
        from vir_addon.device import blender_gpu_device
        class Driver:
            @staticmethod
            def init():
                os.write(2, b"MESA: warning: something\\n")
                gpu.init()
        blender_gpu_device._initialize(Driver)
        def fail():
            os.write(2, b"EGL Error (0x3009): EGL_BAD_MATCH: no version\\n")
            raise SystemError("none")
        Driver.init = fail
        blender_gpu_device._initialize(Driver)
    """
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    assert done.stderr.splitlines()[:2] == ["MESA: warning: something", "EGL Error (0x3009): EGL_BAD_MATCH: no version"]
    assert "Blender found no usable GPU (none)" in done.stderr


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("", (ReflectionFilter.EYE, 32, None)),
        ("--reflection-filter poisson", (ReflectionFilter.POISSON, 25, None)),
        ("--reflection-filter adaptive --reflection-samples 8", (ReflectionFilter.ADAPTIVE, 8, None)),
        ("--reflection-cube 512", (ReflectionFilter.EYE, 32, 512)),
    ],
)
def test_what_the_papers_do_with_reflections_can_be_asked_for(given, expected):
    settings = settings_of(make_parser().parse_args(["plan", "scene.blend", "--effects", "reflection", *given.split()]))
    assert (settings.reflection_filter, settings.reflection_sample_count, settings.reflection_cube_px) == expected


def test_exit_statuses(blend, folder):
    no_camera, dark, smoke, broken = (folder / f"{name}.blend" for name in ("no camera", "dark", "smoke", "broken"))
    build(no_camera, camera=False)
    build(dark, light=False)
    build(smoke, surfaces=False)
    broken.write_bytes(b"not a blend")
    pipe = folder / "pipe"
    os.mkfifo(pipe)
    cases = [
        (2, "no light named 'Sun'", ("render", blend, "--output", folder / "x", "--lights", "Sun")),
        (2, "is none of auto, mvr, ivir", ("render", blend, "--output", folder / "x", "--method", "magic")),
        (
            2,
            "which compares neighbours in their buffer",
            ("plan", blend, "--method", "vir", "--points", "bufferless"),
        ),
        (2, "required", ("render", blend)),
        (2, "outside of Blender's frames", ("plan", blend, "--frames", "1-99999999999")),
        (2, "argument --output: the name is empty", ("render", blend, "--output", "")),
        # before anything is rendered, which would be lost
        (2, "it is a folder", ("render", blend, "--output", folder / "x", "--stats", folder)),
        (2, "a pipe or a device", ("render", blend, "--output", folder / "x", "--stats", pipe)),
        (2, f"{blend} is not a folder", ("render", blend, "--output", blend / "x")),
        (2, "two counts such as 32+64", ("plan", blend, "--method", "pcss", "--pcss-samples", "96")),
        (2, "views must be", ("plan", blend, "--views", "0")),
        (2, "choose the method ivir", ("plan", blend, "--method", "micro", "--points", "bufferless")),
        (2, "choose the method ivir", ("plan", blend, "--method", "micro", "--point-generation", "rasterizer")),
        (2, "at most 1 texel", ("plan", blend, "--culling-area", "2")),
        (2, "--culling-area does nothing with the method micro", ("plan", blend, "--method", "micro", "--culling-area", "0.1")),
        (2, "--pcss-samples does nothing with the method auto", ("plan", blend, "--pcss-samples", "32+64")),
        (
            2,
            "--points-per-eye-pixel does nothing with",
            ("plan", blend, "--effects", "reflection", "--reflection-method", "mvr", "--points-per-eye-pixel", "1"),
        ),
        (2, "--reflection-look-up does nothing without", ("plan", blend, "--reflection-look-up", "shaded", "--reflection-cube", "64")),
        (2, "choose the reflection filter poisson", ("plan", blend, "--effects", "reflection", "--reflection-look-up", "lazy")),
        (2, "--points-per-eye-pixel does nothing without", ("plan", blend, "--points-per-eye-pixel", "1")),
        (2, "in steps of 32, not 100", ("plan", blend, "--effects", "reflection", "--reflection-cube", "100")),
        (2, "samples of a pixel, not 0", ("plan", blend, "--reflection-samples", "0")),
        (
            2,
            "another filter than adaptive",
            ("plan", blend, "--effects", "reflection", "--reflection-filter", "adaptive", "--per-reflector"),
        ),
        (3, "is not there", ("render", folder / "missing.blend", "--output", folder / "x")),
        (3, "not a .blend", ("plan", broken)),
        (3, "camera", ("plan", no_camera)),
        (3, "no light", ("render", dark, "--output", folder / "x")),
        (3, "left out: Smoke: volumes", ("render", smoke, "--output", folder / "x")),
        (3, "has no surface", ("plan", smoke)),
    ]
    for status, words, arguments in cases:
        done = vir(*arguments)
        assert (done.returncode, words in done.stderr) == (status, True), (arguments, done.stdout, done.stderr)
        assert "Traceback" not in done.stderr
    assert not list(folder.glob("x/*"))


def test_a_terminal_that_cannot_show_a_name(folder):
    blend = folder / "Lämp.blend"
    build(blend)
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii"}
    done = vir("render", blend, "--output", folder / "ascii", *SIZE, environment=ascii_only)
    assert (done.returncode, done.stderr) == (0, "")
    assert "mp_0001.exr" in done.stdout and done.stdout.splitlines()[-1].isascii()
    assert (folder / "ascii" / "Lämp_0001.exr").is_file()


def test_without_a_standard_output(blend):
    """As a service or a scheduled task may start it."""
    script = "import os, sys; os.close(1); os.execv(sys.argv[1], sys.argv[1:])"
    command = [sys.executable, "-c", script, sys.executable, "-m", "vir_addon", "plan", str(blend), "--resolution", "64x36"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_no_usable_device(blend, folder):
    done = vir("render", blend, "--output", folder / "y", *SIZE, environment=NO_DRIVER)
    assert done.returncode == 4, (done.stdout, done.stderr)
    assert "install" in done.stderr and "Traceback" not in done.stderr
    assert not list(folder.glob("y/*"))


def test_a_log_has_a_line_for_each_step(blend, folder):
    done = vir("render", blend, "--output", folder / "log", *SIZE)
    steps = [line for line in done.stdout.splitlines() if line.startswith("frame 1")]
    layers = ("ViewLayer", "Second.Layer")
    reading = [f"frame 1: {what} {layer}" for layer in layers for what in ("evaluating", "reading")]
    assert steps[:4] == reading
    predicted = [re.fullmatch(r"(.*), about ([0-9.]+) m?s in all", line) for line in steps[4::2]]
    assert [found and found[1] for found in predicted] == [f"frame 1 {layer}: preparing 1 light" for layer in layers]
    assert all(line.startswith(f"frame 1 {layer}: 8/8 views, error") for line, layer in zip(steps[5::2], layers, strict=True))


def test_a_log_of_a_long_render_tells_how_it_goes_on(blend, folder, monkeypatch, capsys):
    """With a line after every batch here, which a test cannot wait for."""
    monkeypatch.setattr("vir_addon.cli.progress.LOG_INTERVAL_S", 0.0)
    assert main(["render", str(blend), "--output", str(folder / "long"), *SIZE, "--views", "32"]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("frame 1 ViewLayer: ")]
    assert lines[0].startswith("frame 1 ViewLayer: preparing 1 light, about ")
    went_on = [re.fullmatch(r"frame 1 ViewLayer: (\d+)/32 views, error [^ ]+, \d+ s left", line) for line in lines[1:-1]]
    assert [found and int(found[1]) for found in went_on] == [8, 16, 24]
    assert lines[-1].startswith("frame 1 ViewLayer: 32/32 views, error ")


@pytest.fixture(scope="module", autouse=True)
def hears_ctrl_c():
    """What a script starts in the background ignores Ctrl-C, and so does what that starts: renders without an end would have none."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("module", ["vir_addon.cli", "rich", "argparse", "numpy", "vir_addon.cli.commands", "bpy"])
def test_ctrl_c_while_importing(blend, module):
    """The first and the last of the program's own modules, and those that take longest."""
    script = """if True:
        import runpy, signal, sys
        class Interrupter:
            awaited = sys.argv.pop()
            @classmethod
            def find_spec(cls, name, *_):
                if name == cls.awaited:
                    cls.awaited = None
                    print("interrupted", flush=True)
                    signal.raise_signal(signal.SIGINT)
        sys.meta_path.insert(0, Interrupter)
        runpy.run_module("vir_addon", run_name="__main__", alter_sys=True)
    """
    command = [sys.executable, "-c", script, "plan", str(blend), module]
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    assert done.stdout.startswith("interrupted")
    assert (done.returncode, done.stderr) == (130, "vir: stopped; files that were written are whole\n")


@pytest.mark.skipif(sys.platform == "win32", reason="has no SIGINT for other processes")
@pytest.mark.parametrize("step", ["Read blend", "evaluating", "preparing"])
def test_ctrl_c_before_the_first_picture(blend, folder, step):
    output = folder / f"stopped while {step}"
    command = [sys.executable, "-u", "-m", "vir_addon", "render", str(blend), "--output", str(output)]
    endless = ["--views", "4096", "--map-resolution", "4096"]
    with subprocess.Popen([*command, *endless], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        while step not in (line := process.stdout.readline()):
            assert line, process.communicate()
        process.send_signal(signal.SIGINT)
        printed, errors = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 130, errors
    assert errors == "vir: stopped; files that were written are whole\n"
    assert "wrote" not in printed and not list(output.glob("*"))


def test_nothing_is_imported_before_ctrl_c_is_waited_for():
    """While Python itself starts nobody can wait for it; a module more takes longer than all that follows."""
    script = "import io, sys; before = {*sys.modules}; import vir_addon.__main__; print(sorted({*sys.modules} - before))"
    # -S: site-packages may import what a bare interpreter does not
    found = subprocess.run([sys.executable, "-S", "-c", script], capture_output=True, text=True, timeout=TIMEOUT_S, cwd=ROOT, check=True)
    assert found.stdout.strip() == "['vir_addon', 'vir_addon.__main__']"


def test_ctrl_c_while_blender_calls_scripts(blend, capfd):
    """Blender prints what its handlers and engines raise, and drops it."""
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    scene = bpy.context.scene
    steps = []

    def interrupt(*_):
        signal.raise_signal(signal.SIGINT)

    bpy.app.handlers.frame_change_post.append(interrupt)
    try:
        with pytest.raises(KeyboardInterrupt):
            jobs_of(scene, scene.frame_current, Settings(), (64, 36), steps.append)
    finally:
        bpy.app.handlers.frame_change_post.remove(interrupt)
    assert "KeyboardInterrupt" not in capfd.readouterr().err
    assert steps == []  # nothing was begun after it


def test_a_lost_device_has_its_status_and_says_what_to_do(blend, folder, monkeypatch, capsys):
    def refuse(*_):
        raise RuntimeError("context lost")

    monkeypatch.setattr(ModernglComputeKernel, "_dispatch", refuse)
    assert main(["render", str(blend), "--output", str(folder), "--device", "moderngl", *SIZE]) == 4
    told = capsys.readouterr().err
    assert told.startswith("vir: the graphics device failed or was lost (context lost): render again") and told.count("\n") == 1
    assert not list(folder.glob("*.exr"))


def test_ctrl_c_that_got_lost_is_heard_with_the_next_batch(blend, folder, monkeypatch):
    def lose(*_):
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(ShownProgress, "large_step", lose)
    output = folder / "lost"
    assert main(["render", str(blend), "--output", str(output), *SIZE]) == 130
    assert not list(output.glob("*.exr"))


def test_ctrl_c_where_python_cleans_up_is_not_printed(blend, folder, monkeypatch):
    class Dropped:
        def __del__(self):
            signal.raise_signal(signal.SIGINT)

    def clean_up(*_):
        Dropped()

    dropped = []
    monkeypatch.setattr(sys, "unraisablehook", dropped.append)
    monkeypatch.setattr(ShownProgress, "preparing", clean_up)
    output = folder / "cleaned up"
    assert main(["render", str(blend), "--output", str(output), *SIZE]) == 130
    assert dropped == []
    assert not list(output.glob("*.exr"))


def test_ctrl_c_is_heard_at_the_end_of_the_inner_of_two_blocks():
    """Opening a file is one of a render: what follows it may take long."""
    with pytest.raises(KeyboardInterrupt), held_interrupts():
        with held_interrupts():
            signal.raise_signal(signal.SIGINT)
        pytest.fail("went on after the inner block")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize("device", ["moderngl", "gpu"])
def test_ctrl_c_ends_a_render_with_the_current_stage(blend, folder, monkeypatch, device):
    stages = []
    show = ShownProgress.stage

    def stage(progress, name, light_name):
        stages.append(name)
        if len(stages) == 4:
            signal.raise_signal(signal.SIGINT)
            # on the device's thread: the main one hears of it when it wakes
            deadline = time.monotonic() + TIMEOUT_S
            while time.monotonic() < deadline:
                show(progress, name, light_name)
                time.sleep(0.01)
        show(progress, name, light_name)

    monkeypatch.setattr(ShownProgress, "stage", stage)
    output = folder / f"stage {device}"
    assert main(["render", str(blend), "--output", str(output), "--device", device, *SIZE]) == 130
    assert len(stages) == 4
    assert not list(output.glob("*.exr"))


@pytest.mark.skipif(sys.platform == "win32", reason="has no SIGINT for other processes")
def test_ctrl_c_leaves_no_half_written_files(blend, folder):
    output = folder / "stopped"
    command = [sys.executable, "-m", "vir_addon", "render", str(blend), "--output", str(output), "--frames", "1-500", *SIZE]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + TIMEOUT_S
        while not list(output.glob("*.exr")):
            assert process.poll() is None and time.monotonic() < deadline
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    assert {path.suffix for path in output.iterdir()} == {".exr"}
    for path in output.iterdir():
        with OpenEXR.File(str(path)) as file:
            assert file.parts


def test_auto_is_all_effects_that_a_scene_calls_for(blend):
    settings = [settings_of(make_parser().parse_args(["plan", "scene.blend", "--effects", text])) for text in ("auto", "shadow,reflection")]
    assert settings[0] == settings[1] and settings[0].effects == tuple(Effect)
    done = vir("plan", blend, "--effects", "auto")
    assert done.returncode == 0 and "nothing reflects" in done.stdout
    refused = vir("plan", blend, "--effects", "auto,shadow")
    assert refused.returncode == 2 and "'auto' is none of shadow, reflection" in refused.stderr


def test_every_stage_of_a_render_has_a_text():
    core = Path(vir_addon.__file__).parent / "core"
    sources = [path.read_text(encoding="utf-8") for path in core.rglob("*.py")]
    stages = {name for source in sources for name in re.findall(r'\b(?:stages?|host_work)\("([^"]+)"', source)}
    assert len(stages) > 8
    assert stages <= set(STAGE_TEXTS)
