"""A material's inputs as a program for the device: what several inputs have in common is worked out once.

The program of a material runs on REGISTER_COUNT registers of three floats, of which the first hold the inputs, in the order of
MATERIAL_INPUTS: those that are constant are there from the start, the others are left there by the program.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from .errors import SceneError
from .material import (
    BLACK,
    WHITE,
    Combination,
    Constant,
    CornerValue,
    Extension,
    ImageSample,
    ImageTexels,
    Layer,
    Material,
    MaterialInput,
    Operation,
    Rgb,
    TableLookup,
)

REGISTER_COUNT = 32
MAX_INSTRUCTIONS = 256
IMAGE_INTERPOLATED, IMAGE_ALPHA, IMAGE_DIVIDED = 1, 2, 4
_FLAT: Rgb = (0.5, 0.5, 1.0)

MATERIAL_INPUTS: Mapping[str, Callable[[Material], MaterialInput]] = {
    "DIFFUSE": lambda m: m.diffuse,
    "DIELECTRIC_WEIGHT": lambda m: m.dielectric_weight,
    "SPECULAR_TINT": lambda m: m.specular_tint,
    "IOR": lambda m: m.ior,
    "METAL": lambda m: m.metal,
    "METAL_WEIGHT": lambda m: m.metal_weight,
    "EMISSION": lambda m: m.emission,
    "ROUGHNESS": lambda m: m.roughness,
    "NORMAL_COLOR": lambda m: m.normal_map.color if m.normal_map else Constant(_FLAT),
    "NORMAL_STRENGTH": lambda m: m.normal_map.strength if m.normal_map else BLACK,
    "COAT_WEIGHT": lambda m: m.coat_weight,
    "COAT_ROUGHNESS": lambda m: m.coat_roughness,
    "COAT_IOR": lambda m: m.coat_ior,
}
PAIRED_INPUTS = 10
"""at the beginning, colours and numbers by turns; numbers follow"""


class OpCode(enum.IntEnum):
    END = 0
    CONSTANT = 1
    IMAGE = 2
    CORNER = 3
    TABLE = 4
    FIRST_OPERATION = 5


OP_CODES = {operation: OpCode.FIRST_OPERATION + index for index, operation in enumerate(Operation)}


class TooLongError(SceneError):
    """A material's nodes come to more than a program can hold."""


@dataclass(frozen=True)
class Program:
    constants: np.ndarray
    """(len(MATERIAL_INPUTS), 3) float32, 0 where the program leaves the value"""
    rows: np.ndarray
    """(texel_count, 4) float32 instructions, empty where all inputs are constant"""


def material_layers(material: Material) -> set[Layer]:
    """The layers that a mesh must have for a material."""
    parts = [part for read in MATERIAL_INPUTS.values() for part in _parts(read(material))]
    found = {part.layer for part in parts if isinstance(part, ImageSample | CornerValue)}
    return found | ({material.normal_map.layer} if material.normal_map else set())


def material_images(material: Material) -> list[ImageTexels]:
    return list(dict.fromkeys(image for read in MATERIAL_INPUTS.values() for image in sampled_images(read(material))))


def sampled_images(expression: MaterialInput) -> list[ImageTexels]:
    return list(dict.fromkeys(part.image for part in _parts(expression) if isinstance(part, ImageSample)))


def _operands(expression: MaterialInput) -> tuple[MaterialInput, ...]:
    if isinstance(expression, Combination):
        return expression.operands
    return (expression.operand,) if isinstance(expression, TableLookup) else ()


def _parts(expression: MaterialInput) -> list[MaterialInput]:
    """The expression and all in it, each once, operands before what they belong to."""
    parts: dict[MaterialInput, None] = {}
    pending = [(expression, False)]
    while pending:
        part, is_ready = pending.pop()
        if part in parts:
            continue
        if is_ready:
            parts[part] = None
        else:
            pending.append((part, True))
            pending += [(operand, False) for operand in reversed(_operands(part))]
    return list(parts)


def compile_material(material: Material, layer_index: Mapping[Layer, int], image_base: Mapping[ImageTexels, int]) -> Program:
    """image_base: where the device has each image. Raises TooLongError."""
    inputs = [read(material) for read in MATERIAL_INPUTS.values()]
    constants = np.array([one.value if isinstance(one, Constant) else BLACK.value for one in inputs], np.float32)
    computed = {index: one for index, one in enumerate(inputs) if not isinstance(one, Constant)}
    if not computed:
        return Program(constants, np.zeros((0, 4), np.float32))
    return Program(constants, _Compiler(computed, layer_index, image_base).rows())


