"""What rays of reflections find, against integrals in float64 and against renders that must come to the same."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools

import numpy as np
import pytest

from tests.core.test_reflections import box_colors, camera_rays, colored_box
from tests.device.surface_queries import UV, ask, scene_of, square
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
from vir_addon.core.material import BLACK, WHITE, Combination, Constant, CornerValue, Layer, LayerKind, Material, Operation, World
from vir_addon.core.material_program import typical_value
from vir_addon.core.pass_set import REFLECTION_COLOR_PASS_NAME, REFLECTION_PASS_NAME
from vir_addon.core.passes import emitters
from vir_addon.core.passes.emitters import pack_emitters
from vir_addon.core.plan import plan
from vir_addon.core.render import Renderer, render
from vir_addon.core.sampling import shuffled_unit_square_points
from vir_addon.core.scene import FilterShape, Mesh, PixelFilter
from vir_addon.core.settings import Effect, ReflectionLookUp, Settings
from vir_addon.device.interface import TextureFormat

WIDTH, HEIGHT = 32, 18


def rough_plate_truth(camera, height_m, half_m, roughness):
    """(HEIGHT, WIDTH, 3) float64 mean radiance over the GGX lobe of a plate within a coloured box: facets by their distribution, weighted
    by Smith's height-correlated masking."""
    eye, directions = camera_rays(camera, WIDTH, HEIGHT)
    at = eye + ((height_m - eye[2]) / directions[..., 2])[..., None] * directions
    width = roughness**2
    u, turn = np.meshgrid((np.arange(96) + 0.5) / 96, (np.arange(96) + 0.5) / 96 * 2 * np.pi, indexing="ij")
    tangent = width * np.sqrt(u / (1 - u))
    facets = np.stack([tangent * np.cos(turn), tangent * np.sin(turn), np.ones_like(u)], axis=-1).reshape(-1, 3)
    facets /= np.linalg.norm(facets, axis=1, keepdims=True)
    truth = np.zeros((HEIGHT, WIDTH, 3))
    for place in np.ndindex(HEIGHT, WIDTH):
        view = -directions[place]
        along = facets @ view
        outgoing = 2 * along[:, None] * facets - view
        counts = (along > 0) & (outgoing[:, 2] > 1e-3)

        def smith(cosine):
            return (np.sqrt(1 + (width / cosine) ** 2 * (1 - cosine**2)) - 1) / 2

        cosine = np.where(counts, outgoing[:, 2], 1.0)
        weights = np.where(counts, along / (view[2] * facets[:, 2]) / (1 + smith(view[2]) + smith(cosine)), 0.0)
        colors, _ = box_colors(at[place], outgoing[counts], half_m)
        truth[place] = weights[counts] @ colors / weights.sum()
    return truth


def test_rough_surfaces_show_their_whole_lobe_with_any_number_of_bounces(device):
    """Where there is nothing else that reflects, more bounces change nothing but the samples."""
    half_m, roughness = 2.0, 0.3
    walls, materials = colored_box(half_m)
    plate = rectangle("plate", (-1.9, -1.9, -1.5), (3.8, 0, 0), (0, 3.8, 0))
    camera = perspective_camera((0.0, -0.8, 0.6), (0.0, 0.3, -1.5), WIDTH, HEIGHT, 0.5)
    scene = snapshot([*walls, plate], [], camera, WIDTH, HEIGHT, materials=[*materials, mirror(roughness=roughness)], world=World())
    truth = rough_plate_truth(camera, -1.5, half_m, roughness)
    errors = [
        rmse(render_passes(scene, device, effects=(Effect.REFLECTION,), bounces=bounces)[REFLECTION_PASS_NAME], truth) for bounces in (1, 2)
    ]
    assert max(errors) < 0.04, errors


def test_shuffled_sequences_say_nothing_of_each_other():
    points = [shuffled_unit_square_points(4096, seed) for seed in range(4)]
    for each in points:
        # any aligned run is as well spread as the sequence it comes from
        assert len(set(map(tuple, (each[:64] * 8).astype(int).tolist()))) == 64
    columns = np.concatenate(points, axis=1)
    assert np.abs(np.corrcoef(columns.T) - np.eye(8)).max() < 0.08


