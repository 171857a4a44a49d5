"""Expressions of `core.material` put together: what nodes do to colours and numbers."""

from __future__ import annotations

from ...core.material import BLACK, WHITE, Constant, ImageSample, MaterialInput, Operation
from ...core.material_program import combined, constant


def is_gray(value: MaterialInput) -> bool:
    if isinstance(value, Constant):
        return value.value[0] == value.value[1] == value.value[2]
    return isinstance(value, ImageSample) and (value.is_alpha or value.image.texels.shape[2] == 1)


def added(first: MaterialInput, *others: MaterialInput) -> MaterialInput:
    for other in others:
        first = combined(Operation.ADD, first, other)
    return first


def channel_sum(value: MaterialInput) -> MaterialInput:
    return added(*(combined(channel, value) for channel in (Operation.RED, Operation.GREEN, Operation.BLUE)))


def inverted(value: MaterialInput) -> MaterialInput:
    return combined(Operation.SUBTRACT, WHITE, value)


def negative(value: MaterialInput) -> MaterialInput:
    return combined(Operation.SUBTRACT, BLACK, value)


def mixed(first: MaterialInput, second: MaterialInput, share: MaterialInput) -> MaterialInput:
    return combined(Operation.MIX, first, second, share)


def clamped(value: MaterialInput) -> MaterialInput:
    return combined(Operation.CLAMP, value)


def joined(red: MaterialInput, green: MaterialInput, blue: MaterialInput) -> MaterialInput:
    """Three numbers as channels."""
    axes = (constant(1, 0, 0), constant(0, 1, 0), constant(0, 0, 1))
    return added(*(combined(Operation.MULTIPLY, value, axis) for value, axis in zip((red, green, blue), axes, strict=True)))
