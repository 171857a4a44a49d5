"""Reflections whose answer is known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.ray_tracing import intersect, world_triangles
from tests.scenes import (
    area_light,
    box,
    bumpy_sphere,
    floor,
    matte,
    mirror,
    perspective_camera,
    point_light,
    rectangle,
    render_passes,
    snapshot,
    sun_light,
)
from vir_addon.core.material import Constant, Layer, LayerKind, NormalMap, World
from vir_addon.core.pass_set import REFLECTION_COLOR_PASS_NAME, REFLECTION_PASS_NAME
from vir_addon.core.passes.reflection_maps import BYTES_PER_TEXEL, MAP_SIZE_STEP_PX, cube_from_box
from vir_addon.core.plan import plan as planned
from vir_addon.core.reflections.reflectors import MAX_GROUPS, MAX_REFLECTORS
from vir_addon.core.reflections.views import convexity
from vir_addon.core.scene import LightShape, Mesh
from vir_addon.core.settings import Effect, ReflectionLookUp, ReflectionMethod, Settings

WIDTH, HEIGHT = 160, 90
COLORS = np.array([(0.9, 0.1, 0.1), (0.1, 0.9, 0.1), (0.1, 0.1, 0.9), (0.9, 0.9, 0.1), (0.1, 0.9, 0.9), (0.9, 0.1, 0.9)])


def colored_box(half_m: float):
    """Six quads that face inwards and their emissions: -x, +x, -y, +y, -z, +z."""
    quads = []
    for axis in range(3):
        for side in (-1, 1):
            corner = np.full(3, -half_m)
            corner[axis] = side * half_m
            sides = [np.zeros(3), np.zeros(3)]
            sides[0][(axis + 1) % 3] = sides[1][(axis + 2) % 3] = 2 * half_m
            quads.append(rectangle(f"wall {axis} {side}", corner, *sides))
    return quads, [matte((0, 0, 0), color) for color in COLORS]


def camera_rays(camera, width, height):
    """Origins and unit directions through pixels' centres, (height, width, 3)."""
    left, right, bottom, top = camera.window
    x = left + (np.arange(width) + 0.5) * (right - left) / width
    y = bottom + (np.arange(height) + 0.5) * (top - bottom) / height
    p = np.stack(np.broadcast_arrays(x[None, :], y[:, None], -1.0), axis=-1)
    directions = p @ camera.world_from_view[:3, :3].T
    return camera.world_from_view[:3, 3], directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def box_colors(origins, directions, half_m):
    """Emission of the wall that a ray from inside meets, and how near to an edge it does so, metres."""
    with np.errstate(divide="ignore"):
        lengths = (np.sign(directions) * half_m - origins) / directions
    axis = np.argmin(lengths, axis=-1)
    length = np.take_along_axis(lengths, axis[..., None], -1)
    at = origins + length * directions
    others = np.sort(np.abs(at), axis=-1)[..., 1]
    positive = np.take_along_axis(directions, axis[..., None], -1)[..., 0] > 0
    return COLORS[2 * axis + positive], half_m - others


def mirrored_colors(camera, width, height, radius_m, half_m, centre=(0.0, 0.0, 0.0)):
    """What a mirror sphere shows of a coloured box, how near to one of the box's edges that is, and how far from the sphere's centre the
    eye's rays pass; metres. Without meaning where they pass beside it."""
    eye, directions = camera_rays(camera, width, height)
    along = directions @ (np.asarray(centre) - eye)
    distance = np.linalg.norm(eye + along[..., None] * directions - centre, axis=-1)
    at = eye + (along - np.sqrt(np.maximum(radius_m**2 - distance**2, 0)))[..., None] * directions
    normal = (at - centre) / radius_m
    return *box_colors(at, directions - 2 * (directions * normal).sum(axis=-1, keepdims=True) * normal, half_m), distance


def test_mirror_sphere_in_a_coloured_box(device):
    half_m, radius_m, centre = 3.0, 0.8, np.array([0.4, 0.3, -0.2])
    walls, materials = colored_box(half_m)
    sphere = bumpy_sphere("ball", centre, radius_m, 96, bump_share=0.0)
    camera = perspective_camera((-2.6, -1.0, 0.8), centre, WIDTH, HEIGHT, 0.6)
    scene = snapshot([*walls, sphere], [], camera, WIDTH, HEIGHT, materials=[*materials, mirror((0.9, 0.8, 0.7))], world=World())
    passes = render_passes(scene, device, reflection_sample_count=2, effects=(Effect.REFLECTION,))

    truth, to_edge, distance = mirrored_colors(camera, WIDTH, HEIGHT, radius_m, half_m, centre)
    judged = (distance < 0.97 * radius_m) & (to_edge > 0.1)
    assert judged.sum() > 1000
    np.testing.assert_allclose(passes[REFLECTION_COLOR_PASS_NAME][judged], np.broadcast_to((0.9, 0.8, 0.7), truth[judged].shape), rtol=1e-3)
    wrong = np.abs(passes[REFLECTION_PASS_NAME] - truth).max(axis=-1) > 0.01
    assert not (wrong & judged).any(), f"{(wrong & judged).sum()} of {judged.sum()}"
    assert not passes[REFLECTION_COLOR_PASS_NAME][distance > 1.03 * radius_m].any()


