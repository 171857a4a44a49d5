"""What a user may ask for. Front ends fill this in; the plan decides what becomes of it."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from .errors import UsageError


class Method(enum.Enum):
    AUTO = "auto"
    MVR = "mvr"
    IVIR = "ivir"
    MICRO = "micro"

    @property
    def uses_points(self) -> bool:
        """Whether maps are splatted from points, which enlarges outlines by half a texel."""
        return self is Method.IVIR


class PointStorage(enum.Enum):
    BUFFERED = "buffered"
    BUFFERLESS = "bufferless"


class Resolve(enum.Enum):
    ADAPTIVE = "adaptive"
    """Tiles that the first batches find wholly lit or dark, with all pixels around, are only probed from then on, and looked up again
    where a probe finds something else."""
    FULL = "full"


@dataclass(frozen=True)
class Settings:
    method: Method = Method.AUTO
    points: PointStorage = PointStorage.BUFFERED
    """of ivir; with AUTO it counts for lights that ivir is chosen for"""
    view_count: int = 64
    """light samples of a light with size; lights without size get one"""
    map_resolution_px: int = 1024
    light_names: tuple[str, ...] | None = None
    """None: every light that the scene shows"""
    stochastic_culling: bool = True
    """cull triangles below a tenth of a pixel with probability 1 - 10 A (Gavane & Watson 2022, section 3.2)"""
    resolve: Resolve = Resolve.ADAPTIVE
    cull_hidden: bool = True
    """after the first batch of views, leave out buffered points and small triangles that none of its views is near to seeing"""
    watertight: bool = True
    """point spacing that leaves no texel empty (covering radius) instead of the published one point per pixel area"""
    replay_buffer_mib: int = 256
    """memory for what views replay (points, small triangles) of all lights; what does not fit is processed in portions, or made again when
    its turn comes"""

    def __post_init__(self) -> None:
        if not 1 <= self.view_count <= 4096:
            raise UsageError(f"views must be 1 to 4096, not {self.view_count}")
        if not 16 <= self.map_resolution_px <= 8192:
            raise UsageError(f"the map resolution must be 16 to 8192, not {self.map_resolution_px}")
        if self.points is PointStorage.BUFFERLESS and not (self.method.uses_points or self.method is Method.AUTO):
            raise UsageError(
                f"points cannot be {self.points.value} with the method {self.method.value}, which makes none; "
                f"choose the method {Method.IVIR.value}, or leave the choice of points out"
            )
        if self.replay_buffer_mib < 1:
            raise UsageError("the replay buffer needs at least 1 MiB")
