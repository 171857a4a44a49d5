"""How opaque a material's surface is, read from its nodes: constants, and one image through a chain that can be tabulated.

A shader tree's opacity is what a Principled BSDF's Alpha, Transparent BSDFs and the Mix and Add Shaders above them make of it. Everything
else is opaque. What depends on more than one image, or on anything but constants and UV coordinates, is refused with the reason, and
counts as opaque.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import bpy
import numpy as np

from ...core.material import IDENTITY_UV_ROWS, Extension, UvRows
from ...core.material_program import LUMINANCE
from ...core.scene import LeftOut, OpacityMap
from .image_cache import ImageCache
from .image_texels import Channel, UnreadableImage, has_encoded_color, is_multiplied_by_alpha, srgb_to_linear
from .inputs import EXTENSIONS, NodeInput, UnreadableNodes, check_image_node, output_node, output_target, read_uv, slot_materials

_TEXEL_VALUES = np.linspace(0.0, 1.0, 256)


@dataclass(frozen=True)
class MaterialOpacity:
    """What there is to know about a material whose surface is not opaque."""

    name: str
    opacity_map: OpacityMap | None
    """None: nothing of the surface is there"""
    uv_map: str | None
    """None: that which Blender marks for rendering"""
    uv_rows: UvRows
    """place in the image = uv_rows @ (u, v, 1)"""
    has_opaque_shadow: bool
    """"Transparent Shadows" of the material is off: it is seen through and yet casts as a whole"""


@dataclass(frozen=True)
class _Texture:
    image: bpy.types.Image
    channel: Channel
    extension: Extension
    is_interpolated: bool
    uv_map: str | None
    uv_rows: UvRows


@dataclass(frozen=True)
class _Scalar:
    """A number at every place of the surface: a function of one texture's value, (n,) float64 -> (n,) or a constant."""

    function: Callable[[np.ndarray], np.ndarray | float]
    texture: _Texture | None = None

    @property
    def constant(self) -> float | None:
        return float(self.function(np.zeros(1))) if self.texture is None else None


def _constant(value: float) -> _Scalar:
    return _Scalar(lambda _: value)


def _combined(operation: Callable[..., np.ndarray | float], *scalars: _Scalar) -> _Scalar:
    textures = {scalar.texture for scalar in scalars if scalar.texture is not None}
    if len(textures) > 1:
        raise UnreadableNodes("more than one texture")
    return _Scalar(lambda x: operation(*(scalar.function(x) for scalar in scalars)), next(iter(textures), None))


class MaterialReader:
    """Reads each material once."""

    def __init__(self, engine: str, images: ImageCache, override: bpy.types.Material | None = None) -> None:
        """engine: its identifier. override: of the view layer, takes the place of every material."""
        self._images = images
        self._target = output_target(engine)
        self._override = override
        self._read: dict[int, MaterialOpacity | None] = {}
        self._maps: dict[tuple[object, ...], OpacityMap] = {}
        self.left_out: list[LeftOut] = []
        self.notes: set[str] = set()

    def materials_of(self, shown: bpy.types.Object) -> tuple[MaterialOpacity | None, ...]:
        """One entry a material slot of an evaluated object; empty when the object is opaque as a whole."""
        opacities = [self._opacity_of(material) for material in slot_materials(shown, self._override)]
        return tuple(opacities) if any(opacity is not None for opacity in opacities) else ()

    def _opacity_of(self, material: bpy.types.Material | None) -> MaterialOpacity | None:
        if material is None:
            return None
        address = material.as_pointer()
        if address not in self._read:
            try:
                self._read[address] = self._compute_opacity(material)
            except (UnreadableNodes, UnreadableImage) as error:
                self._read[address] = None
                self.left_out.append(LeftOut(f"material {material.name}", f"counts as opaque, because its opacity depends on {error}"))
        return self._read[address]

    def _compute_opacity(self, material: bpy.types.Material) -> MaterialOpacity | None:
        output = output_node(material, self._target)
        if output is None:
            return None
        surface, volume = output.inputs["Surface"], output.inputs["Volume"]
        if volume.is_linked and not surface.is_linked:
            self.left_out.append(LeftOut(f"material {material.name}", "is a volume, which VIR cannot render yet: it casts nothing"))
            return self._result(material, None, None)
        opacity = _shader_opacity(NodeInput(surface), {})
        if opacity.texture is None:
            value = opacity.constant
            assert value is not None
            if value >= 1.0:
                return None
            return self._result(material, None, self._constant_map(material.name, value) if value > 0.0 else None)
        return self._textured(material, opacity.texture, opacity.function)

    def _textured(
        self, material: bpy.types.Material, texture: _Texture, function: Callable[[np.ndarray], np.ndarray | float]
    ) -> MaterialOpacity | None:
        values = srgb_to_linear(_TEXEL_VALUES) if has_encoded_color(texture.image, texture.channel) else _TEXEL_VALUES
        with np.errstate(all="ignore"):
            table = np.clip(np.nan_to_num(np.broadcast_to(function(values), values.shape)), 0.0, 1.0).astype(np.float32)
        texels, note = self._images.texels(texture.image, texture.channel)
        if note:
            self.notes.add(note)
        used = table[np.bincount(texels.ravel(), minlength=256) > 0]
        # importers link the alpha of every image, of those that are opaque throughout as well
        if texture.extension is not Extension.CLIP and used.min() >= 1.0:
            return None
        if used.max() <= 0.0 and (texture.extension is not Extension.CLIP or table[0] <= 0.0):
            return self._result(material, texture, None)
        key = (texture.image.as_pointer(), texture.channel, table.tobytes(), texture.extension, texture.is_interpolated)
        if key not in self._maps:
            self._maps[key] = OpacityMap(material.name, texels, table, texture.extension, texture.is_interpolated)
        return self._result(material, texture, self._maps[key])

    def _constant_map(self, name: str, value: float) -> OpacityMap:
        if (value,) not in self._maps:
            self._maps[value,] = OpacityMap(name, np.zeros((1, 1), np.uint8), np.full(256, value, np.float32), is_interpolated=False)
        return self._maps[value,]

    @staticmethod
    def _result(material: bpy.types.Material, texture: _Texture | None, opacity_map: OpacityMap | None) -> MaterialOpacity:
        uv_map, uv_rows = (texture.uv_map, texture.uv_rows) if texture else (None, IDENTITY_UV_ROWS)
        return MaterialOpacity(material.name, opacity_map, uv_map, uv_rows, not material.use_transparent_shadow)


