"""Which objects reflect, and what is drawn for each."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.core.test_reflections import box_colors, camera_rays, colored_box, mirrored_colors, nearest_instance
from tests.scenes import box, bumpy_sphere, camera_from_above, floor, matte, mirror, perspective_camera, rectangle, render_passes, snapshot
from vir_addon.core.errors import UsageError
from vir_addon.core.material import Constant, ImageSample, ImageTexels, Operation, TableLookup, World
from vir_addon.core.material_program import combined, typical_value
from vir_addon.core.pass_set import REFLECTION_COLOR_PASS_NAME, REFLECTION_PASS_NAME
from vir_addon.core.passes.reflection_maps import BYTES_PER_TEXEL, MAP_SIZE_STEP_PX, OWN_CUBES, instances_in_face
from vir_addon.core.plan import plan as planned
from vir_addon.core.reflections import views as reflector_views
from vir_addon.core.reflections.reflectors import MAX_GROUPS, MAX_REFLECTORS, MIN_MAP_RAYS
from vir_addon.core.render import render
from vir_addon.core.scene import Mesh
from vir_addon.core.settings import CUBE_SIZES_PX, Effect, Settings

WIDTH, HEIGHT = 160, 90


def reflectors_of(scene, **settings):
    return planned(scene, Settings(effects=(Effect.REFLECTION,), **settings)).reflections


def number(value):
    return Constant((value, value, value))


def image(value, *, is_srgb=False):
    return ImageSample(ImageTexels("image", np.full((4, 4, 3), value, np.float32), is_srgb=is_srgb))


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        (image(0.5, is_srgb=True), 0.21404),
        (combined(Operation.MULTIPLY, image(0.8), number(0.2)), 0.16),
        (combined(Operation.ADD, image(0.45), number(1.0)), 1.45),
        (combined(Operation.GREATER_THAN, image(0.8), number(0.5)), 1.0),
        (TableLookup(image(0.75), ImageTexels("ramp", np.array([[(1, 1, 1), (1, 1, 1), (0, 0, 0)]], np.float32))), 0.5),
    ],
)
def test_typical_values_are_what_comes_of_images_means(expression, expected):
    np.testing.assert_allclose(typical_value(expression), expected, rtol=1e-4)


def test_typical_values_of_shared_parts_are_worked_out_once():
    """2^60 ways through 60 operations."""
    value = image(0.5)
    for _ in range(60):
        value = combined(Operation.MULTIPLY, value, combined(Operation.ADD, value, number(1.0)))
        value = combined(Operation.MINIMUM, value, combined(Operation.ABSOLUTE, value))
        value = combined(Operation.DIVIDE, value, combined(Operation.ADD, value, number(1.0)))
    assert np.isfinite(typical_value(value)).all()


def test_what_reflections_do_not_see_is_in_no_map():
    meshes = [floor(4.0), box("helper", (1, 0, 0.5), (0.5, 0.5, 0.5)), box("ball", (0, 0, 0.5), (0.5, 0.5, 0.5))]
    camera = perspective_camera((0.5, -3.0, 1.5), (0, 0, 0.4), WIDTH, HEIGHT, 0.6)
    scene = snapshot(meshes, [], camera, WIDTH, HEIGHT, materials=[matte(), matte(), mirror()], world=World())
    instances = dataclasses.replace(scene.instances, visible_in_reflections=np.array([True, False, True]))
    maps = reflectors_of(dataclasses.replace(scene, instances=instances), bounces=2).maps
    assert maps
    assert not any(1 in each.instances for each in maps)
    assert any(1 in each.instances for each in reflectors_of(scene, bounces=2).maps)


def test_what_reflections_do_not_see_has_no_cubes_of_itself():
    ball = bumpy_sphere("ball", (0, 0, 0.5), 0.5, 12, bump_share=0.2)
    camera = perspective_camera((0.5, -3.0, 1.5), (0, 0, 0.4), WIDTH, HEIGHT, 0.6)
    scene = snapshot([floor(4.0), ball], [], camera, WIDTH, HEIGHT, materials=[matte(), mirror()], world=World())
    for is_shown in (True, False):
        instances = dataclasses.replace(scene.instances, visible_in_reflections=np.array([True, is_shown]))
        (found,) = reflectors_of(dataclasses.replace(scene, instances=instances)).reflectors
        assert len(found.own_cubes) == (OWN_CUBES if is_shown else 0)
        assert (found.itself is not None) == is_shown == ("of itself" in found.reason)


def test_a_leaning_mirror_is_flat_though_the_eye_is_within_its_box():
    glass = rectangle("glass", (-2, -2, 0), (4, 0, 0), (0, 4, 4))
    camera = perspective_camera((0.0, -1.0, 2.0), (0.0, 1.0, 2.5), WIDTH, HEIGHT, 0.6)
    scene = snapshot([floor(4.0), glass], [], camera, WIDTH, HEIGHT, materials=[matte(), mirror()], world=World())
    (planar,) = reflectors_of(scene).reflectors
    assert planar.method_text == "planar"
    assert [each.is_cube for each in planar.maps] == [False, True]
    (as_published,) = reflectors_of(scene, planar=False).reflectors
    assert as_published.method_text == "mvr"
    assert [each.is_cube for each in as_published.maps] == [True]


def test_reflectors_behind_the_camera_call_for_no_second_bounce():
    balls = [box(f"ball {k}", (0.2 * k, 1.0 if k == 0 else -8.0, 0.5), (0.5, 0.5, 0.5)) for k in range(20)]
    camera = perspective_camera((0.5, -3.0, 1.5), (0, 1, 0.4), WIDTH, HEIGHT, 0.6)
    scene = snapshot([floor(9.0), *balls], [], camera, WIDTH, HEIGHT, materials=[matte(), *[mirror()] * 20], world=World())
    found = reflectors_of(scene)
    assert found.bounces == 1
    assert [each.name for each in found.reflectors if each.runs] == ["ball 0"]


@pytest.mark.parametrize(("radius_m", "map_count"), [(0.2, 2), (0.01, 1)])
def test_cubes_are_as_wide_as_asked_whatever_reflectors_cover(radius_m, map_count):
    """As the papers' baseline has them; otherwise as wide as their reflectors are in the picture. Small ones share one."""
    balls = [bumpy_sphere(f"ball {k}", (0.5 * k, 0.0, 0.5), radius_m, 12, bump_share=0.0) for k in range(2)]
    camera = perspective_camera((0.5, -3.0, 1.5), (0, 0, 0.4), 640, 360, 0.6)
    scene = snapshot([floor(4.0), *balls], [], camera, 640, 360, materials=[matte(), mirror(), mirror()], world=World())
    asked = reflectors_of(scene, reflection_cube_px=416)
    assert [each.width_px for each in asked.maps] == [416] * map_count
    assert 416 not in {each.width_px for each in reflectors_of(scene).maps}


