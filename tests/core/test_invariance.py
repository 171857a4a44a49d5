"""The same scene elsewhere or in another unit is the same picture."""

import dataclasses
import itertools

import numpy as np
import pytest

from tests.scenes import (
    METHODS,
    METHODS_AND_HYBRID,
    area_light,
    box,
    bumpy_sphere,
    camera_from_above,
    floor,
    leaves,
    perspective_camera,
    point_light,
    render_pass,
    render_passes,
    scaled,
    snapshot,
    spot_light,
    sun_light,
)
from vir_addon.core.scene import Mesh, PixelFilter
from vir_addon.core.settings import Method

WIDTH, HEIGHT = 120, 68
TOLERANCE = 1 / 255
VIEWS = 16


LIGHTS = {
    "area": (area_light("Key", (2.0, -2.0, 5.0)), area_light("Rim", (-4.0, 3.0, 2.0), (0.0, 0.0, 0.5), (0.5, 0.5), strength=40.0)),
    "suns": (sun_light("High", (1.3, -2.1, 4.7)), sun_light("Low", (3.3, -1.1, 1.7), angle_rad=0.3)),
    "lamps": (
        point_light("Hard", (-1.3, -1.1, 3.1), 0.0),
        point_light("Soft", (1.3, -2.1, 3.7), 0.4),
        spot_light("Spot", (1.9, -2.1, 3.9), cone_blend=0.3),
    ),
}
FROM_ABOVE = camera_from_above((0.2, 0.1), 7.0, WIDTH, HEIGHT)


def still_life(lights=LIGHTS["area"], camera=None):
    meshes = [floor(6.0), box("box", (-0.9, 0.3, 0.5), (0.4, 0.5, 0.5), turn_rad=0.4), bumpy_sphere("ball", (0.8, 0.0, 0.8), 0.6, 40)]
    camera = camera or perspective_camera((0.5, -6.0, 3.5), (0.0, 0.0, 0.5), WIDTH, HEIGHT)
    return snapshot(meshes, lights, camera, WIDTH, HEIGHT, pixel_filter=PixelFilter())


