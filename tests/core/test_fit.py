"""Windows hold whatever may be shadowed, against rays in float64: random lights, cameras and objects."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.ray_tracing import delivered, intersect, primary_surfaces, samples_in_world, world_triangles
from tests.scenes import (
    area_light,
    box,
    bumpy_sphere,
    camera_from_above,
    floor,
    perspective_camera,
    point_light,
    rectangle,
    snapshot,
    spot_light,
)
from vir_addon.core.bounds import compute_bounds
from vir_addon.core.fit import _may_be_outermost, _tangent_bounds, _union, fit_light, receiver_cone
from vir_addon.core.reach import Receivers, select_receivers
from vir_addon.core.sampling import Cone, cone_of, light_samples

WIDTH, HEIGHT = 24, 14
VIEWS = 8
RESOLUTION_PX = 256
LIGHT_SIZES_M = ((0.0, 0.0), (0.3, 0.3), (0.6, 0.1))


def near(x, y, z, reach):
    return st.tuples(*(st.floats(centre - reach, centre + reach) for centre in (x, y, z)))


@st.composite
def scenes(draw):
    """A room's corner with things in it, a light anywhere above them, looking down somewhere, and a camera that looks on."""
    meshes = [
        floor(draw(st.sampled_from([1.5, 3.0, 30.0]))),
        rectangle("wall", (-3, 2.5, 0), (6, 0, 0), (0, 0, 3)),
        box("box", draw(near(-0.7, 0, 0.6, 0.5)), (0.4, 0.5, 0.3), turn_rad=draw(st.floats(0, 1.5))),
        bumpy_sphere("ball", draw(near(0.8, 0, 1.2, 0.6)), 0.5, 5, smooth=draw(st.booleans())),
        rectangle("leaf", draw(near(0, -0.5, 1.2, 0.5)), (0.7, 0.1, 0.3), (0.0, 0.6, 0.2)),
    ]
    size_m = draw(st.sampled_from(LIGHT_SIZES_M))
    light = area_light(eye=draw(near(0, 0, 3.8, 1.0)), target=draw(near(0, 0, 0, 1.5)), size_m=size_m)
    if draw(st.booleans()):
        light = dataclasses.replace(light, receivers=np.array(draw(st.permutations([True, True, True, True, False]))))
    if draw(st.booleans()):
        light = dataclasses.replace(light, blockers=np.array(draw(st.permutations([True, True, True, False, False]))))
    if draw(st.booleans()):
        camera = camera_from_above((draw(st.floats(-1, 1)), 0.0), draw(st.floats(1.0, 12.0)), WIDTH, HEIGHT)
    else:
        camera = perspective_camera(draw(near(0, -6.0, 2.5, 1.5)), draw(near(0, 0, 0.5, 0.8)), WIDTH, HEIGHT, draw(st.floats(0.1, 0.8)))
    return snapshot(meshes, [light], camera, WIDTH, HEIGHT)


def g_buffer(scene, triangles, surfaces):
    positions = np.full((HEIGHT, WIDTH, 4), -1.0, np.float32)
    normals = np.zeros((HEIGHT, WIDTH, 4), np.float32)
    rows, columns = surfaces.pixel.T
    positions[rows, columns, :3] = surfaces.position
    positions[rows, columns, 3] = triangles.instance[surfaces.triangle]
    normals[rows, columns, :3] = surfaces.geometric
    return positions, normals


def blocked_pairs(scene, triangles, surfaces, light, samples_ws):
    """What no map may leave out: (n,) points, samples and the instances in between, by rays in float64."""
    linked = np.ones(len(scene.instances), bool) if light.receivers is None else light.receivers
    receives = linked[triangles.instance[surfaces.triangle]]
    weight = delivered(light, samples_ws, surfaces.position, surfaces.shading)
    d = surfaces.position[:, None] - samples_ws[None]
    toward = np.einsum("nj,nmj->nm", surfaces.geometric, d) < 0
    point, sample = np.nonzero((weight > 0) & toward & receives[:, None])
    casts = np.flatnonzero((scene.instances.casts_shadow if light.blockers is None else light.blockers)[triangles.instance])
    t, _ = intersect(surfaces.position[point], samples_ws[sample] - surfaces.position[point], triangles.corners[casts])
    # what touches the surface or the light is a matter of the bias, not of windows
    pair, blocker = np.nonzero((t > 1e-3) & (t < 1 - 1e-3))
    return point[pair], sample[pair], triangles.instance[casts[blocker]]


