"""How dark hollows are that flat mirrors show, against float64 rays."""

from __future__ import annotations

import dataclasses

import numpy as np

from tests.core.test_reflections import camera_rays
from tests.ray_tracing import intersect, world_triangles
from tests.scenes import box, matte, mirror, perspective_camera, rectangle, render_passes, snapshot
from vir_addon.core.material import World
from vir_addon.core.pass_set import REFLECTION_PASS_NAME
from vir_addon.core.settings import Effect

WIDTH, HEIGHT = 64, 36


def open_sky(positions, normals, corners, ray_count, seed=5):
    """(n,) share of the sky, by the cosine, that no triangle hides"""
    shares = np.zeros(len(positions))
    rng = np.random.default_rng(seed)
    for _ in range(ray_count):
        around = rng.normal(size=positions.shape)
        directions = normals + around / np.linalg.norm(around, axis=1, keepdims=True)
        along, _ = intersect(positions, directions, corners)
        shares += ~((along > 1e-5) & np.isfinite(along)).any(axis=1)
    return shares / ray_count


def test_the_sky_does_not_shine_through_hollows_that_a_flat_mirror_shows(device):
    """A box that is open towards the mirror, whose lid lies at the height from which the mirror's cube looks and is edge-on to it."""
    case = box("case", (0.0, 0.6, 0.3), (0.8, 0.6, 0.6))
    is_open = (case.positions_os[case.triangles][..., 1] > 1.19).all(axis=1)
    case = dataclasses.replace(case, triangles=case.triangles[~is_open].copy(), is_closed=False)
    camera = perspective_camera((-1.2, -3.5, 1.6), (0.3, 2.0, 0.4), WIDTH, HEIGHT, 0.4)
    flat = rectangle("flat", (-2, 2, -1), (4, 0, 0), (0, 0, 3.5))
    scene = snapshot([flat, case], [], camera, WIDTH, HEIGHT, materials=[mirror(), matte((1, 1, 1))], world=World((1, 1, 1)))
    image = render_passes(scene, device, effects=(Effect.REFLECTION,), bounces=1, reflection_sample_count=64)[REFLECTION_PASS_NAME][..., 0]

    triangles = world_triangles(scene)
    eye, directions = camera_rays(camera, WIDTH, HEIGHT)
    first, _ = intersect(np.broadcast_to(eye, (WIDTH * HEIGHT, 3)), directions.reshape(-1, 3), triangles.corners)
    first[~(first > 1e-6)] = np.inf
    shows = np.isfinite(first.min(axis=1)) & (triangles.instance[first.argmin(axis=1)] == 0)
    at = eye + first.min(axis=1)[shows, None] * directions.reshape(-1, 3)[shows]
    reflected = directions.reshape(-1, 3)[shows] * (1, -1, 1)
    # the mirror itself is in no map of it: what it shows has the sky there
    corners = triangles.corners[triangles.instance == 1]
    along, _ = intersect(at, reflected, corners)
    along[~(along > 1e-6)] = np.inf
    is_met = np.isfinite(along.min(axis=1))
    normals = np.cross(*np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 0))[along.argmin(axis=1)]
    normals *= -np.sign((normals * reflected).sum(axis=1, keepdims=True)) / np.linalg.norm(normals, axis=1, keepdims=True)
    inner = np.zeros(WIDTH * HEIGHT, bool)
    inner[np.flatnonzero(shows)[is_met]] = True
    inner = inner.reshape(HEIGHT, WIDTH)
    for axis in (0, 1):
        inner &= np.roll(inner, 1, axis) & np.roll(inner, -1, axis)
    truth = np.zeros(WIDTH * HEIGHT)
    truth[np.flatnonzero(shows)[is_met]] = open_sky(
        at[is_met] + along.min(axis=1)[is_met, None] * reflected[is_met], normals[is_met], corners, 256
    )
    truth = truth.reshape(HEIGHT, WIDTH)
    assert inner.sum() > 40
    assert truth[inner].mean() < 0.6
    np.testing.assert_allclose(image[inner].mean(), truth[inner].mean(), atol=0.04)
    assert np.sqrt(((image - truth)[inner] ** 2).mean()) < 0.16