# shaders


def _shader_opacity(shader: NodeInput, read: dict[tuple[int, ...], _Scalar]) -> _Scalar:
    """read: what was found so far, by node and the groups it is in: many nodes may share one"""
    node, _, here = shader.source()
    if node is None:
        return _constant(1.0)
    place = (node.as_pointer(), *(group.as_pointer() for group in here.groups))
    if place not in read:
        read[place] = _node_opacity(node, here, read)
    return read[place]


def _node_opacity(node: bpy.types.Node, here: NodeInput, read: dict[tuple[int, ...], _Scalar]) -> _Scalar:  # noqa: PLR0911  one a kind of node
    match node.type:
        case "BSDF_PRINCIPLED":
            return _combined(lambda a: np.clip(a, 0.0, 1.0), _scalar(here.of(node, "Alpha")))
        case "EEVEE_SPECULAR":
            return _combined(lambda t: 1.0 - np.clip(t, 0.0, 1.0), _scalar(here.of(node, "Transparency")))
        case "BSDF_TRANSPARENT":
            color = here.of(node, "Color")
            if color.source()[0] is not None:
                raise UnreadableNodes("the colour that a Transparent BSDF gets from other nodes")
            return _constant(1.0 - min(float(np.dot(color.source()[2].socket.default_value[:3], LUMINANCE)), 1.0))
        case "MIX_SHADER":
            first, second = (_shader_opacity(here.of(node, identifier), read) for identifier in ("Shader", "Shader_001"))
            if first.constant is not None and first.constant == second.constant:
                return first  # whatever the factor
            factor = _combined(lambda f: np.clip(f, 0.0, 1.0), _scalar(here.of(node, "Fac")))
            return _combined(lambda f, a, b: (1.0 - f) * a + f * b, factor, first, second)
        case "ADD_SHADER":
            first, second = (_shader_opacity(here.of(node, identifier), read) for identifier in ("Shader", "Shader_001"))
            return _combined(lambda a, b: np.clip(a + b - 1.0, 0.0, 1.0), first, second)
    return _constant(1.0)


# numbers

