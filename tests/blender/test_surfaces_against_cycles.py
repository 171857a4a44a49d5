"""Radiance of lit surfaces against Cycles: lights in Blender's units, materials read from nodes, the device's reflection functions.

Squares lie in a row; what the centre of each sends to the camera is the mean over a light's samples of what they deliver times the BRDF.
"""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
pytest.importorskip("OpenEXR")

import struct  # noqa: E402  (bpy decides whether this file runs)
import tempfile  # noqa: E402
import zlib  # noqa: E402
from pathlib import Path  # noqa: E402

import OpenEXR  # noqa: E402

from tests.blender.test_material_opacity import SQUARE, Nodes, image_of, with_uvs  # noqa: E402
from tests.device.surface_queries import ask  # noqa: E402
from tests.ray_tracing import delivered, samples_in_world  # noqa: E402
from vir_addon.core.sampling import light_samples, sample_weights  # noqa: E402
from vir_addon.core.scene import Light, LightShape, SceneSnapshot  # noqa: E402
from vir_addon.device.open import open_device  # noqa: E402

SPACING_M = 1.25
TILT_RAD = 0.9
SAMPLE_COUNT = 512
PX_PER_SQUARE = 12
ROWS, COLUMNS = np.array([5, 6]), np.array([4, 5])
"""of the pixels that are looked at, within a square's cell"""


@pytest.fixture(scope="module")
def device():
    opened = open_device("moderngl")
    yield opened
    opened.close()


def rows_of_squares(add, materials):
    """One square a material along x, seen by a tilted orthographic camera."""
    for index, material in enumerate(materials):
        shown = add.mesh(f"square {index:02}", *SQUARE, location=(SPACING_M * index, 0.0, 0.0))
        with_uvs(shown.data)
        shown.data.materials.append(material)
    scene = bpy.context.scene
    width_m = SPACING_M * len(materials)
    middle = np.array([width_m / 2 - 0.125, 0.5, 0.0])
    away = np.array([0.0, -np.sin(TILT_RAD), np.cos(TILT_RAD)])
    camera = scene.camera
    camera.data.type, camera.data.ortho_scale = "ORTHO", width_m
    camera.location, camera.rotation_euler = middle + 20 * away, (TILT_RAD, 0.0, 0.0)
    scene.render.resolution_x, scene.render.resolution_y = PX_PER_SQUARE * len(materials), PX_PER_SQUARE
    scene.render.resolution_percentage = 100
    return away


def cycles_radiance(scene, count, samples):
    """(count, pixel_count, 3) around the squares' centres"""
    render, cycles = scene.render, scene.cycles
    render.engine, cycles.device, cycles.samples = "CYCLES", "CPU", samples
    render.filter_size = cycles.filter_width = 0.01
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.max_bounces = 0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    render.image_settings.file_format, render.image_settings.color_depth, render.image_settings.color_mode = "OPEN_EXR", "32", "RGB"
    with tempfile.TemporaryDirectory() as folder:
        render.filepath = str(Path(folder) / "image")
        bpy.ops.render.render(write_still=True)
        with OpenEXR.File(str(next(Path(folder).glob("image*.exr")))) as file:
            pixels = next(iter(file.channels().values())).pixels
    # row 0 is the top one
    return pixels[::-1][ROWS][:, (PX_PER_SQUARE * np.arange(count))[:, None] + COLUMNS].transpose(1, 0, 2, 3).reshape(count, -1, 3)


def looked_at(count):
    """(count, pixel_count, 2) where on each square the pixels of `cycles_radiance` are"""
    px_m = SPACING_M / PX_PER_SQUARE
    x = (COLUMNS + 0.5) * px_m - 0.125
    y = 0.5 + (ROWS + 0.5 - PX_PER_SQUARE / 2) * px_m / np.cos(TILT_RAD)
    return np.tile(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2), (count, 1, 1))


