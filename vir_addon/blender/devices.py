"""Devices that stay open between renders: opening one and compiling its kernels takes longer than a small picture.

Nothing is opened before someone renders: in background Blender's own module must not be touched before that.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, TypeVar

import bpy

from ..core.errors import DeviceError
from ..device.interface import Device
from ..device.open import open_device

Result = TypeVar("Result")

MAIN_THREAD_WAIT_S = 10.0
"""for Blender's main thread to begin what it was asked for; it does not while it waits for the render to end, on quitting for example"""

_devices: dict[str, Device] = {}
_lock = threading.Lock()


def device_name(choice: str) -> str:
    """'AUTO', 'MODERNGL' or 'GPU' of the settings -> the name of the device, which is then open. Raises DeviceError."""
    if choice == "MODERNGL":
        return get_device("moderngl").name
    if choice == "GPU":
        return on_main_thread(get_device, "gpu").name
    try:
        return get_device("moderngl").name
    except DeviceError as without_opengl:
        try:
            return on_main_thread(get_device, "gpu").name
        except DeviceError as without_blender:
            raise DeviceError(f"no device: {without_opengl}. {without_blender}") from without_blender


def get_device(name: str) -> Device:
    """Open it on the first call. Raises DeviceError."""
    with _lock:
        if name not in _devices:
            _devices[name] = open_device(name)
        return _devices[name]


def is_bound_to_main_thread(name: str) -> bool:
    return name == "gpu"


def close_devices() -> None:
    """What they hold goes with them."""
    with _lock:
        while _devices:
            _devices.popitem()[1].close()


def on_main_thread(function: Callable[..., Result], *arguments: Any) -> Result:
    """Call it on Blender's main thread and wait for its result. Exceptions arrive here.

    Raises DeviceError if the main thread does not get round to it: it may be waiting for the very thread that calls.
    """
    if threading.current_thread() is threading.main_thread():
        return function(*arguments)
    begun, done = threading.Event(), threading.Event()
    outcome: list[Any] = [None, None]

    def call() -> None:
        begun.set()
        try:
            outcome[0] = function(*arguments)
        except BaseException as error:  # belongs to the thread that waits
            outcome[1] = error
        finally:
            done.set()

    bpy.app.timers.register(call, first_interval=0.0)
    if not begun.wait(MAIN_THREAD_WAIT_S):
        if bpy.app.timers.is_registered(call):
            bpy.app.timers.unregister(call)
        raise DeviceError("Blender did not hand its graphics over to the passes; choose the device OpenGL for renders with F12")
    done.wait()
    if outcome[1] is not None:
        raise outcome[1]
    return outcome[0]