_MATH: dict[str, Callable[..., np.ndarray]] = {
    "ADD": np.add,
    "SUBTRACT": np.subtract,
    "MULTIPLY": np.multiply,
    "DIVIDE": lambda a, b: np.where(b == 0.0, 0.0, np.divide(a, b)),
    "POWER": lambda a, b: np.where((a < 0.0) & (b != np.floor(b)), 0.0, np.power(np.abs(a), b)),
    "MINIMUM": np.minimum,
    "MAXIMUM": np.maximum,
    "GREATER_THAN": lambda a, b: np.where(a > b, 1.0, 0.0),
    "LESS_THAN": lambda a, b: np.where(a < b, 1.0, 0.0),
    "ROUND": lambda a: np.floor(a + 0.5),
    "FLOOR": np.floor,
    "CEIL": np.ceil,
    "ABSOLUTE": np.abs,
    "SQRT": lambda a: np.sqrt(np.maximum(a, 0.0)),
    "MULTIPLY_ADD": lambda a, b, c: a * b + c,
}
_MATH_INPUTS = {"ROUND": 1, "FLOOR": 1, "CEIL": 1, "ABSOLUTE": 1, "SQRT": 1, "MULTIPLY_ADD": 3}


def _scalar(number: NodeInput) -> _Scalar:  # noqa: PLR0911  one a kind of node
    node, output, here = number.source()
    if node is None:
        value = here.socket.default_value
        return _constant(float(value) if isinstance(value, (int, float)) else float(np.dot(value[:3], LUMINANCE)))
    match node.type:
        case "VALUE":
            return _constant(float(node.outputs[0].default_value))
        case "TEX_IMAGE":
            return _Scalar(lambda x: x, _texture(node, here, Channel.ALPHA if output == "Alpha" else Channel.GRAY))
        case "SEPARATE_COLOR" if node.mode == "RGB":
            return _separated(here.of(node, "Color"), Channel[output.upper()])
        case "MATH" if node.operation in _MATH:
            names = ("Value", "Value_001", "Value_002")[: _MATH_INPUTS.get(node.operation, 2)]
            operation = _MATH[node.operation]
            result = _combined(operation, *(_scalar(here.of(node, name)) for name in names))
            return _combined(lambda a: np.clip(a, 0.0, 1.0), result) if node.use_clamp else result
        case "INVERT":
            share, value = (_scalar(here.of(node, name)) for name in ("Fac", "Color"))
            return _combined(lambda f, a: (1.0 - f) * a + f * (1.0 - a), share, value)
        case "CLAMP" if node.clamp_type == "MINMAX":
            return _combined(lambda a, low, high: np.minimum(np.maximum(a, low), high), *(_scalar(here.of(node, s)) for s in _CLAMP_INPUTS))
        case "MAP_RANGE" if node.data_type == "FLOAT" and node.interpolation_type == "LINEAR":
            return _mapped_range(node, here)
        case "VALTORGB":
            return _color_ramp(node, _scalar(here.of(node, "Fac")), is_alpha=output == "Alpha")
    raise UnreadableNodes(f"the node '{node.name}'")


_CLAMP_INPUTS = ("Value", "Min", "Max")


def _separated(color: NodeInput, channel: Channel) -> _Scalar:
    node, output, here = color.source()
    if node is None:
        return _constant(float(here.socket.default_value[channel.index]))
    if node.type != "TEX_IMAGE" or output != "Color":
        raise UnreadableNodes(f"a channel of the node '{node.name}'")
    return _Scalar(lambda x: x, _texture(node, here, channel))


def _mapped_range(node: bpy.types.Node, here: NodeInput) -> _Scalar:
    def mapped(a: np.ndarray, from_min: float, from_max: float, to_min: float, to_max: float) -> np.ndarray:
        share = np.where(from_max == from_min, 0.0, (a - from_min) / np.where(from_max == from_min, 1.0, from_max - from_min))
        return to_min + (np.clip(share, 0.0, 1.0) if node.clamp else share) * (to_max - to_min)

    return _combined(mapped, *(_scalar(here.of(node, name)) for name in ("Value", "From Min", "From Max", "To Min", "To Max")))


def _color_ramp(node: bpy.types.Node, place: _Scalar, *, is_alpha: bool) -> _Scalar:
    colors = np.array([node.color_ramp.evaluate(x) for x in _TEXEL_VALUES])
    values = colors[:, 3] if is_alpha else colors[:, :3] @ np.array(LUMINANCE)
    return _combined(lambda a: np.interp(a, _TEXEL_VALUES, values), place)


# textures


def _texture(node: bpy.types.Node, here: NodeInput, channel: Channel) -> _Texture:
    check_image_node(node)
    # Cycles and EEVEE hand out colours multiplied with alpha where only the colour is asked for, but leave data alone
    if channel is Channel.GRAY and not node.outputs["Alpha"].is_linked and is_multiplied_by_alpha(node.image):
        channel = Channel.GRAY_TIMES_ALPHA
    uv_map, uv_rows = read_uv(here.of(node, "Vector"))
    return _Texture(node.image, channel, EXTENSIONS[node.extension], node.interpolation != "Closest", uv_map, uv_rows)
