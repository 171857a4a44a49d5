"""Point lights and spots whose shadows are known: integrated in float64 over the directions to the light, or by geometry alone."""

import numpy as np
import pytest

from tests.scenes import (
    METHODS,
    area_light,
    box,
    bumpy_sphere,
    camera_from_above,
    floor,
    perspective_camera,
    point_light,
    prepared_renderer,
    rectangle,
    render_batches,
    render_pass,
    rmse,
    snapshot,
    spot_light,
)
from vir_addon.core.plan import plan
from vir_addon.core.settings import Method, Settings

WIDTH, HEIGHT = 96, 12
LIGHT_HEIGHT_M, EDGE_HEIGHT_M = 4.0, 1.0


def half_plane_scene(light, width_m, height_px=HEIGHT):
    """A half plane x < 0 over a floor seen from above."""
    occluder = rectangle("half plane", (-8, -8, EDGE_HEIGHT_M), (8, 0, 0), (0, 16, 0))
    camera = camera_from_above((0.0, 0.0), width_m, WIDTH, height_px)
    return snapshot([floor(), occluder], [light], camera, WIDTH, height_px, visible_to_camera=[True, False])


def middle_row_x(width_m):
    return (np.arange(WIDTH) + 0.5) / WIDTH * width_m - width_m / 2


def integrated_disc_of_directions(x_m, half_angle_of, count=600):
    """The pass on the floor at (x, 0): mean of cosine * visibility over a cone of directions around the light's centre.
    half_angle_of: radians of a distance."""
    radius, turn = np.meshgrid((np.arange(count) + 0.5) / count, (np.arange(count) + 0.5) / count * 2 * np.pi)
    image = np.empty(len(x_m))
    for index, x in enumerate(x_m):
        towards = np.array([-x, 0.0, LIGHT_HEIGHT_M])
        distance = np.linalg.norm(towards)
        towards /= distance
        across = np.array([towards[2], 0.0, -towards[0]])
        cosine = 1 - radius * (1 - np.cos(half_angle_of(distance)))  # uniform in solid angle
        sine = np.sqrt(1 - cosine**2)
        d_x = cosine * towards[0] + sine * np.cos(turn) * across[0]
        d_z = cosine * towards[2] + sine * np.cos(turn) * across[2]
        image[index] = (d_z * (x + d_x / d_z * EDGE_HEIGHT_M >= 0)).sum() / d_z.sum()
    return image


