"""Cubes from one cloud against those that the rasterizer draws one by one, and against rays."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.core.test_reflections import nearest_instance
from tests.scenes import (
    box,
    bumpy_sphere,
    floor,
    matte,
    mirror,
    perspective_camera,
    point_light,
    prepared_renderer,
    rectangle,
    render_passes,
    rmse,
    snapshot,
    with_opacity,
)
from vir_addon.core.cost import cubes_ms
from vir_addon.core.material import World
from vir_addon.core.methods import reflected_points
from vir_addon.core.methods.linear_store import LinearStore
from vir_addon.core.methods.reflected_points import ReflectedPoints
from vir_addon.core.pass_set import REFLECTION_PASS_NAME
from vir_addon.core.plan import plan as planned
from vir_addon.core.settings import Effect, ReflectionMethod, Settings

WIDTH, HEIGHT = 160, 90
METHODS = (ReflectionMethod.IVIR, ReflectionMethod.EPR)


def room_with_balls(rows: int = 40):
    """Walls that cross all faces of cubes, bumpy balls of triangles of a texel and far less, one of them mirrored, and two mirror balls."""
    walls = box("room", (0, 0, 2), (5, 5, 2), inside_out=True)
    balls = [bumpy_sphere(f"ball {k}", (1.4 * np.cos(k), 1.4 * np.sin(k), 0.5), 0.4, rows) for k in range(4)]
    mirrors = [bumpy_sphere(f"mirror {k}", (0.5 * k - 0.3, 0.3 * k, 1.1), 0.25, 16, bump_share=0.0) for k in range(2)]
    transforms = np.tile(np.eye(4), (7, 1, 1))
    transforms[2, 0, 0] = -1
    camera = perspective_camera((0.4, -3.5, 1.6), (0, 0, 0.9), WIDTH, HEIGHT, 0.35)
    materials = [matte((0.7, 0.6, 0.5)), *[matte((0.2, 0.2 * k, 0.8)) for k in range(4)], mirror(), mirror()]
    light = point_light(eye=(1, -2, 3.5), radius_m=0.0)
    meshes = [walls, *balls, *mirrors]
    return snapshot(meshes, [light], camera, WIDTH, HEIGHT, transforms=transforms, materials=materials, world=World((0.2, 0.2, 0.2)))


def drawn_cubes(scene, device, method, **settings):
    """(n, 2) int64 instance and triangle of every texel of the finest levels of all cubes, -1: none; and the maps."""
    settings = {"effects": (Effect.REFLECTION,), "reflection_sample_count": 2, "bounces": 1, "view_count": 1, **settings}
    with prepared_renderer(scene, device, reflection_method=method, **settings) as renderer:
        maps = renderer.reflections.maps
        assert all(each.method is method for each in maps.maps if each.is_cube)
        texels = device.read(maps.texels).reshape(-1, 4)
        statistics = renderer.reflections.statistics
    found, first = [], 0
    for each in maps.maps:
        count = each.face_count * each.width_px * each.height_px
        if each.is_cube:
            found.append(texels[first : first + count, 2:])
        first += each.texel_count
    assert found
    return np.concatenate(found).astype(np.int64), maps.maps, statistics


def test_without_culling_splats_are_the_rasterizers_picture(device):
    scene = room_with_balls()
    rasterized, maps, _ = drawn_cubes(scene, device, ReflectionMethod.MVR)
    splatted, same_maps, statistics = drawn_cubes(scene, device, ReflectionMethod.EPR, stochastic_culling=False)
    assert [each.width_px for each in maps] == [each.width_px for each in same_maps]
    assert statistics.cloud_triangle_count > 20_000 and statistics.splatted_map_count == 2
    # a texel's centre on an edge, as nearly as float32 can tell
    assert (splatted[:, 0] != rasterized[:, 0]).mean() < 0.0005
    assert (splatted != rasterized).any(axis=1).mean() < 0.005


def test_splats_are_what_rays_from_the_cubes_centres_meet(device):
    """In float64, through every thirty-seventh texel's centre."""
    scene = room_with_balls(rows=10)
    splatted, (cube, *_), _ = drawn_cubes(scene, device, ReflectionMethod.EPR, stochastic_culling=False)
    side = cube.width_px
    numbers = np.arange(0, 6 * side**2, 37)
    face, row, column = numbers // side**2, numbers // side % side, numbers % side
    tangents = (np.stack([column, row], axis=1) + 0.5) * 2 / side - 1
    axes = np.stack([cube.face_axes(k) for k in range(6)])[face]
    directions = np.einsum("nij,ni->nj", axes, np.column_stack([tangents, np.ones(len(tangents))]))
    (own,) = set(range(7)) - set(cube.instances.tolist())
    met = nearest_instance(scene, np.broadcast_to(cube.center_ws, directions.shape), directions, leave_out=own)
    assert len(set(met.tolist())) == 6
    assert (splatted[numbers, 0] != met).mean() < 0.002


