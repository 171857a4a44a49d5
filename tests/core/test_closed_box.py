"""No light leaves a closed box, whatever the resolution and wherever its faces look."""

import dataclasses

import numpy as np
import pytest

from tests.scenes import (
    METHODS,
    METHODS_AND_HYBRID,
    area_light,
    box,
    bumpy_sphere,
    floor,
    perspective_camera,
    point_light,
    rectangle,
    render_pass,
    snapshot,
    spot_light,
)
from vir_addon.core.scene import Camera, Mesh, PixelFilter
from vir_addon.core.settings import PointStorage

WIDTH, HEIGHT = 96, 54


@pytest.fixture(autouse=True)
def _maps_have_to_tell(monkeypatch):
    """Of closed meshes the plan knows it (tests/core/test_enclosure.py); here it does not."""
    monkeypatch.setattr("vir_addon.core.light_plan.sealing_object", lambda *_: None)


def boxed_light(inside_out, light_turned=False):
    target = (0.4, 0.2, 0.0) if light_turned else (0.0, 0.0, 0.0)
    light = area_light(eye=(0.0, 0.0, 2.0), target=target, size_m=(0.5, 0.3))
    meshes = [
        floor(6.0),
        rectangle("wall", (-6, 4, 0), (12, 0, 0), (0, 0, 6)),
        box("around", (0.05, 0.02, 1.9), (0.6, 0.5, 0.4), inside_out=inside_out, turn_rad=0.2),
    ]
    camera = perspective_camera((0.0, -8.0, 4.0), (0.0, 0.0, 1.5), WIDTH, HEIGHT)
    return snapshot(meshes, [light], camera, WIDTH, HEIGHT)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("inside_out", [False, True])