@pytest.mark.parametrize("side_px", [0, 16, 100, 1056])
def test_cubes_have_sides_that_maps_have(side_px):
    assert range(MAP_SIZE_STEP_PX, reflector_views.MAX_MAP_PX + 1, MAP_SIZE_STEP_PX) == CUBE_SIZES_PX
    with pytest.raises(UsageError, match=f"32 to 1024 px wide in steps of 32, not {side_px}"):
        Settings(reflection_cube_px=side_px)


def test_reasons_say_why_a_cube_is_where_it_is(monkeypatch):
    """What parallel cameras and very fine meshes go without."""
    glass, ball = rectangle("glass", (-1, -1, 0), (0.8, 0, 0), (0, 0.8, 0)), box("ball", (0.5, 0.5, 0.5), (0.3, 0.3, 0.3))
    camera = camera_from_above((0, 0), 3.0, WIDTH, HEIGHT)
    scene = snapshot([glass, ball], [], camera, WIDTH, HEIGHT, materials=[mirror()] * 2, world=World())
    found = reflectors_of(scene).reflectors
    assert {each.method_text for each in found} <= {"mvr", "epr"}
    assert all("a parallel camera has neither mirrored views" in each.reason for each in found)
    assert not any("triangles: its cube is around a place on it" in each.reason for each in found)
    monkeypatch.setattr(reflector_views, "MAX_INSCRIBED_TRIANGLES", 11)
    reasons = {each.name: each.reason for each in reflectors_of(scene).reflectors}
    assert "triangles: its cube is around a place on it" in reasons["ball"]
    assert "around a place" not in reasons["glass"]


