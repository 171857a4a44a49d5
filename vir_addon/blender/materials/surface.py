"""A material's nodes -> `core.material.Material`: what its surface looks like in reflections.

Shaders become lobes, and what mixes them mixes the lobes. What of a material cannot be read has the value that stands behind its input,
or the viewport's colour, and is listed with the reason.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...core.errors import SceneError
from ...core.material import BLACK, WHITE, Constant, Layer, LayerKind, Material, MaterialInput, NormalMap, Operation, Rgb
from ...core.material_program import combined, compile_material, constant, material_images, material_layers
from ...core.scene import LeftOut
from .colors import ColorReader
from .expressions import clamped, mixed
from .image_cache import ImageCache
from .image_texels import UnreadableImage
from .inputs import NodeInput, UnreadableNodes, by_identifier, output_node, output_target, slot_materials

_MOST_SHADERS_DEEP = 40
_LARGEST_REFLECTANCE = 0.99
"""straight on, as renderers limit it"""
_BLENDER_DEFAULT = Material("", diffuse=constant(0.8), dielectric_weight=BLACK)
"""what renderers show where a slot is empty"""


_NOTHING = Material("", diffuse=BLACK, dielectric_weight=BLACK)


def _scaled(lobes: Material, share: MaterialInput) -> Material:
    """The share that a mix gives a shader."""
    return replace(
        lobes,
        diffuse=_times(lobes.diffuse, share),
        dielectric_weight=_times(lobes.dielectric_weight, share),
        metal_weight=_times(lobes.metal_weight, share),
        coat_weight=_times(lobes.coat_weight, share),
        emission=_times(lobes.emission, share),
    )


def _lobe_weight(lobes: Material) -> MaterialInput:
    return combined(Operation.ADD, lobes.dielectric_weight, lobes.metal_weight)


def _sum(first: Material, second: Material) -> Material:
    def added(name: str) -> MaterialInput:
        return combined(Operation.ADD, getattr(first, name), getattr(second, name))

    def mean(name: str, weight: Callable[[Material], MaterialInput]) -> MaterialInput:
        return _mean(getattr(first, name), getattr(second, name), weight(first), weight(second))

    return Material(
        "",
        diffuse=added("diffuse"),
        dielectric_weight=added("dielectric_weight"),
        ior=mean("ior", lambda lobes: lobes.dielectric_weight),
        specular_tint=mean("specular_tint", _lobe_weight),
        metal_weight=added("metal_weight"),
        metal=mean("metal", lambda lobes: lobes.metal_weight),
        has_metal_fresnel=first.has_metal_fresnel if first.metal_weight != BLACK else second.has_metal_fresnel,
        roughness=mean("roughness", _lobe_weight),
        coat_weight=added("coat_weight"),
        coat_roughness=mean("coat_roughness", lambda lobes: lobes.coat_weight),
        coat_ior=mean("coat_ior", lambda lobes: lobes.coat_weight),
        emission=added("emission"),
        normal_map=first.normal_map or second.normal_map,
    )


def _mean(first: MaterialInput, second: MaterialInput, first_weight: MaterialInput, second_weight: MaterialInput) -> MaterialInput:
    if second_weight == BLACK or first is second or (isinstance(first, Constant) and first == second):
        return first
    if first_weight == BLACK:
        return second
    share = combined(Operation.DIVIDE, second_weight, combined(Operation.ADD, first_weight, second_weight))
    return mixed(first, second, share)


class SurfaceReader:
    """Reads each material once, into `materials`."""

    def __init__(self, engine: str, images: ImageCache, override: bpy.types.Material | None = None) -> None:
        """engine: its identifier. override: of the view layer, takes the place of every material."""
        self._target = output_target(engine)
        self._override = override
        self._index: dict[int, int] = {}
        self._layers: dict[tuple[int, ...], frozenset[Layer]] = {}
        self._colors = ColorReader(images)
        self.materials: list[Material] = []
        self.left_out: list[LeftOut] = []

    @property
    def notes(self) -> list[str]:
        return self._colors.notes

    def material_set(self, shown: bpy.types.Object) -> tuple[int, ...]:
        """Indices into `materials`, one a material slot of an evaluated object, at least one."""
        return tuple(self._index_of(material) for material in slot_materials(shown, self._override) or [None])

    def layers_of(self, material_set: tuple[int, ...]) -> frozenset[Layer]:
        """What a mesh with these materials must have at its corners."""
        if material_set not in self._layers:
            self._layers[material_set] = frozenset().union(*(material_layers(self.materials[index]) for index in set(material_set)))
        return self._layers[material_set]

    def _index_of(self, material: bpy.types.Material | None) -> int:
        address = 0 if material is None else material.as_pointer()
        if address not in self._index:
            # before anything is noted: there may be no time for an image
            read = _BLENDER_DEFAULT if material is None else self._read(material)
            self._index[address] = len(self.materials)
            self.materials.append(read)
        return self._index[address]

    def _read(self, material: bpy.types.Material) -> Material:
        output = output_node(material, self._target)
        if output is None:
            has_nodes = material.node_tree is not None and (bpy.app.version >= (5, 0) or material.use_nodes)
            return replace(_NOTHING, name=material.name) if has_nodes else _viewport_material(material)
        reading = _ShaderReading(self._colors, material)
        try:
            read = replace(reading.lobes(NodeInput(output.inputs["Surface"])), name=material.name)
            compile_material(read, dict.fromkeys(material_layers(read), 0), dict.fromkeys(material_images(read), 0))
        except (UnreadableNodes, UnreadableImage, SceneError) as error:
            self.left_out.append(
                LeftOut(f"material {material.name}", f"is reflected in its viewport colour, because it depends on {error}")
            )
            return replace(_viewport_material(material), is_fallback=True)
        self.left_out += [LeftOut(f"material {material.name}", f"is reflected {reason}") for reason in reading.reasons]
        return read


def viewport_color(material: bpy.types.Material) -> Rgb:
    return tuple(material.diffuse_color[:3])


def _viewport_material(material: bpy.types.Material) -> Material:
    color = constant(*viewport_color(material))
    metallic = constant(material.metallic)
    return Material(
        material.name,
        diffuse=combined(Operation.MULTIPLY, color, combined(Operation.SUBTRACT, WHITE, metallic)),
        dielectric_weight=combined(Operation.SUBTRACT, WHITE, metallic),
        metal_weight=metallic,
        metal=color,
        roughness=constant(material.roughness),
    )


class _ShaderReading:
    """One material's shaders."""

    def __init__(self, colors: ColorReader, material: bpy.types.Material) -> None:
        self.colors, self._material = colors, material
        self._depth = 0
        self._lobes: dict[tuple[int, ...], Material] = {}
        """of shader nodes in their groups: many may share one"""
        self.reasons: list[str] = []
        """what is not read, as in 'with ...'"""

    def lobes(self, shader: NodeInput) -> Material:
        node, _, here = shader.source()
        if node is None:
            return _NOTHING
        if self._depth >= _MOST_SHADERS_DEEP:
            raise UnreadableNodes(f"more than {_MOST_SHADERS_DEEP} shaders one behind the other, or links that go in a circle")
        read = _SHADERS.get(node.type)
        if read is None:
            raise UnreadableNodes(f"the node '{node.name}'")
        place = (node.as_pointer(), *(group.as_pointer() for group in here.groups))
        if place not in self._lobes:
            self._depth += 1
            try:
                self._lobes[place] = read(self, _Inputs(self, node, here))
            finally:
                self._depth -= 1
        return self._lobes[place]

    def value(self, node: bpy.types.Node, here: NodeInput, identifier: str, *, is_color: bool) -> MaterialInput:
        """Of an input; where what is linked to it cannot be read, the viewport's colour or the input's own number."""
        socket = here.of(node, identifier)
        try:
            return self.colors.color(socket) if is_color else self.colors.number(socket)
        except (UnreadableNodes, UnreadableImage) as error:
            if is_color and identifier in _MAIN_COLORS:
                self.reasons.append(f"in its viewport colour, because its {identifier} depends on {error}")
                return constant(*viewport_color(self._material))
            self.reasons.append(f"with a plain {identifier}, because that depends on {error}")
            value = by_identifier(node.inputs, identifier).default_value
            return constant(*value[:3]) if is_color else constant(value)

    def normal_map(self, node: bpy.types.Node, here: NodeInput) -> NormalMap | None:
        source, _, there = here.of(node, "Normal").source()
        if source is None:
            return None
        if source.type != "NORMAL_MAP" or source.space != "TANGENT":
            what = f"the space of the node '{source.name}'" if source.type == "NORMAL_MAP" else f"the node '{source.name}'"
            self.reasons.append(f"with plain normals, because they depend on {what}")
            return None
        try:
            color, strength = self.colors.color(there.of(source, "Color")), self.colors.number(there.of(source, "Strength"))
        except (UnreadableNodes, UnreadableImage) as error:
            self.reasons.append(f"with plain normals, because they depend on {error}")
            return None
        if strength == BLACK or color == constant(0.5, 0.5, 1.0):
            return None
        return NormalMap(color, strength, Layer(LayerKind.UV, source.uv_map))