def lost_pairs(scene, light, samples_m, faces, surfaces, triangles):
    """(row, column), sample and instance of every blocked ray that no window holds"""
    samples_ws = samples_in_world(light, samples_m)
    point, sample, instance = blocked_pairs(scene, triangles, surfaces, light, samples_ws)
    held = np.zeros(len(point), bool)
    for fitted in faces:
        views, rotation = fitted.views, fitted.views.face.face_from_world
        if not len(fitted.caster_indices):
            continue
        p = (surfaces.position[point] - samples_ws[sample]) @ rotation.T
        windows = np.array([views.window_tangents(k) for k in range(views.view_count)])[sample]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            x, y = p[:, 0] / p[:, 2], p[:, 1] / p[:, 2]
        inside = (p[:, 2] > views.near_m) & (windows[:, 0] <= x) & (x <= windows[:, 1]) & (windows[:, 2] <= y) & (y <= windows[:, 3])
        place = np.searchsorted(fitted.caster_indices, instance)
        known = place < len(fitted.caster_indices)
        known[known] = fitted.caster_indices[place[known]] == instance[known]
        known[known] = fitted.seen_by_view[sample[known], place[known]]
        held |= inside & known & (p[:, 2] <= views.far_m)
    lost = ~held
    return list(zip(surfaces.pixel[point[lost]].tolist(), sample[lost].tolist(), instance[lost].tolist(), strict=True))


@settings(max_examples=40)
@given(scene=scenes())
def test_whatever_is_shadowed_lies_in_a_window(scene):
    """Every ray from what the camera sees to a light sample that something blocks ends in the window of that sample's view, on a face
    that draws the blocker."""
    (light,) = scene.lights
    samples_m = light_samples(light, VIEWS)
    triangles = world_triangles(scene)
    surfaces = primary_surfaces(scene, triangles)
    receivers = select_receivers(*g_buffer(scene, triangles, surfaces), light)
    faces, is_cube = fit_light(scene, light, samples_m, compute_bounds(scene), receivers, RESOLUTION_PX)
    assert len(faces) <= (5 if is_cube else 1)
    lost = lost_pairs(scene, light, samples_m, faces, surfaces, triangles)
    assert not lost, lost[:5]


@settings(max_examples=40)
@given(seed=st.integers(0, 1 << 30), spread=st.floats(0.1, 20.0), light_m=st.floats(0.0, 2.0))
def test_points_that_are_left_out_change_no_view_s_bounds(seed, spread, light_m):
    """To the last bit, with points beside the face and behind the light among them."""
    rng = np.random.default_rng(seed)
    points = rng.normal((0, 0, 3), (spread, spread, 2), (300, 3))
    eyes = rng.uniform(-light_m, light_m, (12, 3)) * (1, 1, 0.5)
    limits, near_m = (-1.2, 1.2, -0.5, 1.2), 0.01
    kept = points[_may_be_outermost(points, eyes, near_m, limits)]
    for eye in eyes:
        of_all, of_kept = (_union(_tangent_bounds((some - eye).T[:, None], near_m, limits)) for some in (points, kept))
        assert (of_all == of_kept).all()


def test_few_points_decide_the_windows_of_a_small_light():
    rng = np.random.default_rng(1)
    points, eyes = rng.normal((0, 0, 5), (1, 1, 0.5), (8000, 3)), rng.uniform(-0.1, 0.1, (8, 3))
    assert _may_be_outermost(points, eyes, 0.01, (-1.2, 1.2, -1.2, 1.2)).mean() < 0.05


def test_windows_reach_up_to_the_seams_of_a_cube():
    """Of a large picture some pixels decide the windows. In a strip of floor that is seen through a narrow gap the last of them before a
    seam may be some texels away from it, and what lies between was lit through a closed box."""
    light = point_light(eye=(0.0, 0.0, 1.5), radius_m=0.1)
    camera = perspective_camera((0.0, -9.0, 3.0), (0.0, 0.0, 0.0), 16, 9)
    scene = snapshot([floor(9.0), box("around", (0.0, 0.0, 1.5), (0.4, 0.4, 0.4))], [light], camera, 16, 9)
    samples_m = light_samples(light, 16)
    # most of the picture shows the floor on this side; two columns of pixels go on to the other, across the seam at y = 1.5
    positions, normals = np.zeros((2, 400, 302, 4))
    normals[..., 2] = 1
    x, y = np.meshgrid(np.linspace(-2, 2, 300), np.linspace(-4, -2, 400))
    positions[:, :300, 0], positions[:, :300, 1] = x, y
    positions[:, 300, 3] = positions[:, 301, 3] = -1
    for seed in range(20):
        random = np.random.default_rng(seed)
        rows = np.sort(random.choice(400, 24, replace=False))
        positions[:, 300:] = 0, 0, 0, -1
        positions[rows, 300:] = 0
        positions[rows, 300:, 0] = [0.7, 0.72]
        positions[rows, 300:, 1] = np.linspace(0.6, 3.0, 24)[:, None]
        receivers = select_receivers(positions, normals, light)
        faces, is_cube = fit_light(scene, light, samples_m, compute_bounds(scene), receivers, 256)
        assert is_cube
        seen = positions[positions[..., 3] >= 0][:, :3]
        for fitted in faces:
            views = fitted.views
            p_fs = (seen - light.world_from_light[:3, 3]) @ views.face.face_from_world.T
            for view, centre in enumerate(views.centers_fs):
                p = p_fs - centre
                own = p[(p[:, 2] > 0) & (np.abs(p[:, :2]) <= p[:, 2:]).all(axis=1)]
                texels = own[:, :2] / own[:, 2:] / views.texel_tangent - views.window_texels[view]
                assert (texels >= 1).all() and (texels < np.array([views.map_width_px, views.map_height_px]) - 1).all(), (
                    seed,
                    views.face.name,
                )


