"""lib/material.glsl and lib/brdf.glsl on the device: against expressions in float64, closed forms, and integrals over directions."""

from __future__ import annotations

import numpy as np
import pytest

from tests.device.surface_queries import COLOR, SQUARE_CORNERS, UP, UV, ask, scene_of, square
from vir_addon.core.material import (
    BLACK,
    WHITE,
    Combination,
    Constant,
    CornerValue,
    Extension,
    ImageSample,
    ImageTexels,
    Layer,
    LayerKind,
    Material,
    NormalMap,
    Operation,
    TableLookup,
    World,
)
from vir_addon.core.material_program import MAX_INSTRUCTIONS, TooLongError, evaluate_operation
from vir_addon.core.passes.surface_data import SurfaceData
from vir_addon.core.reflectance_table import fresnel_dielectric, ggx_lobe

PLAIN = {"dielectric_weight": BLACK, "roughness": Constant((0.5,) * 3)}


def gray(value):
    return Constant((value, value, value))


def diffuse_of(device, expressions, mesh=None, **query):
    """One row an expression: what the device makes of it as the diffuse colour (which is never negative)."""
    mesh = mesh or square()
    shown = scene_of([mesh] * len(expressions), [Material(f"{k}", one, **PLAIN) for k, one in enumerate(expressions)])
    return ask(device, shown, instance=np.arange(len(expressions)), **query).diffuse


# expressions

COLORS = [(0.2, 0.5, 0.9), (0.7, 0.0, 0.4), (1.5, 0.25, 1.0), (0.9, 0.9, 0.9), (-0.6, 2.5, 0.3), (0.0, 0.0, 0.0)]
UNARY = (Operation.FLOOR, Operation.ABSOLUTE, Operation.CLAMP, Operation.RED, Operation.GREEN, Operation.BLUE, Operation.LUMINANCE)
OPERAND_COUNTS = {Operation.MIX: 3} | dict.fromkeys((*UNARY, Operation.RGB_TO_HSV, Operation.HSV_TO_RGB), 1)


def test_every_operation_is_what_it_says(device):
    cases = []
    for operation in Operation:
        count = OPERAND_COUNTS.get(operation, 2)
        for start in range(len(COLORS)):
            cases.append((operation, [COLORS[(start + 2 * k) % len(COLORS)] for k in range(count)]))
    # the bias keeps negative results from being cut off
    expressions = [
        Combination(Operation.ADD, (Combination(operation, tuple(map(Constant, colors))), gray(100.0))) for operation, colors in cases
    ]
    expected = np.array([evaluate_operation(operation, *map(np.array, colors)) for operation, colors in cases])
    np.testing.assert_allclose(diffuse_of(device, expressions) - 100.0, expected, atol=3e-5)


def test_values_that_many_share_are_worked_out_once_and_kept(device):
    """Doubling forty times over: as an expression tree it has a million million leaves."""
    part = CornerValue(UV)
    for _ in range(40):
        part = Combination(Operation.MULTIPLY, (Combination(Operation.ADD, (part, part)), gray(0.5)))
    metal = Combination(Operation.ADD, (part, gray(0.25)))
    material = Material("shared", part, dielectric_weight=metal, metal=part, metal_weight=WHITE)
    found = ask(device, scene_of([square()], [material]), weights=(0.5, 0.25))
    np.testing.assert_allclose(found.diffuse[0], [0.75, 0.25, 0.0], atol=1e-6)
    np.testing.assert_allclose(found.metal[0], [0.75, 0.25, 0.0], atol=1e-6)
    np.testing.assert_allclose(found.dielectric_weight, 1.0, atol=1e-6)


def test_programs_that_are_too_long_are_refused(device):
    part = CornerValue(UV)
    for _ in range(MAX_INSTRUCTIONS):
        part = Combination(Operation.ADD, (part, gray(0.1)))
    with pytest.raises(TooLongError, match="steps"):
        diffuse_of(device, [part])

    # a tree without anything in common needs a register a level, its nodes are few
    def tree(depth, index=1):
        if not depth:
            return CornerValue(Layer(LayerKind.UV, f"{index}"))
        return Combination(Operation.ADD, (tree(depth - 1, 2 * index), tree(depth - 1, 2 * index + 1)))

    assert (diffuse_of(device, [tree(6)]) == 0.0).all()