@pytest.mark.parametrize(("is_wanted", "light_names"), [(True, None), (False, None), (True, ())])
def test_lights_without_a_pass_light_what_reflectors_show(device, is_wanted, light_names):
    """An artist who switches a light's shadow pass off, or leaves it out, does not switch the light off."""
    light = point_light(eye=(0.5, 0.0, 2.0), radius_m=0.0, strength=10.0, strength_rgb=(12.0, 10.0, 4.0))
    camera = perspective_camera((0.0, -4.0, 1.5), (0.0, 0.0, 0.8), WIDTH, HEIGHT, 0.3)
    wall = rectangle("wall", (-2, 2, -0.5), (4, 0, 0), (0, 0, 4))
    materials = [matte((0.7, 0.5, 0.3)), mirror()]
    lit, switched_off = (
        snapshot([floor(6.0), wall], [each], camera, WIDTH, HEIGHT, materials=materials, world=World())
        for each in (light, dataclasses.replace(light, is_wanted=is_wanted))
    )
    settings = {"effects": (Effect.REFLECTION,), "reflection_sample_count": 2, "view_count": 1}
    expected = render_passes(lit, device, **settings)[REFLECTION_PASS_NAME]
    assert expected.max() > 0.1
    found = render_passes(switched_off, device, **settings, omni_shadows=is_wanted, light_names=light_names)[REFLECTION_PASS_NAME]
    np.testing.assert_array_equal(found, expected)


def test_what_shines_in_colours_finer_than_texels_shines_no_brighter(device):
    """Corners of random colours: no place between them is brighter than 1, whatever plane beside its triangle a ray meets."""
    shine = bumpy_sphere("shine", (0.8, 0.6, 0.5), 0.45, 120)
    colors = np.random.default_rng(5).uniform(0, 1, (shine.triangle_count, 3, 3)).astype(np.float32)
    layer = Layer(LayerKind.COLOR)
    shine = dataclasses.replace(shine, layers={layer: colors})
    ball = bumpy_sphere("ball", (-0.2, 0, 0.5), 0.4, 24, bump_share=0.0)
    materials = [matte((0.9, 0.9, 0.9)), dataclasses.replace(matte((0, 0, 0)), emission=CornerValue(layer)), mirror()]
    camera = perspective_camera((-0.5, -3.0, 1.5), (0, 0, 0.4), 64, 36, 0.3)
    scene = snapshot([floor(3.0), shine, ball], [], camera, 64, 36, materials=materials, world=World())
    image = render_passes(scene, device, effects=(Effect.REFLECTION,), reflection_sample_count=16)[REFLECTION_PASS_NAME]
    assert image.max() > 0.3
    assert image.max() < 1.001
    assert image.min() >= 0