def test_lit_floor_in_a_mirror(device):
    """A wall that mirrors a matte floor under a point light with and without something in the light's way: albedo / pi times the light's
    irradiance, closed form."""
    light = point_light(eye=(0.5, 0.0, 2.0), radius_m=0.0, strength=10.0, strength_rgb=(12.0, 10.0, 4.0))
    camera = perspective_camera((0.0, -4.0, 1.5), (0.0, 0.0, 0.8), WIDTH, HEIGHT, 0.3)
    wall = rectangle("wall", (-2, 2, -0.5), (4, 0, 0), (0, 0, 4))
    shade = rectangle("shade", (-0.5, -0.5, 1.0), (1.0, 0, 0), (0, 1.0, 0))
    albedo = np.array([0.7, 0.5, 0.3])
    scene = snapshot(
        [floor(6.0), shade, wall],
        [light],
        camera,
        WIDTH,
        HEIGHT,
        materials=[matte(albedo), matte((0, 0, 0)), mirror()],
        world=World(),
    )
    image = render_passes(scene, device, reflection_sample_count=2, effects=(Effect.REFLECTION,), view_count=1)[REFLECTION_PASS_NAME]

    eye, directions = camera_rays(camera, WIDTH, HEIGHT)
    to_wall = (2 - eye[1]) / directions[..., 1]
    at = eye + to_wall[..., None] * directions
    reflected = directions * (1, -1, 1)
    with np.errstate(divide="ignore"):
        to_floor = -at[..., 2] / reflected[..., 2]
        to_shade = (1.0 - at[..., 2]) / reflected[..., 2]
    place = at + to_floor[..., None] * reflected
    in_shade = at + to_shade[..., None] * reflected
    before_wall = eye + (1.0 - eye[2]) / directions[..., 2:] * directions
    hides = (np.abs(in_shade[..., :2]) < 0.6).all(axis=-1) & (to_shade > 0)
    hides |= (np.abs(before_wall[..., :2]) < 0.6).all(axis=-1)
    judged = (
        (reflected[..., 2] < 0) & (np.abs(place[..., :2]) < 5.5).all(axis=-1) & (np.abs(at[..., 0]) < 1.9) & (at[..., 2] > 0.05) & ~hides
    )
    toward = place - (0.5, 0.0, 2.0)
    squared = (toward**2).sum(axis=-1)
    irradiance = 2.0 / squared**1.5
    # the shade as the light throws it onto the floor
    shadow = (np.abs(place[..., :2] - (-0.5, 0.0)) < 1.0).all(axis=-1)
    at_edge = (np.abs(np.abs(place[..., :2] - (-0.5, 0.0)).max(axis=-1) - 1.0) < 0.1) & judged
    truth = np.where(shadow, 0.0, irradiance)[..., None] * albedo / np.pi * (12.0, 10.0, 4.0)
    judged &= ~at_edge
    assert (judged & shadow).sum() > 300
    assert (judged & ~shadow).sum() > 1000
    np.testing.assert_allclose(image[judged], truth[judged], rtol=3e-3, atol=1e-4)  # normals of what is lit are packed to a thousandth


def bumpy_floor(half_m: float, mapped, material):
    """A floor and its material with a normal map that says the same everywhere, a unit vector in the world's axes."""
    mesh = floor(half_m)
    uv = Layer(LayerKind.UV, "UVMap")
    normal_map = NormalMap(Constant(tuple(0.5 + 0.5 * np.asarray(mapped))), Constant((1.0, 1.0, 1.0)), uv)
    uvs = (mesh.positions_os[:, :2] / (2 * half_m) + 0.5)[mesh.triangles].astype(np.float32)
    return dataclasses.replace(mesh, layers={uv: uvs}), dataclasses.replace(material, normal_map=normal_map)


@pytest.mark.parametrize("look_up", ["march", "shaded"])
def test_mirrors_show_normal_maps_by_the_light_of_lamps(device, look_up):
    """A sun lights what a mirror shows under the cosine to the mapped normal, in every round anew."""
    mapped = np.array([0.48, -0.36, 0.8])
    toward = np.array([-0.2, -0.6, 0.9])
    sun = sun_light(eye=tuple(toward), angle_rad=0.0, strength_rgb=(2.0, 2.0, 2.0))
    camera = perspective_camera((0.0, -4.0, 1.5), (0.0, 0.0, 0.8), WIDTH, HEIGHT, 0.3)
    mesh, material = bumpy_floor(30.0, mapped, matte((0.8, 0.8, 0.8)))
    wall = rectangle("wall", (-2, 2, 0.5), (4, 0, 0), (0, 0, 4))
    scene = snapshot([mesh, wall], [sun], camera, WIDTH, HEIGHT, materials=[material, mirror()], world=World())
    settings = {"effects": (Effect.REFLECTION,), "bounces": 1, "view_count": 2, "reflection_look_up": ReflectionLookUp(look_up)}
    passes = render_passes(scene, device, reflection_sample_count=2, reflection_method=ReflectionMethod.MVR, **settings)
    shown = passes[REFLECTION_PASS_NAME][(passes[REFLECTION_COLOR_PASS_NAME] > 0.99).all(axis=-1)]
    expected = 2.0 * 0.8 / np.pi * (mapped @ toward) / np.linalg.norm(toward)
    lit = shown[shown[:, 0] > 0.0]
    assert len(lit) > 500
    np.testing.assert_allclose(np.median(lit, axis=0), expected, rtol=5e-3)


@pytest.mark.parametrize("planar", [True, False])
def test_bumpy_mirrors_show_what_stands_alone_once(device, planar):
    """Rays that pass a leaning sheet go out, though in their direction from maps' centres it stands."""
    mapped = np.array([-0.2, 0.0, np.sqrt(0.96)])
    camera = perspective_camera((0.0, -3.0, 3.2), (0.0, 0.2, 0.0), WIDTH, HEIGHT, 0.45)
    mesh, material = bumpy_floor(3.0, mapped, mirror())
    lean, turn = np.radians(80), 0.2
    side = np.array([np.cos(turn), np.sin(turn), 0.0])
    up = np.array([-np.sin(turn) * np.cos(lean), np.cos(turn) * np.cos(lean), np.sin(lean)])
    normal, middle = np.cross(side, up), np.array([0.0, 2.0, 2.0])
    transforms = np.tile(np.eye(4), (2, 1, 1))
    transforms[1, :3] = np.column_stack([side, up, normal, middle])
    materials = [material, matte((0, 0, 0), (1, 0, 0))]
    scene = snapshot(
        [mesh, floor(1.5)], [], camera, WIDTH, HEIGHT, transforms=transforms, materials=materials, world=World((0.0, 1.0, 0.0))
    )
    passes = render_passes(scene, device, effects=(Effect.REFLECTION,), bounces=1, reflection_sample_count=1, planar=planar)
    eye, directions = camera_rays(camera, WIDTH, HEIGHT)
    at = eye - (eye[2] / directions[..., 2])[..., None] * directions
    leaving = directions - 2 * (directions @ mapped)[..., None] * mapped
    along = ((middle - at) @ normal) / (leaving @ normal)
    place = at + along[..., None] * leaving - middle
    within_m = 1.5 - np.abs(np.stack([place @ side, place @ up], axis=-1)).max(axis=-1)
    judged = (np.abs(within_m) > 0.1) & (passes[REFLECTION_COLOR_PASS_NAME] > 0.99).all(axis=-1) & (leaving[..., 2] > 0.05)
    shows_sheet = (within_m > 0) & (along > 0)
    assert (judged & shows_sheet).sum() > 1000
    assert (judged & ~shows_sheet).sum() > 1000
    wrong = (passes[REFLECTION_PASS_NAME][..., 0] > 0.5) != shows_sheet
    assert wrong[judged].mean() < 0.005