def joined(name, *meshes):
    starts = np.cumsum([0, *(len(each.positions_os) for each in meshes)])
    triangles = [each.triangles + start for each, start in zip(meshes, starts, strict=False)]
    return Mesh(name, np.concatenate([each.positions_os for each in meshes]), np.concatenate(triangles), is_closed=True)


def test_only_what_is_all_around_the_eye_has_its_cube_around_the_eye(monkeypatch):
    """Columns whose box the eye is in are not, walls are, also such as have an outside; what is too fine to find out is not asked."""
    columns = joined("columns", *(box(f"{k}", (3 * np.cos(k), 3 * np.sin(k), 1.0), (0.2, 0.2, 2.0)) for k in range(6)))
    inner, outer = box("inner", (0, 0, 1), (3, 3, 2), inside_out=True), box("outer", (0, 0, 1), (3.2, 3.2, 2.2))
    camera = perspective_camera((0.0, 0.0, 1.0), (0.0, 1.0, 1.0), WIDTH, HEIGHT, 0.6)
    for mesh, is_room in ((columns, False), (inner, True), (joined("walls", inner, outer), True)):
        scene = snapshot([floor(9.0), mesh], [], camera, WIDTH, HEIGHT, materials=[matte(), mirror()], world=World())
        (found,) = reflectors_of(scene).reflectors
        assert found.runs
        assert ("the eye is inside" in found.reason) == is_room
        assert (np.abs(found.seen.center_ws - (0, 0, 1)).max() < 1e-6 and len(found.elsewhere) == 2) == is_room
    monkeypatch.setattr(reflector_views, "MAX_INSCRIBED_TRIANGLES", 23)
    (found,) = reflectors_of(scene).reflectors
    assert found.runs and "its cube is around a place on it" in found.reason


def test_directions_that_a_reflector_lies_in_count_once():
    """A closed ball around a place in all, half a ball in half of them, however fine; many layers of leaves in as many as rays in float64
    meet, though they add up to more than all."""
    camera = perspective_camera((0, -4.0, 0), (0, 0, 0), WIDTH, HEIGHT, 0.6)
    place = np.array([0.03, 0.02, -0.01])

    def covers(mesh, share):
        scene = snapshot([mesh], [], camera, WIDTH, HEIGHT, materials=[mirror()], world=World())
        return reflector_views._covers(scene, np.array([0]), place, share)

    for row_count in (8, 40, 200):
        ball = bumpy_sphere("ball", (0, 0, 0), 2.0, row_count, bump_share=0.0)
        assert covers(ball, 0.999)
        lower = (ball.positions_os[ball.triangles][..., 2] < 1e-4).all(axis=1)
        half = dataclasses.replace(ball, triangles=ball.triangles[lower], is_closed=False)
        assert covers(half, 0.46) and not covers(half, 0.54)
    rng = np.random.default_rng(5)
    middles = rng.normal(size=(3000, 1, 3))
    middles *= rng.uniform(2, 4, (3000, 1, 1)) / np.linalg.norm(middles, axis=2, keepdims=True)
    corners = (middles + rng.normal(scale=0.2, size=(3000, 3, 3))).astype(np.float32)
    turned = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) > 0
    corners[turned] = corners[turned][:, ::-1]
    leaves = Mesh("leaves", corners.reshape(-1, 3), np.arange(9000, dtype=np.int32).reshape(-1, 3))
    scene = snapshot(
        [leaves], [], perspective_camera(place, (0, 4.0, 0), WIDTH, HEIGHT), WIDTH, HEIGHT, materials=[mirror()], world=World()
    )
    ways = rng.normal(size=(1000, 3))
    met = (nearest_instance(scene, np.broadcast_to(place, ways.shape), ways, leave_out=None) == 0).mean()
    assert covers(leaves, met - 0.05) and not covers(leaves, met + 0.05)
    front, _ = reflector_views._solid_angles(scene, np.array([0]), place)
    assert met + 0.05 < reflector_views.ROOM_SHARE < front / (4 * np.pi)
    assert not reflector_views.eye_is_inside(scene, np.array([0]), corners.reshape(-1, 3))