SPARSE = {"points_per_eye_pixel": 0.001}


@pytest.mark.parametrize(("method", "density"), [*((each, {}) for each in METHODS), (ReflectionMethod.EPR, SPARSE)])
def test_culled_clouds_leave_no_holes_and_move_outlines_by_less_than_a_sample(device, method, density):
    scene = room_with_balls(rows=120)
    rasterized, maps, _ = drawn_cubes(scene, device, ReflectionMethod.MVR)
    splatted, _, statistics = drawn_cubes(scene, device, method, **density)
    assert statistics.cloud_triangle_count + statistics.point_count < 0.7 * scene.instanced_triangle_count
    # what is another instance is next to where the rasterizer has it
    first = 0
    for each in maps:
        side = each.width_px
        own, truth = (texels[first : first + 6 * side**2, 0].reshape(6, side, side)[:, 1:-1, 1:-1] for texels in (splatted, rasterized))
        wide = rasterized[first : first + 6 * side**2, 0].reshape(6, side, side)
        around = [wide[:, 1 + y : side - 1 + y, 1 + x : side - 1 + x] for y in (-1, 0, 1) for x in (-1, 0, 1)]
        near, near_balls = [each == own for each in around], [each >= 1 for each in around]
        # a hole in a ball would show the wall behind it
        assert not (np.all(near_balls, axis=0) & (own == 0)).any()
        assert (np.all(near_balls, axis=0)).sum() > 500
        if not density:
            assert (own != truth).mean() < 0.02
            assert (~np.any(near, axis=0)).mean() < 0.001
        assert (own != truth).any()
        first += 6 * side**2


@pytest.mark.parametrize(("rows", "share"), [(24, 0.02), (120, 0.1)])
def test_pictures_are_those_of_rasterized_cubes(device, rows, share):
    """Also of balls of which most triangles are left out."""
    scene = room_with_balls(rows)
    settings = {"effects": (Effect.REFLECTION,), "reflection_sample_count": 2, "bounces": 1, "view_count": 1}
    truth, *images = (
        render_passes(scene, device, reflection_method=each, **settings)[REFLECTION_PASS_NAME] for each in (ReflectionMethod.MVR, *METHODS)
    )
    assert truth.std() > 0.1
    for image in images:
        assert rmse(image, truth) < share * truth.std()