_MAIN_COLORS = ("Base Color", "Color")
"""what the viewport's colour stands for"""


@dataclass(frozen=True)
class _Inputs:
    """A shader node's."""

    reading: _ShaderReading
    node: bpy.types.Node
    here: NodeInput

    def color(self, identifier: str) -> MaterialInput:
        return self.reading.value(self.node, self.here, identifier, is_color=True)

    def number(self, identifier: str) -> MaterialInput:
        return self.reading.value(self.node, self.here, identifier, is_color=False)

    def lobes(self, identifier: str) -> Material:
        return self.reading.lobes(self.here.of(self.node, identifier))

    def source(self, identifier: str) -> tuple[bpy.types.Node | None, str, NodeInput]:
        return self.here.of(self.node, identifier).source()

    def normal_map(self) -> NormalMap | None:
        return self.reading.normal_map(self.node, self.here)


def _rest(value: MaterialInput) -> MaterialInput:
    return combined(Operation.SUBTRACT, WHITE, value)


def _times(*values: MaterialInput) -> MaterialInput:
    product = values[0]
    for value in values[1:]:
        product = combined(Operation.MULTIPLY, product, value)
    return product


def _principled(_: _ShaderReading, inputs: _Inputs) -> Material:
    base = inputs.color("Base Color")
    metallic, transmission = clamped(inputs.number("Metallic")), clamped(inputs.number("Transmission Weight"))
    coat = clamped(inputs.number("Coat Weight"))
    emission = _times(inputs.color("Emission Color"), inputs.number("Emission Strength"))
    dielectric = _rest(metallic)
    return replace(
        _NOTHING,
        diffuse=_times(base, dielectric, _rest(transmission)),
        dielectric_weight=dielectric,
        ior=_ior_of_level(inputs.number("IOR"), inputs.number("Specular IOR Level")),
        specular_tint=inputs.color("Specular Tint"),
        metal_weight=metallic,
        metal=base if metallic != BLACK else BLACK,
        roughness=inputs.number("Roughness"),
        coat_weight=coat,
        coat_roughness=inputs.number("Coat Roughness") if coat != BLACK else _NOTHING.coat_roughness,
        coat_ior=inputs.number("Coat IOR") if coat != BLACK else _NOTHING.coat_ior,
        emission=emission,
        normal_map=inputs.normal_map(),
    )