def test_tables_are_looked_up_by_the_first_channel(device):
    entries = np.random.default_rng(1).uniform(0, 1, (1, 17, 3)).astype(np.float32)
    table = ImageTexels("ramp", entries)
    places = [-0.3, 0.0, 0.34, 0.66, 0.99, 1.0, 1.7]
    expected = [[np.interp(x, np.linspace(0, 1, 17), entries[0, :, k]) for k in range(3)] for x in places]
    found = diffuse_of(device, [TableLookup(Constant((x, 0.9, 0.1)), table) for x in places])
    np.testing.assert_allclose(found, expected, atol=1e-6)


# corners and images


def test_corner_values_are_linear_and_zero_where_there_are_none(device):
    colors = np.random.default_rng(2).uniform(0, 1, (4, 3))
    missing = CornerValue(Layer(LayerKind.COLOR, "another"))
    found = diffuse_of(device, [CornerValue(COLOR), CornerValue(UV), missing], square(colors=colors), triangle=1, weights=(0.5, 0.2))
    np.testing.assert_allclose(found[0], 0.3 * colors[0] + 0.5 * colors[2] + 0.2 * colors[3], atol=1e-6)
    np.testing.assert_allclose(found[1], [0.5, 0.7, 0.0], atol=1e-6)
    assert (found[2] == 0).all()


def texel(texels, x, y, extension):
    height, width = texels.shape[:2]
    if extension is Extension.REPEAT:
        x, y = x % width, y % height
    elif extension is Extension.MIRROR:
        x, y = (min(k % (2 * n), 2 * n - 1 - k % (2 * n)) for k, n in ((x, width), (y, height)))
    elif extension is Extension.CLIP and not (0 <= x < width and 0 <= y < height):
        return np.zeros(texels.shape[2])
    return texels[min(max(y, 0), height - 1), min(max(x, 0), width - 1)]


def interpolated(texels, u, v, extension):
    height, width = texels.shape[:2]
    x, y = u * width - 0.5, v * height - 0.5
    low_x, low_y = int(np.floor(x)), int(np.floor(y))
    share_x, share_y = x - low_x, y - low_y
    rows = [[texel(texels, low_x + i, low_y + j, extension) for i in range(2)] for j in range(2)]
    along = [(1 - share_x) * row[0] + share_x * row[1] for row in rows]
    return (1 - share_y) * along[0] + share_y * along[1]


def linear(encoded):
    return np.where(encoded <= 0.04045, encoded / 12.92, ((np.maximum(encoded, 0) + 0.055) / 1.055) ** 2.4)


@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("kind", [np.uint8, np.float32])
def test_images_of_every_packing(device, channels, kind):
    random = np.random.default_rng(channels)
    texels = random.integers(0, 256, (7, 13, channels)).astype(kind)
    if kind is np.float32:
        texels = texels * np.float32(0.037)
    scale = 255.0 if kind is np.uint8 else 1.0
    image = ImageTexels("image", texels, is_srgb=kind is np.uint8)
    rows = ((2.0, 0.5, -0.7), (-0.3, 1.7, 0.2))
    places = random.uniform(0, 1, (40, 2))
    places /= np.maximum(places.sum(axis=1, keepdims=True), 1.0)
    uvs = np.array(rows) @ np.column_stack([places[:, 0] + places[:, 1], places[:, 1], np.ones(40)]).T
    for extension in Extension:
        shown = scene_of([square()], [Material("m", ImageSample(image, UV, rows, extension), **PLAIN)])
        values = np.array([interpolated(texels.astype(np.float64) / scale, u, v, extension) for u, v in uvs.T])
        colors = values[:, [0, 0, 0]] if channels == 1 else values[:, :3]
        np.testing.assert_allclose(
            ask(device, shown, weights=places).diffuse, linear(colors) if image.is_srgb else colors, atol=2e-5, rtol=2e-5
        )


def test_closest_texels_alpha_and_colours_without_alpha(device):
    random = np.random.default_rng(8)
    texels = random.integers(0, 256, (4, 4, 4)).astype(np.uint8)
    image = ImageTexels("image", texels)
    places = random.uniform(0, 0.5, (30, 2))
    uvs = np.column_stack([places.sum(axis=1), places[:, 1]])
    smooth = np.array([interpolated(texels / 255.0, u, v, Extension.REPEAT) for u, v in uvs])
    closest = np.array([texels[int(v * 4), int(u * 4)] for u, v in uvs]) / 255.0
    for expected, sample in (
        (closest[:, :3], ImageSample(image, is_interpolated=False)),
        (smooth[:, [3, 3, 3]], ImageSample(image, is_alpha=True)),
        (smooth[:, :3] / smooth[:, 3:], ImageSample(image, divides_by_alpha=True)),
    ):
        found = ask(device, scene_of([square()], [Material("m", sample, **PLAIN)]), weights=places)
        np.testing.assert_allclose(found.diffuse, expected, atol=1e-5, rtol=1e-5)


