"""Parts of the picture that a kernel is to walk: a list of tiles, so that what needs nothing costs nothing.

On a GPU a tile left out is a group of invocations less; software rasterizers would walk through all of a kernel even where it has
nothing to do.
"""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from ...device.declaration import Constant, Sampled
from ...device.interface import ComputeKernel, Device, spread_out
from ...device.owned import Owned

TILE_PX = 8
"""a kernel that walks tiles has groups of TILE_PX x TILE_PX invocations"""
BAND_ROWS = 4
"""rows of tiles that follow each other in a list: what lies near in the picture lies near in the maps"""
PROBE_STEP_PX = 4
"""With the flag PROBES a kernel looks at one pixel in PROBE_STEP_PX x PROBE_STEP_PX only, at others in every batch."""
PROBE_COUNT = PROBE_STEP_PX**2
PROBES_PER_ROW = TILE_PX // PROBE_STEP_PX
QUARTERS = ((0, 0), (1, 1), (1, 0), (0, 1))
"""of a square, those apart first"""
SIZE_CONSTANTS = {"width": Constant("int", "of the picture, pixels"), "height": Constant("int", "of the picture, pixels")}
TILE_TEXTURES = {"tiles": Sampled("sampler2D", "x, y: column and row of every tile to walk; z, w: what the kernel wants to know of it")}
WALK_CONSTANTS = {"tile_count": Constant("int", "tiles to walk")}
TILE_CONSTANTS = {
    **WALK_CONSTANTS,
    "probe_x": Constant("int", "with PROBES: the first pixel of a tile to look at"),
    "probe_y": Constant("int", "the same in y"),
}
TILE_DEFINES = {"TILE_PX": TILE_PX, "PROBE_STEP_PX": PROBE_STEP_PX}
PROBES_FLAG = {"PROBES": "look at a few pixels of every tile"}


def grid_shape(width_px: int, height_px: int) -> tuple[int, int]:
    """Rows and columns of a picture's tiles."""
    return -(-height_px // TILE_PX), -(-width_px // TILE_PX)


def spread_to_pixels(grid: np.ndarray, width_px: int, height_px: int) -> np.ndarray:
    """(rows, columns) values of tiles -> (height, width) of their pixels."""
    return grid.repeat(TILE_PX, axis=0).repeat(TILE_PX, axis=1)[:height_px, :width_px]


def with_neighbours(grid: np.ndarray) -> np.ndarray:
    """(rows, columns) bool: these tiles and the eight around each."""
    wide = grid.copy()
    wide[1:] |= grid[:-1]
    wide[:-1] |= grid[1:]
    high = wide.copy()
    high[:, 1:] |= wide[:, :-1]
    high[:, :-1] |= wide[:, 1:]
    return high


def probe_px(batch: int) -> tuple[int, int]:
    """Where the probes of a batch begin in every tile: within PROBE_COUNT batches everywhere, soon everywhere nearly.

    The order is that of a Bayer matrix: every prefix is spread out.
    """
    coarse, fine = batch % 4, batch // 4 % 4
    (coarse_x, coarse_y), (fine_x, fine_y) = QUARTERS[coarse], QUARTERS[fine]
    return 2 * coarse_x + fine_x, 2 * coarse_y + fine_y


class Tiles:
    """A list of some of a picture's tiles."""

    def __init__(self, device: Device, wanted: np.ndarray, numbers: np.ndarray | None = None) -> None:
        """wanted: (rows, columns) bool; numbers: (rows, columns, 2), z and w of the list"""
        bands = spread_out(-(-len(wanted) // BAND_ROWS))
        order = (BAND_ROWS * bands[:, None] + np.arange(BAND_ROWS)).ravel()
        order = order[order < len(wanted)]
        rows, columns = np.nonzero(wanted[order])
        rows = order[rows]
        texels = np.zeros((len(rows), 4), np.float32)
        texels[:, 0], texels[:, 1] = columns, rows
        if numbers is not None:
            texels[:, 2:] = numbers[rows, columns]
        self.device, self.count = device, len(rows)
        self.texture = device.upload_array(texels)

    def dispatch(self, kernel: ComputeKernel, /, **bindings: object) -> None:
        self._dispatch(kernel, self.count, (0, 0) if "probe_x" in kernel.declaration.constants else None, bindings)

    def dispatch_probes(self, kernel: ComputeKernel, batch: int, /, **bindings: object) -> None:
        """For a kernel with the flag PROBES."""
        self._dispatch(kernel, -(-self.count // PROBE_COUNT), probe_px(batch), bindings)

    def walking(self, kernel: ComputeKernel, /, **bindings: object) -> Generator[None, None, None]:
        """`dispatch`, after a pause where the kernel has not been run: software rasterizers translate it then, which takes as long as the
        walk does."""
        yield from self._translating(kernel, bindings)
        self.dispatch(kernel, **bindings)

    def probing(self, kernel: ComputeKernel, batch: int, /, **bindings: object) -> Generator[None, None, None]:
        """`dispatch_probes`, paused like `walking`."""
        yield from self._translating(kernel, bindings)
        self.dispatch_probes(kernel, batch, **bindings)

    def _translating(self, kernel: ComputeKernel, bindings: dict[str, object]) -> Generator[None, None, None]:
        if self.count and not self.device.has_run(kernel):
            # of a picture without pixels: nothing is done, by the very program that the rest needs
            self.dispatch(kernel, **{**bindings, "width": 0})
            yield

    def _dispatch(self, kernel: ComputeKernel, group_count: int, probe: tuple[int, int] | None, bindings: dict[str, object]) -> None:
        probes = {} if probe is None else {"probe_x": probe[0], "probe_y": probe[1]}
        kernel.dispatch_linear(group_count * TILE_PX, tiles=self.texture, tile_count=self.count, **probes, **bindings)

    def release(self) -> None:
        self.texture.release()


class TileSplit:
    """A picture's tiles in two lists: those that kernels walk, and the others, which they only probe."""

    def __init__(self, device: Device, is_walked: np.ndarray) -> None:
        """is_walked: (rows, columns) bool"""
        self.is_walked = is_walked
        with Owned() as owned:
            self.walked = owned.own(Tiles(device, is_walked))
            self.probed = owned.own(Tiles(device, ~is_walked))
            self._owned = owned.pop_all()

    def release(self) -> None:
        self._owned.close()
