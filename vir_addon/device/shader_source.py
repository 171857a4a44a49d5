"""Composes shader text: includes, variant flags, shared numbers, and for plain OpenGL the interface of a declaration.

Nothing here needs a GPU; `check_shaders` composes every variant of every kernel in a test.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from ..core.errors import DeviceError
from ..resources import shader_folder
from .declaration import ComputeDeclaration, KernelDeclaration, RasterDeclaration

INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')
FORBIDDEN = re.compile(r"^\s*(#version|layout\s*\(|uniform\s|in\s|out\s)")


def load(file_name: str, _including: tuple[str, ...] = ()) -> str:
    """The text of a shader file with its includes in place, each file once.

    Raises DeviceError with file and line for a missing or circular include and for an interface declared in the body.
    """
    return "\n".join(_expand(file_name, set(), _including))


def _expand(file_name: str, seen: set[str], including: tuple[str, ...]) -> list[str]:
    path: Path = shader_folder() / file_name
    if file_name in including:
        raise DeviceError(f"{file_name} includes itself through {' -> '.join(including)}")
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        place = f" (included by {including[-1]})" if including else ""
        raise DeviceError(f"shader file {file_name} cannot be read{place}: {error.strerror}") from error
    seen.add(file_name)
    lines: list[str] = []
    for number, line in enumerate(text.splitlines(), 1):
        include = INCLUDE.match(line)
        if include:
            if include[1] not in seen:
                lines += _expand(include[1], seen, (*including, file_name))
        elif FORBIDDEN.match(line):
            raise DeviceError(f"{file_name}:{number}: the interface belongs in the kernel's declaration: {line.strip()}")
        else:
            lines.append(line)
    return lines


def prologue(declaration: KernelDeclaration, flags: Iterable[str]) -> str:
    """Variant flags and shared numbers as preprocessor lines."""
    flags = tuple(flags)
    declaration.check_flags(flags)
    numbers = [f"#define {name} {value!r}" for name, value in declaration.defines.items()]
    return "\n".join([f"#define {flag} 1" for flag in sorted(flags)] + numbers) + "\n"


def _opengl_resources(declaration: KernelDeclaration) -> list[str]:
    lines = [f"uniform {texture.sampler} {name};" for name, texture in declaration.textures.items()]
    for slot, (name, image) in enumerate(declaration.images.items()):
        layout = f"layout({image.texture_format.lower()}, binding = {slot})"
        prefix = "u" if image.texture_format.endswith("UI") else ""
        qualifier = "writeonly " if image.access == "write" else ""
        lines.append(f"{layout} uniform {qualifier}{prefix}image2D {name};")
    lines += [f"uniform {constant.glsl_type} {name};" for name, constant in declaration.constants.items()]
    for slot, (name, table) in enumerate(declaration.tables.items()):
        lines.append(f"layout(std140, binding = {slot}) uniform {name}_block {{ vec4 {name}[{table.length}]; }};")
    return lines


def opengl_compute(declaration: ComputeDeclaration, flags: Iterable[str]) -> str:
    x, y, z = declaration.local_size
    head = ["#version 430", f"layout(local_size_x = {x}, local_size_y = {y}, local_size_z = {z}) in;"]
    return "\n".join([*head, prologue(declaration, flags), *_opengl_resources(declaration), load(declaration.source)]) + "\n"


def opengl_raster(declaration: RasterDeclaration, flags: Iterable[str]) -> tuple[str, str]:
    """vertex and fragment text"""
    shared = ["#version 430", prologue(declaration, flags), *_opengl_resources(declaration)]
    varyings = [(f"{v.interpolation} %s {v.glsl_type} {name};") for name, v in declaration.varyings.items()]
    vertex = [*shared, "in vec3 position_os;", *(line % "out" for line in varyings), load(declaration.vertex_source)]
    output = f"out {declaration.output_type} {declaration.output_name};"
    fragment = [*shared, *(line % "in" for line in varyings), output, load(declaration.fragment_source)]
    return "\n".join(vertex) + "\n", "\n".join(fragment) + "\n"