def our_radiance(device, snapshot: SceneSnapshot, count, away):
    """The same from the snapshot and the device's functions, lights sampled at SAMPLE_COUNT points."""
    total = np.zeros((count, len(ROWS) * len(COLUMNS), 3))
    for index, places in enumerate(looked_at(count)):
        positions = np.column_stack([places[:, 0] + SPACING_M * index, places[:, 1], np.zeros(len(places))])
        # the first triangle's plane is the square's: weights may be negative
        weights = np.column_stack([places[:, 0] - places[:, 1], places[:, 1]])
        for light in snapshot.lights:
            towards, delivered_here = light_at(light, positions)
            sample_count = towards.shape[1]
            found = ask(
                device,
                snapshot,
                instance=index,
                weights=np.repeat(weights, sample_count, axis=0),
                to_eye=away,
                to_light=towards.reshape(-1, 3),
            )
            reflected = found.brdf.reshape(-1, sample_count, 3)
            if light.shape is LightShape.SUN:
                delivered_here = np.maximum(np.einsum("nj,nmj->nm", found.normal[::sample_count], towards), 0)
            total[index] += np.array(light.strength_rgb) * (reflected * delivered_here[..., None]).mean(axis=1)
        total[index] += ask(device, snapshot, instance=index, weights=weights, to_eye=away).emitted
    return total


def light_at(light: Light, positions):
    """(n, m, 3) unit directions to the light's samples, (n, m) what they deliver to surfaces that look up (suns: nothing yet)."""
    up = np.tile([0.0, 0.0, 1.0], (len(positions), 1))
    if light.shape is LightShape.SUN:
        towards = np.tile(light.world_from_light[:3, 2], (len(positions), 1, 1))
        return towards, np.zeros(towards.shape[:2])
    samples_m = light_samples(light, SAMPLE_COUNT if light.has_size else 1)
    samples_ws = samples_in_world(light, samples_m)
    weight = delivered(light, samples_ws, positions, up) * sample_weights(light, samples_m)
    if light.shape.is_omni and light.has_size:
        # of the sphere's samples only those that are seen deliver; the disc's are met from both sides
        weight = weight * (2.0 if light.has_soft_falloff else 4.0)
    towards = samples_ws[None] - positions[:, None]
    return towards / np.linalg.norm(towards, axis=-1, keepdims=True), weight


def compare(device, scene, look, count, away, samples=512):
    ours = our_radiance(device, look(), count, away)
    truth = cycles_radiance(scene, count, samples)
    return ours, truth


@pytest.fixture
def look(take):
    return lambda: take(with_materials=True)


def white_diffuse():
    nodes = Nodes("white")
    node = nodes("BsdfDiffuse")
    node.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    nodes.link(node.outputs[0], nodes.output.inputs["Surface"])
    return nodes.material


LIGHTS = {
    "square": ("AREA", {"size": 1.0}),
    "ellipse with a spread": ("AREA", {"shape": "ELLIPSE", "size": 2.0, "size_y": 0.5, "spread": 1.2}),
    "not normalized": ("AREA", {"size": 0.5, "normalize": False}),
    "hard point": ("POINT", {"shadow_soft_size": 0.0}),
    "sphere": ("POINT", {"shadow_soft_size": 0.6, "use_soft_falloff": False}),
    "soft sphere": ("POINT", {"shadow_soft_size": 0.6, "use_soft_falloff": True}),
    "spot": ("SPOT", {"shadow_soft_size": 0.1, "spot_size": 1.6, "spot_blend": 0.8}),
    "sun": ("SUN", {"angle": 0.001}),
    "bright": ("POINT", {"exposure": 1.5, "use_temperature": True, "temperature": 3000.0}),
}


@pytest.mark.parametrize("name", LIGHTS)
def test_lights_have_blender_s_units(device, scene, add, look, name):
    kind, data = LIGHTS[name]
    away = rows_of_squares(add, [white_diffuse()] * 3)
    energy = 3.0 if kind == "SUN" else 100.0
    add.light(
        "Lamp", kind, data={"energy": energy, "color": (1.0, 0.6, 0.2), **data}, location=(2.0, 1.5, 2.0), rotation_euler=(-0.5, 0.2, 0.0)
    )
    ours, truth = compare(device, scene, look, 3, away)
    print(name, np.abs(ours / truth - 1).max())
    assert truth.min() > 1e-3
    np.testing.assert_allclose(ours, truth, rtol=0.02)


def principled(**inputs):
    nodes = Nodes("principled")
    node = nodes.principled()
    for name, value in inputs.items():
        socket = node.inputs[name.replace("_", " ")]
        socket.default_value = (*value, 1.0) if isinstance(value, tuple) else value
    return nodes.material


GOLD, BLUE = (1.0, 0.7, 0.3), (0.1, 0.3, 0.9)


def glossy(color, roughness):
    nodes = Nodes("glossy")
    node = nodes("BsdfGlossy")
    node.inputs["Color"].default_value, node.inputs["Roughness"].default_value = (*color, 1.0), roughness
    nodes.link(node.outputs[0], nodes.output.inputs["Surface"])
    return nodes.material


