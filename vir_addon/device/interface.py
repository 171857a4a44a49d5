"""The small interface behind which both backends stand. Passes know only this."""

from __future__ import annotations

import abc
import enum
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from .declaration import ComputeDeclaration, GeometryDeclaration, KernelDeclaration, RasterDeclaration

Result = TypeVar("Result")

LINEAR_TEXTURE_WIDTH = 4096
"""Arrays on the device are textures of this width, filled row by row; lib/linear_texel.glsl addresses them."""
EMPTY_DEPTH_BITS = 0x7F7FFFFF
"""'Nothing here' in depth maps: the bits of the largest finite float. A pattern that decodes to NaN would make every comparison false."""


def split_integers(values: np.ndarray) -> np.ndarray:
    """(...) non-negative integers -> (..., 2) float32: high and low 16 bits, both exact."""
    values = np.asarray(values, np.int64)
    return np.stack([values >> 16, values & 0xFFFF], axis=-1).astype(np.float32)


def spread_out(count: int) -> np.ndarray:
    """(count,) int64: all of range(count) in an order of which every half, quarter, ... has some of everywhere (bits are reversed).

    For lists that kernels walk: of a dispatch Mesa's software rasterizer hands each of its threads one part of the groups, as many as the
    others', and where one part takes longer the others wait.
    """
    numbers = np.arange(count)
    bits = max(count - 1, 0).bit_length()
    reversed_bits = sum(((numbers >> bit & 1) << (bits - 1 - bit) for bit in range(bits)), np.zeros(count, np.int64))
    return np.argsort(reversed_bits)


class TextureFormat(enum.Enum):
    """name -> (channels, numpy dtype of a read-back)"""

    R32UI = "R32UI"
    RG32UI = "RG32UI"
    RGBA32F = "RGBA32F"
    DEPTH32F = "DEPTH32F"

    @property
    def channel_count(self) -> int:
        return {"R32UI": 1, "RG32UI": 2, "RGBA32F": 4, "DEPTH32F": 1}[self.value]

    @property
    def is_unsigned(self) -> bool:
        return self in (TextureFormat.R32UI, TextureFormat.RG32UI)


class Texture(abc.ABC):
    width: int
    height: int
    format: TextureFormat

    @abc.abstractmethod
    def release(self) -> None: ...

    @property
    def byte_count(self) -> int:
        return 4 * self.format.channel_count * self.width * self.height

    def no_memory(self) -> str:
        """Of a DeviceError when it cannot be made."""
        return (
            f"the device has no memory for a texture of {self.width} x {self.height} texels ({self.byte_count >> 20} MiB): "
            "choose a lower resolution, or where maps are as large, smaller maps"
        )


class DeviceMesh(abc.ABC):
    triangle_count: int

    @abc.abstractmethod
    def release(self) -> None: ...


class RenderTarget(abc.ABC):
    """One unsigned colour attachment and a depth attachment of the same size."""

    color: Texture
    depth: Texture

    @abc.abstractmethod
    def release(self) -> None: ...


@dataclass(frozen=True)
class Draw:
    """Some instances of one mesh, or one instance of a range of its triangles; constants that change from draw to draw (ints only)."""

    mesh: DeviceMesh
    instance_count: int
    constants: Mapping[str, int]
    cull_back_faces: bool = False
    triangle_range: tuple[int, int] | None = None
    """first and number; only with one instance"""


class ComputeKernel(abc.ABC):
    declaration: ComputeDeclaration

    @abc.abstractmethod
    def dispatch(self, group_counts: tuple[int, int, int], /, **bindings: Any) -> None:
        """Run. Every name of the declaration must be bound; numbers and matrices by value, textures by object,
        tables as (rows, 4) float32 arrays."""

    def dispatch_grid(self, size: tuple[int, int], /, **bindings: Any) -> None:
        """Run at least `size` invocations in x and y."""
        width, height = self.declaration.local_size[:2]
        self.dispatch((math.ceil(size[0] / width), math.ceil(size[1] / height), 1), **bindings)

    def dispatch_linear(self, invocation_count: int, /, **bindings: Any) -> None:
        """Run at least `invocation_count` invocations in x; lib/linear_texel.glsl's `linear_invocation()` numbers them."""
        if invocation_count <= 0:
            return
        groups = math.ceil(invocation_count / self.declaration.local_size[0])
        rows = math.ceil(groups / MAX_GROUPS_PER_ROW)
        self.dispatch((math.ceil(groups / rows), rows, 1), **bindings)


MAX_GROUPS_PER_ROW = 32768
"""Half of what OpenGL guarantees for one dimension of a dispatch."""


class RasterKernel(abc.ABC):
    declaration: RasterDeclaration

    @abc.abstractmethod
    def draw(self, target: RenderTarget, viewport: tuple[int, int, int, int], draws: Sequence[Draw], /, **bindings: Any) -> None:
        """Draw with depth test 'less', unless the declaration has none, into `viewport` (x, y, width, height) of the target."""


class GeometryKernel(abc.ABC):
    declaration: GeometryDeclaration

    @abc.abstractmethod
    def draw(self, target: RenderTarget, viewport: tuple[int, int, int, int], strip_count: int, /, **bindings: Any) -> None:
        """Draw so many strips into `viewport` (x, y, width, height) of the target, without a depth test."""


SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "lavapipe", "SwiftShader", "Microsoft Basic Render", "Apple Software")
"""parts of the names by which drivers that run on the processor call themselves"""


def _variant(declaration: KernelDeclaration, flags: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
    return declaration.name, tuple(sorted(flags))


class Device(abc.ABC):
    """A GPU (or its software stand-in).

    moderngl: methods may be called from any thread; the work happens on the device's own, one call after the other.
    gpu: methods work on the thread that opened the device and raise DeviceError on any other.
    """

    name: str
    """'moderngl' or 'gpu'"""
    description: str
    """renderer and driver, as the driver names itself"""
    is_software: bool
    """whether the processor does its work"""
    max_texture_size_px: int
    stores_from_fragments: bool
    """whether raster kernels may have images"""
    stores_from_geometry: bool
    """whether there are geometry kernels"""
    _kernels: dict[tuple[str, tuple[str, ...]], Any]
    """by declaration name and sorted flags"""
    _started: set[Any]
    """kernels that have been run"""

    @abc.abstractmethod
    def run(self, function: Callable[..., Result], *arguments: Any) -> Result:
        """Call on the device's thread and return or raise what it does; use it around many small calls."""

    @abc.abstractmethod
    def create_texture(self, width: int, height: int, texture_format: TextureFormat) -> Texture:
        """What is in it is anything, what another texture was left with included."""

    @abc.abstractmethod
    def upload_texture(self, texels: np.ndarray) -> Texture:
        """(height, width, 4) float32 -> RGBA32F"""

    @abc.abstractmethod
    def upload_mesh(self, positions: np.ndarray, triangles: np.ndarray) -> DeviceMesh:
        """(vertex_count, 3) float32 and (triangle_count, 3) int32, for the rasterizer"""

    @abc.abstractmethod
    def create_target(self, color: Texture, depth: Texture) -> RenderTarget: ...

    @abc.abstractmethod
    def compute_kernel(self, declaration: ComputeDeclaration, *flags: str) -> ComputeKernel:
        """Compiled once per variant and kept. DeviceError names the file and the line that the driver refuses."""

    @abc.abstractmethod
    def raster_kernel(self, declaration: RasterDeclaration, *flags: str) -> RasterKernel: ...

    @abc.abstractmethod
    def geometry_kernel(self, declaration: GeometryDeclaration, *flags: str) -> GeometryKernel: ...

    def _describe(self, renderer: str, driver: str) -> None:
        self.description = f"{renderer}, {driver}"
        self.is_software = any(name.lower() in renderer.lower() for name in SOFTWARE_RENDERERS)

    def _kernel(self, kind: type, declaration: KernelDeclaration, flags: tuple[str, ...]) -> Any:
        """The variant's kernel of the backend's class `kind`, made when it is first asked for."""
        key = _variant(declaration, flags)
        if key not in self._kernels:
            self._kernels[key] = self.run(kind, self, declaration, key[1])
        return self._kernels[key]

    def has_kernel(self, declaration: KernelDeclaration, *flags: str) -> bool:
        """Whether the variant has been compiled."""
        return _variant(declaration, flags) in self._kernels

    @property
    def kernel_count(self) -> int:
        """compiled so far"""
        return len(self._kernels)

    @property
    def translation_count(self) -> int:
        """How often a driver has translated a kernel so far: when it was compiled, and once more when it was first run, as software
        rasterizers do and GPUs may."""
        return len(self._kernels) + len(self._started)

    def has_run(self, kernel: ComputeKernel | RasterKernel | GeometryKernel) -> bool:
        return kernel in self._started

    def note_run(self, kernel: ComputeKernel | RasterKernel | GeometryKernel) -> None:
        """To be told by every kernel whenever it is run."""
        self._started.add(kernel)

    @abc.abstractmethod
    def fill(self, texture: Texture, value: int) -> None:
        """Set every texel's every channel of an unsigned texture to `value` (32 bits), or depth to 1 for a depth texture."""

    @abc.abstractmethod
    def read(self, texture: Texture) -> np.ndarray:
        """R32UI -> (height, width) uint32, RGBA32F -> (height, width, 4) float32; row 0 is the bottom row.

        RG32UI is for kernels only: Blender cannot read it back."""

    @abc.abstractmethod
    def finish(self) -> None:
        """Wait until everything submitted is done: around what is timed."""

    @abc.abstractmethod
    def close(self) -> None: ...

    def upload_array(self, rows: np.ndarray) -> Texture:
        """(count, 4) float32 as a texture for `linear_texel`. UsageError when it exceeds the device's largest texture."""
        from ..core.errors import UsageError

        height = max(1, math.ceil(len(rows) / LINEAR_TEXTURE_WIDTH))
        if height > self.max_texture_size_px:
            raise UsageError(f"{len(rows)} texels exceed the device's largest texture ({self.max_texture_size_px} rows); split the scene")
        texels = np.zeros((height * LINEAR_TEXTURE_WIDTH, 4), np.float32)
        texels[: len(rows)] = rows
        return self.upload_texture(texels.reshape(height, LINEAR_TEXTURE_WIDTH, 4))