def test_rays_go_wherever_a_reflector_is_thinner_than_a_pixel(device):
    """Wires of a twentieth of a pixel across the picture, which an eye sample sees here and there."""
    width, height = 160, 90
    camera = perspective_camera((0.0, -2.0, 0.0), (0.0, 0.0, 0.0), width, height, 0.5)
    pixel_m = 2.0 / width
    slopes = np.array([-0.19, -0.11, 0.07, 0.13, 0.21])
    wires = [
        rectangle(f"wire {k}", (-1.0, 0, 0.18 * (k - 2) - slope), (2.0, 0, 2 * slope), (0, 0, 0.05 * pixel_m))
        for k, slope in enumerate(slopes)
    ]
    materials, filtered = [mirror()] * len(wires), PixelFilter(FilterShape.BOX, 1.0)
    scene = snapshot(wires, [], camera, width, height, pixel_filter=filtered, materials=materials, world=World((0.5, 0.5, 0.5)))
    with prepared_renderer(scene, device, effects=(Effect.REFLECTION,), reflection_sample_count=8) as renderer:
        shown = renderer.reflections.tiles_shown
    columns = np.arange(4, width, 8)
    x_m = (columns + 0.5) * pixel_m - 1.0
    for k, slope in enumerate(slopes):
        rows = np.floor((0.18 * (k - 2) + slope * x_m) / pixel_m + height / 2).astype(int)
        inside = (rows >= 0) & (rows < height)
        assert inside.sum() > 15
        assert shown[rows[inside] // 8, columns[inside] // 8].all()


def test_what_nobody_wrote_is_read_by_nobody(device, monkeypatch):
    """New textures hold anything: lights must not be fitted to it."""
    light = point_light(eye=(0.5, 0.0, 2.0), radius_m=0.0, strength=10.0)
    camera = perspective_camera((0.0, -4.0, 1.5), (0.0, 0.0, 0.8), 64, 36, 0.6)
    wall = rectangle("wall", (-0.5, 2, 0.2), (1, 0, 0), (0, 0, 1))
    shade = rectangle("shade", (-0.5, -0.5, 1.0), (1.0, 0, 0), (0, 1.0, 0))
    materials = [matte((0.7, 0.5, 0.3)), matte((0.1, 0.1, 0.1)), mirror()]
    scene = snapshot([floor(6.0), shade, wall], [light], camera, 64, 36, materials=materials, world=World())
    settings = {"effects": (Effect.REFLECTION,), "reflection_sample_count": 2, "view_count": 1, "bounces": 2}
    expected = render_passes(scene, device, **settings)[REFLECTION_PASS_NAME]
    assert expected.max() > 0.1
    create = device.create_texture

    def create_used(width, height, texture_format):
        texture = create(width, height, texture_format)
        if texture_format is TextureFormat.RGBA32F:
            device.fill(texture, int(np.float32(1e4).view(np.uint32)))
        return texture

    monkeypatch.setattr(device, "create_texture", create_used)
    np.testing.assert_array_equal(render_passes(scene, device, **settings)[REFLECTION_PASS_NAME], expected)


def test_hidden_reflectors_cost_no_maps(device):
    """A mirror behind a wall is in the camera's view, and not in the picture."""
    camera = perspective_camera((0.0, -4.0, 1.5), (0.0, 0.0, 0.8), WIDTH, HEIGHT, 0.3)
    wall = rectangle("wall", (-3, 0, -0.5), (6, 0, 0), (0, 0, 6))
    hidden = rectangle("hidden", (-1, 2, -0.5), (2, 0, 0), (0, 0, 2))
    shown = rectangle("shown", (-0.5, -0.5, 0.5), (1, 0, 0), (0, 0.3, 1))
    light = point_light(eye=(0.5, -2.0, 2.0), radius_m=0.0, strength=10.0)
    settings = Settings(effects=(Effect.SHADOW, Effect.REFLECTION), reflection_sample_count=2, view_count=1, bounces=1)
    for meshes, map_count in (([wall, hidden], 0), ([wall, hidden, shown], 2)):
        materials = [matte(), *[mirror()] * (len(meshes) - 1)]
        scene = snapshot(meshes, [light], camera, WIDTH, HEIGHT, materials=materials, world=World())
        *_, progress = render(scene, plan(scene, settings), device)
        found = progress.statistics.reflections
        assert found.map_count == map_count
        assert any(line.startswith("hidden: skipped: hidden behind others") for line in found.reflectors)
        assert progress.passes[REFLECTION_COLOR_PASS_NAME].any() == (map_count > 0)
        assert any("hidden behind" in note for note in progress.statistics.notes) == (map_count == 0)


GLOSSY = {
    "metal": Material(
        "metal", BLACK, BLACK, metal_weight=WHITE, metal=Constant((0.9, 0.5, 0.2)), roughness=Constant(3 * (0.6,)), specular_tint=WHITE
    ),
    "plastic": Material("plastic", Constant((0.2, 0.1, 0.05)), roughness=Constant(3 * (0.4,))),
    "coat": Material(
        "coat", Constant((0.1, 0.1, 0.1)), BLACK, coat_weight=WHITE, coat_roughness=Constant(3 * (0.35,)), roughness=Constant(3 * (0.9,))
    ),
}


@pytest.mark.parametrize("name", GLOSSY)
def test_lights_shine_on_what_reflectors_show_as_its_whole_material_says(device, name):
    """A floor in a mirror, lit by a point, with highlights: the BRDF that the device has for single directions, times irradiance."""
    light_ws = np.array((0.3, -4.2, 2.4))
    light = point_light(eye=light_ws, radius_m=0.0, strength=10.0, strength_rgb=(12.0, 10.0, 8.0))
    camera = perspective_camera((0.0, -3.0, 2.4), (0.0, 2.0, 1.2), WIDTH, HEIGHT, 0.25)
    wall = rectangle("wall", (-2, 2, -0.5), (4, 0, 0), (0, 0, 4))
    scene = snapshot([floor(6.0), wall], [light], camera, WIDTH, HEIGHT, materials=[GLOSSY[name], mirror()], world=World())
    image = render_passes(scene, device, reflection_sample_count=2, effects=(Effect.REFLECTION,), view_count=1, bounces=1)
    shown = image[REFLECTION_PASS_NAME]

    eye, directions = camera_rays(camera, WIDTH, HEIGHT)
    at = eye + ((2 - eye[1]) / directions[..., 1])[..., None] * directions
    reflected = directions * (1, -1, 1)
    with np.errstate(divide="ignore"):
        place = at - (at[..., 2] / reflected[..., 2])[..., None] * reflected
    judged = (reflected[..., 2] < 0) & (np.abs(place[..., :2]) < 5.5).all(axis=-1) & (np.abs(at[..., 0]) < 1.9) & (at[..., 2] > 0.05)
    assert judged.sum() > 150
    toward = light_ws - place[judged]
    distance = np.linalg.norm(toward, axis=1, keepdims=True)
    answers = ask(device, scene_of([square()], [GLOSSY[name]]), to_eye=-reflected[judged], to_light=toward / distance)
    truth = answers.brdf * toward[:, 2:] / distance**3 * (12.0, 10.0, 8.0)
    diffuse = answers.diffuse / np.pi * toward[:, 2:] / distance**3 * (12.0, 10.0, 8.0)
    assert (truth > 1.5 * diffuse).any(axis=1).sum() > 20
    np.testing.assert_allclose(shown[judged], truth, rtol=0.06, atol=0.003 * truth.max())


def test_metal_without_a_map_shows_what_surrounds_it(device):
    """In a mirror: what is too rough for maps, and what the eye does not see."""
    camera = perspective_camera((0.0, -3.0, 1.6), (0.0, 2.0, 0.9), WIDTH, HEIGHT, 0.25)
    wall = rectangle("wall", (-2, 2, -0.5), (4, 0, 0), (0, 0, 4))
    means = []
    for roughness in (0.7, 0.0):
        scene = snapshot(
            [floor(6.0), wall],
            [],
            camera,
            WIDTH,
            HEIGHT,
            materials=[mirror((0.5, 0.5, 0.5), roughness=roughness), mirror()],
            world=World((1.0, 1.0, 1.0)),
        )
        image = render_passes(scene, device, reflection_sample_count=16, effects=(Effect.REFLECTION,), bounces=1)[REFLECTION_PASS_NAME]
        means.append(image[2:6, 8:-8].mean())
    np.testing.assert_allclose(means, 0.5, atol=0.08)


POLISHED = Material(
    "polished", diffuse=Constant((0.5, 0.5, 0.5)), dielectric_weight=BLACK, metal_weight=Constant((0.4, 0.4, 0.4)), metal=WHITE
)
POLISHED = dataclasses.replace(POLISHED, has_metal_fresnel=False, roughness=BLACK)


@pytest.mark.parametrize(
    ("ground", "inside_out", "look_up"),
    [
        *itertools.product([matte((0.5, 0.5, 0.5)), POLISHED, mirror(roughness=0.4)], [False, True], [ReflectionLookUp.MARCH]),
        (matte((0.5, 0.5, 0.5)), False, ReflectionLookUp.DIRECTION),
    ],
    ids=lambda one: getattr(one, "name", None),
)
def test_in_a_room_that_shines_all_is_as_bright_as_its_albedo(device, ground, inside_out, look_up):
    """Whichever way the room's faces are turned: a floor that is matte, also below what would show an image, or of rough metal, which has a
    map of its own, where the last ray ends. By direction alone, too: it shines in all of them. Reflecting floors know of the wall, which is
    left out of what others are lit by, and so shines as the room does, and hides nothing that they see beside it."""
    room = box("room", (0, 0, 1), (4, 4, 4), inside_out=inside_out)
    wall = rectangle("wall", (-4, 2, -3), (8, 0, 0), (0, 0, 8))
    camera = perspective_camera((0.0, -3.0, 1.6), (0.0, 2.0, 0.6), WIDTH, HEIGHT, 0.35)
    shining = BLACK if ground.name == "matte" else Constant((3.0, 3.0, 3.0))
    materials = [ground, matte((0, 0, 0), (3, 3, 3)), dataclasses.replace(mirror(), emission=shining)]
    scene = snapshot([floor(3.0), room, wall], [], camera, WIDTH, HEIGHT, materials=materials, world=World())
    settings = {"effects": (Effect.REFLECTION,), "bounces": 1, "reflection_sample_count": 32, "reflection_look_up": look_up}
    image = render_passes(scene, device, **settings)[REFLECTION_PASS_NAME][5:10, 4:-4, 0]
    assert image.mean() == pytest.approx(3.0 if ground.name == "mirror" else 1.5, rel=0.02)


@pytest.mark.parametrize("roughness", [None, 0.6])
def test_a_panel_lights_what_a_mirror_shows_without_noise(device, roughness):
    """A small one that shines, over a matte floor or one of rough metal, against an integral over the panel."""
    size_m, radiance, at_ws = 0.2, 60.0, np.array([0.0, 0.3, 1.5])
    panel = rectangle("panel", at_ws - (size_m / 2, size_m / 2, 0), (0, size_m, 0), (size_m, 0, 0))
    wall = rectangle("wall", (-2, 2, -0.5), (4, 0, 0), (0, 0, 4))
    ground = matte((0.5, 0.5, 0.5)) if roughness is None else mirror((1.0, 1.0, 1.0), roughness=roughness)
    camera = perspective_camera((0.0, -3.0, 1.6), (0.0, 2.0, 0.9), WIDTH, HEIGHT, 0.25)
    materials = [ground, matte((0, 0, 0), 3 * (radiance,)), mirror()]
    scene = snapshot([floor(6.0), panel, wall], [], camera, WIDTH, HEIGHT, materials=materials, world=World())
    settings = {"effects": (Effect.REFLECTION,), "bounces": 1, "reflection_sample_count": 64}
    image = render_passes(scene, device, **settings)[REFLECTION_PASS_NAME][..., 0]

    eye, directions = camera_rays(camera, WIDTH, HEIGHT)
    on_wall = eye + ((2 - eye[1]) / directions[..., 1:2]) * directions
    reflected = directions * (1, -1, 1)
    rows = slice(1, 6)
    on_floor = (on_wall - on_wall[..., 2:] / reflected[..., 2:] * reflected)[rows, 4:-4]
    steps = ((np.arange(8) + 0.5) / 8 - 0.5) * size_m
    places = at_ws + np.stack([*np.meshgrid(steps, steps), np.zeros((8, 8))], axis=-1).reshape(-1, 3)
    to_light = places - on_floor[..., None, :]
    distance = np.linalg.norm(to_light, axis=-1)
    to_light /= distance[..., None]
    irradiance = radiance * size_m**2 * to_light[..., 2] ** 2 / distance**2
    if roughness is None:
        truth = 0.5 / np.pi * irradiance.mean(axis=-1)
    else:
        truth = (irradiance * white_metal(-reflected[rows, 4:-4], to_light, roughness**2)).mean(axis=-1)
    np.testing.assert_allclose(image[rows, 4:-4], truth, rtol=0.06)
    np.testing.assert_allclose(image[rows, 4:-4].mean(), truth.mean(), rtol=0.01)


def test_what_shines_is_drawn_by_its_area_and_brightness(monkeypatch):
    """As likely a square metre as its object is bright, dark slots never, hidden objects neither; where there are too many triangles,
    those of the objects that shine most."""
    half = dataclasses.replace(square(), material_slot=np.array([0, 1], np.uint8))
    large, small = rectangle("large", (0, 0, 1), (4, 0, 0), (0, 2, 0)), rectangle("small", (0, 0, 2), (1, 0, 0), (0, 1, 0))
    dark, dim, bright = matte((1, 1, 1)), matte((0, 0, 0), (1, 1, 1)), matte((0, 0, 0), (12, 12, 12))
    scene = scene_of([half, large, small], [dark, dim, bright])
    scene = dataclasses.replace(scene, material_sets=((0, 1), (1,), (2,)))
    per_instance, drawn = np.split(pack_emitters(scene).rows, [3])
    np.testing.assert_allclose(per_instance[:, 0], np.array([1, 1, 12]) / 20.5, rtol=1e-6)
    np.testing.assert_allclose(drawn[:, 2], np.array([6, 12, 16, 20, 20.5]) / 20.5, rtol=1e-6)
    assert drawn[:, :2].tolist() == [[2, 0], [2, 1], [1, 0], [1, 1], [0, 1]]
    hidden = dataclasses.replace(scene.instances, visible_in_reflections=np.array([True, True, False]))
    assert (pack_emitters(dataclasses.replace(scene, instances=hidden)).rows[:, 0] != 2).all()
    monkeypatch.setattr(emitters, "MAX_EMITTING_TRIANGLES", 2)
    assert pack_emitters(scene).rows[:3, 0].tolist() == [0.0, 0.0, 1.0]


def test_what_shines_is_listed_anew_where_its_size_changes(device):
    """Not where it moves."""
    camera = perspective_camera((0.0, -3.0, 1.6), (0.0, 2.0, 0.9), WIDTH, HEIGHT, 0.25)
    meshes = [floor(6.0), rectangle("panel", (0, 0, 1), (1, 0, 0), (0, 1, 0)), rectangle("wall", (-2, 2, -0.5), (4, 0, 0), (0, 0, 4))]
    scene = snapshot(meshes, [], camera, WIDTH, HEIGHT, materials=[matte(), matte((0, 0, 0), (3, 3, 3)), mirror()], world=World())
    settings = {"effects": (Effect.REFLECTION,), "bounces": 1, "reflection_sample_count": 2}
    away, large = np.eye(4, dtype=np.float32), np.diag([2, 2, 2, 1]).astype(np.float32)
    away[0, 3] = 0.5
    with prepared_renderer(scene, device, **settings) as first:
        for matrix, is_same in ((away, True), (large, False)):
            matrices = scene.instances.world_from_object.copy()
            matrices[1] = matrix
            changed = dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, world_from_object=matrices))
            with contextlib.closing(Renderer(changed, plan(changed, Settings(**settings)), device, previous=first)) as second:
                device.run(second.prepare)
                assert (second.emitters is first.emitters) == is_same
                shown = device.run(device.read, second.reflections.emitters).reshape(-1, 4)
                expected = pack_emitters(changed).rows
                np.testing.assert_array_equal(shown[: len(expected), :2], expected[:, :2])
                np.testing.assert_array_equal(shown[len(meshes) : len(expected), 2:], expected[len(meshes) :, 2:])