def test_the_inscribed_radius_is_that_of_the_nearest_triangle(monkeypatch):
    """Also where they come in portions, and none around a place outside."""
    ball = bumpy_sphere("ball", (0.4, 0, 0), 0.5, 40, bump_share=0.0)
    camera = perspective_camera((0, -4.0, 0), (0, 0, 0), WIDTH, HEIGHT, 0.6)
    monkeypatch.setattr(reflector_views, "TRIANGLES_AT_ONCE", 500)
    block = box("block", (0, 0, 0), (2, 1.5, 1.2))
    scene = snapshot([block, ball], [], camera, WIDTH, HEIGHT, materials=[mirror()] * 2, world=World())
    radius = reflector_views._inscribed_radius
    place = np.array([0.4, 0.1, 0.0])
    assert radius(scene, np.array([0]), place) == pytest.approx(1.2)
    # facets of 40 rows are flatter than the sphere by less than 1 - cos(pi / 40)
    assert radius(scene, np.array([1]), place) == pytest.approx(0.4, abs=0.5 * 0.004)
    assert radius(scene, np.array([1]), np.array([-0.4, 0, 0])) == 0


def test_small_reflectors_near_each_other_share_maps():
    rails = [box(f"rail {k}", (0.02 * (k % 103) - 1, 0.1 * (k // 103), 0.5), (0.002, 0.002, 0.02)) for k in range(309)]
    ball = box("ball", (0, 1, 0.5), (0.5, 0.5, 0.5))
    camera = perspective_camera((0.5, -3.0, 1.5), (0, 1, 0.4), WIDTH, HEIGHT, 0.6)
    scene = snapshot([*rails, ball], [], camera, WIDTH, HEIGHT, materials=[mirror()] * 310, world=World())
    found = reflectors_of(scene)
    assert found.reflectors[0].name == "ball"
    assert "one map" in found.reflectors[1].reason
    assert len(found.reflectors) <= 1 + MAX_GROUPS
    assert (found.instance_maps(310)[:, 0] >= 0).all()
    assert not np.isin(found.reflectors[1].instances, found.reflectors[1].seen.instances).any()


def test_next_to_nothing_in_the_picture_is_no_reason_for_bounces_nor_against_a_map():
    """A nail that covers a pixel beside a mirror: no reflector to show in, and as good as one that is out of the picture."""
    glass = rectangle("glass", (-1, 1, 0), (2, 0, 0), (0, 0, 2))
    nail = box("nail", (-1.2, 0.9, 0.5), (0.004, 0.004, 0.004))
    camera = perspective_camera((0.5, -3.0, 1.5), (0, 1, 0.4), WIDTH, HEIGHT, 0.6)
    scene = snapshot([floor(4.0), glass, nail], [], camera, WIDTH, HEIGHT, materials=[matte(), mirror(), mirror()], world=World())
    assert reflectors_of(scene).bounces == 1
    found = reflectors_of(scene, bounces=2)
    assert [each.name for each in found.waiting] == ["nail"]
    assert found.settled().texts[-1].startswith("nail: skipped: all such together show in next to no pixels, and")


def test_large_ones_that_share_a_map_are_not_called_small():
    balls = [box(f"ball {k}", (0.5 * (k % 10) - 2.25, 2.0, 0.4 * (k // 10) - 1.4), (0.2, 0.2, 0.15)) for k in range(80)]
    camera = perspective_camera((0.0, -3.0, 0.0), (0, 1, 0), 320, 180, 0.6)
    found = reflectors_of(snapshot(balls, [], camera, 320, 180, materials=[mirror()] * 80, world=World()), bounces=1)
    shared = [each for each in found.reflectors if len(each.instances) > 1]
    assert sum(len(each.instances) for each in shared) == 80 - MAX_REFLECTORS
    assert all("more than 64 reflectors" in each.reason and "small" not in each.reason for each in shared)


def test_shared_maps_show_the_right_things_and_cost_as_much_as_is_seen_of_them(device):
    """Thin strips of mirror in a coloured box: none of them large enough for a map, one for all."""
    walls, materials = colored_box(3.0)
    strips = [rectangle(f"strip {k}", (0.12 * k - 0.7, 1.5, -0.3), (0.02, 0, 0), (0, 0, 0.6)) for k in range(12)]
    hidden = [rectangle(f"hidden {k}", (0.12 * k - 0.7, 2.9, 2.5), (0.02, 0, 0), (0, 0, 0.1)) for k in range(12)]
    camera = perspective_camera((0.2, -2.5, 0.4), (0, 1.5, 0), WIDTH, HEIGHT, 0.5)
    scene = snapshot(
        [*walls, *strips, *hidden], [], camera, WIDTH, HEIGHT, materials=[*materials, *[mirror()] * 24], world=World((0.5, 0.5, 0.5))
    )
    settings = Settings(effects=(Effect.REFLECTION,), reflection_sample_count=2, bounces=2)
    *_, last = render(scene, planned(scene, settings), device)
    found = last.statistics.reflections
    assert 0 < found.map_count <= found.ray_count / MIN_MAP_RAYS, found.reflectors
    assert sum(line.startswith("hidden ") and "skipped: " in line for line in found.reflectors) == 12

    eye, directions = camera_rays(camera, WIDTH, HEIGHT)
    at = eye + ((1.5 - eye[1]) / directions[..., 1])[..., None] * directions
    truth, to_edge = box_colors(at, directions * (1, -1, 1), 3.0)
    judged = (last.passes[REFLECTION_COLOR_PASS_NAME] > 0.99).all(axis=-1) & (to_edge > 0.1)
    assert judged.sum() > 200
    assert np.abs(last.passes[REFLECTION_PASS_NAME] - truth)[judged].max() < 0.01


def test_reflectors_outside_of_the_picture_have_maps_where_others_show_them(device):
    """A mirror in the picture shows another behind the eye, but not the one that stands beside it."""
    width, height = 80, 45
    walls, materials = colored_box(3.0)
    front = rectangle("front", (-1, 2.5, -1), (2, 0, 0), (0, 0, 2))
    behind = rectangle("behind", (-1, -2.8, -1), (0, 0, 2), (2, 0, 0))
    beside = rectangle("beside", (2.0, 2.9, -1), (0.5, 0, 0), (0, 0, 2))
    camera = perspective_camera((0.3, -1.0, 0.4), (0, 2.5, 0), width, height, 0.4)
    scene = snapshot([*walls, front, behind, beside], [], camera, width, height, materials=[*materials, *[mirror()] * 3], world=World())
    plan = planned(scene, Settings(effects=(Effect.REFLECTION,), reflection_sample_count=2, bounces=2))
    assert sorted(each.name for each in plan.reflections.waiting) == ["behind", "beside"]
    *_, last = render(scene, plan, device)
    lines = last.statistics.reflections.reflectors
    assert any(line.startswith("behind: mvr shows enough only within other reflectors") for line in lines)
    assert any(line.startswith("beside: skipped: not in the picture, and next to nothing of it shows within") for line in lines)

    eye, directions = camera_rays(camera, width, height)
    first = eye + ((2.5 - eye[1]) / directions[..., 1])[..., None] * directions
    back = directions * (1, -1, 1)
    second = first + ((-2.8 - first[..., 1]) / back[..., 1])[..., None] * back
    within = (np.abs(first[..., [0, 2]]) < 0.97).all(axis=-1) & (np.abs(second[..., [0, 2]]) < 0.97).all(axis=-1)
    truth, to_edge = box_colors(second, directions, 3.0)
    through = second + ((2.5 - second[..., 1]) / directions[..., 1])[..., None] * directions
    judged = within & (to_edge > 0.1) & (np.abs(through[..., [0, 2]]) > 1.12).any(axis=-1)
    # the other mirror behind it
    judged &= np.abs(through[..., 0] - 2.25) > 0.6
    assert judged.sum() > 100
    assert np.abs(last.passes[REFLECTION_PASS_NAME] - truth)[judged].max() < 0.01


def test_faces_draw_what_is_in_them_alone():
    """Every place in front of a face is in it, and boxes around a cube are drawn about once each, not six times."""
    rng = np.random.default_rng(3)
    centres = rng.uniform(-4, 4, (60, 3))
    centres = centres[np.abs(centres).max(axis=1) > 1]
    boxes = [box(f"box {k}", centre, (0.2, 0.3, 0.1)) for k, centre in enumerate(centres)]
    ball = box("ball", (0, 0, 0), (0.5, 0.5, 0.5))
    camera = perspective_camera((0.5, -3.0, 1.5), (0, 0, 0.4), WIDTH, HEIGHT, 0.6)
    scene = snapshot([*boxes, ball], [], camera, WIDTH, HEIGHT, materials=[*[matte()] * len(boxes), mirror()], world=World())
    plan = planned(scene, Settings(effects=(Effect.REFLECTION,)))
    (cube,) = (each for each in plan.reflections.reflectors[0].maps if each.is_cube)
    drawn = [instances_in_face(cube, face, plan.bounds.corners_ws) for face in range(6)]
    for number, centre in enumerate(centres):
        places = centre + rng.uniform(-1, 1, (50, 3)) * (0.2, 0.3, 0.1) - cube.center_ws
        axis = np.abs(places).argmax(axis=1)
        faces = 2 * axis + (np.take_along_axis(places, axis[:, None], 1)[:, 0] < 0)
        assert all(number in drawn[face] for face in faces)
    assert sum(map(len, drawn)) < 2 * len(boxes)


def test_what_is_near_a_small_reflector_is_in_its_map_however_large_the_scene(device):
    """A ball of 4 cm in a box of 12 cm, on a ground of two kilometres."""
    half_m, radius_m, width, height = 0.06, 0.02, 64, 36
    walls, materials = colored_box(half_m)
    ball = bumpy_sphere("ball", (0, 0, 0), radius_m, 64, bump_share=0.0)
    camera = perspective_camera((-0.055, -0.02, 0.016), (0, 0, 0), width, height, 0.6)
    scene = snapshot(
        [*walls, ball, floor(1000.0, -0.1)],
        [],
        dataclasses.replace(camera, clip_start_m=0.001),
        width,
        height,
        materials=[*materials, mirror(), matte((0, 0, 0), (0.5, 0.5, 0.5))],
        world=World(),
    )
    image = render_passes(scene, device, reflection_sample_count=2, effects=(Effect.REFLECTION,))[REFLECTION_PASS_NAME]
    truth, to_edge, distance = mirrored_colors(camera, width, height, radius_m, half_m)
    judged = (distance < 0.95 * radius_m) & (to_edge > 0.1 * half_m)
    assert judged.sum() > 300
    assert np.abs(image - truth)[judged].max() < 0.01


def test_a_reflector_within_another_says_so(device):
    walls, materials = colored_box(3.0)
    outer, inner = (bumpy_sphere(name, (0, 0, 0), radius_m, 24, bump_share=0.0) for name, radius_m in (("outer", 0.8), ("inner", 0.3)))
    camera = perspective_camera((-2.6, -1.0, 0.8), (0, 0, 0), 64, 36, 0.6)
    scene = snapshot([*walls, outer, inner], [], camera, 64, 36, materials=[*materials, mirror(), mirror()], world=World())
    *_, last = render(scene, planned(scene, Settings(effects=(Effect.REFLECTION,), reflection_sample_count=2, bounces=1)), device)
    lines = last.statistics.reflections.reflectors
    assert "inner: skipped: within 'outer'" in lines
    assert any(line.startswith("outer: ") and "px in the picture" in line for line in lines)
    assert last.passes[REFLECTION_PASS_NAME].max() > 0.5


def test_hollows_count_from_wherever_they_are_seen():
    """A closed box has none, two beside each other have, of what is open both sides are seen; an angle has one from one side."""
    angle = Mesh(
        "angle",
        np.array([(0, 0, 0), (0, 1, 0), (1, 0, 1), (1, 1, 1), (-1, 0, 1), (-1, 1, 1)], np.float32),
        np.array([(0, 2, 3), (0, 3, 1), (0, 1, 5), (0, 5, 4)], np.int32),
    )
    plate = rectangle("plate", (-1, -1, 0), (2, 0, 0), (0, 2, 0))
    block = box("block", (0, 0, 0), (0.5, 0.5, 0.5))
    room = box("room", (0, 0, 0), (0.5, 0.5, 0.5), inside_out=True)
    two = joined("two", box("a", (-1, 0, 0), (0.3, 0.3, 0.3)), box("b", (1, 0, 0), (0.3, 0.3, 0.3)))
    above, below = ((0.3, 0.4, 9.0), (0.3, 0.4, -9.0))
    for mesh, eye_ws, expected in (
        (block, above, (True, True)),
        (plate, above, (True, True)),
        (plate, below, (True, True)),
        (angle, above, (False, False)),
        (angle, below, (False, True)),
        (room, above, (False, False)),
        (two, (-9.0, 0, 0), (False, False)),
    ):
        camera = perspective_camera(eye_ws, (0.1, 0.2, 0.1), WIDTH, HEIGHT, 0.6)
        scene = snapshot([mesh], [], camera, WIDTH, HEIGHT, materials=[mirror()], world=World())
        assert reflector_views.convexity(scene, np.array([0])) == expected, (mesh.name, eye_ws)


@pytest.mark.parametrize("height_m", [2.2, 20.0])
def test_parallel_cameras_see_hollows_wherever_they_are(height_m):
    """A step's hollow, which a parallel camera sees, though its place may lie behind the step's surfaces."""
    outline = [(3.0, 0.0), (5.2, 0.0), (5.0, 0.6), (4.4, 0.95), (4.2, 2.0), (3.0, 2.0)]
    positions = np.array([(x, y, z) for y in (-1, 1) for x, z in outline], np.float32)
    triangles = []
    for k in range(6):
        after = (k + 1) % 6
        triangles += [(k, after + 6, after), (k, k + 6, after + 6)]
    for k in range(1, 5):
        triangles += [(0, k, k + 1), (6, k + 7, k + 6)]
    step = Mesh("step", positions, np.array(triangles, np.int32), is_closed=True)
    walls, materials = colored_box(8.0)
    camera = camera_from_above((0, 0, 0), 12, WIDTH, HEIGHT, height_m)
    scene = snapshot([*walls, step], [], camera, WIDTH, HEIGHT, materials=[*materials, mirror()], world=World())
    (found,) = reflectors_of(scene).reflectors
    assert len(found.own_cubes) == OWN_CUBES
    assert found.itself is None and "not convex: cubes of itself besides" in found.reason


def test_cubes_of_reflectors_alone_take_no_memory_that_others_need():
    """They get smaller first and then go, before a map gets smaller than without them or a reflector goes without."""
    balls = [bumpy_sphere(f"ball {k}", (0.6 * (k % 8) - 2.1, 0.6 * (k // 8) - 2.1, 0.0), 0.28, 8, bump_share=0.2) for k in range(64)]
    camera = perspective_camera((0, -1, 5.5), (0, 0, 0), 1280, 720, 0.6)
    scene = snapshot(balls, [], camera, 1280, 720, materials=[mirror()] * 64, world=World())

    def planned_with(memory_mib):
        found = reflectors_of(scene, bounces=1, reflection_map_mib=memory_mib).reflectors
        assert sum(drawn.texel_count for each in found for drawn in each.maps) * BYTES_PER_TEXEL <= memory_mib << 20
        return found

    plenty = planned_with(4096)
    assert all(len(each.own_cubes) == OWN_CUBES and "memory" not in each.reason for each in plenty)
    others_mib = sum(drawn.texel_count for each in plenty for drawn in (each.seen, each.itself)) * BYTES_PER_TEXEL / (1 << 20)
    own_px = min(each.own_cubes[0].width_px for each in plenty)
    assert own_px > MAP_SIZE_STEP_PX
    least_own_mib = 64 * OWN_CUBES * 6 * MAP_SIZE_STEP_PX**2 * 4 / 3 * BYTES_PER_TEXEL / (1 << 20)
    for spare_mib, own_cubes, told in (
        (1.3 * least_own_mib, OWN_CUBES, "cubes besides smaller"),
        (1.0, 0, "no memory is left for cubes besides"),
    ):
        found = planned_with(int(np.ceil(others_mib + spare_mib)))
        for each, before in zip(found, plenty, strict=True):
            assert each.seen.width_px == before.seen.width_px and each.itself.width_px == before.itself.width_px
            assert len(each.own_cubes) == own_cubes and told in each.reason
            assert all(drawn.width_px < own_px for drawn in each.own_cubes)
    small = planned_with(16)
    assert all(each.seen is not None and not each.own_cubes for each in small)
    assert any(
        each.seen.width_px < before.seen.width_px and "smaller for all maps" in each.reason
        for each, before in zip(small, plenty, strict=True)
    )
