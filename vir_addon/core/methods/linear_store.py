"""Lists that kernels append to: arrays on the device that the host lets grow."""

from __future__ import annotations

from ...device.interface import LINEAR_TEXTURE_WIDTH, Device, Texture, TextureFormat
from ...device.owned import Owned
from ..errors import UsageError
from ..passes.small_triangles import COPY_TEXELS


class LinearStore:
    """A growing device array; its content is lost when it grows."""

    def __init__(self, device: Device, texel_count: int) -> None:
        self.device = device
        self._owned = Owned()
        self._create(texel_count)

    def reserve(self, texel_count: int) -> None:
        self.release()
        self._create(texel_count)

    def _create(self, texel_count: int) -> None:
        rows = max(1, -(-texel_count // LINEAR_TEXTURE_WIDTH))
        if rows > self.device.max_texture_size_px:
            raise UsageError(f"{texel_count} texels exceed the device's largest texture; choose a smaller map resolution")
        self.texture: Texture = self._owned.own(self.device.create_texture(LINEAR_TEXTURE_WIDTH, rows, TextureFormat.RGBA32F))
        self.texel_count = rows * LINEAR_TEXTURE_WIDTH

    def replace_by(self, other: LinearStore) -> None:
        self.release()
        self._owned = other._owned.pop_all()
        self.texture, self.texel_count = other.texture, other.texel_count

    def copied(self, first_texel: int, texel_count: int) -> LinearStore:
        """A part of it as a list of its own."""
        with Owned() as owned:
            part = owned.own(LinearStore(self.device, texel_count))
            self.device.compute_kernel(COPY_TEXELS).dispatch_linear(
                texel_count, original=self.texture, copied=part.texture, first_texel=first_texel, texel_count=texel_count
            )
            owned.pop_all()
        return part

    def release(self) -> None:
        self._owned.close()