def test_what_does_not_fit_keeps_no_other_out(monkeypatch):
    """The brightest has too many triangles, alone or stretched to more than its neighbour's: others are drawn all the same."""
    monkeypatch.setattr(emitters, "MAX_EMITTING_TRIANGLES", 100)
    ball, lamp, panel = (
        bumpy_sphere("ball", (0, 0, 0), 1.0, 6),
        box("lamp", (0, 0, 2), (1, 1, 1)),
        rectangle("p", (0, 0, 1), (1, 0, 0), (0, 1, 0)),
    )
    transforms = np.tile(np.eye(4, dtype=np.float32), (3, 1, 1))
    transforms[2, :3, :3] = [(0, -4, 0), (20, 0, 0), (0, 0, 1)]
    shining = [matte((0, 0, 0), 3 * (radiance,)) for radiance in (100.0, 1.0, 2.0)]
    scene = scene_of([ball, lamp, panel], shining, transforms=transforms)
    per_instance, drawn = np.split(pack_emitters(scene).rows, [3])
    np.testing.assert_allclose(per_instance[:, 0], np.array([0, 1, 2]) / (24 + 160), rtol=1e-6)
    assert drawn[:, 0].tolist() == 2 * [2] + 12 * [1]
    monkeypatch.setattr(emitters, "MAX_EMITTING_TRIANGLES", 12)
    assert pack_emitters(scene).rows[:, 0].tolist() == [0, 0, np.float32(1 / 80), 2, 2]


