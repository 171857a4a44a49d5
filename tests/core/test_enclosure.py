"""Lights that something closes around: the plan finds them, and their passes are black without a map."""

import dataclasses

import numpy as np
import pytest

from tests.scenes import (
    area_light,
    box,
    bumpy_sphere,
    camera_from_above,
    floor,
    matte,
    mirror,
    perspective_camera,
    point_light,
    rectangle,
    render_passes,
    snapshot,
    spot_light,
    sun_light,
    with_opacity,
)
from vir_addon.core import mesh_topology
from vir_addon.core import plan as plan_module
from vir_addon.core.bounds import compute_bounds
from vir_addon.core.enclosure import camera_shells, sealing_object, shell_against
from vir_addon.core.material import World
from vir_addon.core.plan import PlannedOnce, plan
from vir_addon.core.render import render
from vir_addon.core.scene import LightShape, Mesh, OpacityMap
from vir_addon.core.settings import Effect, Method, Settings

WIDTH, HEIGHT = 64, 36
CAMERA = perspective_camera((0.0, -6.0, 2.5), (0.0, 0.0, 0.5), WIDTH, HEIGHT)
HALF = (0.5, 0.4, 0.3)
BOX = box("around", (0.0, 0.0, 0.3), HALF, turn_rad=0.3)
WITHIN = (0.02, 0.01, 0.3)
LIGHTS = {
    "rectangle": area_light(eye=WITHIN, target=(1, 0.2, 0.5), size_m=(0.4, 0.2)),
    # its corners come nearer to the walls than a ball around it could be
    "long rectangle": area_light(eye=WITHIN, target=(0.02, 0.01, 0.0), size_m=(0.1, 0.75)),
    "disc": area_light(eye=WITHIN, target=(0.02, 0.01, 5.0), size_m=(0.5, 0.5), shape=LightShape.ELLIPSE),
    "ball": point_light(eye=WITHIN, radius_m=0.25),
    "point": point_light(eye=WITHIN, radius_m=0.0),
    "spot": spot_light(eye=WITHIN, target=(1, 1, 0.1), radius_m=0.2),
}


def joined(*meshes):
    starts = np.cumsum([0, *(mesh.vertex_count for mesh in meshes[:-1])])
    triangles = np.concatenate([mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)])
    return Mesh("joined", np.concatenate([mesh.positions_os for mesh in meshes]), triangles.astype(np.int32))


def unwelded(mesh):
    """Each triangle with corners of its own: the same surface."""
    triangles = np.arange(3 * mesh.triangle_count, dtype=np.int32).reshape(-1, 3)
    return dataclasses.replace(mesh, positions_os=mesh.positions_os[mesh.triangles.ravel()], triangles=triangles)


def slit(mesh):
    """Along one edge, no wider than the next number."""
    apart = unwelded(mesh)
    apart.positions_os[0, 0] = np.nextafter(apart.positions_os[0, 0], np.float32(np.inf))
    return apart


def turned(mesh, axes):
    """axes: (3, 3), orthonormal rows"""
    centre = mesh.positions_os.mean(axis=0)
    return dataclasses.replace(mesh, positions_os=((mesh.positions_os - centre) @ axes + centre).astype(np.float32))


def without_a_face(mesh):
    return dataclasses.replace(mesh, triangles=mesh.triangles[:-1], is_closed=False)


def sealed_by(meshes, light, camera=CAMERA, **fields):
    scene = snapshot(meshes, [light], camera, WIDTH, HEIGHT, **fields)
    return sealing_object(scene, light, compute_bounds(scene))


@pytest.mark.parametrize("light", LIGHTS)
def test_a_box_closes_around_a_light(light):
    assert sealed_by([floor(), BOX], LIGHTS[light]) == "around"