def mixed(first_roughness, second_roughness, factor):
    nodes = Nodes("mixed")
    shaders = []
    for roughness in (first_roughness, second_roughness):
        shaders.append(nodes("BsdfGlossy" if roughness else "BsdfDiffuse"))
        shaders[-1].inputs["Color"].default_value = (*GOLD, 1.0)
        if roughness:
            shaders[-1].inputs["Roughness"].default_value = roughness
    mix = nodes("MixShader")
    mix.inputs[0].default_value = factor
    for index, shader in enumerate(shaders):
        nodes.link(shader.outputs[0], mix.inputs[1 + index])
    nodes.link(mix.outputs[0], nodes.output.inputs["Surface"])
    return nodes.material


def under_fresnel():
    nodes = Nodes("fresnel")
    diffuse, shiny, fresnel, mix = nodes("BsdfDiffuse"), nodes("BsdfGlossy"), nodes("Fresnel"), nodes("MixShader")
    diffuse.inputs["Color"].default_value = (*BLUE, 1.0)
    shiny.inputs["Roughness"].default_value = 0.4
    nodes.link(fresnel.outputs[0], mix.inputs[0])
    nodes.link(diffuse.outputs[0], mix.inputs[1])
    nodes.link(shiny.outputs[0], mix.inputs[2])
    nodes.link(mix.outputs[0], nodes.output.inputs["Surface"])
    return nodes.material


MATERIALS = {
    "plastic": lambda: [principled(Base_Color=BLUE, Roughness=roughness) for roughness in (0.2, 0.35, 0.5, 0.75, 1.0)],
    "metal": lambda: [principled(Base_Color=GOLD, Metallic=1.0, Roughness=roughness) for roughness in (0.2, 0.35, 0.5, 0.75, 1.0)],
    "half metal": lambda: [principled(Base_Color=GOLD, Metallic=share, Roughness=0.4) for share in (0.25, 0.5, 0.75)],
    "tints": lambda: [principled(Base_Color=GOLD, Metallic=share, Roughness=0.5, Specular_Tint=BLUE) for share in (0.0, 0.5, 1.0)],
    "indices": lambda: [principled(Base_Color=BLUE, IOR=ior, Roughness=0.4) for ior in (1.1, 1.33, 2.0)],
    "levels": lambda: [principled(Base_Color=BLUE, Specular_IOR_Level=level, Roughness=0.4) for level in (0.0, 0.25, 1.0)],
    "coats": lambda: [principled(Base_Color=BLUE, Roughness=0.8, Coat_Weight=w, Coat_Roughness=0.3) for w in (0.5, 1.0)],
    "emission": lambda: [principled(Base_Color=BLUE, Emission_Color=GOLD, Emission_Strength=s) for s in (0.5, 2.0)],
    "glossy": lambda: [glossy(GOLD, roughness) for roughness in (0.3, 0.6, 1.0)],
    "mixes": lambda: [mixed(0.0, 0.4, 0.3), mixed(0.4, 0.4, 0.5)],
}


@pytest.mark.parametrize("name", MATERIALS)
def test_materials_reflect_lights_as_in_cycles(device, scene, add, look, name):
    """A sun near the mirror direction, and an area light off it."""
    materials = MATERIALS[name]()
    count = len(materials)
    away = rows_of_squares(add, materials)
    add.light("Sun", "SUN", data={"energy": 1.0, "angle": 0.001}, rotation_euler=(-0.75, 0.1, 0.0))
    area = {"energy": 100.0, "size": 1.0}
    add.light("Area", "AREA", data=area, location=(SPACING_M * count / 2, -2.0, 3.0), rotation_euler=(0.6, 0.0, 0.0))
    ours, truth = compare(device, scene, look, count, away, samples=1024)
    print(name, "\n", np.round((ours / truth).mean(axis=1), 3), np.abs(ours / truth - 1).max())
    np.testing.assert_allclose(ours, truth, rtol=0.02)


def test_shaders_mixed_by_fresnel(device, scene, add, look):
    """Cycles' factor is that of the smooth surface, a dielectric's that of its microfacets."""
    away = rows_of_squares(add, [under_fresnel()])
    add.light("Sun", "SUN", data={"energy": 1.0, "angle": 0.001}, rotation_euler=(-0.75, 0.1, 0.0))
    ours, truth = compare(device, scene, look, 1, away)
    np.testing.assert_allclose(ours, truth, rtol=0.1)