def test_boxes_are_turned_as_few_things_lie():
    """Everything is in them; a leaning sheet's is flat, that of many things lies along the world's axes."""
    side, up = np.array([2.9, 0.6, 0.0]), np.array([-0.1, 0.5, 2.9])
    sheet = np.array([(1.0, 2.0, 3.0) + i * side + j * up for i in (0, 1) for j in (0, 1) for _ in (0, 1)])[None]
    matrix = cube_from_box(sheet)
    placed = sheet[0] @ matrix[:, :3].T + matrix[:, 3]
    assert np.abs(placed).max() < 1 + 1e-6
    across = matrix[:, :3] @ np.cross(side, up) / np.linalg.norm(np.cross(side, up))
    assert np.abs(across).max() > 1000.0
    many = np.random.default_rng(5).normal(size=(40, 8, 3)) + 7.0
    matrix = cube_from_box(many)
    np.testing.assert_allclose(np.count_nonzero(matrix[:, :3]), 3)
    placed = many.reshape(-1, 3) @ matrix[:, :3].T + matrix[:, 3]
    np.testing.assert_allclose([placed.min(axis=0), placed.max(axis=0)], [[-1.0] * 3, [1.0] * 3], atol=1e-9)
    assert np.isfinite(cube_from_box(np.zeros((1, 8, 3)))).all()


def ball_shown_by_a_wall(camera, wall_y_m: float):
    """Where rays from a unit ball around the origin go that the eye sees in a mirroring wall: their starts and directions, and which
    pixels show that, clear of rims and of the ball itself."""
    eye, directions = camera_rays(camera, WIDTH, HEIGHT)
    mirrored = directions * (1, -1, 1)
    at = eye + ((wall_y_m - eye[1]) / directions[..., 1])[..., None] * directions
    chords = []
    for origins, rays in ((np.broadcast_to(eye, directions.shape), directions), (at, mirrored)):
        along = (origins * rays).sum(axis=-1)
        chords.append((along, along**2 - (origins**2).sum(axis=-1) + 1))
    place = at - (chords[1][0] + np.sqrt(np.maximum(chords[1][1], 0.0)))[..., None] * mirrored
    leaving = mirrored - 2 * (mirrored * place).sum(axis=-1, keepdims=True) * place
    return place, leaving, (chords[1][1] > 0.1) & (chords[0][1] < -0.1) & (directions[..., 1] > 0)


@pytest.mark.parametrize("is_reflector", [True, False])
@pytest.mark.parametrize("row_count", [12, 48])
def test_a_ball_in_a_mirror_shows_the_world_but_not_behind_the_mirror(device, row_count, is_reflector):
    """The last ray's, as in Cycles: with one bounce the wall in the ball is black. Facets hide nothing from each other. A ball without maps
    knows what the wall's maps do, which leave the wall out."""
    camera = perspective_camera((3.0, -3.5, 0.5), (-0.9, 2.0, 0.3), WIDTH, HEIGHT, 0.3)
    meshes = [rectangle("wall", (-6, 2, -6), (12, 0, 0), (0, 0, 12)), bumpy_sphere("ball", (0, 0, 0), 1.0, row_count, bump_share=0.0)]
    scene = snapshot(meshes, [], camera, WIDTH, HEIGHT, materials=[mirror(), mirror()], world=World((1.0, 1.0, 1.0)))
    marks = np.array([-1, -1 if is_reflector else 0], np.int8)
    scene = dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, reflector_mark=marks))
    image = render_passes(scene, device, reflection_sample_count=1, effects=(Effect.REFLECTION,), bounces=1)[REFLECTION_PASS_NAME]
    place, leaving, judged = ball_shown_by_a_wall(camera, 2.0)
    away = judged & (leaving[..., 1] < -0.02)
    assert away.sum() > 500
    assert (image[away] < 0.5).any(axis=-1).mean() < 0.02
    with np.errstate(divide="ignore"):
        met = place + ((2.0 - place[..., 1]) / leaving[..., 1])[..., None] * leaving
    toward = judged & (leaving[..., 1] > 0.02) & (np.abs(met[..., [0, 2]]) < 5.8).all(axis=-1)
    assert toward.sum() > 1000
    if is_reflector:
        assert (image[toward] > 0.5).any(axis=-1).mean() < 0.02


def checkerboard(half_m: float, count: int):
    """Two meshes in the plane z = 0, of the light and of the dark squares."""
    step = 2 * half_m / count
    meshes = []
    for parity, name in enumerate(("light", "dark")):
        corners = [(-half_m + i * step, -half_m + j * step) for i in range(count) for j in range(count) if (i + j) % 2 == parity]
        quads = [rectangle(name, (x, y, 0), (step, 0, 0), (0, step, 0)) for x, y in corners]
        positions = np.concatenate([quad.positions_os for quad in quads])
        triangles = np.concatenate([quad.triangles + 4 * k for k, quad in enumerate(quads)])
        meshes.append(Mesh(name, positions, triangles.astype(np.int32)))
    return meshes, [matte((0, 0, 0), (0.9, 0.9, 0.9)), matte((0, 0, 0), (0.1, 0.2, 0.3))]


