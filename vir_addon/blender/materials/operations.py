"""Nodes that make a colour or a number of others: arithmetic, mixing, curves, and textures that are computed."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import bpy
import numpy as np

from ...core.material import WHITE, Constant, CornerValue, ImageTexels, Layer, LayerKind, MaterialInput, Operation, TableLookup
from ...core.material_program import combined, constant
from .expressions import added, channel_sum, clamped, inverted, joined, mixed, negative
from .inputs import NodeInput, UnreadableNodes, check_own_mapping, mapping_matrix

if TYPE_CHECKING:
    from .colors import ColorReader

_TABLE_ENTRIES = 256


def refuse(node: bpy.types.Node, what: str) -> UnreadableNodes:
    return UnreadableNodes(f"the {what} of the node '{node.name}'")


def _mapping(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    vector = reader.color(here.of(node, "Vector"))
    matrix = np.array(mapping_matrix(node, here))
    offset = constant(*matrix[:3, 3])
    if not (matrix[:3, :3] - np.diag(np.diag(matrix)[:3])).any():
        return added(combined(Operation.MULTIPLY, vector, constant(*np.diag(matrix)[:3])), offset)
    channels = [combined(channel, vector) for channel in (Operation.RED, Operation.GREEN, Operation.BLUE)]
    columns = [constant(*matrix[:3, index]) for index in range(3)]
    return added(*(combined(Operation.MULTIPLY, one, column) for one, column in zip(channels, columns, strict=True)), offset)


def _texture_place(reader: ColorReader, node: bpy.types.Node, here: NodeInput) -> MaterialInput:
    """Where a procedural texture is looked up: without a link in generated coordinates."""
    check_own_mapping(node)
    vector = here.of(node, "Vector")
    return CornerValue(Layer(LayerKind.GENERATED)) if vector.source()[0] is None else reader.color(vector)


def _checker(reader: ColorReader, node: bpy.types.Node, output: str, here: NodeInput) -> MaterialInput:
    place = combined(Operation.MULTIPLY, _texture_place(reader, node, here), reader.number(here.of(node, "Scale")))
    # as Cycles does: whole numbers lie safely in a field
    cell = combined(Operation.FLOOR, combined(Operation.MULTIPLY, added(place, constant(1e-6)), constant(0.999999)))
    half = combined(Operation.MULTIPLY, channel_sum(cell), constant(0.5))
    is_odd = combined(Operation.MULTIPLY, combined(Operation.SUBTRACT, half, combined(Operation.FLOOR, half)), constant(2.0))
    if output != "Color":
        return is_odd
    odd, even = reader.named(node, here, "Color1", "Color2")
    return mixed(even, odd, is_odd)


def _gradient(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    if node.gradient_type != "LINEAR":
        raise refuse(node, "type")
    return clamped(combined(Operation.RED, _texture_place(reader, node, here)))


def _vector_math(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    kind = node.operation
    if kind == "SCALE":
        return combined(Operation.MULTIPLY, reader.color(here.of(node, "Vector")), reader.number(here.of(node, "Scale")))
    operands = reader.named(node, here, *("Vector", "Vector_001", "Vector_002")[: _MATH_OPERANDS.get(kind, 2)])
    if kind in _VECTOR_MATH:
        return combined(_MATH[kind], *operands)
    if kind in ("MULTIPLY_ADD", "CEIL", "FRACTION"):
        return _COMPOSED_MATH[kind](*operands)
    raise refuse(node, "operation")


_VECTOR_MATH = frozenset({"ADD", "SUBTRACT", "MULTIPLY", "DIVIDE", "POWER", "MINIMUM", "MAXIMUM", "FLOOR", "ABSOLUTE"})


def _separate_xyz(reader: ColorReader, node: bpy.types.Node, output: str, here: NodeInput) -> MaterialInput:
    return combined(_OF_AXIS[output], reader.color(here.of(node, "Vector")))


_OF_AXIS = {"X": Operation.RED, "Y": Operation.GREEN, "Z": Operation.BLUE}


def _combine_xyz(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    return joined(*reader.numbers(node, here, "X", "Y", "Z"))


def _mix(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    suffix = {"FLOAT": "Float", "VECTOR": "Vector", "RGBA": "Color"}.get(node.data_type)
    if suffix is None:
        raise refuse(node, "data type")
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
        raise refuse(node, "blend mode")
    return blend(a, b, share)


def _screen(a: MaterialInput, b: MaterialInput) -> MaterialInput:
    return inverted(combined(Operation.MULTIPLY, inverted(a), inverted(b)))


def _overlay(a: MaterialInput, b: MaterialInput, share: MaterialInput) -> MaterialInput:
    dark = combined(Operation.MULTIPLY, a, combined(Operation.MULTIPLY, constant(2.0), b))
    doubled = combined(Operation.MULTIPLY, constant(2.0), combined(Operation.MULTIPLY, inverted(a), inverted(b)))
    is_light = combined(Operation.GREATER_THAN, a, constant(0.5))
    return mixed(a, mixed(dark, inverted(doubled), is_light), share)


_BLENDS: dict[str, Callable[[MaterialInput, MaterialInput, MaterialInput], MaterialInput]] = {
    "MIX": mixed,
    "ADD": lambda a, b, share: added(a, combined(Operation.MULTIPLY, b, share)),
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
        raise refuse(node, "operation")
    return clamped(result) if node.use_clamp else result


_MATH = {kind.name: kind for kind in (Operation.ADD, Operation.SUBTRACT, Operation.MULTIPLY, Operation.DIVIDE, Operation.POWER)} | {
    kind.name: kind for kind in (Operation.MINIMUM, Operation.MAXIMUM, Operation.GREATER_THAN, Operation.FLOOR, Operation.ABSOLUTE)
}
_COMPOSED_MATH: dict[str, Callable[..., MaterialInput]] = {
    "LESS_THAN": lambda a, b: combined(Operation.GREATER_THAN, b, a),
    "MULTIPLY_ADD": lambda a, b, c: added(combined(Operation.MULTIPLY, a, b), c),
    "SQRT": lambda a: combined(Operation.POWER, combined(Operation.MAXIMUM, a, constant(0.0)), constant(0.5)),
    "ROUND": lambda a: combined(Operation.FLOOR, added(a, constant(0.5))),
    "CEIL": lambda a: negative(combined(Operation.FLOOR, negative(a))),
    "FRACT": lambda a: combined(Operation.SUBTRACT, a, combined(Operation.FLOOR, a)),
}
_COMPOSED_MATH["FRACTION"] = _COMPOSED_MATH["FRACT"]
_MATH_OPERANDS = dict.fromkeys(("FLOOR", "ABSOLUTE", "SQRT", "ROUND", "CEIL", "FRACT", "FRACTION"), 1) | {"MULTIPLY_ADD": 3}


def _invert(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    value = reader.color(here.of(node, "Color"))
    return mixed(value, inverted(value), reader.number(here.of(node, "Fac")))


def _gamma(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    value, exponent = reader.color(here.of(node, "Color")), reader.number(here.of(node, "Gamma"))
    return combined(Operation.POWER, combined(Operation.MAXIMUM, value, constant(0.0)), exponent)


def _bright_contrast(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    value = reader.color(here.of(node, "Color"))
    bright, contrast = reader.numbers(node, here, "Bright", "Contrast")
    scaled = combined(Operation.MULTIPLY, value, added(WHITE, contrast))
    offset = combined(Operation.SUBTRACT, bright, combined(Operation.MULTIPLY, constant(0.5), contrast))
    return combined(Operation.MAXIMUM, added(scaled, offset), constant(0.0))


def _hue_saturation(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    value = reader.color(here.of(node, "Color"))
    hue, saturation, factor, share = reader.numbers(node, here, "Hue", "Saturation", "Value", "Fac")
    hsv = combined(Operation.RGB_TO_HSV, value)
    turned = added(combined(Operation.RED, hsv), hue, constant(0.5))
    new_hue = combined(Operation.SUBTRACT, turned, combined(Operation.FLOOR, turned))
    new_saturation = clamped(combined(Operation.MULTIPLY, combined(Operation.GREEN, hsv), saturation))
    new_value = combined(Operation.MULTIPLY, combined(Operation.BLUE, hsv), factor)
    changed = combined(Operation.HSV_TO_RGB, joined(new_hue, new_saturation, new_value))
    return combined(Operation.MAXIMUM, mixed(value, changed, share), constant(0.0))


def _separate(reader: ColorReader, node: bpy.types.Node, output: str, here: NodeInput) -> MaterialInput:
    value = reader.color(here.of(node, "Color"))
    if node.mode == "HSV":
        value = combined(Operation.RGB_TO_HSV, value)
    elif node.mode != "RGB":
        raise refuse(node, "mode")
    return combined(Operation[output.upper()], value)


def _combine(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    if node.mode not in ("RGB", "HSV"):
        raise refuse(node, "mode")
    channels = joined(*reader.numbers(node, here, "Red", "Green", "Blue"))
    return channels if node.mode == "RGB" else combined(Operation.HSV_TO_RGB, channels)


def _gray(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    return combined(Operation.LUMINANCE, reader.color(here.of(node, "Color")))


def _clamp(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    if node.clamp_type != "MINMAX":
        raise refuse(node, "kind")
    value, low, high = reader.numbers(node, here, "Value", "Min", "Max")
    return combined(Operation.MINIMUM, combined(Operation.MAXIMUM, value, low), high)


def _map_range(reader: ColorReader, node: bpy.types.Node, _: str, here: NodeInput) -> MaterialInput:
    if node.data_type != "FLOAT" or node.interpolation_type != "LINEAR":
        raise refuse(node, "interpolation")
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
        raise refuse(node, "black and white levels")
    red, green, blue, every = mapping.curves
    places = np.linspace(0.0, 1.0, _TABLE_ENTRIES)
    value = reader.color(here.of(node, "Color"))
    changed = []
    for curve, channel in ((red, Operation.RED), (green, Operation.GREEN), (blue, Operation.BLUE)):
        entries = np.array([mapping.evaluate(curve, mapping.evaluate(every, x)) for x in places], np.float32)
        changed.append(_looked_up(combined(channel, value), node, np.repeat(entries[:, None], 3, axis=1)))
    return mixed(value, joined(*changed), reader.number(here.of(node, "Fac")))


def _looked_up(place: MaterialInput, node: bpy.types.Node, entries: np.ndarray) -> MaterialInput:
    if isinstance(place, Constant):
        places = np.linspace(0.0, 1.0, len(entries))
        return constant(*(float(np.interp(place.value[0], places, entries[:, k])) for k in range(3)))
    return TableLookup(place, ImageTexels(node.name, entries[None]))


OPERATION_NODES: dict[str, Callable[[ColorReader, bpy.types.Node, str, NodeInput], MaterialInput]] = {
    "TEX_CHECKER": _checker,
    "TEX_GRADIENT": _gradient,
    "MAPPING": _mapping,
    "VECT_MATH": _vector_math,
    "SEPXYZ": _separate_xyz,
    "COMBXYZ": _combine_xyz,
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
"""node type -> what reads an output of it"""
