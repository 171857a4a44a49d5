"""Composes shader text: includes, variant flags, shared numbers, and for plain OpenGL the interface of a declaration.

Nothing here needs a GPU; `check_shaders` composes every variant of every kernel in a test.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from ..core.errors import DeviceError
from ..resources import shader_folder
from .declaration import ComputeDeclaration, GeometryDeclaration, KernelDeclaration, RasterDeclaration

NUMBER_SOURCE = "number.vert.glsl"
"""the vertex shader of all geometry kernels"""
INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')
FORBIDDEN = re.compile(r"^\s*(#version|layout\s*\(|uniform\s|in\s|out\s)")


class Line(NamedTuple):
    """A line of shader text and where it came from."""

    text: str
    file_name: str
    number: int


def load(file_name: str) -> str:
    """The text of a shader file with its includes in place, each file once.

    file_name: within gpu_shaders/, or an absolute path (whose includes are still found within gpu_shaders/).
    Raises DeviceError with file and line for a missing or circular include and for an interface declared in the body.
    """
    return "\n".join(line.text for line in _expand(file_name, set(), ()))


def describe_line(composed: str, file_name: str, number: int) -> str:
    """'file:line: text' of line `number` (from 1) of a composed text, whose end is the body `load(file_name)`."""
    composed_lines, body = composed.splitlines(), _expand(file_name, set(), ())
    if not 0 < number <= len(composed_lines):
        return f"{file_name}: line {number} of the composed text"
    index = number - 1 - (len(composed_lines) - len(body))
    if index < 0:
        return f"{file_name}: in the declared interface: {composed_lines[number - 1].strip()}"
    return f"{body[index].file_name}:{body[index].number}: {body[index].text.strip()}"


def refusal(kernel_name: str, log: str, line_pattern: re.Pattern[str], stages: Mapping[str, tuple[str, str]]) -> str:
    """What to tell of a compiler's complaint: the kernel, the line it means, and its own words.

    line_pattern: whose first group is a line number in `log`; stages: what `log` calls a stage -> file name and composed text.
    """
    told = [stage for name, stage in stages.items() if name in log] or list(stages.values())
    line = line_pattern.search(log)
    # a complaint without a line is about the program as a whole
    place = f" at {describe_line(told[0][1], told[0][0], int(line[1]))}" if line else ""
    return f"kernel {kernel_name}: the shader is refused{place}\n{log}"


def _expand(file_name: str, seen: set[str], including: tuple[Line, ...]) -> list[Line]:
    """including: the #include lines that led here"""
    place = f" (included by {including[-1].file_name}:{including[-1].number})" if including else ""
    if file_name in (line.file_name for line in including):
        raise DeviceError(f"shader file {file_name} includes itself through {' -> '.join(line.file_name for line in including)}{place}")
    try:
        text = (shader_folder() / file_name).read_text(encoding="utf-8")
    except OSError as error:
        raise DeviceError(f"shader file {file_name} cannot be read{place}: {error.strerror}") from error
    lines: list[Line] = []
    for number, content in enumerate(text.splitlines(), 1):
        line = Line(content, file_name, number)
        include = INCLUDE.match(content)
        if include:
            if include[1] not in seen:
                lines += _expand(include[1], seen, (*including, line))
        elif FORBIDDEN.match(content):
            raise DeviceError(f"{file_name}:{number}: the interface belongs in the kernel's declaration: {content.strip()}")
        else:
            lines.append(line)
    # only now: a file that is still being read and comes up again includes itself
    seen.add(file_name)
    return lines


def prologue(declaration: KernelDeclaration, flags: Iterable[str]) -> str:
    """Variant flags and shared numbers as preprocessor lines."""
    flags = tuple(flags)
    declaration.check_flags(flags)
    numbers = [f"#define {name} {value!r}" for name, value in declaration.defines.items()]
    return "\n".join([f"#define {flag} 1" for flag in sorted(flags)] + numbers) + "\n"


def _opengl_image(name: str, texture_format: str, slot: int, qualifier: str = "") -> str:
    prefix = "u" if texture_format.endswith("UI") else ""
    return f"layout({texture_format.lower()}, binding = {slot}) uniform {qualifier}{prefix}image2D {name};"


def _opengl_resources(declaration: KernelDeclaration, for_software: bool = False) -> list[str]:
    if for_software:
        first_slot = len(declaration.images)
        textures = enumerate(declaration.textures.items(), first_slot)
        lines = [_opengl_image(name, texture.texture_format, slot, "readonly ") for slot, (name, texture) in textures]
        lines.append("#define texelFetch(name, place, level) imageLoad(name, place)")
    else:
        lines = [f"uniform {texture.sampler} {name};" for name, texture in declaration.textures.items()]
    for slot, (name, image) in enumerate(declaration.images.items()):
        lines.append(_opengl_image(name, image.texture_format, slot, "writeonly " if image.access == "write" else ""))
    lines += [f"uniform {constant.glsl_type} {name};" for name, constant in declaration.constants.items()]
    for slot, (name, table) in enumerate(declaration.tables.items()):
        lines.append(f"layout(std140, binding = {slot}) uniform {name}_block {{ vec4 {name}[{table.length}]; }};")
        if for_software and table.has_named_rows:
            rows = ", ".join(f"{name}[{row}]" for row in range(table.length))
            lines += [f"vec4 {name}_rows[{table.length}] = vec4[]({rows});", f"#define {name} {name}_rows"]
    return lines


def opengl_compute(declaration: ComputeDeclaration, flags: Iterable[str], for_software: bool = False) -> str:
    """for_software: the same as Mesa's software rasterizer runs faster. Textures are images, those after the declaration's own; tables'
    rows are looked up once, not wherever they are named."""
    x, y, z = declaration.local_size
    head = ["#version 430", f"layout(local_size_x = {x}, local_size_y = {y}, local_size_z = {z}) in;", prologue(declaration, flags)]
    return "\n".join([*head, *_opengl_resources(declaration, for_software), load(declaration.source)]) + "\n"


def opengl_raster(declaration: RasterDeclaration, flags: Iterable[str]) -> tuple[str, str]:
    """vertex and fragment text"""
    shared = ["#version 430", prologue(declaration, flags), *_opengl_resources(declaration)]
    varyings = [(f"{v.interpolation} %s {v.glsl_type} {name};") for name, v in declaration.varyings.items()]
    vertex = [*shared, "in vec3 position_os;", *(line % "out" for line in varyings), load(declaration.vertex_source)]
    output = f"out {declaration.output_type} {declaration.output_name};"
    fragment = [*shared, *(line % "in" for line in varyings), output, load(declaration.fragment_source)]
    return "\n".join(vertex) + "\n", "\n".join(fragment) + "\n"


def opengl_geometry(declaration: GeometryDeclaration, flags: Iterable[str]) -> tuple[str, str, str]:
    """vertex, geometry and fragment text"""
    version = "#version 430"
    shared = [version, prologue(declaration, flags), *_opengl_resources(declaration)]
    varyings = [(f"{v.interpolation} %s {v.glsl_type} {name};") for name, v in declaration.varyings.items()]
    strips = ["layout(points) in;", f"layout(triangle_strip, max_vertices = {declaration.most_vertices}) out;"]
    geometry = [*shared, *strips, *(line % "out" for line in varyings), load(declaration.geometry_source)]
    output = f"out {declaration.output_type} {declaration.output_name};"
    fragment = [*shared, *(line % "in" for line in varyings), output, load(declaration.fragment_source)]
    return "\n".join([version, load(NUMBER_SOURCE)]) + "\n", "\n".join(geometry) + "\n", "\n".join(fragment) + "\n"