def test_flat_mirror_shows_what_a_mirrored_camera_sees(device):
    """Beyond the mirror the same scene lies mirrored: a picture of it without the mirror must be what the mirror shows."""
    boards, materials = checkerboard(4.0, 16)
    ball = bumpy_sphere("ball", (0.5, 0.5, 0.6), 0.5, 32)
    glass = rectangle("mirror", (-1.5, 1.5, 0.2), (3, 0, 0), (0, -0.3, 2))
    camera = perspective_camera((0.6, -3.0, 1.6), (0.0, 1.5, 1.0), WIDTH, HEIGHT, 0.4)
    all_materials = [*materials, matte((0, 0, 0), (0.8, 0.1, 0.1)), mirror()]
    scene = snapshot([*boards, ball, glass], [], camera, WIDTH, HEIGHT, materials=all_materials, world=World((0.2, 0.3, 0.4)))
    plan = planned(scene, Settings(effects=(Effect.REFLECTION,)))
    assert [reflector.method_text for reflector in plan.reflections.reflectors] == ["planar"]
    shown = render_passes(scene, device, reflection_sample_count=2, effects=(Effect.REFLECTION,))
    mask = (shown[REFLECTION_COLOR_PASS_NAME] > 0.99).all(axis=-1)
    assert mask.sum() > 3000

    # by brute force: mirrored rays of every third pixel against all triangles but the mirror's
    mask &= np.arange(mask.size).reshape(mask.shape) % 3 == 0
    eye, directions = camera_rays(camera, WIDTH, HEIGHT)
    normal = np.cross((3, 0, 0), (0, -0.3, 2))
    normal = normal / np.linalg.norm(normal)
    to_mirror = ((np.array((-1.5, 1.5, 0.2)) - eye) @ normal) / (directions @ normal)
    at = eye + to_mirror[..., None] * directions
    reflected = directions - 2 * (directions @ normal)[..., None] * normal
    seen = nearest_instance(scene, at[mask], reflected[mask], leave_out=3)
    truth = np.array([(0.9, 0.9, 0.9), (0.1, 0.2, 0.3), (0.8, 0.1, 0.1), (0.2, 0.3, 0.4)])[seen]
    error = np.abs(shown[REFLECTION_PASS_NAME][mask] - truth).max(axis=-1)
    assert len(set(seen.tolist())) == 4
    assert (error > 1 / 255).mean() < 0.002, (error > 1 / 255).sum()


def test_a_tray_shows_what_stands_on_it_where_it_is(device):
    """Flat but for its rim, with a block around which no place sees all of the room: against rays in float64."""
    walls, materials = colored_box(3.0)
    block = box("block", (-0.1, 0.3, 0.601), (0.35, 0.3, 0.6))
    inner, outer = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]), 1.1 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    positions = np.concatenate([np.column_stack([inner, np.zeros(4)]), np.column_stack([outer, np.full(4, 0.1)])]).astype(np.float32)
    sides = [triangle for k in range(4) for triangle in ((k, k + 4, (k + 1) % 4), ((k + 1) % 4, k + 4, (k + 1) % 4 + 4))]
    tray = Mesh("tray", positions, np.array([(0, 1, 2), (0, 2, 3), *sides], np.int32))
    camera = perspective_camera((0.4, -2.6, 1.6), (0.0, 0.0, 0.2), WIDTH, HEIGHT, 0.5)
    scene = snapshot(
        [*walls, block, tray], [], camera, WIDTH, HEIGHT, materials=[*materials, matte((0, 0, 0), (0.4, 0.5, 0.6)), mirror()], world=World()
    )
    (plan,) = reflectors_of(scene).reflectors
    assert [each.is_cube for each in plan.maps] == [False, True, False, True, True]
    assert "mostly flat: a mirrored view besides" in plan.reason
    (as_published,) = reflectors_of(scene, planar=False).reflectors
    assert [each.is_cube for each in as_published.maps] == [True, False, True, True]

    image = render_passes(scene, device, reflection_sample_count=2, effects=(Effect.REFLECTION,), bounces=1)[REFLECTION_PASS_NAME]
    eye, directions = camera_rays(camera, WIDTH, HEIGHT)
    at = eye - eye[2] / directions[..., 2:] * directions
    mask = (np.abs(at[..., :2]) < 0.97).all(axis=-1) & (directions[..., 2] < 0)
    mask[mask] = nearest_instance(scene, np.broadcast_to(eye, (mask.sum(), 3)), directions[mask], leave_out=None) == 7
    seen = nearest_instance(scene, at[mask], directions[mask] * (1, 1, -1), leave_out=7)
    truth = np.concatenate([COLORS, [(0.4, 0.5, 0.6)]])[seen]
    wrong = np.abs(image[mask] - truth).max(axis=-1) > 0.01
    assert (seen == 6).sum() > 200
    assert len(seen) > 1500
    assert wrong.mean() < 0.03, wrong.sum()


def nearest_instance(scene, origins, directions, leave_out):
    """(n,) instance that each ray meets first, -1 for none, in float64."""
    triangles = world_triangles(scene)
    kept = np.full(len(triangles.instance), True) if leave_out is None else triangles.instance != leave_out
    owner = np.append(triangles.instance[kept], -1)
    found = []
    for first in range(0, len(origins), 512):
        rays = slice(first, first + 512)
        along, _ = intersect(origins[rays], directions[rays], triangles.corners[kept])
        along[along <= 1e-6] = np.inf
        found.append(owner[np.argmin(np.pad(along, ((0, 0), (0, 1)), constant_values=1e30), axis=1)])
    return np.concatenate(found)


@pytest.mark.parametrize("bounces", [1, 2, pytest.param(3, marks=pytest.mark.slow)])
def test_parallel_mirrors_show_as_many_images_as_bounces(device, bounces):
    """Between two mirrors a small lamp has an image behind each for every bounce."""
    front = rectangle("front", (-3, 2, -3), (6, 0, 0), (0, 0, 6))
    back = rectangle("back", (-3, -2, -3), (0, 0, 6), (6, 0, 0))
    lamp = rectangle("lamp", (0.6, 0, 0.3), (0.2, 0, 0), (0, 0, 0.2))
    camera = perspective_camera((0.0, -1.0, 0.0), (0.0, 2.0, 0.0), WIDTH, HEIGHT, 0.5)
    scene = snapshot(
        [front, back, lamp], [], camera, WIDTH, HEIGHT, materials=[mirror(), mirror(), matte((0, 0, 0), (1, 1, 1))], world=World()
    )
    image = render_passes(scene, device, reflection_sample_count=2, effects=(Effect.REFLECTION,), bounces=bounces)[REFLECTION_PASS_NAME][
        ..., 0
    ]
    # images of the lamp at y = 0 in the mirrors at y = 2 and y = -2, those that the eye at y = -1 finds by looking at the front one
    shown = 0
    for y in (4.0, 8.0, 12.0):
        distance = y + 1.0
        column = round(WIDTH / 2 + 0.7 / distance / 0.5 * WIDTH / 2)
        row = round(HEIGHT / 2 + 0.4 / distance / 0.5 * WIDTH / 2)
        shown += image[row, column] > 0.99
    assert shown == bounces


