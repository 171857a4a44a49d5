"""Colours and numbers that sockets of shader nodes have, as the expressions of `core.material`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import bpy
import numpy as np

from ..core.material import (
    BLACK,
    WHITE,
    Constant,
    CornerValue,
    ImageSample,
    ImageTexels,
    Layer,
    LayerKind,
    MaterialInput,
    Operation,
    TableLookup,
)
from ..core.material_program import combined, constant
from ..core.passes.material_images import texel_count_of
from .image_texels import MAX_SIDE_PX, UnreadableImage, read_colors
from .node_inputs import EXTENSIONS, NodeInput, UnreadableNodes, check_image_node, check_own_mapping, read_direction, read_uv

_MOST_NODES_DEEP = 60
"""Nodes between a socket and an image at most: what reads them calls itself."""
_TABLE_ENTRIES = 256
IMAGE_BUDGET_BYTES = 1 << 29
"""on the device, for all images of materials, and as much for those of the world"""


class ColorReader:
    """Reads each image and each node's output once."""

    def __init__(self, max_side_px: int = MAX_SIDE_PX, *, is_world: bool = False) -> None:
        """max_side_px: of images; is_world: images may be of surroundings"""
        self._max_side_px, self.is_world = max_side_px, is_world
        self._bytes_left = IMAGE_BUDGET_BYTES
        self.directions: list[np.ndarray] = []
        """(3, 3) each, what images of surroundings are looked up with"""
        self._images: dict[int, tuple[ImageTexels, ImageTexels | None] | UnreadableImage] = {}
        self._known: dict[tuple[object, ...], MaterialInput] = {}
        self._depth = 0
        self.notes: list[str] = []

    def color(self, socket: NodeInput) -> MaterialInput:
        """Raises UnreadableNodes or UnreadableImage."""
        return self._value(socket)[0]

    def number(self, socket: NodeInput) -> MaterialInput:
        """The same in all three channels."""
        value, kind = self._value(socket)
        if kind == "VALUE" or _is_gray(value):
            return value
        if kind != "RGBA":
            channels = [combined(one, value) for one in (Operation.RED, Operation.GREEN, Operation.BLUE)]
            return combined(Operation.MULTIPLY, _added(*channels), constant(1 / 3))
        return combined(Operation.LUMINANCE, value)

    def image(self, image: bpy.types.Image) -> tuple[ImageTexels, ImageTexels | None]:
        """Colours, and alpha where it is kept apart from them."""
        address = image.as_pointer()
        if address not in self._images:
            try:
                # a share of what is left: however many there are, there is something for all
                colors, alpha, note = read_colors(image, self._max_side_px, self._bytes_left // 4)
            except UnreadableImage as error:
                self._images[address] = error
            else:
                self._images[address] = (colors, alpha)
                self._bytes_left -= sum(16 * texel_count_of(one) for one in (colors, alpha) if one is not None)
                self.notes += [note] * bool(note)
        found = self._images[address]
        if isinstance(found, UnreadableImage):
            raise found
        return found

    def _value(self, socket: NodeInput) -> tuple[MaterialInput, str]:
        """The value and the type of the socket that makes it: VALUE, RGBA or another."""
        node, output, here = socket.source()
        if node is None:
            value = here.socket.default_value
            return constant(*([value] if isinstance(value, (int, float)) else value[:3])), here.socket.type
        kind = next((out.type for out in node.outputs if out.identifier == output), "RGBA")
        key = (node.as_pointer(), output, *(group.as_pointer() for group in here.groups))
        if key not in self._known:
            if self._depth >= _MOST_NODES_DEEP:
                raise UnreadableNodes(f"more than {_MOST_NODES_DEEP} nodes one behind the other, or links that go in a circle")
            self._depth += 1
            try:
                self._known[key] = self._computed(node, output, here)
            finally:
                self._depth -= 1
        return self._known[key], kind

    def _computed(self, node: bpy.types.Node, output: str, here: NodeInput) -> MaterialInput:
        read = _NODES.get(node.type)
        if read is None:
            raise UnreadableNodes(f"the node '{node.name}'")
        return read(self, node, output, here)

    def named(self, node: bpy.types.Node, here: NodeInput, *identifiers: str) -> list[MaterialInput]:
        """The colours of a node's inputs."""
        return [self.color(here.of(node, identifier)) for identifier in identifiers]

    def numbers(self, node: bpy.types.Node, here: NodeInput, *identifiers: str) -> list[MaterialInput]:
        return [self.number(here.of(node, identifier)) for identifier in identifiers]


def _is_gray(value: MaterialInput) -> bool:
    if isinstance(value, Constant):
        return value.value[0] == value.value[1] == value.value[2]
    return isinstance(value, ImageSample) and (value.is_alpha or value.image.texels.shape[2] == 1)


def _added(first: MaterialInput, *others: MaterialInput) -> MaterialInput:
    for other in others:
        first = combined(Operation.ADD, first, other)
    return first


def _inverted(value: MaterialInput) -> MaterialInput:
    return combined(Operation.SUBTRACT, WHITE, value)


def _negative(value: MaterialInput) -> MaterialInput:
    return combined(Operation.SUBTRACT, BLACK, value)


def mixed(first: MaterialInput, second: MaterialInput, share: MaterialInput) -> MaterialInput:
    return combined(Operation.MIX, first, second, share)


def clamped(value: MaterialInput) -> MaterialInput:
    return combined(Operation.CLAMP, value)


def _refuse(node: bpy.types.Node, what: str) -> UnreadableNodes:
    return UnreadableNodes(f"the {what} of the node '{node.name}'")


# nodes


def _constant_output(_: ColorReader, node: bpy.types.Node, output: str, __: NodeInput) -> MaterialInput:
    value = next(out.default_value for out in node.outputs if out.identifier == output)
    return constant(*([value] if isinstance(value, (int, float)) else value[:3]))


def _image(reader: ColorReader, node: bpy.types.Node, output: str, here: NodeInput) -> MaterialInput:
    check_image_node(node)
    uv_map, uv_rows = read_uv(here.of(node, "Vector"))
    colors, apart = reader.image(node.image)
    sample = ImageSample(colors, Layer(LayerKind.UV, uv_map or ""), uv_rows, EXTENSIONS[node.extension], node.interpolation != "Closest")
    if output == "Alpha":
        if apart is not None:
            return replace(sample, image=apart)
        return replace(sample, is_alpha=True) if colors.texels.shape[2] == 4 else WHITE
    # renderers hand out colours multiplied with alpha where only the colour is asked for
    return replace(sample, divides_by_alpha=colors.texels.shape[2] == 4 and node.outputs["Alpha"].is_linked)


def _environment(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    if not reader.is_world:
        raise UnreadableNodes(f"the node '{node.name}'")
    if node.image is None:
        raise UnreadableNodes(f"the node '{node.name}', which has no image")
    if node.projection != "EQUIRECTANGULAR":
        raise _refuse(node, "projection")
    check_own_mapping(node)
    reader.directions.append(read_direction(here.of(node, "Vector")))
    return ImageSample(reader.image(node.image)[0], is_interpolated=node.interpolation != "Closest")


def _vertex_color(_: ColorReader, node: bpy.types.Node, output: str, __: NodeInput) -> MaterialInput:
    if output != "Color":
        raise _refuse(node, "alpha")
    return CornerValue(Layer(LayerKind.COLOR, node.layer_name))


def _attribute(_: ColorReader, node: bpy.types.Node, output: str, __: NodeInput) -> MaterialInput:
    if node.attribute_type != "GEOMETRY" or output == "Alpha":
        raise UnreadableNodes(f"what the node '{node.name}' reads")
    value = CornerValue(Layer(LayerKind.COLOR, node.attribute_name))
    if output != "Fac":
        return value
    channels = [combined(one, value) for one in (Operation.RED, Operation.GREEN, Operation.BLUE)]
    return combined(Operation.MULTIPLY, _added(*channels), constant(1 / 3))


def _mix(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    suffix = {"FLOAT": "Float", "VECTOR": "Vector", "RGBA": "Color"}.get(node.data_type)
    if suffix is None:
        raise _refuse(node, "data type")
    is_even = node.data_type != "VECTOR" or node.factor_mode == "UNIFORM"
    share = reader.number(here.of(node, "Factor_Float")) if is_even else reader.color(here.of(node, "Factor_Vector"))
    if node.clamp_factor:
        share = clamped(share)
    read = reader.numbers if node.data_type == "FLOAT" else reader.named
    first, second = read(node, here, f"A_{suffix}", f"B_{suffix}")
    if node.data_type != "RGBA":
        return mixed(first, second, share)
    result = _blended(node, first, second, share)
    return clamped(result) if node.clamp_result else result


def _mix_rgb(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    first, second = reader.named(node, here, "Color1", "Color2")
    result = _blended(node, first, second, clamped(reader.number(here.of(node, "Fac"))))
    return clamped(result) if node.use_clamp else result


def _blended(node: bpy.types.Node, a: MaterialInput, b: MaterialInput, share: MaterialInput) -> MaterialInput:
    """As Blender's own blend modes; those that only make sense for hues are refused."""
    blend = _BLENDS.get(node.blend_type)
    if blend is None:
        raise _refuse(node, "blend mode")
    return blend(a, b, share)


def _screen(a: MaterialInput, b: MaterialInput) -> MaterialInput:
    return _inverted(combined(Operation.MULTIPLY, _inverted(a), _inverted(b)))


def _overlay(a: MaterialInput, b: MaterialInput, share: MaterialInput) -> MaterialInput:
    dark = combined(Operation.MULTIPLY, a, combined(Operation.MULTIPLY, constant(2.0), b))
    doubled = combined(Operation.MULTIPLY, constant(2.0), combined(Operation.MULTIPLY, _inverted(a), _inverted(b)))
    is_light = combined(Operation.GREATER_THAN, a, constant(0.5))
    return mixed(a, mixed(dark, _inverted(doubled), is_light), share)


_BLENDS: dict[str, Callable[[MaterialInput, MaterialInput, MaterialInput], MaterialInput]] = {
    "MIX": mixed,
    "ADD": lambda a, b, share: _added(a, combined(Operation.MULTIPLY, b, share)),
    "SUBTRACT": lambda a, b, share: combined(Operation.SUBTRACT, a, combined(Operation.MULTIPLY, b, share)),
    "MULTIPLY": lambda a, b, share: combined(Operation.MULTIPLY, a, mixed(WHITE, b, share)),
    "DIVIDE": lambda a, b, share: mixed(a, combined(Operation.DIVIDE, a, b), share),
    "DARKEN": lambda a, b, share: mixed(a, combined(Operation.MINIMUM, a, b), share),
    "LIGHTEN": lambda a, b, share: mixed(a, combined(Operation.MAXIMUM, a, b), share),
    "DIFFERENCE": lambda a, b, share: mixed(a, combined(Operation.ABSOLUTE, combined(Operation.SUBTRACT, a, b)), share),
    "SCREEN": lambda a, b, share: mixed(a, _screen(a, b), share),
    "OVERLAY": _overlay,
}


def _math(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    kind = node.operation
    operands = reader.numbers(node, here, *("Value", "Value_001", "Value_002")[: _MATH_OPERANDS.get(kind, 2)])
    if kind in _MATH:
        result = combined(_MATH[kind], *operands)
    elif kind in _COMPOSED_MATH:
        result = _COMPOSED_MATH[kind](*operands)
    else:
        raise _refuse(node, "operation")
    return clamped(result) if node.use_clamp else result


_MATH = {kind.name: kind for kind in (Operation.ADD, Operation.SUBTRACT, Operation.MULTIPLY, Operation.DIVIDE, Operation.POWER)} | {
    kind.name: kind for kind in (Operation.MINIMUM, Operation.MAXIMUM, Operation.GREATER_THAN, Operation.FLOOR, Operation.ABSOLUTE)
}
_COMPOSED_MATH: dict[str, Callable[..., MaterialInput]] = {
    "LESS_THAN": lambda a, b: combined(Operation.GREATER_THAN, b, a),
    "MULTIPLY_ADD": lambda a, b, c: _added(combined(Operation.MULTIPLY, a, b), c),
    "SQRT": lambda a: combined(Operation.POWER, combined(Operation.MAXIMUM, a, constant(0.0)), constant(0.5)),
    "ROUND": lambda a: combined(Operation.FLOOR, _added(a, constant(0.5))),
    "CEIL": lambda a: _negative(combined(Operation.FLOOR, _negative(a))),
    "FRACT": lambda a: combined(Operation.SUBTRACT, a, combined(Operation.FLOOR, a)),
}
_MATH_OPERANDS = {"FLOOR": 1, "ABSOLUTE": 1, "SQRT": 1, "ROUND": 1, "CEIL": 1, "FRACT": 1, "MULTIPLY_ADD": 3}


def _invert(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    value = reader.color(here.of(node, "Color"))
    return mixed(value, _inverted(value), reader.number(here.of(node, "Fac")))


def _gamma(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    value, exponent = reader.color(here.of(node, "Color")), reader.number(here.of(node, "Gamma"))
    return combined(Operation.POWER, combined(Operation.MAXIMUM, value, constant(0.0)), exponent)


def _bright_contrast(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    value = reader.color(here.of(node, "Color"))
    bright, contrast = reader.numbers(node, here, "Bright", "Contrast")
    scaled = combined(Operation.MULTIPLY, value, _added(WHITE, contrast))
    offset = combined(Operation.SUBTRACT, bright, combined(Operation.MULTIPLY, constant(0.5), contrast))
    return combined(Operation.MAXIMUM, _added(scaled, offset), constant(0.0))


def _hue_saturation(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    value = reader.color(here.of(node, "Color"))
    hue, saturation, factor, share = reader.numbers(node, here, "Hue", "Saturation", "Value", "Fac")
    hsv = combined(Operation.RGB_TO_HSV, value)
    turned = _added(combined(Operation.RED, hsv), hue, constant(0.5))
    new_hue = combined(Operation.SUBTRACT, turned, combined(Operation.FLOOR, turned))
    new_saturation = clamped(combined(Operation.MULTIPLY, combined(Operation.GREEN, hsv), saturation))
    new_value = combined(Operation.MULTIPLY, combined(Operation.BLUE, hsv), factor)
    changed = combined(Operation.HSV_TO_RGB, _joined(new_hue, new_saturation, new_value))
    return combined(Operation.MAXIMUM, mixed(value, changed, share), constant(0.0))


def _joined(red: MaterialInput, green: MaterialInput, blue: MaterialInput) -> MaterialInput:
    """Three numbers as channels."""
    axes = (constant(1, 0, 0), constant(0, 1, 0), constant(0, 0, 1))
    return _added(*(combined(Operation.MULTIPLY, value, axis) for value, axis in zip((red, green, blue), axes, strict=True)))


def _separate(reader: ColorReader, node: bpy.types.Node, output: str, here: NodeInput) -> MaterialInput:
    value = reader.color(here.of(node, "Color"))
    if node.mode == "HSV":
        value = combined(Operation.RGB_TO_HSV, value)
    elif node.mode != "RGB":
        raise _refuse(node, "mode")
    return combined(Operation[output.upper()], value)


def _combine(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    if node.mode not in ("RGB", "HSV"):
        raise _refuse(node, "mode")
    joined = _joined(*reader.numbers(node, here, "Red", "Green", "Blue"))
    return joined if node.mode == "RGB" else combined(Operation.HSV_TO_RGB, joined)


def _gray(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    return combined(Operation.LUMINANCE, reader.color(here.of(node, "Color")))


def _clamp(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    if node.clamp_type != "MINMAX":
        raise _refuse(node, "kind")
    value, low, high = reader.numbers(node, here, "Value", "Min", "Max")
    return combined(Operation.MINIMUM, combined(Operation.MAXIMUM, value, low), high)


def _map_range(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    if node.data_type != "FLOAT" or node.interpolation_type != "LINEAR":
        raise _refuse(node, "interpolation")
    value, from_min, from_max, to_min, to_max = reader.numbers(node, here, "Value", "From Min", "From Max", "To Min", "To Max")
    width = combined(Operation.SUBTRACT, from_max, from_min)
    share = combined(Operation.DIVIDE, combined(Operation.SUBTRACT, value, from_min), width)
    return mixed(to_min, to_max, clamped(share) if node.clamp else share)


def _ramp(reader: ColorReader, node: bpy.types.Node, output: str, here: NodeInput) -> MaterialInput:
    colors = np.array([node.color_ramp.evaluate(x) for x in np.linspace(0.0, 1.0, _TABLE_ENTRIES)], np.float32)
    entries = np.repeat(colors[:, 3:], 3, axis=1) if output == "Alpha" else colors[:, :3]
    return _looked_up(reader.number(here.of(node, "Fac")), node, entries)


def _curves(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    mapping = node.mapping
    mapping.initialize()
    low, high = mapping.black_level, mapping.white_level
    if tuple(low) != (0.0, 0.0, 0.0) or tuple(high) != (1.0, 1.0, 1.0):
        raise _refuse(node, "black and white levels")
    red, green, blue, every = mapping.curves
    places = np.linspace(0.0, 1.0, _TABLE_ENTRIES)
    columns = [[mapping.evaluate(curve, mapping.evaluate(every, x)) for x in places] for curve in (red, green, blue)]
    value = reader.color(here.of(node, "Color"))
    changed = _looked_up(value, node, np.array(columns, np.float32).T)
    return mixed(value, changed, reader.number(here.of(node, "Fac")))


def _looked_up(place: MaterialInput, node: bpy.types.Node, entries: np.ndarray) -> MaterialInput:
    if isinstance(place, Constant):
        places = np.linspace(0.0, 1.0, len(entries))
        return constant(*(float(np.interp(x, places, entries[:, k])) for k, x in enumerate(place.value)))
    return TableLookup(place, ImageTexels(node.name, entries[None]))


_NODES: dict[str, Callable[[ColorReader, bpy.types.Node, str, NodeInput], MaterialInput]] = {
    "RGB": _constant_output,
    "VALUE": _constant_output,
    "TEX_IMAGE": _image,
    "TEX_ENVIRONMENT": _environment,
    "VERTEX_COLOR": _vertex_color,
    "ATTRIBUTE": _attribute,
    "MIX": _mix,
    "MIX_RGB": _mix_rgb,
    "MATH": _math,
    "INVERT": _invert,
    "GAMMA": _gamma,
    "BRIGHTCONTRAST": _bright_contrast,
    "HUE_SAT": _hue_saturation,
    "SEPARATE_COLOR": _separate,
    "COMBINE_COLOR": _combine,
    "RGBTOBW": _gray,
    "CLAMP": _clamp,
    "MAP_RANGE": _map_range,
    "VALTORGB": _ramp,
    "CURVE_RGB": _curves,
}
