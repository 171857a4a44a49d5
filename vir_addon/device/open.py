"""Opens a device by name; a backend is imported only when asked for, because not every installation has both."""

from __future__ import annotations

from ..core.errors import DeviceError
from .interface import Device

DEVICE_NAMES = ("moderngl", "gpu")


def open_device(name: str = "moderngl") -> Device:
    """'moderngl': OpenGL 4.3 in a context of its own, any thread. 'gpu': Blender's own module, on the thread that opens it.

    Raises DeviceError for an unknown name and for a device that cannot be had, and says what to install.
    """
    if name == "moderngl":
        from .moderngl_device import ModernglDevice

        return ModernglDevice()
    if name == "gpu":
        from .blender_gpu_device import BlenderGpuDevice

        return BlenderGpuDevice()
    raise DeviceError(f"unknown device {name!r}; there are {' and '.join(DEVICE_NAMES)}")