@pytest.mark.parametrize(
    "mesh",
    [
        box("around", (0.0, 0.0, 0.3), HALF, inside_out=True),
        # walls of some thickness: two surfaces, of which the inner one is turned to the light
        joined(box("outer", (0.0, 0.0, 0.3), (0.6, 0.5, 0.35)), box("inner", (0.0, 0.0, 0.3), HALF, inside_out=True)),
        # what stands in the same mesh beside it closes nothing and is in nobody's way, open or not
        joined(rectangle("beside", (2, 2, 0), (1, 0, 0), (0, 1, 0)), BOX, box("aside", (3, 0, 0.5), (0.5, 0.5, 0.5))),
        bumpy_sphere("around", (0.0, 0.0, 0.3), 0.9, 16),
        unwelded(BOX),
    ],
    ids=["inside out", "with thick walls", "joined with others", "round", "of faces that share no vertices"],
)
def test_other_meshes_close_around_it(mesh):
    assert sealed_by([floor(), mesh], LIGHTS["rectangle"]) == mesh.name


INSIDE = perspective_camera((0.3, 0.1, 0.4), (-0.3, 0.0, 0.3), WIDTH, HEIGHT)
CUTTING = dataclasses.replace(perspective_camera((0.0, -0.7, 0.3), (0.0, 0.0, 0.3), WIDTH, HEIGHT), clip_start_m=0.4)
NOT_SEALED = {
    "open": ([without_a_face(BOX)], {}),
    "slit": ([slit(BOX)], {}),
    "does not cast": ([BOX], {"casts_shadow": [False]}),
    "the camera is inside": ([BOX], {"camera": INSIDE}),
    "the camera looks into it": ([BOX], {"camera": CUTTING}),
    "a cut-out": ([dataclasses.replace(BOX, opacity_map=OpacityMap("lace", np.zeros((2, 2), np.uint8), np.linspace(0, 1, 256)))], {}),
    "it is within another": ([box("around", (0.0, 0.0, 0.0), (9, 9, 9))], {}),
    # their boxes hold the light, they do not
    "beside it": ([joined(box("left", (-0.8, 0, 0.3), (0.3, 0.3, 0.3)), box("right", (0.8, 0, 0.3), (0.3, 0.3, 0.3)))], {}),
    "between two shells": ([joined(box("low", (0, 0, -0.2), (1, 1, 0.1)), box("high", (0, 0, 0.9), (1, 1, 0.1)))], {}),
}


SEES_ALL_BUT_THE_BOX = {"visible_to_camera": [False, True]}
SLANTED = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
BESIDE_THE_BOX = {
    "on a floor": (BOX, floor(), CAMERA),
    # the floor runs on below it along all of its axes
    "slanted over a floor": (turned(BOX, SLANTED), floor(6.0, -0.5), CAMERA),
    # in a corner of its box
    "a ball by a ball": (bumpy_sphere("around", (0.0, 0.0, 0.3), 0.9, 32), bumpy_sphere("ball", (0.7, 0.7, 1.0), 0.2, 16), CAMERA),
    "in a hollow": (BOX, bumpy_sphere("hollow", (0.0, 0.0, 0.0), 4.0, 64), CAMERA),
    "the camera inside": (BOX, floor(), INSIDE),
}


@pytest.mark.parametrize("case", BESIDE_THE_BOX)
def test_a_box_that_the_camera_does_not_see_closes_around_a_light_for_all_that_it_sees(case):
    around, other, camera = BESIDE_THE_BOX[case]
    assert sealed_by([around, other], LIGHTS["ball"], camera, **SEES_ALL_BUT_THE_BOX) == "around"
    # what it is held against is scaled, mirrored and moved as an instance, too
    matrix = np.diag([-2.0, 2.0, 2.0, 1.0]).astype(np.float32)
    other = dataclasses.replace(other, positions_os=(other.positions_os @ np.linalg.inv(matrix[:3, :3]).T).astype(np.float32))
    matrices = np.stack([np.eye(4, dtype=np.float32), matrix])
    assert sealed_by([around, other], LIGHTS["ball"], camera, transforms=matrices, **SEES_ALL_BUT_THE_BOX) == "around"