def _ior_of_level(ior: MaterialInput, level: MaterialInput) -> MaterialInput:
    """The "Specular IOR Level" scales what the index of refraction makes of light straight on; at 0.5 nothing changes."""
    half = constant(0.5)
    if level == half:
        return ior
    root = combined(Operation.DIVIDE, combined(Operation.SUBTRACT, ior, WHITE), combined(Operation.ADD, ior, WHITE))
    reflectance = _times(root, root, constant(2.0), combined(Operation.MAXIMUM, level, BLACK))
    new_root = combined(Operation.POWER, combined(Operation.MINIMUM, reflectance, constant(_LARGEST_REFLECTANCE)), half)
    return combined(Operation.DIVIDE, combined(Operation.ADD, WHITE, new_root), _rest(new_root))


def _diffuse(_: _ShaderReading, inputs: _Inputs) -> Material:
    return replace(_NOTHING, diffuse=inputs.color("Color"), normal_map=inputs.normal_map())


def _glossy(_: _ShaderReading, inputs: _Inputs) -> Material:
    return replace(
        _NOTHING,
        metal_weight=WHITE,
        metal=inputs.color("Color"),
        has_metal_fresnel=False,
        roughness=inputs.number("Roughness"),
        normal_map=inputs.normal_map(),
    )


def _metallic(_: _ShaderReading, inputs: _Inputs) -> Material:
    if inputs.node.fresnel_type == "F82":
        metal, tint = inputs.color("Base Color"), inputs.color("Edge Tint")
    else:
        index, extinction = (np.array(by_identifier(inputs.node.inputs, name).default_value[:3]) for name in ("IOR", "Extinction"))
        squared = extinction**2
        metal, tint = constant(*((index - 1) ** 2 + squared) / ((index + 1) ** 2 + squared)), WHITE
    return replace(
        _NOTHING,
        metal_weight=WHITE,
        metal=metal,
        specular_tint=tint,
        roughness=inputs.number("Roughness"),
        normal_map=inputs.normal_map(),
    )