@pytest.mark.parametrize("method", [METHODS[0], pytest.param(METHODS[1], marks=pytest.mark.slow)])
@pytest.mark.parametrize("soft", [False, True])
def test_sphere_over_a_straight_edge(device, method, soft):
    width_m, radius_m = 1.0, 0.5
    light = point_light(eye=(0, 0, LIGHT_HEIGHT_M), radius_m=radius_m, has_soft_falloff=soft)
    image = render_pass(half_plane_scene(light, width_m), device, method=method, view_count=512, map_resolution_px=256)
    x = middle_row_x(width_m)
    truth = integrated_disc_of_directions(x, (lambda d: np.arctan(radius_m / d)) if soft else (lambda d: np.arcsin(radius_m / d)))
    row = image[HEIGHT // 2]
    assert truth.min() < 0.001 and truth.max() > 0.999
    assert rmse(row, truth) <= 0.01
    # half of the samples are on the side that a place sees
    assert np.abs(row - truth).max() <= 0.04


@pytest.mark.parametrize("method", METHODS)
def test_hard_point_light(device, method):
    """The edge's shadow ends where the line over it meets the floor."""
    light = point_light(eye=(-0.5, 0, LIGHT_HEIGHT_M), radius_m=0.0)
    width_m = 1.0
    image = render_pass(half_plane_scene(light, width_m), device, method=method, map_resolution_px=512)
    share = EDGE_HEIGHT_M / (LIGHT_HEIGHT_M - EDGE_HEIGHT_M)
    np.testing.assert_array_equal(image, np.broadcast_to(middle_row_x(width_m) > 0.5 * share, image.shape))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("cone_rad", [0.4, 2.0])
def test_hard_spot(device, method, cone_rad):
    """Nothing is delivered outside the cone, which is 0, and inside only the half plane shadows."""
    light = spot_light(eye=(0.2, 0, LIGHT_HEIGHT_M), target=(0.2, 0, 0), radius_m=0.0, cone_rad=cone_rad)
    width_m = min(3.0 * LIGHT_HEIGHT_M * np.tan(cone_rad / 2), 19.0)
    image = render_pass(half_plane_scene(light, width_m), device, method=method, map_resolution_px=512)
    x = middle_row_x(width_m)[None]
    y = ((np.arange(HEIGHT) + 0.5 - HEIGHT / 2) * width_m / WIDTH)[:, None]
    in_cone = np.hypot(x - 0.2, y) < LIGHT_HEIGHT_M * np.tan(cone_rad / 2)
    lit = x > -0.2 * EDGE_HEIGHT_M / (LIGHT_HEIGHT_M - EDGE_HEIGHT_M)
    # the picture's resolution at the cone's rim: a pixel's centre within rounding of it
    rim = np.abs(np.hypot(x - 0.2, y) / (LIGHT_HEIGHT_M * np.tan(cone_rad / 2)) - 1) < 1e-5
    np.testing.assert_array_equal(image[~rim], (in_cone & lit)[~rim])
    assert in_cone.any() and not in_cone.all()


def room_around(half_m=2.0):
    return box("room", (0.0, 0.0, 0.0), (half_m, half_m, half_m), inside_out=True)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("radius_m", [0.0, 0.3])
def test_lamp_in_an_empty_room_lights_all_of_it(device, method, radius_m):
    """Receivers in all six directions and no seam between faces. The room's corners are turned against the cube's."""
    light = point_light(eye=(0.3, -0.2, 0.4), radius_m=radius_m)
    light.world_from_light[:3, :3] = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    if np.linalg.det(light.world_from_light[:3, :3]) < 0:
        light.world_from_light[:3, 0] *= -1
    checked = 0
    for direction in ((1.0, 0.2, 0.1), (-1.0, 0.1, 0.3), (0.2, 1.0, -0.2), (0.1, -1.0, 0.2), (0.1, 0.3, 1.0), (-0.2, 0.3, -1.0)):
        camera = perspective_camera(-1.6 * np.array(direction), 3 * np.array(direction), 48, 48, 1.2)
        scene = snapshot([room_around()], [light], camera, 48, 48)
        with prepared_renderer(scene, device, method=method, view_count=8, map_resolution_px=128) as renderer:
            render_batches(renderer)
            image, positions = renderer.read_passes()["VIR Shadow Key"], device.run(device.read, renderer.eye.buffers[0].positions)
        # within a texel of the next wall its map cannot tell which of them is nearer
        clear = np.sort(np.abs(positions[..., :3]), axis=-1)[..., 1] < 2.0 - 0.06
        np.testing.assert_array_equal(image[clear], 1)
        checked += clear.sum()
    assert checked > 6 * 0.85 * 48**2


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("inside_out", [False, True])
@pytest.mark.parametrize("radius_m", [0.0, 0.15])
def test_nothing_leaves_a_closed_box(device, method, inside_out, radius_m):
    meshes = [room_around(4.0), box("around", (0.05, 0.02, 0.1), (0.5, 0.4, 0.45), inside_out=inside_out, turn_rad=0.3)]
    light = point_light(eye=(0.1, 0.0, 0.05), radius_m=radius_m)
    camera = perspective_camera((3.5, -3.5, 2.5), (0.0, 0.0, 0.0), 48, 32, 1.2)
    # a box that is inside out would show its lit inner faces
    scene = snapshot(meshes, [light], camera, 48, 32, visible_to_camera=[True, False])
    image = render_pass(scene, device, method=method, view_count=16, map_resolution_px=100)
    np.testing.assert_array_equal(image, 0)


def test_receiver_inside_the_sphere(device):
    """All around shines there: a floor through the sphere's middle is lit wherever nothing else stands."""
    light = point_light(eye=(0.0, 0.0, 0.2), radius_m=1.0)
    camera = camera_from_above((0.0, 0.0), 1.2, 16, 16, 6.0)
    image = render_pass(snapshot([floor(3.0), box("box", (2, 2, 1), (0.3, 0.3, 1))], [light], camera, 16, 16), device, view_count=64)
    assert image.min() > 0.95


@pytest.mark.parametrize("light", [area_light(eye=(0.4, 0, 4), target=(0.4, 0, 0)), point_light(eye=(0.4, 0, 4))], ids=["area", "point"])
def test_telling_the_faces_of_a_cube_apart_changes_nothing_where_one_has_casters(light, device):
    """Places that belong to faces without casters lie outside the only map's windows."""
    camera = camera_from_above((0.0, 0.0), 13.0, WIDTH, WIDTH)
    scene = snapshot([floor(), bumpy_sphere("ball", (0, 0.2, 1.2), 0.6, 12)], [light], camera, WIDTH, WIDTH)
    images = []
    for told_apart in (False, True):
        with prepared_renderer(scene, device, method=Method.MICRO, view_count=16, map_resolution_px=256) as renderer:
            (work,) = renderer.works
            assert len(work.faces) >= 5 and len(work.mapped) == 1 and "MANY_FACES" not in work.resolve_flags
            work.resolve_flags += ["MANY_FACES"] * told_apart
            render_batches(renderer)
            images.append(renderer.read_passes()["VIR Shadow Key"])
    assert (images[0] < 0.9).sum() > 50
    np.testing.assert_array_equal(*images)


@pytest.mark.parametrize("name", ["Key", "Lamp", "Fill"])
@pytest.mark.parametrize("view_count", [2, 3])
def test_few_points_of_a_ball_leave_nothing_dark_that_faces_it(device, view_count, name):
    """The name chooses the points. With two .187, .003 and .323 of the picture were dark that are lit by most of many."""
    meshes = [box("room", (0.0, 0.0, 1.5), (2.0, 2.0, 1.5), inside_out=True), box("box", (0.0, 0.0, 0.3), (0.3, 0.3, 0.3))]
    light = point_light(name, (0.8, -0.6, 2.4), 0.5)
    scene = snapshot(meshes, [light], perspective_camera((0.0, -1.8, 1.2), (0.0, 0.0, 0.8), 64, 36), 64, 36)
    (planned,) = plan(scene, Settings(view_count=view_count)).passes
    assert "fewer points of a ball" in planned.reason
    few, many = (render_pass(scene, device, view_count=count) for count in (view_count, 64))
    dark_share = ((few == 0) & (many > 0.5)).mean()
    print(f"{name}, {view_count} views: {dark_share:.4f} dark")
    assert dark_share <= 0.001
    # one view is the light's centre, which all that faces it sees
    (planned,) = plan(scene, Settings(view_count=1)).passes
    assert planned.view_count == 1 and "fewer points" not in planned.reason