SEEN_IN_THE_BOX = {
    "a lamp's socket": rectangle("within", (0.3, 0.1, 0.2), (0.05, 0, 0), (0, 0.05, 0)),
    "a pole through its lid": box("pole", (0.3, 0.1, 1.0), (0.02, 0.02, 0.8)),
    # none of its corners is near
    "a floor through it": floor(6.0, 0.1),
    "one beyond the box and one within": joined(floor(6.0, -2.0), bumpy_sphere("near", (0.3, 0.1, 0.2), 0.02, 8)),
}


@pytest.mark.parametrize("case", SEEN_IN_THE_BOX)
def test_a_box_that_the_camera_does_not_see_leaves_light_to_what_it_sees_within(case):
    around = turned(BOX, SLANTED) if case.startswith("a floor") else BOX
    assert sealed_by([around, SEEN_IN_THE_BOX[case]], LIGHTS["point"], **SEES_ALL_BUT_THE_BOX) is None
    assert sealed_by([around, SEEN_IN_THE_BOX[case]], LIGHTS["point"], visible_to_camera=[False, False]) == "around"


@pytest.mark.parametrize("case", NOT_SEALED)
def test_what_does_not_seal_a_light(case):
    meshes, fields = NOT_SEALED[case]
    assert sealed_by(meshes, LIGHTS["ball"], **fields) is None


def test_lights_that_nothing_seals():
    """One that the box does not block, one without shadows, a sun."""
    assert sealed_by([BOX], dataclasses.replace(LIGHTS["ball"], blockers=np.array([False]))) is None
    assert sealed_by([BOX], dataclasses.replace(LIGHTS["ball"], casts_shadow=False)) is None
    assert sealed_by([BOX], sun_light(eye=WITHIN)) is None


@pytest.mark.parametrize("shape", [LightShape.RECTANGLE, LightShape.ELLIPSE, LightShape.POINT])
def test_a_light_that_reaches_through_a_wall_is_not_sealed(shape):
    """Its size decides: within a box of 1 x 0.8 x 0.6 m, level, turned with it."""
    for size_m, is_within in ((0.55, True), (0.75, shape is not LightShape.POINT), (0.85, False), (2.5, False)):
        if shape is LightShape.POINT:
            light = point_light(eye=(0.0, 0.0, 0.3), radius_m=size_m / 2)
        else:
            # it looks along x, so that its sides are the box's across y, and its height is 0.55
            light = area_light(eye=(0.0, 0.0, 0.3), target=(1.0, 0.0, 0.3), size_m=(size_m, 0.55), shape=shape)
        found = sealed_by([box("around", (0.0, 0.0, 0.3), HALF)], light)
        assert (found == "around") == is_within, size_m


def test_inside_and_outside_are_those_of_the_solid_angle():
    """Of balls with bumps and rings, turned, scaled and mirrored at random, and points anywhere: against the sum of the triangles' solid
    angles (Van Oosterom & Strackee 1983)."""
    random = np.random.default_rng(11)
    counts = [0, 0]
    for k in range(120):
        ball = bumpy_sphere("ball", (0, 0, 0), 1.0, int(random.integers(4, 24)), bump_share=random.choice([0.0, 0.3, 0.6]))
        matrix = np.eye(4)
        matrix[:3, :3] = np.linalg.qr(random.normal(size=(3, 3)))[0] * random.uniform(0.2, 3.0, 3)
        matrix[:3, 3] = random.uniform(-0.3, 0.3, 3)
        mesh = ball if k % 3 else joined(ball, bumpy_sphere("within", (0.2, 0, 0), 0.3, 8))
        eye = matrix[:3, :3] @ random.uniform(-1.2, 1.2, 3) + matrix[:3, 3]
        camera = perspective_camera((30.0, 0.0, 0.0), (0.0, 0.0, 0.0), WIDTH, HEIGHT)
        found = sealed_by([mesh], point_light(eye=eye, radius_m=0.0), camera, transforms=matrix[None].astype(np.float32))
        corners = mesh.positions_os.astype(np.float64) @ matrix[:3, :3].astype(np.float32).T.astype(np.float64) + matrix[:3, 3] - eye
        a, b, c = np.moveaxis(corners[mesh.triangles], 1, 0)
        la, lb, lc = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
        dots = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
        windings = 2 * np.arctan2(np.einsum("ij,ij->i", a, np.cross(b, c)), dots).sum() / (4 * np.pi)
        assert (found is not None) == (abs(windings) > 0.5), (k, windings)
        counts[found is not None] += 1
    assert min(counts) > 25