def scattered(seed):
    """Things of many sizes anywhere above a floor beside the world's origin, or above none, before one light of each kind."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform((-3, -3, 0), 3)
    meshes = [
        box(f"box {k}", middle + rng.normal(0, 1, 3), rng.lognormal(-1.5, 0.7, 3), turn_rad=rng.uniform(0, 3))
        for k in range(rng.integers(1, 5))
    ]
    meshes.append(bumpy_sphere("ball", middle + rng.normal(0, 1, 3), rng.uniform(0.1, 0.7), 12))
    meshes.append(leaves("leaves", middle + rng.normal(0, 1, 3), 2.0, 30, 0.3, seed))
    if rng.random() < 0.8:
        ground = floor(rng.uniform(2, 40), -1.0)
        meshes.append(dataclasses.replace(ground, positions_os=(ground.positions_os + middle).astype(np.float32)))
    above = middle + rng.normal((0, 0, 4), 1, (4, 3))
    lights = [
        area_light("Area", above[0], middle, tuple(rng.uniform(0, 1.5, 2))),
        point_light("Point", above[1], rng.choice([0.0, 0.3])),
        spot_light("Spot", above[2], middle, cone_rad=rng.uniform(0.3, 2.5)),
        sun_light("Sun", above[3], middle, angle_rad=rng.uniform(0, 0.6)),
    ]
    if rng.random() < 0.3:
        camera = camera_from_above(middle, 5.0, WIDTH, HEIGHT, float(middle[2]) + 6)
    else:
        camera = perspective_camera(middle + rng.normal((0.5, -6.0, 3.0), 0.5), middle, WIDTH, HEIGHT)
    return snapshot(meshes, lights, camera, WIDTH, HEIGHT, pixel_filter=PixelFilter())


def moved(scene, shift):
    """As extraction leaves it when it takes another origin: transforms carry the shift."""
    placed = scene.instances.world_from_object.copy()
    placed[:, :3, 3] += shift
    camera, lights = scene.camera.world_from_view.copy(), []
    camera[:3, 3] += shift
    for light in scene.lights:
        matrix = light.world_from_light.copy()
        matrix[:3, 3] += shift
        lights.append(dataclasses.replace(light, world_from_light=matrix))
    return dataclasses.replace(
        scene,
        instances=dataclasses.replace(scene.instances, world_from_object=placed),
        camera=dataclasses.replace(scene.camera, world_from_view=camera),
        lights=tuple(lights),
    )


def assert_same_pictures(first, second, may_flip):
    """may_flip: pixels that may differ by one sample"""
    assert list(first) == list(second)
    for name, image in first.items():
        difference = np.abs(image - second[name])
        assert np.count_nonzero(difference > TOLERANCE) <= may_flip, name
        assert difference.max() <= 1.2 / VIEWS, name


def may_flip(method):
    # a point that lies within rounding (a ten-thousandth of a texel) of a texel's border is drawn on either side of it: of the quarter
    # of a million points here a few are at an outline in some view, and one sample of a pixel there sees it
    return 2 if method is Method.IVIR else 0


def cases(*cameras):
    """Points of lamps take seconds, and from above nothing is new but the camera."""
    found = []
    for camera, lights, method in itertools.product(cameras, LIGHTS, METHODS):
        is_slow = lights == "lamps" if method is Method.IVIR else camera is not None and method is Method.MICRO
        name = f"{'perspective' if camera is None else 'orthographic'}-{lights}-{method.value}"
        found.append(pytest.param(camera, lights, method, id=name, marks=pytest.mark.slow if is_slow else ()))
    return found


@pytest.mark.parametrize(("camera", "lights", "method"), cases(None, FROM_ABOVE))
def test_another_unit_is_the_same_picture(device, method, lights, camera):
    scene = still_life(LIGHTS[lights], camera)
    arguments = {"method": method, "view_count": VIEWS, "map_resolution_px": 512, "stochastic_culling": False}
    picture = render_passes(scene, device, **arguments)
    for factor in (1e-3, 37.0, 1e3):
        assert_same_pictures(picture, render_passes(scaled(scene, factor), device, **arguments), may_flip(method))


@pytest.mark.parametrize(("camera", "lights", "method"), cases(None))
def test_another_origin_is_the_same_picture(device, method, lights, camera):
    scene = still_life(LIGHTS[lights], camera)
    arguments = {"method": method, "view_count": VIEWS, "map_resolution_px": 512}
    elsewhere = moved(scene, np.array([3.3, -5.1, 2.7]))
    assert_same_pictures(render_passes(scene, device, **arguments), render_passes(elsewhere, device, **arguments), may_flip(method))


@pytest.mark.parametrize("seed", range(6))
def test_scattered_things_elsewhere_in_another_unit(device, seed):
    """Where every coordinate moves by its last bit, one of a hundred thousand pixels sees an outline on the other side of a sample."""
    scene, rng = scattered(seed), np.random.default_rng(seed)
    arguments = {"method": Method.MVR, "view_count": VIEWS, "map_resolution_px": 256}
    picture = render_passes(scene, device, **arguments)
    assert all(image.min() < 0.9 for image in picture.values())
    for factor in (1e-3, 1e3, 10 ** rng.uniform(-3, 3)):
        again = render_passes(scaled(moved(scene, rng.uniform(-3, 3, 3)), factor), device, **arguments)
        assert_same_pictures(picture, again, may_flip=2)


def test_two_runs_have_the_same_bits(device):
    for method in METHODS:
        first, second = (render_passes(still_life(), device, method=method, view_count=VIEWS, map_resolution_px=512) for _ in range(2))
        for name in first:
            np.testing.assert_array_equal(first[name], second[name])


def crossing_sheets(seed):
    """Folded, open and crossing each other in one mesh: at folds and where they cross many eye samples see two triangles equally near."""
    rng = np.random.default_rng(seed)
    u, v = np.meshgrid(np.linspace(-1, 1, 25), np.linspace(-1, 1, 25))
    corner = np.arange(24 * 25).reshape(24, 25)[:, :24].ravel()
    of_sheet = np.concatenate([np.stack([corner, corner + 1, corner + 26], 1), np.stack([corner, corner + 26, corner + 25], 1)])
    positions, triangles = [], []
    for number in range(8):
        turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        sheet = np.stack([u, v, 0.4 * np.sin(5 * u + 2 * v + number)], axis=-1).reshape(-1, 3) @ turned + rng.normal(0, 0.4, 3)
        triangles.append(of_sheet + len(positions) * len(sheet))
        positions.append(sheet)
    return Mesh("sheets", np.float32(np.concatenate(positions) + np.array([0.0, 0.0, 1.5])), np.concatenate(triangles).astype(np.int32))


@pytest.mark.parametrize("camera", [None, FROM_ABOVE], ids=["perspective", "orthographic"])
@pytest.mark.parametrize("method", METHODS_AND_HYBRID)
def test_permuted_triangles_are_the_same_bits(device, method, camera):
    camera = camera or perspective_camera((0.5, -6.0, 3.5), (0.0, 0.0, 1.0), WIDTH, HEIGHT)
    for seed in range(3):
        sheets = crossing_sheets(seed)
        shuffled = dataclasses.replace(sheets, triangles=np.random.default_rng(seed).permutation(sheets.triangles))
        first, second = (
            render_passes(
                snapshot([floor(6.0), mesh], LIGHTS["area"], camera, WIDTH, HEIGHT, pixel_filter=PixelFilter()),
                device,
                method=method,
                view_count=VIEWS,
                map_resolution_px=256,
            )
            for mesh in (sheets, shuffled)
        )
        for name, image in first.items():
            assert 0.1 < image.mean() < 0.9
            np.testing.assert_array_equal(image, second[name])


@pytest.mark.parametrize("clip_end_m", [30.0, 1e3, 1e5])
def test_permuted_objects_are_the_same_bits_to_orthographic_cameras(device, clip_end_m):
    """Also where the clip range is so long that all depths are next to 0."""
    camera = dataclasses.replace(camera_from_above((0.0, 0.0), 4.0, WIDTH, HEIGHT, 10.0), clip_start_m=0.1, clip_end_m=clip_end_m)
    objects = [floor(3.0), bumpy_sphere("ball", (0.0, 0.0, 1.0), 0.8, 40)]
    first, second = (
        render_pass(snapshot(order, LIGHTS["area"][:1], camera, WIDTH, HEIGHT), device, view_count=VIEWS, map_resolution_px=256)
        for order in (objects, objects[::-1])
    )
    np.testing.assert_array_equal(first, second)
    assert first[HEIGHT // 2, WIDTH // 2] > 0.5 > first.min()  # the ball hides its shadow