def within(half_deg, toward, count=200, middle=(0.0, 0.0, 5.0)):
    """Places in all directions within an angle to `toward` from a light, one of them at that angle."""
    rng = np.random.default_rng(7)
    rotation = np.linalg.qr(np.column_stack([toward, rng.normal(size=(3, 2))]))[0]
    angle = np.radians(half_deg) * np.append(np.sqrt(rng.random(count)), 1.0)
    turn = rng.uniform(0, 2 * np.pi, count + 1)
    directions = np.column_stack([np.cos(angle), np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn)]) @ rotation.T
    directions *= np.sign(directions[0] @ toward)
    return Receivers(middle + rng.uniform(3, 6, (count + 1, 1)) * directions, 0.02)


@pytest.mark.parametrize("along", range(6))
@pytest.mark.parametrize(("half_deg", "cone_deg"), [(5, 15), (14, 15), (20, 30), (29, 30), (40, 45)])
def test_samples_of_a_lamp_gather_for_its_receivers(along, half_deg, cone_deg):
    """Around whichever of the light's axes they lie, and no step wider than needed."""
    toward = np.roll((1.0, 0.0, 0.0), along % 3) * (1 if along < 3 else -1)
    receivers, light = within(half_deg, toward), point_light(radius_m=0.2)
    cone = receiver_cone(light, receivers)
    assert math.degrees(cone.half_rad) == pytest.approx(cone_deg)
    samples = samples_in_world(light, light_samples(light, 256, cone)) - light.world_from_light[:3, 3]
    # the farthest that anything within the cone sees
    assert (samples @ toward / 0.2 > -math.sin(cone.half_rad) - 1e-9).all()
    assert (samples @ toward > 0).mean() > 0.75


def test_lamps_among_their_receivers_have_samples_all_around():
    light = point_light(radius_m=0.2)
    floor_around = np.random.default_rng(1).uniform((-20, -20, 0), (20, 20, 0), (500, 3))
    assert receiver_cone(light, Receivers(floor_around, 0.02)) == cone_of(light)
    inside = Receivers(np.array([[0.0, 0.0, 4.9]]), 0.02)
    assert receiver_cone(light, inside) == cone_of(light)
    assert receiver_cone(light, Receivers(np.zeros((0, 3)), 0.02)) == cone_of(light)


def test_spots_samples_gather_for_receivers_in_a_part_of_the_cone():
    light, down = spot_light(radius_m=0.2, cone_rad=math.radians(70)), (0.0, 0.0, -1.0)
    assert receiver_cone(light, within(12, down)) == Cone((0, 0, 1), math.radians(15))
    assert receiver_cone(light, within(34, down)) == cone_of(light)
    # beside the axis, where nothing is lit, it makes no difference what is there
    assert receiver_cone(light, within(12, (1.0, 0.0, 0.0))) == cone_of(light)


@pytest.mark.parametrize(("pitch_rad", "is_orthographic"), [(0.5, False), (1.0, False), (0.8, True)])
def test_receivers_reach_as_far_beyond_the_picture_as_its_samples(pitch_rad, is_orthographic):
    """On a floor exactly so far, also where the next row of pixels sees much more of it than the last; and what ends there ends."""
    height, width, beyond_px = 40, 60, 2.0

    def places(row, column):
        """Seen from 3 m above the floor at these rows and columns, pixels' centres being integers"""
        x, y = (column - width / 2) / 60, (row - height / 2) / 60
        down, forward = np.array([0, np.cos(pitch_rad), np.sin(pitch_rad)]), np.array([0, np.sin(pitch_rad), -np.cos(pitch_rad)])
        aside = x[..., None] * np.array([1.0, 0, 0]) + y[..., None] * down
        start = np.array([0.0, 0.0, 3.0]) + (aside if is_orthographic else 0)
        ray = np.broadcast_to(forward, aside.shape) if is_orthographic else forward + aside
        return start - start[..., 2:] / ray[..., 2:] * ray

    rows, columns = np.meshgrid(np.arange(height), np.arange(width), indexing="ij")
    positions, normals = np.zeros((2, height, width, 4))
    positions[..., :3], normals[..., 2] = places(rows, columns), 1
    light = point_light(eye=(0.0, 3.0, 2.0))
    edges = np.array([-beyond_px, height - 1 + beyond_px]), np.array([-beyond_px, width - 1 + beyond_px])
    corners = places(*np.meshgrid(*edges, indexing="ij")).reshape(-1, 3)
    found = select_receivers(positions, normals, light, beyond_px).beyond_ws
    for corner in corners:
        assert np.linalg.norm(found - corner, axis=1).min() < 1e-6
    within = select_receivers(positions, normals, light, beyond_px).points_ws
    np.testing.assert_array_equal(within, positions[..., :3].reshape(-1, 3))
    positions[0, :, 3] = 1  # another instance: nothing is known of how it goes on
    fewer = select_receivers(positions, normals, light, beyond_px).beyond_ws
    assert len(fewer) < len(found) and fewer[:, 1].min() >= within[:, 1].min() - 1e-9