@pytest.mark.parametrize("method", [ReflectionMethod.EPR, ReflectionMethod.IVIR])
def test_the_same_cloud_in_every_run_and_in_any_number_of_portions(device, method, monkeypatch):
    """Portion by portion and cube by cube, so that a caller can draw or stop in between."""
    scene = room_with_balls(rows=90)
    collected, steps = [], []
    collect, drawing = ReflectedPoints._collect, ReflectedPoints.drawing

    def collect_noted(self, portion):
        collected.append(len(steps))
        return collect(self, portion)

    def drawing_counted(self):
        for step in drawing(self):
            steps.append(step)
            yield step

    monkeypatch.setattr(ReflectedPoints, "_collect", collect_noted)
    monkeypatch.setattr(ReflectedPoints, "drawing", drawing_counted)
    once, _, _ = drawn_cubes(scene, device, method)
    again, _, _ = drawn_cubes(scene, device, method)
    np.testing.assert_array_equal(again, once)
    collected.clear()
    in_portions, _, statistics = drawn_cubes(scene, device, method, replay_buffer_mib=1)
    # a portion is collected twice in a step where there was no room for it
    assert len(collected) > 10 and max(np.bincount(collected)) <= 2
    assert 48 * statistics.cloud_triangle_count + 32 * statistics.point_count > 2 << 20
    np.testing.assert_array_equal(in_portions, once)


def test_as_many_tiles_at_a_time_as_there_is_memory_for(device, monkeypatch):
    """What is large in cubes comes in smaller portions, and to the same."""
    scene = room_with_balls(rows=4)
    counts = []
    splat = ReflectedPoints._splat_triangles

    def splat_counted(self, **bindings):
        is_splatted = splat(self, **bindings)
        counts.append(self._batch_tile_count * is_splatted)
        return is_splatted

    monkeypatch.setattr(ReflectedPoints, "_splat_triangles", splat_counted)
    once, _, _ = drawn_cubes(scene, device, ReflectionMethod.EPR)
    all_count, counts[:] = max(counts), []
    monkeypatch.setattr(reflected_points, "FIRST_TILE_CAPACITY", 1)
    monkeypatch.setattr(reflected_points, "MAX_TILES", 1)
    monkeypatch.setattr(reflected_points, "LinearStore", unpadded_store)
    in_portions, _, _ = drawn_cubes(scene, device, ReflectionMethod.EPR)
    assert 0 < max(counts) < all_count
    np.testing.assert_array_equal(in_portions, once)


def unpadded_store(device, texel_count):
    """Of as many texels as asked for, though rows of textures have more."""
    store = LinearStore(device, texel_count)
    store.texel_count = texel_count
    return store


def test_cut_outs_stand_before_and_behind_what_is_splatted(device):
    """A leaf with a hole between a mirror ball and a wall, another behind a screen."""
    hole = np.ones((8, 8))
    hole[3:5, 3:5] = 0
    uvs = [(0, 0), (1, 0), (1, 1), (0, 1)]
    leaf = with_opacity(rectangle("leaf", (-0.5, -1.5, 0.5), (1, 0, 0), (0, 0, 1)), hole, uvs)
    hidden = with_opacity(rectangle("hidden", (1.6, -0.3, 0.6), (0, 0.6, 0), (0, 0, 0.6)), hole, uvs)
    screen = rectangle("screen", (1.2, -1, 0), (0, 2, 0), (0, 0, 2))
    ball = bumpy_sphere("ball", (0, 0, 1), 0.4, 24, bump_share=0.0)
    camera = perspective_camera((-2.5, -3.0, 1.5), (0, 0, 1), WIDTH, HEIGHT, 0.4)
    materials = [matte(), matte(), matte(), matte(), mirror()]
    scene = snapshot([floor(7.0), leaf, hidden, screen, ball], [], camera, WIDTH, HEIGHT, materials=materials, world=World())
    rasterized, _, _ = drawn_cubes(scene, device, ReflectionMethod.MVR)
    splatted, _, _ = drawn_cubes(scene, device, ReflectionMethod.EPR)
    assert (rasterized[:, 0] == 1).sum() > 100 and not (splatted[:, 0] == 2).any()
    assert (splatted[:, 0] != rasterized[:, 0]).mean() < 0.002