@pytest.mark.parametrize("is_solid", [False, True])
def test_what_is_met_by_chance_alone_shines_as_brightly(device, monkeypatch, is_solid):
    """As where places are drawn on it, which is a twentieth more: rays beside a panel do not meet it where the mirror would show it. The
    limit is that and three standard errors."""
    panel = box("panel", (-0.5, 0.3, 1.4), (0.6, 0.6, 0.3)) if is_solid else rectangle("panel", (-1.5, -0.7, 1.5), (0, 2, 0), (1.5, 0, 0))
    wall = rectangle("wall", (-2, 2, -0.5), (4, 0, 0), (0, 0, 4))
    camera = perspective_camera((0.0, -3.0, 1.6), (0.0, 2.0, 0.9), WIDTH, HEIGHT, 0.25)
    materials = [matte((0.5, 0.5, 0.5)), matte((0, 0, 0), (5, 5, 5)), mirror()]
    scene = snapshot([floor(6.0), panel, wall], [], camera, WIDTH, HEIGHT, materials=materials, world=World())
    means = []
    for most in (0, emitters.MAX_EMITTING_TRIANGLES):
        monkeypatch.setattr(emitters, "MAX_EMITTING_TRIANGLES", most)
        settings = {"effects": (Effect.REFLECTION,), "bounces": 1, "reflection_sample_count": 128}
        means.append(render_passes(scene, device, **settings)[REFLECTION_PASS_NAME][1:6, 4:-4, 0].mean())
    assert means[0] == pytest.approx(means[1], rel=0.08)