def _glass(_: _ShaderReading, inputs: _Inputs) -> Material:
    return replace(
        _NOTHING,
        dielectric_weight=WHITE,
        ior=inputs.number("IOR"),
        specular_tint=inputs.color("Color"),
        roughness=inputs.number("Roughness"),
        normal_map=inputs.normal_map(),
    )


def _emission(_: _ShaderReading, inputs: _Inputs) -> Material:
    return replace(_NOTHING, emission=_times(inputs.color("Color"), inputs.number("Strength")))


def _specular(_: _ShaderReading, inputs: _Inputs) -> Material:
    """EEVEE's "Specular BSDF": the colour of the lobe straight on is given."""
    return replace(
        _NOTHING,
        diffuse=inputs.color("Base Color"),
        metal_weight=WHITE,
        metal=inputs.color("Specular"),
        roughness=inputs.number("Roughness"),
        emission=inputs.color("Emissive Color"),
        normal_map=inputs.normal_map(),
    )


def _nothing(_: _ShaderReading, __: _Inputs) -> Material:
    return _NOTHING


def _added(_: _ShaderReading, inputs: _Inputs) -> Material:
    return _sum(inputs.lobes("Shader"), inputs.lobes("Shader_001"))


def _mixed(reading: _ShaderReading, inputs: _Inputs) -> Material:
    # what is transparent is not there, and what is there is the other shader: opacity is another matter
    kinds = [source.type if source is not None else None for source in (inputs.source(name)[0] for name in ("Shader", "Shader_001"))]
    if "BSDF_TRANSPARENT" in kinds:
        return inputs.lobes("Shader_001" if kinds[0] == "BSDF_TRANSPARENT" else "Shader")
    first, second = inputs.lobes("Shader"), inputs.lobes("Shader_001")
    factor, output, there = inputs.source("Fac")
    if factor is not None and (factor.type == "FRESNEL" or (factor.type == "LAYER_WEIGHT" and output == "Fresnel")):
        layered = _layered(reading, first, second, factor, there)
        if layered is not None:
            return layered
    try:
        share = clamped(reading.colors.number(inputs.here.of(inputs.node, "Fac")))
    except (UnreadableNodes, UnreadableImage) as error:
        raise UnreadableNodes(f"{error}, which mixes shaders") from error
    return _sum(_scaled(first, _rest(share)), _scaled(second, share))


def _layered(reading: _ShaderReading, under: Material, over: Material, factor: bpy.types.Node, here: NodeInput) -> Material | None:
    """A Glossy BSDF over another by a Fresnel factor, which is what a dielectric is. None: something else."""
    if over.metal_weight != WHITE or over.has_metal_fresnel or under.dielectric_weight != BLACK:
        return None
    if factor.type == "FRESNEL":
        ior = reading.value(factor, here, "IOR", is_color=False)
    else:
        blend = combined(Operation.MINIMUM, reading.value(factor, here, "Blend", is_color=False), constant(1.0 - 1e-5))
        ior = combined(Operation.DIVIDE, WHITE, _rest(blend))
    lobe = replace(over, metal_weight=BLACK, metal=BLACK, dielectric_weight=WHITE, ior=ior, specular_tint=over.metal)
    return _sum(under, lobe)


_SHADERS: dict[str, Callable[[_ShaderReading, _Inputs], Material]] = {
    "BSDF_PRINCIPLED": _principled,
    "BSDF_DIFFUSE": _diffuse,
    "SUBSURFACE_SCATTERING": _diffuse,
    "BSDF_TOON": _diffuse,
    "BSDF_GLOSSY": _glossy,
    "BSDF_METALLIC": _metallic,
    "BSDF_GLASS": _glass,
    "EMISSION": _emission,
    "EEVEE_SPECULAR": _specular,
    "MIX_SHADER": _mixed,
    "ADD_SHADER": _added,
    # light that passes through has no part in reflections yet
    "BSDF_REFRACTION": _nothing,
    "BSDF_TRANSLUCENT": _nothing,
    "BSDF_TRANSPARENT": _nothing,
    "BSDF_SHEEN": _nothing,
    "HOLDOUT": _nothing,
}
