"""What a kernel takes and gives, declared once.

The same declaration makes the GLSL interface for moderngl, the GPUShaderCreateInfo for Blender's gpu module, and the
check that every name is bound and none is unknown. Shader files hold bodies only, no `layout` and no `uniform`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

CONSTANT_FLOATS = {"int": 1, "float": 1, "vec2": 2, "vec3": 3, "vec4": 4, "mat4": 16}
"""Constants live in push constants on Blender's side: 128 bytes are guaranteed, of which mat4 takes half."""
MAX_CONSTANT_BYTES = 128


@dataclass(frozen=True)
class Sampled:
    """A texture that a kernel reads with texelFetch."""

    sampler: str
    """'sampler2D' or 'usampler2D'"""
    text: str
    channel_count: int | None = None
    """None: four, of a usampler2D one"""

    @property
    def texture_format(self) -> str:
        """one of `interface.TextureFormat` values"""
        if self.sampler == "sampler2D":
            return "RGBA32F"
        return "RG32UI" if self.channel_count == 2 else "R32UI"


@dataclass(frozen=True)
class Stored:
    """A texture that a kernel writes, or updates atomically."""

    texture_format: str
    """one of `interface.TextureFormat` values, e.g. 'R32UI'"""
    access: str
    """'write', 'read_write' or 'atomic'"""
    text: str


@dataclass(frozen=True)
class Constant:
    glsl_type: str
    text: str


@dataclass(frozen=True)
class Table:
    """An array of vec4 in a uniform block: small tables that every invocation walks through, e.g. the views of a batch."""

    length: int
    text: str
    has_named_rows: bool = False
    """kernels ask for each row by a literal number"""

    def pack(self, name: str, rows: Any) -> bytes:
        """Rows as float32, padded with zeros to the declared length. TypeError, with `name`, when they do not fit."""
        rows = np.asarray(rows, np.float32)
        if rows.ndim != 2 or rows.shape[1] != 4 or len(rows) > self.length:
            raise TypeError(f"table {name} takes at most {self.length} rows of 4 floats, not an array of shape {rows.shape}")
        return rows.tobytes().ljust(16 * self.length, b"\0")


@dataclass(frozen=True, kw_only=True)
class KernelDeclaration:
    name: str
    text: str
    textures: Mapping[str, Sampled] = field(default_factory=dict)
    images: Mapping[str, Stored] = field(default_factory=dict)
    constants: Mapping[str, Constant] = field(default_factory=dict)
    tables: Mapping[str, Table] = field(default_factory=dict)
    flags: Mapping[str, str] = field(default_factory=dict)
    """preprocessor names that select a variant, each with what it does"""
    defines: Mapping[str, int | float] = field(default_factory=dict)
    """numbers that host and shader share"""

    def __post_init__(self) -> None:
        size = sum(4 * CONSTANT_FLOATS[constant.glsl_type] for constant in self.constants.values())
        if size > MAX_CONSTANT_BYTES:
            raise ValueError(f"kernel {self.name}: {size} bytes of constants, {MAX_CONSTANT_BYTES} are guaranteed; use a table")

    @property
    def binding_names(self) -> frozenset[str]:
        return frozenset([*self.textures, *self.images, *self.constants, *self.tables])

    def check_bindings(self, given: Iterable[str]) -> None:
        """Raises TypeError that names what is missing and what is unknown."""
        names = set(given)
        missing, unknown = self.binding_names - names, names - self.binding_names
        if missing or unknown:
            parts = [f"missing {sorted(missing)}"] * bool(missing) + [f"unknown {sorted(unknown)}"] * bool(unknown)
            raise TypeError(f"kernel {self.name}: {', '.join(parts)}")

    def check_flags(self, given: Iterable[str]) -> None:
        unknown = set(given) - set(self.flags)
        if unknown:
            raise TypeError(f"kernel {self.name}: unknown flags {sorted(unknown)}, it has {sorted(self.flags)}")


@dataclass(frozen=True, kw_only=True)
class ComputeDeclaration(KernelDeclaration):
    source: str
    """file name in gpu_shaders/, or an absolute path"""
    local_size: tuple[int, int, int] = (64, 1, 1)
    is_long: bool = False
    """so that software rasterizers need a preview's patience to compile it: what runs faster and compiles slower is not for it"""


@dataclass(frozen=True)
class Varying:
    glsl_type: str
    interpolation: str
    """'smooth' or 'flat'"""
    text: str


@dataclass(frozen=True, kw_only=True)
class RasterDeclaration(KernelDeclaration):
    """Draws indexed triangle meshes whose one attribute is `position_os` (vec3). Fragments may store into images only on devices that
    have `stores_from_fragments`."""

    vertex_source: str
    fragment_source: str
    varyings: Mapping[str, Varying] = field(default_factory=dict)
    output_name: str
    output_type: str
    """'uint', 'uvec2' or 'uvec4': the one colour attachment"""
    has_depth_test: bool = True
    """False: every fragment counts, in front or not"""
    writes_depth: bool = False
    """the fragment shader writes gl_FragDepth"""


@dataclass(frozen=True, kw_only=True)
class GeometryDeclaration(KernelDeclaration):
    """A geometry shader makes a triangle strip of a number (gl_PrimitiveIDIn), the rasterizer fragments of that, and all of these store
    into images. Only on devices that have `stores_from_geometry`."""

    geometry_source: str
    fragment_source: str
    most_vertices: int
    """of a strip"""
    varyings: Mapping[str, Varying]
    output_name: str
    output_type: str
    """as of a RasterDeclaration; nobody looks at it"""