def test_triangles_find_the_material_of_their_slot(device):
    """Two instances of one mesh with other materials in its slots; a slot beyond the last counts as the last."""
    from dataclasses import replace

    mesh = replace(square(), material_slot=np.array([1, 7], np.uint8))
    materials = [Material(f"{k}", gray(k / 10), **PLAIN) for k in range(4)]
    shown = scene_of([mesh, mesh], materials)
    shown = replace(shown, material_sets=((0, 1), (3, 2, 0)))
    found = ask(device, shown, instance=[0, 0, 1, 1], triangle=[0, 1, 0, 1])
    np.testing.assert_allclose(found.diffuse[:, 0], [0.1, 0.1, 0.2, 0.0], atol=1e-7)


# normal maps

TILTED = np.array([0.48, 0.36, 0.8])
TURN = np.array([[0.0, -1.0, 0, 2], [1, 0, 0, 1], [0, 0, 1, 0], [0, 0, 0, 1]])
FLAT_UVS = SQUARE_CORNERS[:, :2]


def normal_material(strength=1.0, direction=TILTED):
    return Material("bumpy", normal_map=NormalMap(Constant(tuple(0.5 + 0.5 * direction)), gray(strength), UV), **PLAIN)


@pytest.mark.parametrize(
    ("uvs", "transform", "expected"),
    [
        (FLAT_UVS, np.eye(4), TILTED),
        (3 * FLAT_UVS + 5, np.eye(4), TILTED),
        (FLAT_UVS[:, ::-1], np.eye(4), TILTED[[1, 0, 2]]),
        (FLAT_UVS * (-1, 1), np.eye(4), TILTED * (-1, 1, 1)),
        (FLAT_UVS, TURN, TILTED[[1, 0, 2]] * (-1, 1, 1)),
        (FLAT_UVS, np.diag([-2.0, 2.0, 2.0, 1.0]), TILTED * (-1, 1, 1)),
        (0 * FLAT_UVS, np.eye(4), (0, 0, 1)),
    ],
    ids=["plain", "scaled", "swapped", "mirrored uvs", "turned", "mirrored object", "no area"],
)
def test_normal_maps(device, uvs, transform, expected):
    shown = scene_of([square(uvs=uvs)], [normal_material()], transforms=np.array([transform]))
    found = ask(device, shown, triangle=[0, 1])
    np.testing.assert_allclose(found.normal, [expected] * 2, atol=1e-6)
    # from behind it is the front's turned around
    behind = ask(device, shown, triangle=[0, 1], geometric=(0.0, 0.0, -1.0))
    np.testing.assert_allclose(behind.normal, [-np.array(expected)] * 2, atol=1e-6)


def test_strength_of_normal_maps(device):
    half = TILTED * (0.5, 0.5, 1) + (0, 0, 0.1)
    for strength, expected in ((0.0, np.array(UP)), (0.5, half / np.linalg.norm(half))):
        found = ask(device, scene_of([square()], [normal_material(strength)]))
        np.testing.assert_allclose(found.normal[0], expected, atol=1e-6)


# the world


def test_equirectangular_worlds(device):
    image = ImageTexels("sky", np.random.default_rng(5).uniform(0, 3, (16, 32, 3)).astype(np.float32))
    directions = np.random.default_rng(6).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    turned = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    shown = scene_of([square()], [Material("m")], World((0.5, 1.0, 1.0), image, turned))
    x, y, z = turned @ directions.T
    u, v = 0.5 - np.arctan2(y, x) / (2 * np.pi), 0.5 + np.arcsin(z) / np.pi
    expected = [0.5 * interpolated(image.texels, *place, Extension.REPEAT)[0] for place in zip(u, v, strict=True)]
    np.testing.assert_allclose(ask(device, shown, to_light=directions).world_red, expected, atol=2e-4)
    plain = scene_of([square()], [Material("m")], World((0.25, 0.5, 1.0)))
    np.testing.assert_allclose(ask(device, plain, to_light=directions).world_red, 0.25, atol=1e-7)


# reflection


def hemisphere(count):
    """Unit vectors of equal projected area: the mean over them times pi integrates times the cosine."""
    index = np.arange(count)
    radius = np.sqrt((index + 0.5) / count)
    angle = 2 * np.pi * (index * 0.6180339887498949 % 1.0)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)])


def eye_at(cosine):
    return np.array([np.sqrt(1 - cosine**2), 0.0, cosine])


