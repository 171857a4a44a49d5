"""Work in steps: whoever has something else to do, like a user interface to keep alive, does it between them."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any, TypeVar

from ..device.declaration import ComputeDeclaration, RasterDeclaration
from ..device.interface import ComputeKernel, Device, RasterKernel, Texture
from ..device.owned import Owned

Result = TypeVar("Result")

HostWork = Callable[[], Any]
"""needs neither the device nor its thread"""
Steps = Generator[HostWork | None, Any, None]
"""Pauses where it yields: None, or a call whose result is to be sent in, so that it may run elsewhere meanwhile."""


def compiling(device: Device, declaration: ComputeDeclaration, *flags: str) -> Generator[None, None, ComputeKernel]:
    """Returns a kernel. One that has to be compiled is so in a step of its own: software rasterizers take long, and as long once more when
    it is first run."""
    return _in_own_step(device.has_kernel(declaration, *flags), lambda: device.compute_kernel(declaration, *flags))


def compiling_raster(device: Device, declaration: RasterDeclaration, *flags: str) -> Generator[None, None, RasterKernel]:
    """`compiling` of what the rasterizer runs."""
    return _in_own_step(device.has_kernel(declaration, *flags), lambda: device.raster_kernel(declaration, *flags))


def _in_own_step(is_there: bool, kernel: Callable[[], Result]) -> Generator[None, None, Result]:
    if is_there:
        return kernel()
    yield
    compiled = kernel()
    yield
    return compiled


ALLOCATED_A_STEP = 1 << 25
"""bytes. Software rasterizers keep textures in memory, which an operating system hands out page by page: in virtual machines as slowly as
100 MB a second."""


class Allocation:
    """Textures of one owner, large ones and many, created with pauses."""

    def __init__(self, owned: Owned) -> None:
        self._owned = owned
        self._byte_count = 0

    def keeping(self, create: Callable[..., Texture], *arguments: Any) -> Generator[None, None, Texture]:
        """Returns what `create` does, after a pause where those before it were enough for a step."""
        if self._byte_count >= ALLOCATED_A_STEP:
            self._byte_count = 0
            yield
        texture = self._owned.own(create(*arguments))
        self._byte_count += texture.byte_count
        return texture


def send_step(steps: Generator[HostWork | None, Any, Any], answer: Any) -> tuple[HostWork | None, bool]:
    """A step: what is to be called and its result sent in next, and whether it was the last."""
    try:
        return steps.send(answer), False
    except StopIteration:
        return None, True


def run_steps(steps: Generator[HostWork | None, Any, Result]) -> Result:
    """To the end, at once and on this thread; what comes of it."""
    answer = None
    try:
        while True:
            host_work = steps.send(answer)
            answer = host_work() if host_work is not None else None
    except StopIteration as end:
        return end.value