class _Compiler:
    def __init__(
        self, outputs: Mapping[int, MaterialInput], layer_index: Mapping[Layer, int], image_base: Mapping[ImageTexels, int]
    ) -> None:
        """outputs: register -> what is to stand there in the end"""
        self._outputs, self._layer_index, self._image_base = outputs, layer_index, image_base
        self._order = list(dict.fromkeys(part for output in outputs.values() for part in _parts(output)))
        self._rows: list[tuple[float, ...]] = []

    def rows(self) -> np.ndarray:
        if len(self._order) + len(self._outputs) >= MAX_INSTRUCTIONS:
            raise TooLongError(f"more than {MAX_INSTRUCTIONS} steps")
        last_use: dict[MaterialInput, int] = {}
        for index, part in enumerate(self._order):
            for operand in _operands(part):
                last_use[operand] = index
        targets: dict[MaterialInput, list[int]] = {}
        for register, output in self._outputs.items():
            targets.setdefault(output, []).append(register)
        free = list(range(REGISTER_COUNT - 1, len(MATERIAL_INPUTS) - 1, -1))
        register_of: dict[MaterialInput, int] = {}
        for index, part in enumerate(self._order):
            operands = [register_of[operand] for operand in _operands(part)]
            # an input's own register keeps its value to the end; others are free after their last use, by this very step too
            for operand in set(_operands(part)):
                if last_use[operand] == index and operand not in targets:
                    free.append(register_of[operand])
            if part in targets:
                register_of[part] = targets[part][0]
            elif free:
                register_of[part] = free.pop()
            else:
                raise TooLongError(f"more than {REGISTER_COUNT - len(MATERIAL_INPUTS)} values at a time")
            self._emit(part, register_of[part], operands)
            for copy in targets.get(part, [])[1:]:
                self._instruction(OP_CODES[Operation.MAXIMUM], copy, register_of[part], register_of[part])
        self._instruction(OpCode.END, 0)
        return np.array(self._rows, np.float32)

    def _instruction(self, op_code: int, register: int, *arguments: float) -> None:
        self._rows.append((op_code + 64 * register, *arguments, *[0.0] * (3 - len(arguments))))

    def _emit(self, part: MaterialInput, register: int, operands: list[int]) -> None:
        match part:
            case Constant(value):
                self._instruction(OpCode.CONSTANT, register, *value)
            case CornerValue(layer):
                self._instruction(OpCode.CORNER, register, self._layer_index[layer])
            case ImageSample():
                base = self._image_base[part.image]
                flags = IMAGE_INTERPOLATED * part.is_interpolated | IMAGE_ALPHA * part.is_alpha | IMAGE_DIVIDED * part.divides_by_alpha
                self._instruction(OpCode.IMAGE, register, self._layer_index[part.layer], base >> 16, base & 0xFFFF)
                self._rows.append((*part.uv_rows[0], list(Extension).index(part.extension)))
                self._rows.append((*part.uv_rows[1], flags))
            case TableLookup():
                entries = part.table.texels[0]
                self._instruction(OpCode.TABLE, register, operands[0], len(entries))
                self._rows += [(*entry, 0.0) for entry in entries.tolist()]
            case Combination(operation):
                self._instruction(OP_CODES[operation], register, *operands)


# expressions


def combined(operation: Operation, *operands: MaterialInput) -> MaterialInput:
    """The operation as an expression, worked out at once where all operands are constant and left out where it changes nothing."""
    values = [np.array(operand.value) for operand in operands if isinstance(operand, Constant)]
    if len(values) == len(operands):
        return constant(*evaluate_operation(operation, *values))
    if operation is Operation.MULTIPLY and BLACK in operands:
        return BLACK
    if operation is Operation.MIX and (operands[2] in (BLACK, WHITE) or operands[0] is operands[1]):
        return operands[1] if operands[2] == WHITE else operands[0]
    if operation in _NEUTRAL and operands[1] == _NEUTRAL[operation]:
        return operands[0]
    if operation in (Operation.ADD, Operation.MULTIPLY) and operands[0] == _NEUTRAL[operation]:
        return operands[1]
    return Combination(operation, operands)


_NEUTRAL = {
    Operation.ADD: BLACK,
    Operation.SUBTRACT: BLACK,
    Operation.MULTIPLY: WHITE,
    Operation.DIVIDE: WHITE,
    Operation.POWER: WHITE,
}
"""second operands that change nothing"""


def constant(*channels: float) -> Constant:
    """Of one number or three; what is not finite becomes 0."""
    values = [float(np.nan_to_num(channel, nan=0.0, posinf=1e30, neginf=-1e30)) for channel in channels]
    return Constant((values[0], values[0], values[0]) if len(values) == 1 else (values[0], values[1], values[2]))


LUMINANCE = (0.2126, 0.7152, 0.0722)
"""of linear Rec. 709 colours"""


def evaluate_operation(operation: Operation, *operands: np.ndarray) -> np.ndarray:
    """(..., 3) float64 operands -> (..., 3)"""
    with np.errstate(all="ignore"):
        return _OPERATIONS[operation](*operands)


def evaluate_on_texels(expression: MaterialInput, image: ImageTexels) -> np.ndarray:
    """(height, width, 3) float32: what the expression, which samples that image alone, makes of each of its texels."""
    colors = _linear_colors(image, image.texels)

    def value_of(leaf: ImageSample | CornerValue) -> np.ndarray:
        if isinstance(leaf, CornerValue):
            raise ValueError("an image has no corners")
        return colors

    return np.broadcast_to(_evaluate(expression, value_of), colors.shape).astype(np.float32)