@pytest.mark.parametrize("resolution_px", [64, 100, 256, *(pytest.param(size, marks=pytest.mark.slow) for size in (1024, 2048))])
def test_outside_is_black(device, method, inside_out, resolution_px):
    scene = boxed_light(inside_out)
    image = render_pass(scene, device, method=method, view_count=16, map_resolution_px=resolution_px)
    assert (image == 0).mean() > 0.5
    # the background is 1 and nothing is in between
    assert set(np.unique(image)) <= {0.0, 1.0}
    rows = np.arange(HEIGHT)
    assert (image[rows < HEIGHT // 3] == 0).all()


@pytest.mark.parametrize("inside_out", [False, True])
def test_outside_is_black_for_a_slanted_light_and_points_as_they_come(device, inside_out):
    scene = boxed_light(inside_out, light_turned=True)
    image = render_pass(scene, device, method=METHODS[1], view_count=16, map_resolution_px=128, points=PointStorage.BUFFERLESS)
    assert set(np.unique(image)) == {0.0, 1.0}


def balls_around_a_boxed_light(light):
    """Of each something is grazed by every point of the light, and the box's walls cross the tangent planes there."""
    meshes = [
        floor(6.0),
        box("around", (0.05, 0.02, 1.9), (0.6, 0.5, 0.4), turn_rad=0.2),
        bumpy_sphere("smooth", (1.6, 0.3, 1.2), 0.8, 64, bump_share=0.0),
        bumpy_sphere("bumpy", (-1.5, 0.5, 1.6), 0.7, 48),
        bumpy_sphere("facets", (0.3, 1.7, 2.3), 0.6, 6, bump_share=0.0, smooth=False),
        bumpy_sphere("before", (-0.4, -1.5, 0.9), 0.5, 24, bump_share=0.2, smooth=False),
    ]
    camera = perspective_camera((0.0, -8.0, 4.0), (0.0, 0.0, 1.5), WIDTH, HEIGHT)
    return snapshot(meshes, [light], camera, WIDTH, HEIGHT)


BOXED_LIGHTS = {
    "down": area_light(eye=(0.0, 0.0, 2.0), target=(0.0, 0.0, 0.0), size_m=(0.5, 0.3)),
    "aside": area_light(eye=(0.0, 0.0, 2.0), target=(2.0, 0.3, 1.9), size_m=(0.5, 0.3)),
    "point": point_light(eye=(0.0, 0.0, 2.0), radius_m=0.2),
}


@pytest.mark.parametrize("method", METHODS_AND_HYBRID)
@pytest.mark.parametrize("light", BOXED_LIGHTS)
def test_nothing_leaks_where_the_light_would_graze(device, method, light):
    scene = balls_around_a_boxed_light(BOXED_LIGHTS[light])
    background = None
    for resolution_px in (16, 33, 64, 100, 333):
        image = render_pass(scene, device, method=method, view_count=8, map_resolution_px=resolution_px)
        leaks = (image > 0) & (image < 1)
        assert not leaks.any(), f"{leaks.sum()} pixels, {image[leaks].max():.3f} at most, in maps of {resolution_px} texels"
        background = background if background is not None else image == 1
        np.testing.assert_array_equal(image == 1, background)
    assert 0.3 < background.mean() < 0.5


def balls_around_a_random_box(seed):
    """A box turned at random, with a light anywhere in it, and balls, smooth and faceted, that do not touch it."""
    random = np.random.default_rng(seed)
    half = random.uniform(0.15, 0.8, 3)
    axes = np.linalg.qr(random.normal(size=(3, 3)))[0]
    axes *= np.linalg.det(axes)
    radius_m = 0.9 * random.uniform(0.05, 0.8) * half.min()
    eye = axes @ (random.uniform(-1, 1, 3) * (half - radius_m))
    aim = eye + random.normal(size=3)
    light = (
        area_light(eye=eye, target=aim, size_m=(1.2 * radius_m, 0.8 * radius_m)),
        point_light(eye=eye, radius_m=radius_m),
        spot_light(eye=eye, target=aim, radius_m=radius_m, cone_rad=2.5),
    )[seed % 3]
    straight = box("around", (0, 0, 0), half)
    meshes = [dataclasses.replace(straight, positions_os=(straight.positions_os @ axes.T).astype(np.float32))]
    for k in range(5):
        away, ball_m = random.normal(size=3), random.uniform(0.2, 0.9)
        centre = away / np.linalg.norm(away) * (np.linalg.norm(half) + ball_m + random.uniform(0.1, 1.2))
        row_count, bump_share = random.choice([5, 8, 16, 32, 64]), random.choice([0.0, 0.1])
        meshes.append(bumpy_sphere(f"ball {k}", centre, ball_m, row_count, bump_share=bump_share, smooth=bool(k % 2)))
    side = random.uniform(0, 2 * np.pi)
    camera = perspective_camera((7 * np.cos(side), 7 * np.sin(side), 2.0), (0.0, 0.0, 0.0), WIDTH, HEIGHT)
    return snapshot(meshes, [light], camera, WIDTH, HEIGHT)


@pytest.mark.parametrize("method", METHODS[:2])
@pytest.mark.parametrize("seed", [0, 2, 10, 14, 19, 30, 34, 36, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(100, 140))])
def test_nothing_leaks_from_a_random_box(device, method, seed):
    scene = balls_around_a_random_box(seed)
    for resolution_px in (16, 23, 33, 50):
        image = render_pass(scene, device, method=method, view_count=8, map_resolution_px=resolution_px)
        assert set(np.unique(image)) == {0.0, 1.0}, f"{image[image < 1].max():.4f} at most, in maps of {resolution_px} texels"


def box_of_planes(seed):
    """Six rectangles on a floor, whose lid lies on the walls' upper edges or crosses the walls below these, with balls around."""
    random = np.random.default_rng(seed)
    half, turn_rad, radius_m = random.uniform(0.3, 0.8, 3), random.uniform(0, np.pi / 2), random.uniform(0.02, 0.2)
    crosses = bool(seed % 2)
    sides = []
    for axis in range(3):
        u, v = (np.eye(3)[k] * half for k in ((axis + 1) % 3, (axis + 2) % 3))
        for sign in (-1, 1):
            middle, wider = sign * np.eye(3)[axis] * half, 1.0
            if axis == 2 and sign == 1 and crosses:
                middle, wider = 0.98 * middle, 1.1
            sides.append(rectangle(f"side {axis} {sign}", middle - wider * (u + v), 2 * wider * u, 2 * wider * v))
    turn = np.array([[np.cos(turn_rad), -np.sin(turn_rad), 0], [np.sin(turn_rad), np.cos(turn_rad), 0], [0, 0, 1]])
    meshes = [dataclasses.replace(side, positions_os=(side.positions_os @ turn.T).astype(np.float32)) for side in sides]
    meshes.append(floor(8.0, float(-half[2])))
    for k in range(3):
        angle, ball_m = random.uniform(0, 2 * np.pi), random.uniform(0.2, 0.6)
        away_m = np.linalg.norm(half) + ball_m + 0.1
        meshes.append(bumpy_sphere(f"ball {k}", (away_m * np.cos(angle), away_m * np.sin(angle), 0), ball_m, 32, smooth=bool(k % 2)))
    side = random.uniform(0, 2 * np.pi)
    camera = perspective_camera((7 * np.cos(side), 7 * np.sin(side), 2.0), (0, 0, 0), 160, 90)
    light = point_light(eye=random.uniform(-0.5, 0.5, 3) * half, radius_m=radius_m)
    return snapshot(meshes, [light], camera, 160, 90)


@pytest.mark.parametrize("seed", [1, 3, 5, 7, 10, 12, 15, 19])
def test_nothing_leaks_beside_the_joints_of_thin_walls(device, seed):
    """A texel's centre may lie before a wall's foot, and the receiver behind it."""
    image = render_pass(box_of_planes(seed), device, method=METHODS[0], view_count=8, map_resolution_px=512)
    leaks = (image > 0) & (image < 1)
    assert not leaks.any(), f"{leaks.sum()} pixels, {image[leaks].max():.3f} at most"


@pytest.mark.parametrize("method", METHODS_AND_HYBRID)
def test_nothing_leaks_below_a_hovering_box(device, method):
    """Its walls rise beside its floor, which hovers less than a texel above what it shadows."""
    random = np.random.default_rng(15)
    half, height_m = random.uniform(0.3, 0.7, 3), random.uniform(0.05, 0.3)
    centre = (0.0, 0.0, half[2] + height_m)
    meshes = [floor(6.0), box("around", centre, half, turn_rad=random.uniform(0, 1.5))]
    camera = perspective_camera((0.0, -4.0, 0.6), (0.0, 0.0, 0.2), WIDTH, HEIGHT, 0.3)
    scene = snapshot(meshes, [point_light(eye=centre, radius_m=0.15)], camera, WIDTH, HEIGHT)
    image = render_pass(scene, device, method=method, view_count=8, map_resolution_px=16)
    assert set(np.unique(image)) == {0.0, 1.0}


@pytest.mark.parametrize("method", METHODS[:2])
def test_nothing_leaks_at_the_borders_of_a_large_picture(device, method):
    """Some of its pixels decide how far maps reach: a wide floor under a wider roof, seen from between them, with the light above."""
    width, height = 320, 180
    x, y, z, eye = (-0.84368, -0.53685, 0), (0.48519, -0.7625, 0.42799), (-0.22976, 0.36109, 0.90378), (3.43036, -1.35783, 1.10228)
    matrix = np.eye(4)
    matrix[:3] = np.stack([x, y, z, eye], axis=1)
    half = np.tan(1.1426749 / 2)
    camera = Camera("Camera", False, matrix, (-half, half, -half * height / width, half * height / width), 0.1, 100.0)
    light = area_light(eye=(0.1481, -0.0853, 2.0413), target=(0.1481, -0.0853, 0.0), size_m=(0.5, 0.5))
    light.world_from_light[:3, 0], light.world_from_light[:3, 1] = (0.1697, -0.9855, 0), (0.9855, 0.1697, 0)
    scene = snapshot(
        [floor(30.0), dataclasses.replace(floor(40.0, 1.4), name="roof")], [light], camera, width, height, pixel_filter=PixelFilter()
    )
    image = render_pass(scene, device, method=method, view_count=64, map_resolution_px=512)
    assert set(np.unique(image)) <= {0.0, 1.0}, f"{((image > 0) & (image < 1)).sum()} pixels"


def box_beside_what_is_seen(seed):
    """Hills or balls, seen with a pixel filter; the box is not in the picture, but for what it casts."""
    random = np.random.default_rng(seed)
    width, height = 96, 54
    x = np.linspace(-20.0, 20.0, 120)
    hill = np.sin(1.3 * x + random.uniform(0, 6))
    heights = random.uniform(0.05, 0.25) * np.outer(hill, np.cos(0.9 * x)) if seed % 2 else np.zeros((120, 120))
    ground = np.stack([*np.meshgrid(x, x, indexing="ij"), heights], axis=-1).reshape(-1, 3)
    first = (np.arange(119)[:, None] * 120 + np.arange(119)).ravel()
    corners = np.concatenate([np.stack([first, first + 120, first + 121], axis=1), np.stack([first, first + 121, first + 1], axis=1)])
    meshes = [Mesh("ground", ground.astype(np.float32), corners.astype(np.int32))]
    for k in range(25 * (1 - seed % 2)):
        angle, away_m, radius_m = random.uniform(0, 6.3), random.uniform(2.5, 6.0), random.uniform(0.05, 0.8)
        at = (away_m * np.cos(angle), away_m * np.sin(angle), random.uniform(0.0, 4.0))
        meshes.append(bumpy_sphere(f"ball {k}", at, radius_m, int(random.choice([6, 16, 32]))))
    centre = np.array([0.0, 0.0, random.uniform(1.6, 2.5)])
    meshes.append(box("around", centre, random.uniform(0.35, 0.7, 3), turn_rad=random.uniform(0, 1.5)))
    light = [
        area_light(eye=centre, target=(0.3, 0.1, 0.0), size_m=(0.2, 0.15)),
        point_light(eye=centre, radius_m=0.1),
        spot_light(eye=centre, target=(0.5, 0.3, 0.0), radius_m=0.05, cone_rad=2.5),
    ][seed % 3]
    side, distance_m = random.uniform(0, 6.3), random.uniform(3.0, 9.0)
    eye = (distance_m * np.cos(side), distance_m * np.sin(side), random.uniform(2.5, 6.0))
    camera = perspective_camera(eye, (*random.normal(scale=2.5, size=2), 0.2), width, height)
    seen = [each.name != "around" for each in meshes]
    return snapshot(meshes, [light], camera, width, height, visible_to_camera=seen, pixel_filter=PixelFilter())


@pytest.mark.parametrize("seed", [15, 26, 27, 31, 42, 63, 69, 75, 84, 88, 96])
def test_nothing_leaks_where_only_later_eye_samples_look(device, seed, monkeypatch):
    """Views are fitted to what the first eye sample sees. Others see curved ground beyond the picture's edge and the rims of balls."""
    scene = box_beside_what_is_seen(seed)
    image = render_pass(scene, device, method=METHODS[0], view_count=16, map_resolution_px=256)
    monkeypatch.setattr("vir_addon.core.light_plan.sealing_object", lambda *_: "around")
    without_light = render_pass(scene, device, method=METHODS[0], view_count=16, map_resolution_px=256)
    leaks = image > without_light
    assert not leaks.any(), f"{leaks.sum()} pixels, {image[leaks].max():.3f} at most"