def test_parts_are_those_that_a_search_finds():
    random = np.random.default_rng(3)
    for vertex_count, triangle_count in ((6, 2), (60, 12), (400, 120), (3000, 1400)):
        triangles = random.integers(0, vertex_count, (triangle_count, 3)).astype(np.int32)
        follow = {k: {k} for k in range(vertex_count)}
        for a, b, c in triangles.tolist():
            together = follow[a] | follow[b] | follow[c]
            for vertex in together:
                follow[vertex] = together
        expected = np.array([min(follow[a]) for a in triangles[:, 0].tolist()])
        np.testing.assert_array_equal(mesh_topology.parts_of(triangles, vertex_count), expected)


RESOLUTIONS_PX = (16, 50, 333, 2048)


@pytest.mark.parametrize("method", Method)
@pytest.mark.parametrize("height_m", [0.0, 0.001, 0.03])
def test_nothing_leaves_a_box_on_or_above_a_floor(device, method, height_m):
    """Where maps cannot tell a floor from the box's bottom, nothing has to."""
    light = LIGHTS["ball"] if method is Method.EPR else LIGHTS["rectangle"]
    around = dataclasses.replace(BOX, positions_os=BOX.positions_os + np.float32([0, 0, height_m]))
    for resolution_px in RESOLUTIONS_PX:
        scene = snapshot([floor(4.0), around], [light], CAMERA, WIDTH, HEIGHT)
        settings = Settings(method=method, view_count=8, map_resolution_px=resolution_px)
        (line,) = plan(scene, settings).passes
        assert line.runs and not line.needs_maps and "'around' closes around it" in line.reason
        *_, progress = render(scene, plan(scene, settings), device)
        assert set(np.unique(progress.passes["VIR Shadow Key"])) == {0.0, 1.0}
        (made,) = progress.statistics.passes
        assert made.method == "none" and made.map_resolution_px == 0 and "splat or raster" not in made.stage_ms


def test_the_maps_leak_where_the_plan_would_not_know(device):
    """What the last test is about: without the plan's knowledge a strip of the floor beside the box is lit in coarse maps."""
    scene = snapshot([floor(4.0), slit(BOX)], [LIGHTS["ball"]], CAMERA, WIDTH, HEIGHT)
    image = render_passes(scene, device, view_count=8, map_resolution_px=16)["VIR Shadow Key"]
    assert ((image > 0) & (image < 1)).any()


@pytest.mark.parametrize("method", [Method.MVR, Method.PCSS])
def test_a_sealed_light_weighs_in_the_combined_pass(device, method):
    """A picture without shadows has its light, so the combined pass has to take it away; as where maps find out."""
    lights = [LIGHTS["rectangle"], point_light("Lamp", eye=(1.5, -1.0, 2.0), strength=30.0, radius_m=0.1)]
    images = {}
    for name, mesh in (("planned", BOX), ("looked up", slit(BOX))):
        scene = snapshot([floor(4.0), mesh], lights, CAMERA, WIDTH, HEIGHT)
        images[name] = render_passes(scene, device, method=method, view_count=64, map_resolution_px=1024)
    planned, looked_up = images["planned"]["VIR Shadow"], images["looked up"]["VIR Shadow"]
    assert np.abs(planned - looked_up).mean() < 0.004
    assert np.array_equal(images["planned"]["VIR Shadow Lamp"], images["looked up"]["VIR Shadow Lamp"])
    # not as if it were left out
    assert np.abs(planned - images["planned"]["VIR Shadow Lamp"]).max() > 0.2