def typical_value(expression: MaterialInput) -> np.ndarray:
    """(3,) float64: what the expression makes of its images' means, and of 0.5 for what only a place on the surface has."""
    if isinstance(expression, Constant):
        return np.array(expression.value, np.float64)

    def value_of(leaf: ImageSample | CornerValue) -> np.ndarray:
        if isinstance(leaf, CornerValue):
            return np.full(3, 0.5)
        height, width, channel_count = leaf.image.texels.shape
        step = max(1, math.isqrt(height * width // _TYPICAL_TEXELS))
        texels = leaf.image.texels[::step, ::step]
        if leaf.is_alpha:
            return np.full(3, texels[..., 3].mean() / _texel_scale(texels) if channel_count == 4 else 1.0)
        return _linear_colors(leaf.image, texels).reshape(-1, 3).mean(axis=0)

    return np.nan_to_num(_evaluate(expression, value_of))


_TYPICAL_TEXELS = 4096


def _texel_scale(texels: np.ndarray) -> float:
    return 255.0 if texels.dtype == np.uint8 else 1.0


def _linear_colors(image: ImageTexels, texels: np.ndarray) -> np.ndarray:
    """(height, width, 3) float64 of texels of an image."""
    values = texels.astype(np.float64) / _texel_scale(texels)
    colors = values[..., :3] if values.shape[2] > 1 else np.repeat(values, 3, axis=2)
    return np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4) if image.is_srgb else colors


def _evaluate(expression: MaterialInput, value_of: Callable[[ImageSample | CornerValue], np.ndarray]) -> np.ndarray:
    """(..., 3) float64; each part once, however many share it. value_of: of what is looked up on the surface"""
    values: dict[MaterialInput, np.ndarray] = {}
    for part in _parts(expression):
        operands = [values[operand] for operand in _operands(part)]
        match part:
            case Constant(value):
                values[part] = np.array(value, np.float64)
            case ImageSample() | CornerValue():
                values[part] = value_of(part)
            case TableLookup(table=table):
                places = np.linspace(0.0, 1.0, table.texels.shape[1])
                values[part] = np.stack([np.interp(operands[0][..., 0], places, table.texels[0, :, k]) for k in range(3)], axis=-1)
            case Combination(operation):
                values[part] = evaluate_operation(operation, *operands)
    return values[expression]


def _channel(index: int) -> Callable[[np.ndarray], np.ndarray]:
    return lambda a: np.repeat(a[..., index : index + 1], 3, axis=-1)


def _hsv_of(colors: np.ndarray) -> np.ndarray:
    r, g, b = np.moveaxis(colors, -1, 0)
    value = colors.max(axis=-1)
    spread = value - colors.min(axis=-1)
    safe = np.where(spread > 0.0, spread, 1.0)
    hue = np.select([value == r, value == g], [(g - b) / safe, 2.0 + (b - r) / safe], 4.0 + (r - g) / safe)
    is_gray = spread <= 0.0
    return np.stack([np.where(is_gray, 0.0, (hue / 6.0) % 1.0), np.where(is_gray, 0.0, spread / np.where(value == 0, 1, value)), value], -1)


def _color_of_hsv(hsv: np.ndarray) -> np.ndarray:
    hue, saturation, value = (hsv[..., k : k + 1] for k in range(3))
    pure = np.clip(np.abs((6.0 * hue + np.array([0.0, 4.0, 2.0])) % 6.0 - 3.0) - 1.0, 0.0, 1.0)
    return value * (1.0 - saturation + saturation * pure)


_OPERATIONS: Mapping[Operation, Callable[..., np.ndarray]] = {
    Operation.ADD: np.add,
    Operation.SUBTRACT: np.subtract,
    Operation.MULTIPLY: np.multiply,
    Operation.DIVIDE: lambda a, b: np.where(b == 0.0, 0.0, a / np.where(b == 0.0, 1.0, b)),
    Operation.POWER: lambda a, b: np.nan_to_num(np.power(a, b), nan=0.0),
    Operation.MINIMUM: np.minimum,
    Operation.MAXIMUM: np.maximum,
    Operation.GREATER_THAN: lambda a, b: np.where(a > b, 1.0, 0.0),
    Operation.FLOOR: np.floor,
    Operation.ABSOLUTE: np.abs,
    Operation.CLAMP: lambda a: np.clip(a, 0.0, 1.0),
    Operation.MIX: lambda a, b, share: a * (1.0 - share) + b * share,
    Operation.RED: _channel(0),
    Operation.GREEN: _channel(1),
    Operation.BLUE: _channel(2),
    Operation.LUMINANCE: lambda a: np.repeat((a @ np.array(LUMINANCE))[..., None], 3, axis=-1),
    Operation.RGB_TO_HSV: _hsv_of,
    Operation.HSV_TO_RGB: _color_of_hsv,
}