def test_what_does_not_belong_to_the_cloud_is_left_alone(device):
    """Single views of flat mirrors stay the rasterizer's."""
    glass = rectangle("glass", (-1, 1, 0), (2, 0, 0), (0, 0, 2))
    ball = bumpy_sphere("ball", (0.6, 0, 0.5), 0.3, 16, bump_share=0.0)
    camera = perspective_camera((0, -3.0, 1.5), (0, 0.5, 0.8), WIDTH, HEIGHT, 0.4)
    scene = snapshot([floor(6.0), glass, ball], [], camera, WIDTH, HEIGHT, materials=[matte(), mirror(), mirror()], world=World())
    settings = Settings(effects=(Effect.REFLECTION,), reflection_method=ReflectionMethod.EPR)
    reflections = planned(scene, settings).reflections
    assert {each.name: each.method_text for each in reflections.reflectors} == {"glass": "planar", "ball": "epr"}
    assert all((each.method is ReflectionMethod.EPR) == each.is_cube for each in reflections.maps)


def many_triangles(scene, count):
    """The same with meshes that only seem to have so many."""
    big = dataclasses.replace(scene.meshes[1], triangles=np.tile(scene.meshes[1].triangles, (count // scene.meshes[1].triangle_count, 1)))
    return dataclasses.replace(scene, meshes=(scene.meshes[0], big, *scene.meshes[2:]))


def test_auto_leaves_cut_outs_to_the_rasterizer_at_once():
    """A cloud would have it draw them all the same."""
    scene = many_triangles(room_with_balls(rows=4), 2_000_000)
    leaf = with_opacity(scene.meshes[1], np.ones((4, 4)), np.zeros((len(scene.meshes[1].positions_os), 2)))
    foliage = dataclasses.replace(scene, meshes=(scene.meshes[0], leaf, *scene.meshes[2:]))
    methods, times_ms = [], []
    for each in (scene, foliage):
        reflections = planned(each, Settings(effects=(Effect.REFLECTION,))).reflections
        methods.append({reflector.method_text for reflector in reflections.reflectors})
        times_ms.append([cubes_ms(each, Settings(), reflections.maps, method) for method in (ReflectionMethod.MVR, ReflectionMethod.EPR)])
    assert methods == [{"epr"}, {"mvr"}]
    assert times_ms[0][0] == times_ms[1][0] < times_ms[1][1]


def test_auto_takes_the_cloud_for_many_triangles_and_the_rasterizer_for_few():
    settings = Settings(effects=(Effect.REFLECTION,))
    scene = room_with_balls(rows=4)
    few = planned(scene, settings).reflections
    many = planned(many_triangles(scene, 2_000_000), settings).reflections
    assert {each.method_text for each in few.reflectors} == {"mvr"}
    assert {each.method_text for each in many.reflectors} == {"epr"}
    assert all("mvr about" in each.reason and "faster than epr for its cube" in each.reason for each in few.reflectors)
    assert all("epr about" in each.reason and "faster than mvr for 2 cubes" in each.reason for each in many.reflectors)
    # a near mirror's texels take longer to splat than its triangles to draw; to draw those of many far ones takes longer than that
    balls = [bumpy_sphere(f"far {k}", (0.5 * k - 4, 3.0, 1.5), 0.15, 16, bump_share=0.0) for k in range(16)]
    near = bumpy_sphere("near", (0.4, -2.6, 1.4), 0.25, 16, bump_share=0.0)
    walls = scene.meshes[:2]
    camera = perspective_camera((0.4, -3.5, 1.6), (0, 0, 1.2), 640, 360, 0.6)
    materials = [matte((0.7, 0.6, 0.5))] * 2 + [mirror()] * 17
    mixed = snapshot([*walls, near, *balls], [], camera, 640, 360, materials=materials, world=World((0.2, 0.2, 0.2)))
    methods = {each.name: each.method_text for each in planned(many_triangles(mixed, 20_000), settings).reflections.reflectors}
    assert methods.pop("near") == "mvr"
    assert set(methods.values()) == {"epr"}
    asked = planned(scene, dataclasses.replace(settings, reflection_method=ReflectionMethod.IVIR)).reflections
    assert all(each.method_text == "ivir" and each.reason.endswith("; ivir as asked") for each in asked.reflectors)
