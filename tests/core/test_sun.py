"""Shadows of suns: closed forms, float64 rays, and what must not change them."""

import dataclasses

import numpy as np
import pytest

from tests.ray_tracing import nearest_blocker, surfaces_at, world_triangles
from tests.scenes import (
    METHODS,
    box,
    bumpy_sphere,
    camera_from_above,
    floor,
    perspective_camera,
    prepared_renderer,
    rectangle,
    render_batches,
    render_pass,
    rmse,
    snapshot,
    sun_light,
)
from vir_addon.core.settings import Method, PointStorage
from vir_addon.core.views import LATTICE_STRIDE

WIDTH, HEIGHT = 96, 12
EDGE_HEIGHT_M = 1.0


def half_plane(light, width_m, centre=(0.0, 0.0)):
    """A half plane x < 0 over a floor seen from above; the sun shines along x = 0 unless it is turned."""
    occluder = rectangle("half plane", (-8, -8, EDGE_HEIGHT_M), (8, 0, 0), (0, 16, 0))
    return snapshot(
        [floor(), occluder], [light], camera_from_above(centre, width_m, WIDTH, HEIGHT), WIDTH, HEIGHT, visible_to_camera=[True, False]
    )


def row_x(width_m):
    return (np.arange(WIDTH) + 0.5) / WIDTH * width_m - width_m / 2


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("angle_rad", [0.1, 0.8])
def test_penumbra_of_a_straight_edge(device, method, angle_rad):
    """2 d tan(angle / 2) wide; in between, the share of the disc of directions beyond the edge, by the floor's cosine."""
    reach_m = EDGE_HEIGHT_M * np.tan(angle_rad / 2)
    x = row_x(3 * reach_m)
    image = render_pass(
        half_plane(sun_light(angle_rad=angle_rad), 3 * reach_m), device, method=method, view_count=256, map_resolution_px=256
    )
    # irradiance is an integral over the disc of sines, whose share on one side of a chord is known
    edge = np.clip(np.sin(np.arctan(x / EDGE_HEIGHT_M)) / np.sin(angle_rad / 2), -1, 1)
    if angle_rad < 0.2:
        truth = 0.5 + (edge * np.sqrt(1 - edge**2) + np.arcsin(edge)) / np.pi
        assert rmse(image[HEIGHT // 2], truth) <= 0.01
        assert np.abs(image - truth).max() <= 0.04
    dark, lit = x < -reach_m * 1.02, x > reach_m * 1.02
    assert dark.any() and (image[:, dark] == 0).all() and (image[:, lit] == 1).all()
    between = np.abs(x) < 0.85 * reach_m
    assert ((image[:, between] > 0) & (image[:, between] < 1)).all()


@pytest.mark.parametrize("method", METHODS)
def test_hard_sun(device, method):
    light = sun_light(eye=(1.0, 0.0, 2.0), angle_rad=0.0)
    image = render_pass(half_plane(light, 2.0), device, method=method, map_resolution_px=512)
    np.testing.assert_array_equal(image, np.broadcast_to(row_x(2.0) > -0.5 * EDGE_HEIGHT_M, image.shape))


def still_life(light, width=40, height=24):
    meshes = [
        floor(3.0),
        box("box", (-0.9, 0.3, 0.5), (0.4, 0.5, 0.5), turn_rad=0.4),
        bumpy_sphere("ball", (0.8, 0.0, 0.8), 0.6, 8, smooth=False),
        rectangle("leaf", (-0.2, -1.2, 0.7), (0.7, 0.1, 0.3), (0.0, 0.6, 0.2)),
        rectangle("cloud far towards the sun", (35.0, -42.0, 60.0), (4.0, 0.0, 0.0), (0.0, 4.0, 0.0)),
    ]
    camera = perspective_camera((0.5, -6.0, 3.5), (0.0, 0.0, 0.5), width, height)
    return snapshot(meshes, [light], camera, width, height)


def traced(scene, samples_m, positions):
    """(n,) the pass at the surfaces of a G-buffer, and (n, 2) their pixels"""
    triangles = world_triangles(scene)
    surfaces = surfaces_at(positions, scene, triangles)
    rotation = scene.lights[0].world_from_light[:3, :3]
    rays = np.add(samples_m, (0, 0, 1)) @ (rotation * [1, 1, -1]).T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    weight = np.maximum(-surfaces.shading @ rays.T, 0)
    seen = np.zeros_like(weight)
    for index, ray in enumerate(rays):
        free = ~np.isfinite(nearest_blocker(surfaces.position, surfaces.position - 200 * ray, triangles.corners))
        seen[:, index] = free & (surfaces.geometric @ ray < 0)
    total = weight.sum(axis=1)
    return np.where(total > 0, (weight * seen).sum(axis=1) / np.where(total > 0, total, 1), 0), surfaces.pixel


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("angle_rad", [0.0, 0.3])
def test_against_rays(device, method, angle_rad):
    scene = still_life(sun_light(eye=(3.0, -4.0, 5.0), angle_rad=angle_rad))
    with prepared_renderer(scene, device, method=method, view_count=16, map_resolution_px=1024) as renderer:
        render_batches(renderer)
        image, (work,) = renderer.read_passes()["VIR Shadow Key"], renderer.works
        truth, pixel = traced(scene, work.samples_m, device.run(device.read, renderer.eye.buffers[0].positions))
    assert 0.2 < truth.mean() < 0.97 and truth.std() > 0.1
    # one sample: a pixel is either right or wholly wrong
    assert rmse(image[tuple(pixel.T)], truth) <= (0.06 if angle_rad == 0 else 0.02)


@pytest.mark.parametrize("method", METHODS)
def test_where_the_sun_stands_does_not_matter(device, method):
    light = sun_light(eye=(3.0, -4.0, 5.0))
    elsewhere = light.world_from_light.copy()
    elsewhere[:3, 3] = 1000.0, -20.0, -300.0
    arguments = {"method": method, "view_count": 8, "map_resolution_px": 256}
    moved = dataclasses.replace(light, world_from_light=elsewhere)
    np.testing.assert_array_equal(render_pass(still_life(light), device, **arguments), render_pass(still_life(moved), device, **arguments))


def test_points_as_they_come_make_the_same_picture(device):
    scene = still_life(sun_light(eye=(3.0, -4.0, 5.0)))
    arguments = {"method": Method.IVIR, "view_count": 8, "map_resolution_px": 256, "cull_hidden": False}
    np.testing.assert_array_equal(
        render_pass(scene, device, **arguments), render_pass(scene, device, points=PointStorage.BUFFERLESS, **arguments)
    )


def lattice_places(views):
    """(view_count, 2) where, in texels of its map, each view has the world's origin"""
    x, y, z = views.face.face_from_world @ -views.origin_ws
    return (np.array([x, y]) - views.centers_fs[:, :2] - views.samples_m[:, :2] * z) / views.texel_tangent


def fitted_views(scene, device):
    with prepared_renderer(scene, device, method=Method.MVR, view_count=8, map_resolution_px=256) as renderer:
        return renderer.works[0].faces[0][0].views


def test_lattice_stays_when_the_camera_moves(device):
    """Texels of two pictures' maps are the same ones, however the camera looks: windows differ by whole texels of one ladder."""
    light = sun_light(eye=(1.0, 0.5, 2.0))
    first, second = (fitted_views(half_plane(light, 2.0, centre), device) for centre in ((0.0, 0.0), (0.37, 0.11)))
    assert first.texel_tangent == second.texel_tangent
    apart = lattice_places(first) - lattice_places(second)
    np.testing.assert_allclose(apart, np.round(apart), atol=1e-6)
    assert not np.array_equal(first.window_texels, second.window_texels)


def test_lattice_stays_when_an_object_moves(device):
    """Unless it is the largest of the scene, in which case it takes the lattice along."""
    light, places = sun_light(eye=(1.0, 0.5, 2.0)), []
    for moved in ((0, 0), (0, 0.0123), (0.0123, 0)):
        scene = half_plane(light, 2.0)
        instances = dataclasses.replace(scene.instances, world_from_object=scene.instances.world_from_object.copy())
        instances.world_from_object[:, 0, 3] = moved
        places.append(lattice_places(fitted_views(dataclasses.replace(scene, instances=instances), device)))
    still, other, largest = places
    np.testing.assert_allclose(other - still, np.round(other - still), atol=1e-6)
    assert np.abs(largest - still - np.round(largest - still)).max() > 1e-3


def test_lattice_stays_when_the_largest_object_grows(device):
    """If it is known not to stay; the others hold it."""
    light, views = sun_light(eye=(1.0, 0.5, 2.0)), []
    for width_m in (4.0, 4.1):
        occluder = rectangle("half plane", (-1, -1, EDGE_HEIGHT_M), (1, 0, 0), (0, 2, 0))
        sea = rectangle("sea", (-2.0, -2.0, -0.5), (width_m, 0.0, 0.0), (0.0, 4.0, 0.0))
        camera = camera_from_above((0.0, 0.0), 1.0, WIDTH, HEIGHT)
        scene = snapshot([sea, floor(1.5), occluder], [light], camera, WIDTH, HEIGHT, stays=[False, True, True])
        views.append(fitted_views(scene, device))
    one, other = views
    assert one.texel_tangent == other.texel_tangent
    apart = lattice_places(one) - lattice_places(other)
    np.testing.assert_allclose(apart, np.round(apart), atol=1e-6)


def test_what_is_stored_of_a_lattice_far_away_is_small(device):
    """A place of the picture a kilometre from the largest object is as sharp as one beside it."""
    light = sun_light(eye=(1.0, 0.5, 2.0), angle_rad=0.3)
    occluder = rectangle("half plane", (-1, -1, EDGE_HEIGHT_M), (1, 0, 0), (0, 2, 0))
    ground = rectangle("ground", (-1.0, -1.0, 0.0), (2000.0, 0.0, 0.0), (0.0, 2000.0, 0.0))
    scene = snapshot([ground, occluder], [light], camera_from_above((0.0, 0.0), 1.0, WIDTH, HEIGHT), WIDTH, HEIGHT)
    views = fitted_views(scene, device)
    assert np.abs(views.window_texels).max() < LATTICE_STRIDE
    assert np.abs(views.centers_fs[:, :2] / views.texel_tangent).max() <= 0.5
    assert max(views.texel_tangent) < 4 / views.map_width_px


def test_views_without_casters_do_not_stretch_the_lattice(device):
    """What shadows the picture's edge alone is not seen by all views: those without it would have theirs beside the largest object."""
    light = sun_light(eye=(1.0, 0.5, 2.0), angle_rad=0.3)
    ground = rectangle("ground", (-1.0, -1.0, 0.0), (2000.0, 0.0, 0.0), (0.0, 2000.0, 0.0))
    occluder = box("at the edge", (0.37, 0.15, 0.18), (0.02, 0.02, 0.02))
    scene = snapshot([ground, occluder], [light], camera_from_above((0.0, 0.0), 0.4, WIDTH, 54), WIDTH, 54)
    with prepared_renderer(scene, device, method=Method.MVR, view_count=64, map_resolution_px=256) as renderer:
        fitted = renderer.works[0].faces[0][0]
    assert 0.1 < (~fitted.seen_by_view.any(axis=1)).mean() < 0.9
    assert np.abs(fitted.views.window_texels).max() < LATTICE_STRIDE
    assert max(fitted.views.texel_tangent) * fitted.views.map_width_px < 0.4, "wider than the picture"