def test_a_mirror_that_shines_lights_what_it_shows(device):
    """The floor before it, against an integral over the mirror, which its own map leaves out: no ray meets it by chance."""
    wall = rectangle("wall", (-2, 2, 0.0), (4, 0, 0), (0, 0, 3))
    camera = perspective_camera((0.0, -3.0, 1.6), (0.0, 2.0, 0.9), WIDTH, HEIGHT, 0.25)
    materials = [matte((0.5, 0.5, 0.5)), dataclasses.replace(mirror(), emission=WHITE)]
    scene = snapshot([floor(6.0), wall], [], camera, WIDTH, HEIGHT, materials=materials, world=World())
    settings = {"effects": (Effect.REFLECTION,), "bounces": 1, "reflection_sample_count": 64}
    shown = render_passes(scene, device, **settings)[REFLECTION_PASS_NAME][1:4, 4:-4, 0]
    eye, directions = camera_rays(camera, WIDTH, HEIGHT)
    directions = directions[1:4, 4:-4]
    at = eye + ((2 - eye[1]) / directions[..., 1])[..., None] * directions
    reflected = directions * (1, -1, 1)
    place = at - (at[..., 2] / reflected[..., 2])[..., None] * reflected
    x, z = np.meshgrid((np.arange(120) + 0.5) / 30 - 2, (np.arange(120) + 0.5) / 40)
    toward = np.stack([x, np.full_like(x, 2.0), z], axis=-1) - place[:, :, None, None]
    squared = (toward**2).sum(axis=-1)
    truth = 0.5 / np.pi * (toward[..., 1] * toward[..., 2] / squared**2).sum(axis=(2, 3)) / 1200
    np.testing.assert_allclose(shown.mean(axis=1), truth.mean(axis=1), rtol=0.03)


