"""`ivir` with the point generation of the papers: a geometry shader puts every triangle before an orthographic view, and every fragment
that the hardware rasterizer makes of it is a point.

The lattices are those of the kernels of `ivir`, a cell a pixel, and so are the points: where the rasterizer leaves cells out that a
triangle only touches, what the geometry shader hands it is larger by half a cell (gpu_shaders/lib/lattice_strip.glsl). The papers put
a triangle into the picture as a whole; large ones come in the same tiles here as there.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

from ..passes.points import (
    BUFFER_TILES_BY_RASTERIZER,
    BUFFER_TRIANGLES_BY_RASTERIZER,
    LATTICE_VIEWPORT_PX,
    SPLAT_TILES_BY_RASTERIZER,
    SPLAT_TRIANGLES_BY_RASTERIZER,
)
from .ivir import ImprovedViewIndependentRasterization


class PointsByRasterizer(ImprovedViewIndependentRasterization):
    buffer_triangles = BUFFER_TRIANGLES_BY_RASTERIZER
    buffer_tiles = BUFFER_TILES_BY_RASTERIZER
    splat_triangles = SPLAT_TRIANGLES_BY_RASTERIZER
    splat_tiles = SPLAT_TILES_BY_RASTERIZER
    invocations_per_tile = 1

    def _compiling(self, declaration: Any) -> Generator[None, None, Any]:
        yield from ()
        return self.device.geometry_kernel(declaration, *self._flags_of(declaration))

    def _generating(self, declaration: Any, invocation_count: int, **bindings: Any) -> Generator[None, None, None]:
        kernel = yield from self._compiling(declaration)
        viewport = (0, 0, LATTICE_VIEWPORT_PX, LATTICE_VIEWPORT_PX)
        kernel.draw(self.shared.lattice_target.target, viewport, invocation_count, **bindings)