def test_textures_and_normal_maps_as_in_cycles(device, scene, add, look):
    random = np.random.default_rng(2)
    colors = np.ones((4, 4, 4), np.float32)
    colors[..., :3] = random.uniform(0, 1, (4, 4, 3))
    bumps = np.ones((3, 3, 4), np.float32)
    bumps[..., :3] = 0.5 + 0.5 * random.uniform((-0.5, -0.5, 0.6), (0.5, 0.5, 1.0), (3, 3, 3))
    materials = []
    for strength, has_alpha in ((0.0, False), (1.0, False), (0.5, True)):
        nodes = Nodes(f"{strength}")
        texture = nodes.texture(image_of(colors, f"colors {has_alpha}"))
        shader = nodes.principled()
        shader.inputs["Roughness"].default_value = 0.6
        nodes.link(texture.outputs["Color"], shader.inputs["Base Color"])
        normal = nodes("NormalMap")
        normal.inputs["Strength"].default_value = strength
        nodes.link(nodes.texture(image_of(bumps, "bumps", color_space="Non-Color")).outputs["Color"], normal.inputs["Color"])
        nodes.link(normal.outputs[0], shader.inputs["Normal"])
        materials.append(nodes.material)
    away = rows_of_squares(add, materials)
    add.light("Sun", "SUN", data={"energy": 3.0, "angle": 0.001}, rotation_euler=(-0.4, 0.3, 0.0))
    ours, truth = compare(device, scene, look, len(materials), away)
    print(np.round(ours / truth, 3))
    np.testing.assert_allclose(ours, truth, rtol=0.02)


def checkered(kind, scale):
    nodes = Nodes(f"checkered by {kind}")
    checker, emission = nodes("TexChecker"), nodes("Emission")
    for name, value in {"Color1": (*GOLD, 1.0), "Color2": (*BLUE, 1.0), "Scale": scale}.items():
        checker.inputs[name].default_value = value
    if kind != "nothing":
        mapping, coordinates = nodes("Mapping"), nodes("TexCoord")
        mapping.inputs["Location"].default_value, mapping.inputs["Rotation"].default_value = (0.1, 0.2, 0.3), (0.3, 0.2, 0.5)
        nodes.link(coordinates.outputs[kind], mapping.inputs["Vector"])
        nodes.link(mapping.outputs[0], checker.inputs["Vector"])
    nodes.link(checker.outputs["Color"], emission.inputs["Color"])
    nodes.link(emission.outputs[0], nodes.output.inputs["Surface"])
    return nodes.material


def gradient():
    """Of a part of v, through a ramp and a curve."""
    nodes = Nodes("gradient")
    coordinates, scale, separate, combine = (
        nodes("TexCoord"),
        nodes("VectorMath", operation="MULTIPLY_ADD"),
        nodes("SeparateXYZ"),
        nodes("CombineXYZ"),
    )
    scale.inputs[1].default_value, scale.inputs[2].default_value = (1.0, 1.5, 1.0), (0.0, -0.2, 0.0)
    blend, ramp, curves, emission = nodes("TexGradient"), nodes("ValToRGB"), nodes("RGBCurve"), nodes("Emission")
    ramp.color_ramp.elements[0].color, ramp.color_ramp.elements[1].color = (*GOLD, 1.0), (*BLUE, 1.0)
    ramp.color_ramp.elements[0].position = 0.2
    curves.mapping.curves[0].points[0].location = (0.0, 0.3)
    curves.mapping.update()
    links = (
        (coordinates.outputs["UV"], scale.inputs[0]),
        (scale.outputs[0], separate.inputs[0]),
        (separate.outputs["Y"], combine.inputs["X"]),
        (combine.outputs[0], blend.inputs[0]),
        (blend.outputs["Fac"], ramp.inputs[0]),
        (ramp.outputs["Color"], curves.inputs["Color"]),
        (curves.outputs[0], emission.inputs["Color"]),
        (emission.outputs[0], nodes.output.inputs["Surface"]),
    )
    for output, socket in links:
        nodes.link(output, socket)
    return nodes.material


def test_computed_textures_as_in_cycles(device, scene, add, look):
    materials = [checkered("nothing", 3.7), checkered("UV", 9.0), checkered("Generated", 7.0), gradient()]
    away = rows_of_squares(add, materials)
    snapshot = look()
    assert not snapshot.left_out
    ours, truth = our_radiance(device, snapshot, len(materials), away), cycles_radiance(scene, len(materials), 16)
    assert (np.ptp(truth, axis=1).max(axis=1) > 0.05).sum() >= 3  # fields of both colours, and a gradient
    np.testing.assert_allclose(ours, truth, atol=3e-3)