def test_what_shines_in_few_places_shines(device, monkeypatch):
    """A panel that shines in two fifths of its width, which what it typically shines says nothing of, over a floor that a mirror shows and
    under a black sky: as brightly as that part alone."""
    part, whole = (rectangle("panel", (-0.9 * k - 0.6, -0.7, 1.5), (0, 2, 0), (0.9 * k + 0.6, 0, 0)) for k in range(2))
    corners = whole.positions_os[whole.triangles]
    uvs = np.stack([corners[..., 0] / 1.5 + 1.0, corners[..., 1] / 2 + 0.35], axis=-1).astype(np.float32)
    whole = dataclasses.replace(whole, layers={UV: uvs})
    u = Combination(Operation.RED, (CornerValue(UV),))
    is_lit = Combination(Operation.GREATER_THAN, (u, Constant((0.6, 0.6, 0.6))))
    glow = dataclasses.replace(matte((0, 0, 0)), emission=Combination(Operation.MULTIPLY, (Constant((10.0, 10.0, 10.0)), is_lit)))
    assert not typical_value(glow.emission).any()
    wall = rectangle("wall", (-2, 2, -0.5), (4, 0, 0), (0, 0, 4))
    camera = perspective_camera((0.0, -3.0, 1.6), (0.0, 2.0, 0.9), WIDTH, HEIGHT, 0.25)
    monkeypatch.setattr(emitters, "MAX_EMITTING_TRIANGLES", 0)
    means = []
    for mesh, shining in ((part, matte((0, 0, 0), (10, 10, 10))), (whole, glow)):
        materials = [matte((0.5, 0.5, 0.5)), shining, mirror()]
        scene = snapshot([floor(6.0), mesh, wall], [], camera, WIDTH, HEIGHT, materials=materials, world=World())
        settings = {"effects": (Effect.REFLECTION,), "bounces": 1, "reflection_sample_count": 64}
        means.append(render_passes(scene, device, **settings)[REFLECTION_PASS_NAME][1:6, 4:-4, 0].mean())
    assert means[1] == pytest.approx(means[0], rel=0.06)


def test_what_opacity_cuts_out_does_not_shine(device, monkeypatch):
    """Over a floor that a mirror shows: a panel half of which is there, as bright as that half alone where rays meet it by chance, too."""
    half = rectangle("panel", (-1.5, -0.7, 1.5), (0, 2, 0), (1.5, 0, 0))
    strips = [rectangle("strip", (-1.5 + k / 4, -0.7, 1.5), (0, 2, 0), (0.25, 0, 0)) for k in range(12)]
    positions, triangles = np.concatenate([one.positions_os for one in strips]), np.concatenate([half.triangles + 4 * k for k in range(12)])
    uvs = np.column_stack([positions[:, 0] / 3 + 0.5, (positions[:, 1] + 0.7) / 2])
    cut_out = with_opacity(Mesh("panel", positions, triangles), [[1, 0]], uvs, is_interpolated=False)
    wall = rectangle("wall", (-2, 2, -0.5), (4, 0, 0), (0, 0, 4))
    camera = perspective_camera((0.0, -3.0, 1.6), (0.0, 2.0, 0.9), WIDTH, HEIGHT, 0.25)
    materials = [matte((0.5, 0.5, 0.5)), matte((0, 0, 0), (5, 5, 5)), mirror()]
    means = []
    for mesh, most in ((half, 0), (cut_out, emitters.MAX_EMITTING_TRIANGLES)):
        monkeypatch.setattr(emitters, "MAX_EMITTING_TRIANGLES", most)
        scene = snapshot([floor(6.0), mesh, wall], [], camera, WIDTH, HEIGHT, materials=materials, world=World())
        settings = {"effects": (Effect.REFLECTION,), "bounces": 1, "reflection_sample_count": 64}
        means.append(render_passes(scene, device, **settings)[REFLECTION_PASS_NAME][1:6, 4:-4, 0].mean())
    assert means[1] == pytest.approx(means[0], rel=0.06)


def white_metal(to_eye, to_light, width):
    """Radiance over irradiance of one that reflects all light, upwards: a GGX lobe and what bounces between its facets, which is as the
    lobe itself. to_eye: (..., 3), to_light: (..., n, 3)"""

    def lobe(view, light):
        half = view + light
        half /= np.linalg.norm(half, axis=-1, keepdims=True)
        density = width**2 / (np.pi * (half[..., 2] ** 2 * (width**2 - 1) + 1) ** 2)
        view_z, light_z = np.broadcast_arrays(view[..., 2], light[..., 2])
        masking = 1 + sum((np.sqrt(1 + (width / z) ** 2 * (1 - z**2)) - 1) / 2 for z in (view_z, light_z))
        return density / (4 * view_z * light_z * masking)

    height, turn = np.meshgrid((np.arange(256) + 0.5) / 256, (np.arange(256) + 0.5) / 256 * 2 * np.pi, indexing="ij")
    around = np.sqrt(1 - height**2)
    all_ways = np.stack([around * np.cos(turn), around * np.sin(turn), height], axis=-1).reshape(-1, 3)
    albedo = np.array([2 * np.pi * (lobe(view, all_ways) * all_ways[:, 2]).mean() for view in to_eye.reshape(-1, 3)])
    return lobe(to_eye[..., None, :], to_light) / albedo.reshape(to_eye.shape[:-1])[..., None]


