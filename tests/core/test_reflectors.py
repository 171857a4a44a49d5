"""Which objects reflect, and what is drawn for each."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.scenes import box, floor, matte, mirror, perspective_camera, rectangle, snapshot
from vir_addon.core.material import Constant, ImageSample, ImageTexels, Operation, TableLookup, World
from vir_addon.core.material_program import combined, typical_value
from vir_addon.core.passes.reflection_maps import instances_in_face
from vir_addon.core.plan import plan as planned
from vir_addon.core.settings import Effect, Settings

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


def test_a_leaning_mirror_is_flat_though_the_eye_is_within_its_box():
    glass = rectangle("glass", (-2, -2, 0), (4, 0, 0), (0, 4, 4))
    camera = perspective_camera((0.0, -1.0, 2.0), (0.0, 1.0, 2.5), WIDTH, HEIGHT, 0.6)
    scene = snapshot([floor(4.0), glass], [], camera, WIDTH, HEIGHT, materials=[matte(), mirror()], world=World())
    assert [each.method_text for each in reflectors_of(scene).reflectors] == ["planar"]


def test_reflectors_behind_the_camera_call_for_no_second_bounce():
    balls = [box(f"ball {k}", (0.2 * k, 1.0 if k == 0 else -8.0, 0.5), (0.5, 0.5, 0.5)) for k in range(20)]
    camera = perspective_camera((0.5, -3.0, 1.5), (0, 1, 0.4), WIDTH, HEIGHT, 0.6)
    scene = snapshot([floor(9.0), *balls], [], camera, WIDTH, HEIGHT, materials=[matte(), *[mirror()] * 20], world=World())
    found = reflectors_of(scene)
    assert found.bounces == 1
    assert [each.name for each in found.reflectors if each.runs] == ["ball 0"]


def test_small_reflectors_share_a_line_and_have_no_maps():
    rails = [box(f"rail {k}", (0.02 * (k % 103) - 1, 0.1 * (k // 103), 0.5), (0.002, 0.002, 0.02)) for k in range(309)]
    ball = box("ball", (0, 1, 0.5), (0.5, 0.5, 0.5))
    camera = perspective_camera((0.5, -3.0, 1.5), (0, 1, 0.4), WIDTH, HEIGHT, 0.6)
    scene = snapshot([*rails, ball], [], camera, WIDTH, HEIGHT, materials=[mirror()] * 310, world=World())
    found = reflectors_of(scene)
    assert [(each.name, each.runs) for each in found.reflectors] == [("ball", True), ("309 small reflectors", False)]
    assert (found.instance_maps(310)[:309] == -1).all()


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
    cube = plan.reflections.reflectors[0].seen
    drawn = [instances_in_face(cube, face, plan.bounds.corners_ws) for face in range(6)]
    for number, centre in enumerate(centres):
        places = centre + rng.uniform(-1, 1, (50, 3)) * (0.2, 0.3, 0.1) - cube.center_ws
        axis = np.abs(places).argmax(axis=1)
        faces = 2 * axis + (np.take_along_axis(places, axis[:, None], 1)[:, 0] < 0)
        assert all(number in drawn[face] for face in faces)
    assert sum(map(len, drawn)) < 2 * len(boxes)