def shining_by(image, *, uses_alpha):
    """Its colours shine, by their alpha where that is used as well."""
    nodes = Nodes(f"{image.name} {uses_alpha}")
    texture, emission = nodes.texture(image), nodes("Emission")
    nodes.link(texture.outputs["Color"], emission.inputs["Color"])
    if uses_alpha:
        nodes.link(texture.outputs["Alpha"], emission.inputs["Strength"])
    nodes.link(emission.outputs[0], nodes.output.inputs["Surface"])
    return nodes.material


def compare_images(device, scene, add, look, images):
    materials = [shining_by(image, uses_alpha=uses_alpha) for image in images for uses_alpha in (False, True)]
    away = rows_of_squares(add, materials)
    ours, truth = our_radiance(device, look(), len(materials), away), cycles_radiance(scene, len(materials), 16)
    np.testing.assert_allclose(ours, truth, rtol=0.01)


@pytest.mark.parametrize("color_space", ["sRGB", "Non-Color"])
def test_images_with_alpha_as_in_cycles(device, scene, add, look, color_space):
    # Cycles 4.5 multiplies bytes of colours by alpha though they are said to be premultiplied; VIR does as 5.2
    premultiplied = ("PREMUL",) if bpy.app.version >= (5, 0) or color_space == "Non-Color" else ()
    rgba = np.random.default_rng(4).uniform(0.2, 1, (2, 2, 4)).astype(np.float32)
    modes = ("STRAIGHT", *premultiplied, "CHANNEL_PACKED", "NONE")
    images = [image_of(rgba, mode, color_space=color_space, alpha_mode=mode) for mode in modes]
    compare_images(device, scene, add, look, images)


def write_png(path, rgba, *, bits):
    """Texels as they are: Blender and other writers divide by alpha, or know no 16 bits."""
    height, width, _ = rgba.shape
    values = np.round(rgba[::-1] * (2**bits - 1)).astype(f">u{bits // 8}")
    rows = b"".join(b"\0" + row.tobytes() for row in values)
    parts = {b"IHDR": struct.pack(">IIBBBBB", width, height, bits, 6, 0, 0, 0), b"IDAT": zlib.compress(rows), b"IEND": b""}
    chunks = (struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts.items())
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(chunks))


@pytest.mark.skipif(bpy.app.version < (5, 2), reason="Cycles 4.5 reads alpha of files otherwise; VIR does as 5.2")
@pytest.mark.parametrize("is_packed", [False, True], ids=["on disk", "packed"])
@pytest.mark.parametrize("color_space", ["sRGB", "Linear Rec.709", "Non-Color"])
@pytest.mark.parametrize("kind", ["8 bits", "16 bits", "floats"])
@pytest.mark.parametrize("covers", [True, False], ids=["covering", "glow"])
def test_files_with_alpha_as_in_cycles(device, scene, add, look, tmp_path, covers, kind, color_space, is_packed):
    """Cycles opens files by itself, and takes what is packed from Blender, which multiplies floats by alpha and divides bytes by it.

    covers: its alpha is not 0 throughout, which renderers give glow and fire
    """
    rgba = np.random.default_rng(4).uniform(0.5, 1, (2, 2, 4)).astype(np.float32)
    rgba[..., :3] *= rgba[..., 3:]  # premultiplied ones never have more, unless they glow
    rgba[..., 3] *= covers
    path = tmp_path / ("image.exr" if kind == "floats" else "image.png")
    if kind == "floats":
        OpenEXR.File({}, {"RGBA": rgba[::-1].copy()}).write(str(path))
    else:
        write_png(path, rgba, bits=int(kind.split()[0]))
    images = []
    # bytes that Blender has divided by an alpha of 0 are white, whatever the file holds
    is_lost = kind == "8 bits" and not covers and not is_packed
    for mode in ("STRAIGHT", *(() if is_lost else ("PREMUL",)), "CHANNEL_PACKED", "NONE"):
        images.append(bpy.data.images.load(str(path)))
        images[-1].name = mode
        images[-1].colorspace_settings.name, images[-1].alpha_mode = color_space, mode
        if is_packed:
            images[-1].pack()
    compare_images(device, scene, add, look, images)
