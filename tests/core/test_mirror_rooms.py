"""What mirrors show that are around the eye, against float64 rays through the triangles."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.ray_tracing import intersect, world_triangles
from tests.scenes import box, bumpy_sphere, matte, mirror, perspective_camera, point_light, prepared_renderer, render_passes, snapshot
from vir_addon.core.material import World
from vir_addon.core.pass_set import REFLECTION_PASS_NAME
from vir_addon.core.passes.reflection_maps import BYTES_PER_TEXEL
from vir_addon.core.passes.reflections import REFLECTED_SURFACE
from vir_addon.core.passes.tiles import spread_to_pixels
from vir_addon.core.plan import plan
from vir_addon.core.settings import Effect, Settings

WIDTH, HEIGHT = 96, 54
BOXES = [
    ((0.9, 0.6, -0.5), (0.4, 0.4, 0.4)),
    ((-0.7, 0.9, 0.3), (0.3, 0.5, 0.3)),
    ((0.0, -1.3, -0.5), (0.5, 0.3, 0.3)),
    ((0.3, 0.5, 0.9), (0.6, 0.2, 0.2)),
    ((-0.6, -0.2, -0.8), (0.3, 0.3, 0.5)),
]
ROOMS = {
    "ball": bumpy_sphere("room", (0, 0, 0), 3.0, 48, bump_share=0.0),
    "room": box("room", (0, 0, 0), (3.0, 3.0, 2.5), inside_out=True),
}
REFLECTING = {"effects": (Effect.REFLECTION,), "bounces": 1, "reflection_sample_count": 1}


def room_with_boxes(room, **fields):
    camera = perspective_camera((0.2, -0.6, 0.1), (0.1, 1.0, 0.0), WIDTH, HEIGHT, 0.8)
    meshes = [room, *(box(f"box {k}", centre, half) for k, (centre, half) in enumerate(BOXES))]
    materials = [mirror(), *[matte()] * len(BOXES)]
    return snapshot(meshes, [], camera, WIDTH, HEIGHT, materials=materials, **{"world": World((0.3, 0.3, 0.3)), **fields})


def first_met(scene, origins, directions):
    """(n,) instance and metres along each ray, in float64"""
    triangles = world_triangles(scene)
    instance, metres = [], []
    for first in range(0, len(origins), 256):
        along, _ = intersect(origins[first : first + 256], directions[first : first + 256], triangles.corners)
        along[along <= 1e-3] = np.inf
        instance.append(triangles.instance[along.argmin(axis=1)])
        metres.append(along.min(axis=1))
    return np.concatenate(instance), np.concatenate(metres)


@pytest.mark.parametrize("name", ROOMS)
def test_rays_meet_what_things_in_a_mirror_room_hide_from_the_eye(device, name):
    """Rays from all around pass behind boxes, and meet their rear sides or each other there."""
    scene = room_with_boxes(ROOMS[name])
    with prepared_renderer(scene, device, **REFLECTING) as renderer:
        work = renderer.reflections
        found = (work.rays["ray_origins"], work.rays["ray_directions"], work.hits[0][0].buffer.positions, work.surfaces)
        origins, directions, positions, surfaces = (device.run(device.read, texture).astype(np.float64) for texture in found)
        shown = (origins[..., 3] >= 0) & spread_to_pixels(work.tiles_shown, WIDTH, HEIGHT)
    origins, positions, how = origins[shown][:, :3], positions[shown], surfaces[shown][:, 3].astype(int)
    instance, metres = first_met(scene, origins, directions[shown][:, :3])
    is_wrong = positions[:, 3] != instance
    is_elsewhere = is_wrong | (np.abs(np.linalg.norm(positions[:, :3] - origins, axis=1) - metres) > 0.02 * (1 + metres))
    assert len(instance) > 3000
    assert 0.05 < (instance > 0).mean() < 0.95
    assert is_wrong.mean() < 0.01, f"{is_wrong.sum()} of {len(is_wrong)}"
    assert is_elsewhere.mean() < 0.01, f"{is_elsewhere.sum()} of {len(is_wrong)}"
    assert is_elsewhere[how == REFLECTED_SURFACE].mean() < 0.008
    assert (how == REFLECTED_SURFACE).mean() > 0.9


def test_what_has_passed_behind_something_does_not_count_as_met(device):
    """Without memory for cubes elsewhere rays meet the wrong things there, and say that they may."""
    scene = room_with_boxes(ROOMS["room"])
    cube = plan(scene, Settings(**REFLECTING)).reflections.reflectors[0].seen
    memory_mib = int(np.ceil(cube.texel_count * BYTES_PER_TEXEL / (1 << 20)))
    with prepared_renderer(scene, device, **REFLECTING, reflection_map_mib=memory_mib) as renderer:
        found = renderer.reflections.statistics
    assert found.map_count == 1 and "no memory is left for cubes besides" in found.reflectors[0]
    assert found.behind_share > 0.1
    assert found.found_share + found.behind_share + found.by_direction_share + found.left_share == pytest.approx(1.0)


def test_cubes_elsewhere_lie_in_the_room_and_in_nothing_else():
    """In a room with a niche that the eye does not see into, and a box as wide as half of the room."""
    wide = box("wide", (1.5, 0.0, 0.0), (1.4, 2.0, 2.0))
    camera = perspective_camera((-1.5, -1.0, 0.1), (-1.5, 1.0, 0.0), WIDTH, HEIGHT, 0.8)
    materials = [mirror(), matte()]
    scene = snapshot([ROOMS["room"], wide], [], camera, WIDTH, HEIGHT, materials=materials, world=World())
    (room,) = plan(scene, Settings(**REFLECTING)).reflections.reflectors
    assert len(room.elsewhere) == 2
    for each in room.elsewhere:
        place = each.center_ws
        assert (np.abs(place) < (3, 3, 2.5)).all() and not (np.abs(place - (1.5, 0, 0)) < (1.4, 2.0, 2.0)).all()
        assert np.linalg.norm(place - camera.world_from_view[:3, 3]) > 1
    # a pillar from floor to ceiling that the eye is behind belongs to the room: places beyond it may be outside
    pillar = box("room", (-1.5, 0.9, 0.0), (1.45, 0.3, 2.45))
    joined = dataclasses.replace(
        ROOMS["room"],
        positions_os=np.concatenate([ROOMS["room"].positions_os, pillar.positions_os]),
        triangles=np.concatenate([ROOMS["room"].triangles, pillar.triangles + len(ROOMS["room"].positions_os)]),
    )
    scene = snapshot([joined], [], camera, WIDTH, HEIGHT, materials=[mirror()], world=World())
    (room,) = plan(scene, Settings(**REFLECTING)).reflections.reflectors
    assert len(room.elsewhere) == 2
    for each in room.elsewhere:
        assert each.center_ws[1] < 0.6 or each.center_ws[0] > -0.05


def test_no_ray_looks_for_a_world_that_something_closed_hides():
    """Where what is closed is not seen in reflections, or is open, or something shines, rays are looked along as before."""

    def planned(scene):
        return plan(scene, Settings(**REFLECTING))

    closed = room_with_boxes(ROOMS["ball"])
    visible = np.arange(len(closed.instances)) > 0
    hidden = dataclasses.replace(closed, instances=dataclasses.replace(closed.instances, visible_in_reflections=visible))
    triangles = ROOMS["ball"].triangles
    opened = room_with_boxes(dataclasses.replace(ROOMS["ball"], triangles=np.delete(triangles, len(triangles) // 2, axis=0)))
    shining = dataclasses.replace(closed, materials=(*closed.materials[:-1], matte((0, 0, 0), (1, 1, 1))))
    assert not planned(closed).has_surroundings
    assert all(planned(scene).has_surroundings for scene in (hidden, opened, shining))
    assert planned(closed).predicted_ms < 0.8 * planned(opened).predicted_ms


def test_the_world_outside_of_what_is_closed_changes_nothing_within(device):
    light = point_light(eye=(0.0, 0.5, 2.0), radius_m=0.0, strength=50.0, strength_rgb=(50.0, 40.0, 30.0))
    images = []
    for world in (World((0.3, 0.3, 0.3)), World()):
        scene = dataclasses.replace(room_with_boxes(ROOMS["ball"], world=world), lights=(light,))
        settings = {**REFLECTING, "reflection_sample_count": 2, "view_count": 1}
        images.append(render_passes(scene, device, **settings)[REFLECTION_PASS_NAME])
    assert images[0].max() > 0.1
    np.testing.assert_array_equal(*images)