LOBES = {
    "dielectric": Material("dielectric", BLACK, roughness=gray(0.5)),
    "rough dielectric": Material("rough dielectric", BLACK, roughness=gray(0.9), ior=gray(2.0)),
    "tinted": Material("tinted", BLACK, roughness=gray(0.6), specular_tint=Constant((1.0, 0.3, 0.1))),
    "gold": Material("gold", BLACK, BLACK, metal_weight=WHITE, metal=Constant((1.0, 0.7, 0.3)), roughness=gray(0.5)),
    "edge": Material(
        "edge", BLACK, BLACK, specular_tint=Constant((0.2, 0.6, 1.0)), metal_weight=WHITE, metal=gray(0.5), roughness=gray(0.4)
    ),
    "glossy": Material(
        "glossy", BLACK, BLACK, metal_weight=WHITE, metal=Constant((0.8, 0.5, 0.2)), has_metal_fresnel=False, roughness=gray(0.8)
    ),
    "half metal": Material("half", BLACK, gray(0.5), metal_weight=gray(0.5), metal=Constant((0.9, 0.6, 0.1)), roughness=gray(0.45)),
    "coated": Material("coated", BLACK, coat_weight=WHITE, coat_roughness=gray(0.4), roughness=gray(0.7)),
}


@pytest.mark.parametrize("cosine", [0.15, 0.5, 0.95])
@pytest.mark.parametrize("name", LOBES)
def test_reflection_color_is_the_integral_of_the_lobes(device_called, name, cosine):
    directions = hemisphere(60_000)
    found = ask(device_called("moderngl"), scene_of([square()], [LOBES[name]]), to_eye=eye_at(cosine), to_light=directions)
    # what bounces between microfacets is given back as a factor, with the mean of Fresnel over all directions
    np.testing.assert_allclose(np.pi * found.brdf.mean(axis=0), found.reflection_color[0], rtol=0.03, atol=3e-3)


@pytest.mark.parametrize("roughness", [0.3, 0.6, 1.0])
def test_white_furnace(device, roughness):
    """A surface that absorbs nothing vanishes in even light: metal alone, and a white diffuse one under a dielectric."""
    metal = Material("metal", BLACK, BLACK, metal_weight=WHITE, metal=WHITE, roughness=gray(roughness))
    paint = Material("paint", WHITE, roughness=gray(roughness))
    directions = hemisphere(40_000)
    shown = scene_of([square()] * 2, [metal, paint])
    for instance in range(2):
        for cosine in (0.2, 0.7):
            found = ask(device, shown, instance=instance, to_eye=eye_at(cosine), to_light=directions)
            assert np.pi * found.brdf.mean(axis=0)[1] == pytest.approx(1.0, abs=0.02), (instance, cosine)


def test_lobes_are_reciprocal(device):
    """Without what bounces between microfacets, which the eye's side alone decides, and without the layers below."""
    random = np.random.default_rng(7)
    directions = random.normal(size=(400, 3))
    directions[:, 2] = np.abs(directions[:, 2]) + 0.3
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    smooth = Material("smooth", BLACK, BLACK, metal_weight=WHITE, metal=Constant((0.9, 0.4, 0.1)), roughness=gray(0.1))
    shown = scene_of([square()], [smooth])
    there = ask(device, shown, to_eye=directions[::2], to_light=directions[1::2]).brdf
    back = ask(device, shown, to_eye=directions[1::2], to_light=directions[::2]).brdf
    np.testing.assert_allclose(there, back, rtol=0.02, atol=1e-6)


@pytest.mark.parametrize("ior", [1.0, 1.06, 1.33, 1.5, 2.0, 3.0])
@pytest.mark.parametrize("roughness", [0.0, 0.37, 0.8])
def test_dielectric_albedo_against_the_integral(device, ior, roughness):
    cosines = np.array([0.03, 0.1, 0.22, 0.4, 0.61, 0.83, 1.0])
    shown = scene_of([square()], [Material("glass", BLACK, ior=gray(ior), roughness=gray(roughness))])
    found = ask(device, shown, to_eye=np.array([eye_at(cosine) for cosine in cosines])).reflection_color[:, 0]
    to_half, weight = ggx_lobe(np.full(len(cosines), max(roughness**2, 1e-4)), cosines, 4096)
    once = (weight * fresnel_dielectric(to_half, ior)).mean(axis=1)
    # Kulla and Conty 2017, "Revisiting Physically Based Shading at Imageworks": what bounces between microfacets comes back
    every = np.linspace(0.001, 1, 200)
    mean_albedo = 2 * np.trapezoid(ggx_lobe(np.full(200, max(roughness**2, 1e-4)), every)[1].mean(axis=1) * every, every)
    mean = 2 * np.trapezoid(fresnel_dielectric(every, ior) * every, every)
    albedo = weight.mean(axis=1)
    expected = once * (1 + mean * mean_albedo / (1 - mean * (1 - mean_albedo)) * (1 - albedo) / albedo)
    np.testing.assert_allclose(found, expected, atol=0.02)