@pytest.mark.parametrize("method", [Method.MVR, Method.PCSS])
def test_a_sealed_light_leaves_the_steps_to_the_others(method):
    """However many samples it would have: those that fit into the batches of the others weigh it. Alone it has as many batches as it would
    have with maps."""
    sealed, lamp = dataclasses.replace(LIGHTS["rectangle"], own_view_count=1024), point_light("Lamp", eye=(1.5, -1.0, 2.0), radius_m=0.1)
    for resolution_px, batch_view_count, most in ((256, 8, 8), (256, 4, 4), (4096, 8, 2)):
        settings = Settings(method=method, view_count=128, map_resolution_px=resolution_px, batch_view_count=batch_view_count)
        alone, both, dark, mapped = (
            plan(snapshot([floor(4.0), around], lights, CAMERA, WIDTH, HEIGHT), settings)
            for around, lights in ((BOX, [lamp]), (BOX, [sealed, lamp]), (BOX, [sealed]), (slit(BOX), [sealed]))
        )
        assert both.has_same_steps(alone) and dark.has_same_steps(mapped)
        key, other = both.passes
        assert key.is_sealed and key.view_count == most * both.batch_count and other.view_count == alone.passes[0].view_count


def test_what_reflectors_show_is_lit_as_before(device):
    """They may show what the camera does not see from outside: a mirror that does not show the box shows what is lit within."""
    inner = box("inner", (0.25, 0.1, 0.1), (0.05, 0.05, 0.1))
    scene = snapshot(
        [floor(4.0), BOX, inner, rectangle("mirror", (-2, 2, 0), (4, 0, 0), (0, 0, 2))],
        [LIGHTS["rectangle"], area_light("Above")],
        CAMERA,
        WIDTH,
        HEIGHT,
        materials=[matte(), matte(), matte(), mirror()],
        world=World(),
    )
    hidden = dataclasses.replace(scene.instances, visible_in_reflections=np.array([True, False, True, True]))
    dark, lit = {}, {}
    for name, shown in (("with the box", scene), ("without", dataclasses.replace(scene, instances=hidden))):
        arguments = {"effects": (Effect.SHADOW, Effect.REFLECTION), "view_count": 8, "map_resolution_px": 256}
        lit[name] = render_passes(shown, device, **arguments)
        dark[name] = render_passes(dataclasses.replace(shown, lights=shown.lights[:1]), device, **arguments)["VIR Reflection"]
        assert set(np.unique(lit[name]["VIR Shadow Key"])) == {0.0, 1.0}
        assert dark[name].max() > 0.05
    np.testing.assert_allclose(lit["with the box"]["VIR Reflection"], dark["with the box"], atol=1e-3)
    assert (lit["without"]["VIR Reflection"] - dark["without"]).max() > 1


def test_an_orthographic_camera_is_outside_of_what_is_wholly_below_it():
    above = camera_from_above((0.0, 0.0), 3.0, WIDTH, HEIGHT)
    assert sealed_by([BOX], LIGHTS["ball"], above) == "around"
    within = dataclasses.replace(above, clip_start_m=19.5)
    assert sealed_by([BOX], LIGHTS["ball"], within) is None


# around the camera

ROOM = box("room", (0.0, 0.0, 1.5), (4.0, 3.0, 1.5))
TABLE = box("table", (0.3, 0.5, 0.4), (0.6, 0.4, 0.4))
INSIDE = perspective_camera((-3.5, -2.5, 1.6), (1.0, 1.0, 1.0), WIDTH, HEIGHT)
OUTSIDE = {
    "sun": sun_light(angle_rad=0.1),
    "lamp": point_light(eye=(0.0, 0.0, 5.0), radius_m=0.3),
    "rectangle": area_light(eye=(1.0, 0.5, 6.0), size_m=(1.0, 1.0)),
    "spot": spot_light(eye=(0, -8, 5), target=(0, 0, 1)),
}


def shell_of(meshes, light, camera=INSIDE, **fields):
    scene = snapshot(meshes, [light], camera, WIDTH, HEIGHT, **fields)
    return shell_against(scene, light, camera_shells(scene, compute_bounds(scene)))


