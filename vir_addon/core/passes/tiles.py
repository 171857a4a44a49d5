"""Parts of the picture that a kernel is to walk: a list of tiles, so that what needs nothing costs nothing.

On a GPU a tile left out is a group of invocations less; software rasterizers would walk through all of a kernel even where it has
nothing to do.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ...device.declaration import Constant, Sampled
from ...device.interface import ComputeKernel, Device

TILE_PX = 8
"""a kernel that walks tiles has groups of TILE_PX x TILE_PX invocations"""
TILE_TEXTURES = {"tiles": Sampled("sampler2D", "x, y: column and row of every tile to walk")}
TILE_CONSTANTS = {"tile_count": Constant("int", "tiles to walk")}


class Tiles:
    """Those tiles of a picture that hold a wanted pixel."""

    def __init__(self, device: Device, wanted: np.ndarray) -> None:
        """wanted: (height, width) bool"""
        height, width = wanted.shape
        padded = np.pad(wanted, ((0, -height % TILE_PX), (0, -width % TILE_PX)))
        self.wanted = padded.reshape(padded.shape[0] // TILE_PX, TILE_PX, -1, TILE_PX).any(axis=(1, 3))
        """(rows, columns) bool"""
        self.picture_shape = (height, width)
        rows, columns = np.nonzero(self.wanted)
        texels = np.zeros((len(rows), 4), np.float32)
        texels[:, 0], texels[:, 1] = columns, rows
        self.count = len(rows)
        self.texture = device.upload_array(texels)

    @cached_property
    def wanted_px(self) -> np.ndarray:
        """(height, width) bool: pixels of the tiles"""
        height, width = self.picture_shape
        return np.kron(self.wanted, np.ones((TILE_PX, TILE_PX), bool))[:height, :width]

    def dispatch(self, kernel: ComputeKernel, /, **bindings: object) -> None:
        kernel.dispatch_linear(self.count * TILE_PX, tiles=self.texture, tile_count=self.count, **bindings)

    def release(self) -> None:
        self.texture.release()