def test_smooth_lobes_are_fresnel_s_own(device):
    cosines = np.linspace(0.1, 1, 12)
    eyes = np.array([eye_at(cosine) for cosine in cosines])
    metal = Material("m", BLACK, BLACK, metal_weight=WHITE, metal=gray(0.6), specular_tint=gray(0.4), roughness=BLACK)
    found = ask(device, scene_of([square()], [metal]), to_eye=eyes).reflection_color[:, 0]
    schlick = 0.6 + 0.4 * (1 - cosines) ** 5
    at_82 = 0.6 + 0.4 * (6 / 7) ** 5
    expected = schlick - at_82 * 0.6 * cosines * (1 - cosines) ** 6 / ((1 / 7) * (6 / 7) ** 6)
    np.testing.assert_allclose(found, expected, atol=0.01)


def test_coats_reflect_most_over_rough_surfaces(device):
    coated = Material("c", gray(0.5), roughness=gray(0.8), coat_weight=WHITE, coat_roughness=gray(0.1), dielectric_weight=BLACK)
    metal = Material("m", BLACK, BLACK, metal_weight=WHITE, metal=gray(0.9), roughness=gray(0.4), coat_weight=WHITE)
    found = ask(device, scene_of([square()] * 2, [coated, metal]), instance=[0, 1])
    np.testing.assert_allclose(found.reflection_roughness, [0.1, 0.4], atol=1e-6)


COMPUTED = CornerValue(UV)
NORMAL_MAP = NormalMap(COMPUTED, gray(1.0))
EVERYTHING = ("PROGRAMS", "COATS", "NORMAL_MAPS")


@pytest.mark.parametrize(
    ("inputs", "flags", "emission_flags"),
    [
        ({}, (), ()),
        ({"diffuse": COMPUTED, "roughness": COMPUTED}, ("PROGRAMS",), ()),
        ({"emission": COMPUTED}, ("PROGRAMS",), ("PROGRAMS",)),
        ({"coat_weight": COMPUTED}, ("PROGRAMS", "COATS"), ()),
        ({"coat_weight": COMPUTED, "emission": WHITE}, ("PROGRAMS", "COATS"), ("PROGRAMS", "COATS")),
        ({"coat_ior": COMPUTED, "emission": WHITE}, ("PROGRAMS",), ()),
        ({"coat_ior": COMPUTED, "coat_weight": gray(0.5), "emission": WHITE}, ("PROGRAMS", "COATS"), ("PROGRAMS", "COATS")),
        ({"normal_map": NORMAL_MAP, "emission": WHITE}, ("PROGRAMS", "NORMAL_MAPS"), ()),
        ({"normal_map": NormalMap(gray(0.5), gray(1.0))}, ("NORMAL_MAPS",), ()),
        ({"normal_map": NORMAL_MAP, "coat_weight": gray(0.5)}, EVERYTHING, ()),
        ({"normal_map": NORMAL_MAP, "coat_weight": gray(0.5), "emission": WHITE}, EVERYTHING, EVERYTHING),
    ],
)
def test_kernels_hold_only_what_materials_need(device, inputs, flags, emission_flags):
    surfaces = SurfaceData(scene_of([square(), square()], [Material("plain"), Material("other", **inputs)]), device)
    assert (surfaces.flags, surfaces.emission_flags, surfaces.has_emission) == (flags, emission_flags, "emission" in inputs)
    assert surfaces.world_flags == ()
    surfaces.release()


def test_only_skies_with_an_image_are_looked_up(device):
    image = ImageTexels("sky", np.full((2, 4, 3), 0.25, np.float32))
    world = World((2.0, 1.0, 0.5), image, np.eye(3))
    surfaces = SurfaceData(scene_of([square()], [Material("plain")], world), device)
    assert surfaces.world_flags == ("WORLD_IMAGE",)
    surfaces.release()


def test_lights_behind_and_dark_surfaces(device):
    shown = scene_of([square()], [Material("black", BLACK, BLACK, emission=Constant((2.0, 1.0, 0.5)))])
    found = ask(device, shown, to_light=[(0, 0, -1.0), UP, (1.0, 0, 0)])
    assert (found.brdf == 0).all()
    np.testing.assert_allclose(found.emitted[0], (2.0, 1.0, 0.5))