@pytest.mark.parametrize("light", OUTSIDE)
def test_a_room_around_the_camera_keeps_light_out(light):
    assert shell_of([floor(20.0, -0.1), ROOM, TABLE], OUTSIDE[light]) == "room"


@pytest.mark.parametrize(
    ("meshes", "light", "camera", "fields"),
    [
        ([without_a_face(ROOM)], "sun", INSIDE, {}),
        ([slit(ROOM)], "sun", INSIDE, {}),
        ([ROOM, TABLE], "sun", perspective_camera((0.0, -8.0, 2.5), (0.0, 0.0, 0.5), WIDTH, HEIGHT), {}),
        # a wall cuts the window where rays start
        ([ROOM, TABLE], "sun", perspective_camera((-3.999, -2.5, 1.6), (-5.0, -2.5, 1.6), WIDTH, HEIGHT), {}),
        ([ROOM, TABLE], "sun", INSIDE, {"casts_shadow": [False, True]}),
        # the camera sees through it
        ([ROOM, TABLE], "sun", INSIDE, {"visible_to_camera": [False, True]}),
        ([with_opacity(ROOM, np.full((2, 2), 0.5), np.zeros((ROOM.vertex_count, 2))), TABLE], "sun", INSIDE, {}),
    ],
    ids=["open", "slit", "camera outside", "camera in a wall", "casts no shadow", "unseen", "cut out"],
)
def test_what_lets_light_in_or_shows_what_is_outside(meshes, light, camera, fields):
    assert shell_of(meshes, OUTSIDE[light], camera, **fields) is None


@pytest.mark.parametrize(
    "eye", [(1.0, 1.0, 2.0), (1.0, 1.0, 3.2), (3.9, 1.0, 1.0)], ids=["inside", "through the ceiling", "through a wall"]
)
def test_lamps_that_are_in_the_room_or_reach_into_it(eye):
    assert shell_of([ROOM, TABLE], point_light(eye=eye, radius_m=0.5)) is None


@pytest.mark.parametrize("method", [Method.MVR, Method.MICRO, Method.IVIR])
def test_no_sun_along_the_joints_of_a_closed_room(device, method):
    """Of walls without thickness maps show light at their feet and at the ceiling."""
    lights = [sun_light("Sun", eye=(3.0, -2.0, 9.0), angle_rad=0.01), point_light("Lamp", eye=(0.0, 0.0, 2.5), radius_m=0.1)]
    scene = snapshot([floor(20.0, -0.1), ROOM, TABLE], lights, INSIDE, WIDTH, HEIGHT)
    planned = plan(scene, Settings(method=method, view_count=16, map_resolution_px=256))
    *_, progress = render(scene, planned, device)
    assert not progress.passes["VIR Shadow Sun"].any()
    assert progress.passes["VIR Shadow Lamp"].max() == 1.0
    assert "'room' closes around the camera" in next(line.reason for line in planned.passes if line.light_name == "Sun")


def test_what_closes_around_the_camera_is_looked_for_where_something_asks(monkeypatch):
    """Once for plans of one snapshot, and not at all where no light has anything to do."""
    searched = []
    monkeypatch.setattr(plan_module, "camera_shells", lambda *inputs: searched.append(inputs) or camera_shells(*inputs))
    sun = sun_light("Sun", eye=(3.0, -2.0, 9.0))
    scene = snapshot([floor(20.0, -0.1), ROOM, TABLE], [dataclasses.replace(sun, casts_shadow=False)], INSIDE, WIDTH, HEIGHT)
    plan(scene, Settings(effects=(Effect.SHADOW,)))
    assert not searched
    scene, once = dataclasses.replace(scene, lights=(sun,)), PlannedOnce()
    first, second = (plan(scene, Settings(effects=(Effect.SHADOW,), view_count=views), once=once) for views in (8, 16))
    assert len(searched) == 1
    assert first.passes[0].reason == second.passes[0].reason == plan(scene, Settings(effects=(Effect.SHADOW,))).passes[0].reason
