"""A render that is stopped after any batch has handed over the pass of the light samples so far."""

import contextlib
import itertools

import numpy as np
import pytest

from tests.ray_tracing import bracket_pass
from tests.scenes import (
    METHODS,
    METHODS_BUT_SLOW_IVIR,
    area_light,
    box,
    bumpy_sphere,
    floor,
    perspective_camera,
    render_passes,
    rmse,
    snapshot,
)
from vir_addon.core.plan import plan
from vir_addon.core.render import Renderer, render
from vir_addon.core.settings import Method, Settings
from vir_addon.core.stopwatch import StoppedError

WIDTH, HEIGHT = 28, 16
VIEWS, BATCHES = 32, 4


def still_life(width=WIDTH, height=HEIGHT):
    meshes = [
        floor(3.0),
        box("box", (-0.9, 0.3, 0.5), (0.4, 0.5, 0.5), turn_rad=0.4),
        bumpy_sphere("ball", (0.8, 0.0, 0.8), 0.6, 7, smooth=False),
    ]
    light = area_light(eye=(2.0, -2.0, 4.0), target=(0, 0, 0.5), size_m=(1.5, 1.5))
    return snapshot(meshes, [light], perspective_camera((0.5, -6.0, 3.5), (0.0, 0.0, 0.5), width, height), width, height)


@pytest.mark.parametrize("method", METHODS)
def test_every_batch_is_the_pass_of_the_samples_so_far(device, method):
    """Against rays to just those samples, in float64."""
    scene = still_life()
    work = plan(scene, Settings(method=method, view_count=VIEWS, map_resolution_px=512))
    assert work.batch_count == BATCHES
    with contextlib.closing(Renderer(scene, work, device)) as renderer:
        device.run(renderer.prepare)
        (light_work,) = renderer.works
        faces = [fitted for fitted, _, _ in light_work.faces]
        positions = device.run(device.read, renderer.eye.buffers[0].positions)
        for batch in range(BATCHES):
            device.run(renderer.render_batch, batch)
            if batch not in (0, 2):
                continue
            image = renderer.read_passes()["VIR Shadow Key"]
            so_far = slice((batch + 1) * VIEWS // BATCHES)
            samples = light_work.samples_m[so_far], light_work.sample_weights[so_far]
            truth = bracket_pass(scene, light_work.light, *samples, faces, positions)
            assert truth.exact[truth.surface].std() > 0.1
            wrong = np.maximum(truth.low - image, image - truth.high) > 2e-3
            assert wrong.sum() <= 1, batch
            assert rmse(image, truth.exact) < 0.02, batch


@pytest.mark.parametrize("method", METHODS_BUT_SLOW_IVIR)
def test_passes_only_get_better(device, method):
    scene = still_life(96, 54)
    arguments = {"method": method, "map_resolution_px": 512}
    reference = render_passes(scene, device, view_count=1024, **arguments)
    errors = []
    steps = render(scene, plan(scene, Settings(view_count=VIEWS, **arguments)), device)
    with contextlib.closing(steps):
        for progress in steps:
            passes = progress.passes
            assert list(passes) == list(reference)
            assert all(image.min() >= 0 and image.max() <= 1 for image in passes.values())
            # one light: all together is it
            np.testing.assert_allclose(passes["VIR Shadow"], passes["VIR Shadow Key"], atol=1e-6)
            errors.append(rmse(passes["VIR Shadow Key"], reference["VIR Shadow Key"]))
    # as much better as with independent samples, at least; stratified ones do better until they meet what all views share
    assert errors[0] > 0.02
    assert errors[-1] < errors[0] / np.sqrt(BATCHES), errors


def test_a_stopped_render_does_not_disturb_the_next(device):
    scene = still_life()
    arguments = {"method": Method.IVIR, "view_count": 16, "map_resolution_px": 256}
    whole = render_passes(scene, device, **arguments)
    with contextlib.closing(render(scene, plan(scene, Settings(**arguments)), device)) as steps:
        stopped = next(steps).passes
    assert not np.array_equal(stopped["VIR Shadow Key"], whole["VIR Shadow Key"])
    again = render_passes(scene, device, **arguments)
    for name, image in whole.items():
        np.testing.assert_array_equal(again[name], image)


@pytest.mark.parametrize("batches", [2, None])
def test_passes_outlive_the_generator(device, batches):
    """Of a loop that is left or runs to its end, the last step still has its passes: that is how everyone writes it."""
    taken = still_life()
    inside = None
    steps = render(taken, plan(taken, Settings(view_count=16, map_resolution_px=64)), device)
    for progress in steps:
        inside = progress.passes
        if progress.batches_done == batches:
            break
    steps.close()
    assert progress.pass_set.images.keys() == inside.keys()
    for name, image in progress.passes.items():
        np.testing.assert_array_equal(image, inside[name])


def test_stages_are_told_as_they_begin(device):
    scene, told = still_life(), []
    for progress in render(scene, plan(scene, Settings(method=Method.MICRO, view_count=8)), device, lambda *stage: told.append(stage)):
        if progress.batches_done == 1:
            # one after the other; more often where there are pauses, as while kernels are compiled
            stages = [stage for stage, _ in itertools.groupby(told)]
            assert stages[:3] == [("upload", None), ("eye G-buffer", None), ("read-back", None)]
            assert stages[3:] == [("points", "Key"), ("splat or raster", "Key"), ("resolve", "Key")]
    assert set(progress.statistics.stage_ms) | set(progress.statistics.passes[0].stage_ms) == {name for name, _ in told} | {"extract"}


def test_no_stage_begins_once_nobody_waits(device):
    """What closing does to a device's thread that is still at work when Ctrl-C has ended the wait."""
    scene, told = still_life(), []

    def stop_at_points(name, light_name):
        told.append(name)
        if name == "points":
            renderer.stopwatch.stop()

    with contextlib.closing(Renderer(scene, plan(scene, Settings(view_count=8)), device, stop_at_points)) as renderer:
        with pytest.raises(StoppedError):
            device.run(renderer.prepare)
        assert [stage for stage, _ in itertools.groupby(told)] == ["upload", "eye G-buffer", "read-back", "points"]
        assert told.count("points") == 1


def test_a_batch_waits_for_the_device_around_its_stages_alone(device, monkeypatch):
    """Once its kernels are there: one stage for the eye, one for a light's maps, one for looking the picture up in them."""
    with contextlib.closing(
        Renderer(still_life(), plan(still_life(), Settings(method=Method.MICRO, view_count=VIEWS)), device)
    ) as renderer:
        device.run(renderer.prepare)
        for batch in (0, 1):
            device.run(renderer.render_batch, batch)
        waits, finish = [], device.finish
        monkeypatch.setattr(device, "finish", lambda: waits.append(finish()))
        device.run(renderer.render_batch, 2)
    assert len(waits) == 2 * 3
