"""Shadows stand still while the camera moves: the pass at fixed places of the scene, with views fitted to one frame after the other."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import ndimage

from tests.scenes import (
    METHODS,
    area_light,
    box,
    bumpy_sphere,
    camera_from_above,
    floor,
    leaves,
    perspective_camera,
    prepared_renderer,
    snapshot,
    sun_light,
)
from vir_addon.core.passes.eye import GBuffer
from vir_addon.core.passes.scene_data import pack_directions
from vir_addon.core.settings import Method

WIDTH, HEIGHT = 80, 45
VIEWS = 16
MAP_PX = 256
FRAMES = 9
LIGHT = area_light(eye=(2.0, -2.0, 5.0), target=(0, 0, 0.5), size_m=(0.6, 0.6))
SUN = sun_light(eye=(3.0, -2.0, 4.0), target=(0, 0, 0.5), angle_rad=0.2)
PLACES = (45, 96)
"""rows and columns of the grid of places on the floor"""
GRID_STEP_M = 0.018
ROUNDING = 2e-6
"""of float32 sums over the views; a single texel that sees something else changes a place by 1 / VIEWS"""


def camera_at(path, frame):
    """None of them sees all of the shadows, so all windows follow."""
    if path == "pan":
        return camera_from_above((-0.1 + 0.011 * frame, 0.007 * frame), 2.2, WIDTH, HEIGHT)
    if path == "orbit":
        turn = 0.01 * frame
        eye = (6.5 * np.sin(turn) + 0.013 * frame, -6.5 * np.cos(turn), 5.4 - 0.011 * frame)
        return perspective_camera(eye, (0.05 * np.sin(frame), 0.0, 0.0), WIDTH, HEIGHT, 0.14)
    return perspective_camera((0.0, -6.5, 5.4), (0.0, 0.0, 0.0), WIDTH, HEIGHT, 0.3)


def scene_at(path, frame, light):
    """A still scene and a light; on the path "visitor" a box comes in, which was out of the picture."""
    meshes = [
        floor(3.0),
        box("box", (-0.9, 0.3, 0.5), (0.4, 0.5, 0.5), turn_rad=0.4),
        bumpy_sphere("ball", (0.8, 0.0, 0.8), 0.6, 20),
        leaves("leaves", (0.0, -0.8, 0.9), 0.6, 40, 0.12),
        box("visitor", (0.0, 0.0, 0.2), (0.2, 0.2, 0.2)),
    ]
    transforms = np.tile(np.eye(4), (5, 1, 1))
    transforms[4, :3, 3] = (3.4 - 0.2 * frame, -1.9, 0.0) if path == "visitor" else (40, 0, 0)
    return snapshot(meshes, [light], camera_at(path, frame), WIDTH, HEIGHT, transforms=transforms)


def floor_places():
    """(rows, columns, 4) positions with the floor's number, and normals: places that every frame's picture shows"""
    x, y = np.meshgrid(GRID_STEP_M * (np.arange(PLACES[1]) - 50), GRID_STEP_M * (np.arange(PLACES[0]) - 22))
    positions, normals = np.zeros((*PLACES, 4), np.float32), np.zeros((*PLACES, 4), np.float32)
    positions[..., 0], positions[..., 1] = x, y
    normals[..., 2], normals[..., 3] = 1, pack_directions(np.array([0.0, 0.0, 1.0]))
    return positions, normals


def shadows_at_places(scene, device, method):
    """The pass at the floor's places, with the views that the scene's own camera calls for; a texel's tangent."""
    with prepared_renderer(scene, device, method=method, view_count=VIEWS, map_resolution_px=MAP_PX) as renderer:
        (work,) = renderer.works
        ((fitted, _, _),) = work.faces
        positions, normals = (device.upload_texture(texels) for texels in floor_places())
        places = SimpleNamespace(buffers=[GBuffer(positions, normals)], size=PLACES[::-1], want_also=lambda tiles: None)
        work.accumulator.release()
        work.accumulator = type(work.accumulator)(device, *PLACES[::-1])
        for sums in renderer.store.batch_sums:
            sums.release()
        renderer.store.batch_sums = [device.upload_texture(np.zeros((*PLACES, 4), np.float32))]
        for batch in range(renderer.plan.batch_count):
            device.run(work.render_batch, batch, places, renderer.stopwatch)
        shadowed, delivered, _ = device.run(work.accumulator.read)
        positions.release()
        normals.release()
        return shadowed / delivered, fitted.views


@pytest.mark.parametrize(
    ("method", "path", "light"),
    [
        pytest.param(method, path, light, id=f"{method.value}-{path}-{kind}", marks=() if quick else pytest.mark.slow)
        for kind, light, paths in (("area", LIGHT, ("pan", "orbit", "visitor")), ("sun", SUN, ("pan", "visitor")))
        for method in METHODS
        for path in paths
        for quick in [method is Method.MICRO or (path == "pan" and light is LIGHT)]
    ],
)
def test_shadows_stand_still(device, method, path, light):
    """The same values from frame to frame, however the windows move; but where texels change by a step of the ladder an edge may move by
    one texel. Between the neighbours of a place, two steps of the grid apart, it passes `spread`."""
    frames = [shadows_at_places(scene_at(path, frame, light), device, method) for frame in range(FRAMES)]
    moved_count = still_count = 0
    for (before, a), (after, b) in itertools.pairwise(frames):
        assert ((before > 0.01) & (before < 0.99)).mean() > 0.2
        moved_count += (a.window_texels != b.window_texels).any()
        if a.texel_tangent == b.texel_tangent:
            still_count += 1
            np.testing.assert_allclose(before, after, rtol=0, atol=ROUNDING)
            continue
        spread = ndimage.maximum_filter(before, 3) - ndimage.minimum_filter(before, 3)
        texel_m = max(a.texel_tangent + b.texel_tangent) * (1.0 if a.is_orthographic else a.far_m)
        assert np.abs(after - before).mean() < spread.mean() * texel_m / (2 * GRID_STEP_M)
    assert moved_count >= 2 and still_count >= 4