@pytest.mark.parametrize("shape", [LightShape.RECTANGLE, LightShape.ELLIPSE, LightShape.POINT])
def test_a_mirror_in_a_mirror_shows_the_lamp(device, shape):
    """Nine metres behind the first mirror, as bright as it is and no larger; the first mirror itself does not show it."""
    front = rectangle("front", (-3, 2, -3), (6, 0, 0), (0, 0, 6))
    back = rectangle("back", (-3, -2, -3), (0, 0, 6), (6, 0, 0))
    size_m, place = (0.6, 0.6 if shape is LightShape.POINT else 0.4), (0.45, 0.0, 0.1)
    area = {LightShape.RECTANGLE: 1.0, LightShape.ELLIPSE: np.pi / 4, LightShape.POINT: np.pi / 4}[shape] * size_m[0] * size_m[1]
    if shape is LightShape.POINT:
        lamp = point_light(eye=place, radius_m=size_m[0] / 2, strength=5.0 * area)
    else:
        lamp = area_light(eye=place, target=(0.45, -5.0, 0.1), size_m=size_m, shape=shape, strength=5.0 * area)
    camera = perspective_camera((0.0, -1.0, 0.0), (0.0, 2.0, 0.0), WIDTH, HEIGHT, 0.1)
    scene = snapshot([front, back], [lamp], camera, WIDTH, HEIGHT, materials=[mirror(), mirror()], world=World())
    settings = {"effects": (Effect.REFLECTION,), "bounces": 1, "reflection_sample_count": 4, "view_count": 4 if shape.is_area else 64}
    image = render_passes(scene, device, **settings)[REFLECTION_PASS_NAME][..., 0]

    _, directions = camera_rays(camera, WIDTH, HEIGHT)
    seen = 9.0 * directions / np.abs(directions[..., 1:2])
    x, z = (seen[..., 0] - place[0]) / size_m[0], (seen[..., 2] - place[2]) / size_m[1]
    away = np.maximum(np.abs(x), np.abs(z)) if shape is LightShape.RECTANGLE else np.hypot(x, z)
    assert (away < 0.47).sum() > 200 and (away > 0.53).sum() > 200
    np.testing.assert_allclose(image[away < 0.47], 5.0, rtol=0.02 if shape.is_area else 0.05)
    assert not image[away > 0.53].any()


@pytest.mark.parametrize("angle", [10.0, 90.0])
def test_mirrors_show_suns_as_wide_as_they_are(device, angle):
    """Through two mirrors; their radiance is the irradiance that they bring over their solid angle."""
    front = rectangle("front", (-30, 2, -30), (60, 0, 0), (0, 0, 60))
    back = rectangle("back", (-30, -2, -30), (0, 0, 60), (60, 0, 0))
    sun = sun_light(eye=(0, 5, 0), target=(0, 0, 0), angle_rad=np.radians(angle), strength=3.0, casts_shadow=False)
    half = np.radians(angle / 2)
    camera = perspective_camera((0.0, -1.0, 0.0), (0.0, 2.0, 0.0), WIDTH, HEIGHT, 2 * np.tan(half))
    scene = snapshot([front, back], [sun], camera, WIDTH, HEIGHT, materials=[mirror(), mirror()], world=World())
    settings = {"effects": (Effect.REFLECTION,), "bounces": 1, "reflection_sample_count": 4, "view_count": 64}
    image = render_passes(scene, device, **settings)[REFLECTION_PASS_NAME][..., 0]
    _, directions = camera_rays(camera, WIDTH, HEIGHT)
    away = np.arccos(directions[..., 1] / np.linalg.norm(directions, axis=-1)) / half
    assert (away < 0.94).sum() > 200 and (away > 1.06).sum() > 200
    np.testing.assert_allclose(image[away < 0.94], 3.0 / (2 * np.pi * (1 - np.cos(half))), rtol=0.01)
    assert not image[away > 1.06].any()


@pytest.mark.parametrize("view_count", [64, pytest.param(256, marks=pytest.mark.slow)])
def test_nearly_mirrors_show_lamps_as_wide_as_their_lobes(device, view_count):
    """However near to each other the lamp's points are. In its middle: the share of a GGX lobe whose facets' slopes reflect into it."""
    front = rectangle("front", (-3, 2, -3), (6, 0, 0), (0, 0, 6))
    back = rectangle("back", (-3, -2, -3), (0, 0, 6), (6, 0, 0))
    radius_m, roughness = 0.06, 0.08
    lamp = area_light(
        eye=(0.45, 0.0, 0.1),
        target=(0.45, -5.0, 0.1),
        size_m=(2 * radius_m, 2 * radius_m),
        shape=LightShape.ELLIPSE,
        strength=5.0 * np.pi * radius_m**2,
    )
    camera = perspective_camera((0.0, -1.0, 0.0), (0.45 * 3 / 9, 2.0, 0.1 * 3 / 9), WIDTH, HEIGHT, 0.03)
    materials = [mirror(), mirror(roughness=roughness)]
    scene = snapshot([front, back], [lamp], camera, WIDTH, HEIGHT, materials=materials, world=World())
    settings = {"effects": (Effect.REFLECTION,), "bounces": 1, "reflection_sample_count": 8, "view_count": view_count}
    image = render_passes(scene, device, **settings)[REFLECTION_PASS_NAME][..., 0]
    _, directions = camera_rays(camera, WIDTH, HEIGHT)
    seen = 9.0 * directions / np.abs(directions[..., 1:2])
    middle = np.hypot(seen[..., 0] - 0.45, seen[..., 2] - 0.1) < 0.15 * radius_m
    slope = radius_m / 2.0 / 2
    assert image[middle].mean() == pytest.approx(5.0 * slope**2 / (slope**2 + roughness**4), rel=0.06)


def test_a_mirror_within_a_lamp_shows_it_all_around(device):
    """A ball of light around two mirrors: whichever way they look, irradiance over pi."""
    front = rectangle("front", (-3, 2, -3), (6, 0, 0), (0, 0, 6))
    back = rectangle("back", (-3, -2, -3), (0, 0, 6), (6, 0, 0))
    radius_m, radiance = 12.0, 5.0
    lamp = point_light(eye=(0.0, -4.0, 0.0), radius_m=radius_m, strength=radiance * np.pi * radius_m**2, casts_shadow=False)
    camera = perspective_camera((0.0, -1.0, 0.0), (0.0, 2.0, 0.0), WIDTH, HEIGHT, 0.1)
    scene = snapshot([front, back], [lamp], camera, WIDTH, HEIGHT, materials=[mirror(), mirror()], world=World())
    settings = {"effects": (Effect.REFLECTION,), "bounces": 1, "reflection_sample_count": 4, "view_count": 32}
    image = render_passes(scene, device, **settings)[REFLECTION_PASS_NAME]
    np.testing.assert_allclose(image, radiance, rtol=0.1)


