"""How opaque a material's surface is, read from its nodes: constants, and one image through a chain that can be tabulated.

A shader tree's opacity is what a Principled BSDF's Alpha, Transparent BSDFs and the Mix and Add Shaders above them make of it. Everything
else is opaque. What depends on more than one image, or on anything but constants and UV coordinates, is refused with the reason, and
counts as opaque.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import bpy
import mathutils
import numpy as np

from ..core.material import Extension
from ..core.scene import LeftOut, OpacityMap
from .image_texels import LUMINANCE, Channel, UnreadableImage, has_encoded_color, read_texels, srgb_to_linear

UvRows = tuple[tuple[float, float, float], tuple[float, float, float]]
_IDENTITY: UvRows = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
_TEXEL_VALUES = np.linspace(0.0, 1.0, 256)
_EXTENSIONS = {kind.name: kind for kind in Extension}


class _UnreadableError(Exception):
    """The text says what of the nodes is not understood, as in 'its opacity depends on ...'."""


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
        raise _UnreadableError("more than one texture")
    return _Scalar(lambda x: operation(*(scalar.function(x) for scalar in scalars)), next(iter(textures), None))


@dataclass(frozen=True)
class _Input:
    """An input socket, and the group nodes that it lies in."""

    socket: bpy.types.NodeSocket
    groups: tuple[bpy.types.Node, ...] = ()

    def of(self, node: bpy.types.Node, identifier: str) -> _Input:
        return replace(self, socket=_by_identifier(node.inputs, identifier))

    def source(self) -> tuple[bpy.types.Node | None, str, _Input]:
        """The node that makes the value, the identifier of its output, and an input as deep in groups as the node; without a node the
        input itself has the value."""
        here = self
        for _ in range(_MAX_LINKS):
            links = [link for link in here.socket.links if link.is_valid and not link.is_muted]
            if not links:
                return None, "", here
            node, output = links[0].from_node, links[0].from_socket
            if node.mute:
                through = [link.from_socket for link in node.internal_links if link.to_socket == output]
                if not through:
                    raise _UnreadableError(f"the muted node '{node.name}'")
                here = replace(here, socket=through[0])
            elif node.type == "REROUTE":
                here = replace(here, socket=node.inputs[0])
            elif node.type == "GROUP" and node.node_tree is not None:
                ends = [end for end in node.node_tree.nodes if end.type == "GROUP_OUTPUT" and end.is_active_output]
                if not ends:
                    raise _UnreadableError(f"the group '{node.name}', which has no output")
                here = _Input(_by_identifier(ends[0].inputs, output.identifier), (*here.groups, node))
            elif node.type == "GROUP_INPUT" and here.groups:
                here = _Input(_by_identifier(here.groups[-1].inputs, output.identifier), here.groups[:-1])
            else:
                return node, output.identifier, here
        raise _UnreadableError("links that go in a circle")


_MAX_LINKS = 1000
"""reroutes and groups that a link may go through"""


def _by_identifier(sockets: bpy.types.NodeInputs, identifier: str) -> bpy.types.NodeSocket:
    found = next((socket for socket in sockets if socket.identifier == identifier), None)
    if found is None:
        raise _UnreadableError(f"a socket '{identifier}' that is not there")
    return found


class MaterialReader:
    """Reads each material once."""

    def __init__(self, engine: str, override: bpy.types.Material | None = None) -> None:
        """engine: its identifier. override: of the view layer, takes the place of every material."""
        self._target = "CYCLES" if engine == "CYCLES" else "EEVEE"
        self._override = override
        self._read: dict[int, MaterialOpacity | None] = {}
        self._maps: dict[tuple[object, ...], OpacityMap] = {}
        self._texels: dict[tuple[int, Channel], np.ndarray] = {}
        self.left_out: list[LeftOut] = []
        self.notes: list[str] = []

    def materials_of(self, shown: bpy.types.Object) -> tuple[MaterialOpacity | None, ...]:
        """One entry a material slot of an evaluated object; empty when the object is opaque as a whole."""
        slots = shown.material_slots
        opacities = []
        for index, own in enumerate(shown.data.materials):
            is_objects = index < len(slots) and slots[index].link == "OBJECT"
            opacities.append(self._opacity_of(self._override or (slots[index].material if is_objects else own)))
        return tuple(opacities) if any(opacity is not None for opacity in opacities) else ()

    def _opacity_of(self, material: bpy.types.Material | None) -> MaterialOpacity | None:
        if material is None:
            return None
        address = material.as_pointer()
        if address not in self._read:
            try:
                self._read[address] = self._compute_opacity(material)
            except (_UnreadableError, UnreadableImage) as error:
                self._read[address] = None
                self.left_out.append(LeftOut(f"material {material.name}", f"counts as opaque, because its opacity depends on {error}"))
        return self._read[address]

    def _compute_opacity(self, material: bpy.types.Material) -> MaterialOpacity | None:
        if material.node_tree is None or (bpy.app.version < (5, 0) and not material.use_nodes):
            return None
        output = material.node_tree.get_output_node(self._target)
        if output is None:
            return None
        surface, volume = output.inputs["Surface"], output.inputs["Volume"]
        if volume.is_linked and not surface.is_linked:
            self.left_out.append(LeftOut(f"material {material.name}", "is a volume, which VIR cannot render yet: it casts nothing"))
            return self._result(material, None, None)
        opacity = _shader_opacity(_Input(surface))
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
        image_key = (texture.image.as_pointer(), texture.channel)
        if image_key not in self._texels:
            self._texels[image_key], note = read_texels(texture.image, texture.channel)
            self.notes += [note] * bool(note)
        texels = self._texels[image_key]
        used = table[np.bincount(texels.ravel(), minlength=256) > 0]
        # importers link the alpha of every image, of those that are opaque throughout as well
        if texture.extension is not Extension.CLIP and used.min() >= 1.0:
            return None
        if used.max() <= 0.0 and (texture.extension is not Extension.CLIP or table[0] <= 0.0):
            return self._result(material, texture, None)
        key = (image_key, table.tobytes(), texture.extension, texture.is_interpolated)
        if key not in self._maps:
            self._maps[key] = OpacityMap(material.name, texels, table, texture.extension, texture.is_interpolated)
        return self._result(material, texture, self._maps[key])

    def _constant_map(self, name: str, value: float) -> OpacityMap:
        if (value,) not in self._maps:
            self._maps[value,] = OpacityMap(name, np.zeros((1, 1), np.uint8), np.full(256, value, np.float32), is_interpolated=False)
        return self._maps[value,]

    @staticmethod
    def _result(material: bpy.types.Material, texture: _Texture | None, opacity_map: OpacityMap | None) -> MaterialOpacity:
        uv_map, uv_rows = (texture.uv_map, texture.uv_rows) if texture else (None, _IDENTITY)
        return MaterialOpacity(material.name, opacity_map, uv_map, uv_rows, not material.use_transparent_shadow)


# shaders


def _shader_opacity(shader: _Input) -> _Scalar:  # noqa: PLR0911  one a kind of node
    node, _, here = shader.source()
    match node.type if node is not None else None:
        case "BSDF_PRINCIPLED":
            return _combined(lambda a: np.clip(a, 0.0, 1.0), _scalar(here.of(node, "Alpha")))
        case "EEVEE_SPECULAR":
            return _combined(lambda t: 1.0 - np.clip(t, 0.0, 1.0), _scalar(here.of(node, "Transparency")))
        case "BSDF_TRANSPARENT":
            color = here.of(node, "Color")
            if color.source()[0] is not None:
                raise _UnreadableError("the colour that a Transparent BSDF gets from other nodes")
            return _constant(1.0 - min(float(np.dot(color.source()[2].socket.default_value[:3], LUMINANCE)), 1.0))
        case "MIX_SHADER":
            first, second = (_shader_opacity(here.of(node, identifier)) for identifier in ("Shader", "Shader_001"))
            if first.constant is not None and first.constant == second.constant:
                return first  # whatever the factor
            factor = _combined(lambda f: np.clip(f, 0.0, 1.0), _scalar(here.of(node, "Fac")))
            return _combined(lambda f, a, b: (1.0 - f) * a + f * b, factor, first, second)
        case "ADD_SHADER":
            first, second = (_shader_opacity(here.of(node, identifier)) for identifier in ("Shader", "Shader_001"))
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


def _scalar(number: _Input) -> _Scalar:  # noqa: PLR0911  one a kind of node
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
    raise _UnreadableError(f"the node '{node.name}'")


_CLAMP_INPUTS = ("Value", "Min", "Max")


def _separated(color: _Input, channel: Channel) -> _Scalar:
    node, output, here = color.source()
    if node is None:
        return _constant(float(here.socket.default_value[channel.index]))
    if node.type != "TEX_IMAGE" or output != "Color":
        raise _UnreadableError(f"a channel of the node '{node.name}'")
    return _Scalar(lambda x: x, _texture(node, here, channel))


def _mapped_range(node: bpy.types.Node, here: _Input) -> _Scalar:
    def mapped(a: np.ndarray, from_min: float, from_max: float, to_min: float, to_max: float) -> np.ndarray:
        share = np.where(from_max == from_min, 0.0, (a - from_min) / np.where(from_max == from_min, 1.0, from_max - from_min))
        return to_min + (np.clip(share, 0.0, 1.0) if node.clamp else share) * (to_max - to_min)

    return _combined(mapped, *(_scalar(here.of(node, name)) for name in ("Value", "From Min", "From Max", "To Min", "To Max")))


def _color_ramp(node: bpy.types.Node, place: _Scalar, *, is_alpha: bool) -> _Scalar:
    colors = np.array([node.color_ramp.evaluate(x) for x in _TEXEL_VALUES])
    values = colors[:, 3] if is_alpha else colors[:, :3] @ np.array(LUMINANCE)
    return _combined(lambda a: np.interp(a, _TEXEL_VALUES, values), place)


# textures


def _texture(node: bpy.types.Node, here: _Input, channel: Channel) -> _Texture:
    if node.image is None:
        raise _UnreadableError(f"the node '{node.name}', which has no image")
    if node.projection != "FLAT":
        raise _UnreadableError(f"the projection of the node '{node.name}'")
    own = node.texture_mapping
    if (*own.translation, *own.rotation, *own.scale) != (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0):
        raise _UnreadableError(f"the node '{node.name}', which maps coordinates itself")
    # Cycles and EEVEE hand out colours multiplied with alpha where only the colour is asked for
    if channel is Channel.GRAY and not node.outputs["Alpha"].is_linked and node.image.alpha_mode == "STRAIGHT":
        channel = Channel.GRAY_TIMES_ALPHA
    uv_map, uv_rows = _uv(here.of(node, "Vector"))
    return _Texture(node.image, channel, _EXTENSIONS[node.extension], node.interpolation != "Closest", uv_map, uv_rows)


def _uv(vector: _Input) -> tuple[str | None, UvRows]:
    """Name of the UV map, None for the default one, and what maps its (u, v, 1) to a place in the image."""
    matrix = mathutils.Matrix.Identity(4)
    for _ in range(_MAX_LINKS):
        node, output, here = vector.source()
        if node is None:
            break
        if node.type == "MAPPING":
            matrix = matrix @ _mapping_matrix(node, here)
            vector = here.of(node, "Vector")
            if vector.source()[0] is None:
                raise _UnreadableError(f"the node '{node.name}', which maps nothing")
            continue
        rows = tuple((matrix[row][0], matrix[row][1], matrix[row][3]) for row in range(2))
        if node.type == "UVMAP" and not node.from_instancer:
            return node.uv_map or None, rows  # type: ignore[return-value]
        if node.type == "TEX_COORD" and output == "UV" and not node.from_instancer:
            return None, rows  # type: ignore[return-value]
        if node.type == "ATTRIBUTE" and node.attribute_type == "GEOMETRY" and output == "Vector":
            return node.attribute_name, rows  # type: ignore[return-value]
        raise _UnreadableError(f"coordinates of the node '{node.name}'")
    return None, _IDENTITY


def _mapping_matrix(node: bpy.types.Node, here: _Input) -> mathutils.Matrix:
    if node.vector_type == "NORMAL":
        raise _UnreadableError(f"the node '{node.name}', which maps normals")
    values = {}
    for name in ("Rotation", "Scale", "Location"):
        if name == "Location" and node.vector_type == "VECTOR":
            values[name] = (0.0, 0.0, 0.0)
            continue
        source, _, end = here.of(node, name).source()
        if source is not None:
            raise _UnreadableError(f"what is linked to the node '{node.name}'")
        values[name] = tuple(end.socket.default_value)
    matrix = mathutils.Matrix.LocRotScale(values["Location"], mathutils.Euler(values["Rotation"]), values["Scale"])
    if node.vector_type != "TEXTURE":
        return matrix
    if any(math.isclose(factor, 0.0) for factor in values["Scale"]):
        raise _UnreadableError(f"the node '{node.name}', whose scale is zero")
    return matrix.inverted()