def test_a_rough_coat_in_even_light_reflects_as_much_as_its_colour_says(device):
    """Masking between facets counts once."""
    coat = Material(
        "coat", Constant((0.1, 0.1, 0.1)), BLACK, coat_weight=WHITE, coat_roughness=Constant(3 * (0.3,)), roughness=Constant(3 * (0.9,))
    )
    camera = perspective_camera((0.0, -1.0, 0.25), (0.0, 0.0, 0.0), WIDTH, HEIGHT, 0.2)
    scene = snapshot([floor(3.0)], [], camera, WIDTH, HEIGHT, materials=[coat], world=World((1.0, 1.0, 1.0)))
    passes = render_passes(scene, device, reflection_sample_count=32, effects=(Effect.REFLECTION,))
    assert passes[REFLECTION_COLOR_PASS_NAME][4:8, 8:-8].min() > 0.1
    assert passes[REFLECTION_PASS_NAME][4:8, 8:-8].mean() == pytest.approx(1.0, abs=0.02)


def test_the_sky_over_far_walls_lights_what_a_ball_between_them_shows(device):
    """Long walls whose tops see past each other, which from the ball's place no direction does: of the sky an upright wall gets
    (1 - sin(elevation of the other's top)) / 2."""
    height_m, half_m, ball_m, long_m, albedo = 2.0, 2.0, 0.5, 80.0, 0.8
    walls = [
        rectangle("left", (-half_m, -long_m / 2, 0), (0, long_m, 0), (0, 0, height_m)),
        rectangle("right", (half_m, -long_m / 2, 0), (0, long_m, 0), (0, 0, height_m)),
    ]
    ground = rectangle("ground", (-half_m, -long_m / 2, 0), (2 * half_m, 0, 0), (0, long_m, 0))
    ball = bumpy_sphere("ball", (0, 0, ball_m), ball_m, 96, bump_share=0.0)
    width, height = 64, 64
    camera = perspective_camera((0.0, -1.6, 0.7), (0.0, 0.0, ball_m), width, height, 0.4)
    materials = [*[matte((albedo,) * 3)] * 2, matte((0, 0, 0)), mirror()]
    scene = snapshot([*walls, ground, ball], [], camera, width, height, materials=materials, world=World((1.0, 1.0, 1.0)))
    image = render_passes(scene, device, effects=(Effect.REFLECTION,), bounces=1, reflection_sample_count=32)[REFLECTION_PASS_NAME][..., 0]

    eye, directions = camera_rays(camera, width, height)
    directions = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    from_ball = eye - (0, 0, ball_m)
    along = directions @ from_ball
    half_chord = along**2 - from_ball @ from_ball + ball_m**2
    at = from_ball + (-along - np.sqrt(np.maximum(half_chord, 0)))[..., None] * directions
    normals = at / ball_m
    outgoing = directions - 2 * (directions * normals).sum(axis=-1, keepdims=True) * normals
    with np.errstate(divide="ignore"):
        way = (half_m - np.sign(outgoing[..., 0]) * at[..., 0]) / np.abs(outgoing[..., 0])
    met_y, met_z = (at + way[..., None] * outgoing)[..., 1], (at + way[..., None] * outgoing)[..., 2] + ball_m
    judged = (half_chord > 0.05) & (met_z > 0.6 * height_m) & (met_z < 0.97 * height_m) & (np.abs(met_y) < 5)
    assert judged.sum() > 100
    elevation = np.arctan((height_m - met_z[judged]) / (2 * half_m))
    assert image[judged].mean() == pytest.approx((albedo * (1 - np.sin(elevation)) / 2).mean(), rel=0.03)


def test_what_a_reflector_holds_within_itself_is_not_in_it(device):
    """A black core in a mirror ball: rays begin outside of the box around all that its cube shows and go away from it."""
    ball, core = bumpy_sphere("ball", (0, 0, 0), 0.5, 96, bump_share=0.0), bumpy_sphere("core", (0, -0.2, 0), 0.18, 24, bump_share=0.0)
    camera = perspective_camera((0.0, -3.0, 0.0), (0.0, 0.0, 0.0), WIDTH, HEIGHT, 0.3)
    materials = [mirror(), matte((0, 0, 0))]
    scene = snapshot([ball, core], [], camera, WIDTH, HEIGHT, materials=materials, world=World((1.0, 1.0, 1.0)))
    passes = render_passes(scene, device, effects=(Effect.REFLECTION,), bounces=1, reflection_sample_count=4)
    shown = passes[REFLECTION_COLOR_PASS_NAME].min(axis=-1) > 0.99
    assert shown.sum() > 40
    np.testing.assert_allclose(passes[REFLECTION_PASS_NAME][shown], 1.0, atol=1e-3)