def test_a_reflector_that_is_not_convex_shows_itself(device):
    """Floor and wall of one mirror: what its own other part keeps from the world is that part, which shows the world: two reflections, also
    where rays are followed once."""
    positions = np.array([(-1, 0, 0), (1, 0, 0), (1, 2, 0), (-1, 2, 0), (1, 2, 2), (-1, 2, 2)], np.float32)
    corner = Mesh("corner", positions, np.array([(0, 1, 2), (0, 2, 3), (3, 2, 4), (3, 4, 5)], np.int32))
    camera = perspective_camera((0.3, -3.0, 2.5), (0.0, 1.2, 0.6), WIDTH, HEIGHT, 0.45)
    scene = snapshot([corner], [], camera, WIDTH, HEIGHT, materials=[mirror((0.8, 0.8, 0.8))], world=World((0.5, 0.5, 0.5)))
    once, twice = (
        render_passes(scene, device, reflection_sample_count=2, effects=(Effect.REFLECTION,), bounces=bounces)[REFLECTION_PASS_NAME][..., 0]
        for bounces in (1, 2)
    )

    eye, directions = camera_rays(camera, WIDTH, HEIGHT)
    to_wall, to_floor = (2 - eye[1]) / directions[..., 1], -eye[2] / directions[..., 2]
    wall, ground = (eye + to[..., None] * directions for to in (to_wall, to_floor))
    on_wall = (np.abs(wall[..., 0]) < 0.98) & (wall[..., 2] > 0.02) & (wall[..., 2] < 1.98)
    on_floor = (np.abs(ground[..., 0]) < 0.98) & (ground[..., 1] > 0.02) & (ground[..., 1] < 1.98) & (to_floor > 0)
    from_wall, from_floor = directions * (1, -1, 1), directions * (1, 1, -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        met_floor = wall - (wall[..., 2] / from_wall[..., 2])[..., None] * from_wall
        met_wall = ground + ((2 - ground[..., 1]) / from_floor[..., 1])[..., None] * from_floor

    def within(x, y, most):
        return np.minimum(1 - np.abs(x), 1 - np.abs(y - most / 2) / (most / 2))

    inner = np.where(on_wall, within(met_floor[..., 0], met_floor[..., 1], 2), within(met_wall[..., 0], met_wall[..., 2], 2))
    inner = np.where(on_wall & (from_wall[..., 2] >= 0), -1.0, inner)
    shown = (on_wall | on_floor) & (np.abs(inner) > 0.06)
    assert (shown & (inner > 0)).sum() > 500
    assert (shown & (inner < 0)).sum() > 500
    # the first reflection is in the reflection's colour
    for image in (once, twice):
        np.testing.assert_allclose(image[shown], np.where(inner > 0, 0.4, 0.5)[shown], atol=1e-3)


def traced(scene, origins, directions, mirrors, bounces):
    """(n,) instance that rays end at after reflections in flat mirrors, -1 for none, and (n,) the mirrors on their way as numbers in base
    100; in float64. Those that meet one mirror too many end there."""
    triangles = world_triangles(scene)
    normals = np.cross(triangles.corners[:, 1] - triangles.corners[:, 0], triangles.corners[:, 2] - triangles.corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    origins, directions = np.array(origins, np.float64), np.array(directions, np.float64)
    ends, ways = np.full(len(origins), -1), np.zeros(len(origins), np.int64)
    left = np.arange(len(origins))
    for bounce in range(bounces + 1):
        along, _ = intersect(origins[left], directions[left], triangles.corners)
        along[along <= 1e-6] = np.inf
        met, length = along.argmin(axis=1), along.min(axis=1)
        ends[left] = np.where(np.isfinite(length), triangles.instance[met], -1)
        goes_on = np.isin(ends[left], mirrors) & (bounce < bounces)
        left, normal, length = left[goes_on], normals[met[goes_on]], length[goes_on]
        ways[left] = 100 * ways[left] + ends[left] + 1
        origins[left] += length[:, None] * directions[left]
        directions[left] -= 2 * (directions[left] * normal).sum(axis=1, keepdims=True) * normal
    return ends, ways


def test_a_reflector_shows_parts_of_itself_that_the_eye_does_not_see(device):
    """A plate and a roof that leans over its rear half, of one mirror, from above: the roof's underside shows in the plate."""
    walls, materials = colored_box(6.0)
    plate = [(-1, -1, 0), (1, -1, 0), (1, 2, 0), (-1, 2, 0)]
    roof = [(-0.6, 0.5, 0.8), (0.6, 0.5, 0.8), (0.6, 1.7, 0.2), (-0.6, 1.7, 0.2), (0, 0.5, 1.2), (0, 1.7, 0.6)]
    triangles = [(0, 1, 2), (0, 2, 3), (4, 6, 5), (4, 7, 6), (4, 5, 8), (6, 7, 9), (5, 6, 9), (5, 9, 8), (7, 4, 8), (7, 8, 9)]
    mesh = Mesh("plate and roof", np.array(plate + roof, np.float32), np.array(triangles, np.int32))
    camera = perspective_camera((0.2, -2.2, 2.6), (0.0, 0.3, 0.2), WIDTH, HEIGHT, 0.45)
    scene = snapshot([*walls, mesh], [], camera, WIDTH, HEIGHT, materials=[*materials, mirror()], world=World())
    image = render_passes(scene, device, reflection_sample_count=2, effects=(Effect.REFLECTION,), bounces=3)[REFLECTION_PASS_NAME]

    eye, directions = camera_rays(camera, WIDTH, HEIGHT)
    ends, ways = traced(scene, np.broadcast_to(eye, (WIDTH * HEIGHT, 3)), directions.reshape(-1, 3), [6], 3)
    # where the roof's underside, z = 1.05 - y / 2, is mirrored in the plate
    image_of_roof = eye + ((1.05 - eye[1] / 2 + eye[2]) / (directions[..., 1] / 2 - directions[..., 2]))[..., None] * directions
    shows_roof = (np.abs(image_of_roof[..., 0]) < 0.58) & (np.abs(image_of_roof[..., 1] - 1.1) < 0.58)
    # in the plate, in the roof and perhaps in the plate again
    judged = shows_roof.ravel() & np.isin(ways, (707, 70707)) & (ends >= 0) & (ends < 6)
    wrong = np.abs(image.reshape(-1, 3)[judged] - COLORS[ends[judged]]).max(axis=-1) > 0.01
    assert judged.sum() > 500
    assert wrong.mean() < 0.1, f"{wrong.sum()} of {judged.sum()}"


@pytest.mark.parametrize("is_open", [False, True])
def test_maps_of_other_reflectors_know_what_is_hidden_from_ones_own(device, is_open):
    """A flat mirror with a block on it, looked up in a cube alone, which sees little of what is behind the block, if that is walls, or the
    world above them; two small mirrors are elsewhere."""
    walls, materials = colored_box(3.0)
    if is_open:
        walls, materials = walls[:5], materials[:5]
    others = [rectangle(f"small {k}", (x, 1.6, 0.5), (0.4, 0, 0), (0, 0, 0.4)) for k, x in enumerate((-1.8, 1.4))]
    meshes = [*walls, box("block", (0.0, 0.35, 0.301), (0.3, 0.3, 0.3)), rectangle("plate", (-1, -1, 0), (2, 0, 0), (0, 2, 0)), *others]
    look = [*materials, matte((0, 0, 0), (0.4, 0.5, 0.6)), *[mirror()] * 3]
    camera = perspective_camera((0.4, -2.6, 1.6), (0.0, 0.0, 0.1), WIDTH, HEIGHT, 0.5)
    world_rgb = (0.3, 0.2, 0.1)
    scene = snapshot(meshes, [], camera, WIDTH, HEIGHT, materials=look, world=World(world_rgb))
    settings = {"reflection_sample_count": 2, "effects": (Effect.REFLECTION,), "bounces": 1, "planar": False}
    image = render_passes(scene, device, **settings)[REFLECTION_PASS_NAME]

    eye, directions = camera_rays(camera, WIDTH, HEIGHT)
    plate = len(walls) + 1
    ends, ways = traced(scene, np.broadcast_to(eye, (WIDTH * HEIGHT, 3)), directions.reshape(-1, 3), [plate, plate + 1, plate + 2], 1)
    judged = (ways == plate + 1) & (ends < plate)
    colors = np.array([*COLORS[: len(walls)], (0.4, 0.5, 0.6), *[(0, 0, 0)] * 3, world_rgb])
    wrong = np.abs(image.reshape(-1, 3)[judged] - colors[ends[judged]]).max(axis=-1) > 0.01
    assert judged.sum() > 2500
    assert {-1, plate - 1} <= set(ends[judged].tolist()) or not is_open
    assert wrong.mean() < 0.02, f"{wrong.sum()} of {judged.sum()}"


def test_a_reflector_shows_itself_within_another(device):
    """Floor and wall of one mirror in a flat one beside them."""
    walls, materials = colored_box(6.0)
    positions = np.array([(-1, 0, 0), (1, 0, 0), (1, 2, 0), (-1, 2, 0), (1, 2, 2), (-1, 2, 2)], np.float32)
    corner = Mesh("corner", positions, np.array([(0, 1, 2), (0, 2, 3), (3, 2, 4), (3, 4, 5)], np.int32))
    meshes = [*walls, corner, rectangle("flat", (1.5, -1.0, -0.5), (0, 4, 0), (0, 0, 3))]
    camera = perspective_camera((-1.6, -3.0, 2.5), (0.9, 1.0, 0.9), WIDTH, HEIGHT, 0.6)
    scene = snapshot(meshes, [], camera, WIDTH, HEIGHT, materials=[*materials, *[mirror()] * 2], world=World())
    image = render_passes(scene, device, reflection_sample_count=2, effects=(Effect.REFLECTION,), bounces=3)[REFLECTION_PASS_NAME]

    eye, directions = camera_rays(camera, WIDTH, HEIGHT)
    ends, ways = traced(scene, np.broadcast_to(eye, (WIDTH * HEIGHT, 3)), directions.reshape(-1, 3), [6, 7], 3)
    # in the flat one, in the corner and in the corner again
    judged = (ways == 80707) & (ends >= 0) & (ends < 6)
    wrong = np.abs(image.reshape(-1, 3)[judged] - COLORS[ends[judged]]).max(axis=-1) > 0.01
    assert judged.sum() > 200
    assert wrong.mean() < 0.1, f"{wrong.sum()} of {judged.sum()}"


def reflectors_of(scene, **settings):
    return planned(scene, Settings(effects=(Effect.REFLECTION,), **settings)).reflections


def test_what_cannot_reflect_gets_a_line_that_says_why():
    walls, materials = colored_box(3.0)
    point = Mesh("point", np.zeros((3, 3), np.float32), np.array([(0, 1, 2)], np.int32))
    ball = bumpy_sphere("behind the eye", (-8.0, 0, 0), 0.5, 8)
    camera = perspective_camera((-2.6, 0, 0), (0, 0, 0), WIDTH, HEIGHT)
    scene = snapshot([*walls, point, ball], [], camera, WIDTH, HEIGHT, materials=[*materials, mirror(), mirror()], world=World())
    found = {each.name: each for each in reflectors_of(scene, bounces=1).reflectors}
    assert not any(each.runs for each in found.values())
    assert found["point"].reason == "skipped: it has no size"
    assert found["behind the eye"].reason == "skipped: not in the picture"
    seen_twice = {each.name: each for each in reflectors_of(scene, bounces=2).reflectors}
    assert "within other reflectors" in seen_twice["behind the eye"].reason


def test_matte_scenes_draw_no_maps(device):
    walls, materials = colored_box(3.0)
    scene = snapshot(walls, [], perspective_camera((-2.6, 0, 0), (0, 0, 0), 32, 16), 32, 16, materials=materials, world=World())
    assert not reflectors_of(scene).runs
    passes = render_passes(scene, device, reflection_sample_count=2, effects=(Effect.REFLECTION,))
    assert set(passes) == {REFLECTION_PASS_NAME, REFLECTION_COLOR_PASS_NAME}
    assert not any(image.any() for image in passes.values())


def test_five_hundred_reflectors_keep_to_the_memory_they_are_given():
    balls = [bumpy_sphere(f"ball {k}", (k % 25 - 12, k // 25, 0.0), 0.4, 6) for k in range(500)]
    camera = perspective_camera((0, -8, 6), (0, 8, 0), 960, 540, 0.8)
    scene = snapshot(balls, [], camera, 960, 540, materials=[mirror()] * 500, world=World())
    found = reflectors_of(scene, bounces=1, reflection_map_mib=64)
    assert MAX_REFLECTORS <= sum(each.runs for each in found.reflectors) <= MAX_REFLECTORS + MAX_GROUPS
    assert len(found.lines) <= MAX_REFLECTORS + MAX_GROUPS + 1
    assert sum(each.texel_count for each in found.maps) * BYTES_PER_TEXEL <= 64 << 20
    found = reflectors_of(scene, bounces=1, reflection_map_mib=2)
    assert sum(each.texel_count for each in found.maps) * BYTES_PER_TEXEL <= 2 << 20
    assert found.maps and all(each.width_px == MAP_SIZE_STEP_PX for each in found.maps)
    assert all("smaller for all maps to fit" in each.reason for each in found.reflectors if each.maps and each.covered_px[0] > 32)
    assert any(each.reason == "skipped: no memory is left for its map" for each in found.reflectors)


def test_an_eye_within_a_reflector_looks_from_where_it_is(device):
    """A room of mirrors with a lamp: every wall shows the room, from the eye's own place."""
    room = box("room", (0, 0, 0), (2, 2, 2), inside_out=True)
    lamp = box("lamp", (0.5, 0.5, 0.8), (0.2, 0.2, 0.2))
    camera = perspective_camera((0.2, -1.0, 0.1), (0.0, 1.0, 0.0), 64, 36, 0.6)
    scene = snapshot([room, lamp], [], camera, 64, 36, materials=[mirror(), matte((0, 0, 0), (1, 1, 1))], world=World((0.3, 0, 0)))
    assert "the eye is inside" in reflectors_of(scene).reflectors[0].reason
    image = render_passes(scene, device, reflection_sample_count=2, effects=(Effect.REFLECTION,), bounces=2)[REFLECTION_PASS_NAME]
    # nothing of the world gets into a closed room
    assert image[..., 0].max() > 0.99
    np.testing.assert_allclose(image[..., 0], image[..., 1], atol=2e-3)


@pytest.mark.parametrize("scale", [(-1.0, 1.0, 1.0), (2.0, 0.7, 1.3)])
def test_mirrored_and_stretched_reflectors_reflect_as_they_stand(device, scale):
    """The same mirror as its vertices say and as its object's transform does."""
    walls, materials = colored_box(3.0)
    ball = bumpy_sphere("ball", (0, 0, 0), 0.7, 48, bump_share=0.0)
    normals = ball.positions_os / np.array(scale) ** 2 * np.array(scale)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    stretched = dataclasses.replace(ball, positions_os=(ball.positions_os * np.array(scale)).astype(np.float32))
    if np.prod(scale) < 0:
        stretched = dataclasses.replace(stretched, triangles=stretched.triangles[:, ::-1].copy())
    stretched = dataclasses.replace(stretched, point_normals_os=normals.astype(np.float32))
    camera = perspective_camera((-2.6, -1.0, 0.8), (0, 0, 0), WIDTH, HEIGHT, 0.6)
    transforms = np.tile(np.eye(4), (7, 1, 1))
    placed = transforms.copy()
    placed[6, :3, :3] = np.diag(scale)
    images = [
        render_passes(
            snapshot([*walls, mesh], [], camera, WIDTH, HEIGHT, transforms=matrices, materials=[*materials, mirror()], world=World()),
            device,
            effects=(Effect.REFLECTION,),
            reflection_sample_count=2,
        )[REFLECTION_PASS_NAME]
        for mesh, matrices in ((stretched, transforms), (ball, placed))
    ]
    assert images[0].max() > 0.5
    assert (np.abs(images[0] - images[1]).max(axis=-1) > 0.02).mean() < 0.005


def angle_with_a_wall(degrees):
    """An L on end, a mirror, in front of a mirror, in a coloured box, and an eye that has gone around them by an angle."""
    walls, materials = colored_box(5.0)
    outline = [(-0.8, -0.3), (0.8, -0.3), (0.8, 0.9), (0.5, 0.9), (0.5, 0.0), (-0.8, 0.0)]
    positions = np.array([(x, y, z) for z in (-0.5, 0.5) for x, y in outline], np.float32)
    triangles = []
    for k in range(6):
        after = (k + 1) % 6
        triangles += [(k, after, after + 6), (k, after + 6, k + 6)]
    for a, b, c in ((0, 1, 4), (0, 4, 5), (1, 2, 3), (1, 3, 4)):
        triangles += [(a, c, b), (a + 6, b + 6, c + 6)]
    angled = Mesh("angle", positions, np.array(triangles, np.int32), is_closed=True)
    flat = rectangle("flat", (-3.5, -0.5, -2.0), (4, 4, 0), (0, 0, 4.5))
    turn_rad = np.radians(degrees)
    camera = perspective_camera((-3.5 * np.cos(turn_rad), -3.5 * np.sin(turn_rad), 1.6), (0, 0, 0), WIDTH, HEIGHT, 0.4)
    return snapshot([*walls, flat, angled], [], camera, WIDTH, HEIGHT, materials=[*materials, mirror(), mirror()], world=World())


def test_cubes_of_a_reflector_alone_do_not_come_and_go_with_the_eye(device):
    """Where the hollow of an L gets out of the eye's sight, others still show it, and so does what is behind them."""
    own = np.array([7])
    seen, hidden = 98.0, 99.0
    assert [convexity(angle_with_a_wall(degrees), own) for degrees in (seen, hidden)] == [(False, False), (False, True)]
    while hidden - seen > 2e-4:
        middle = (seen + hidden) / 2
        seen, hidden = (seen, middle) if convexity(angle_with_a_wall(middle), own)[1] else (middle, hidden)
    scenes = [angle_with_a_wall(degrees) for degrees in (seen, hidden)]
    settings = {"reflection_sample_count": 1, "effects": (Effect.REFLECTION,), "bounces": 3}
    before, after = (render_passes(scene, device, **settings)[REFLECTION_PASS_NAME] for scene in scenes)
    assert (before.max(axis=-1) > 0.05).sum() > 5000
    assert (np.abs(after - before).max(axis=-1) > 0.05).sum() < 30
    eye, directions = camera_rays(scenes[1].camera, WIDTH, HEIGHT)
    ends, ways = traced(scenes[1], np.broadcast_to(eye, (WIDTH * HEIGHT, 3)), directions.reshape(-1, 3), [6, 7], 3)
    judged = (ways > 0) & (ends >= 0) & (ends < 6)
    assert judged.sum() > 5000
    wrong = np.abs(after.reshape(-1, 3)[judged] - COLORS[ends[judged]]).max(axis=-1) > 0.01
    assert wrong.mean() < 0.01, f"{wrong.sum()} of {judged.sum()}"
