"""Devices that stay open between renders: opening one and compiling its kernels takes longer than a small picture.

Nothing is opened before someone renders: in background Blender's own module must not be touched before that.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable, Iterator
from typing import Any, TypeVar, cast

import bpy

from ..core.errors import DeviceError
from ..device.blender_objects import free_put_by
from ..device.interface import Device
from ..device.open import open_device

Result = TypeVar("Result")

MAIN_THREAD_WAIT_S = 300.0
"""for Blender's main thread to do what it was asked for. It may be busy drawing, or wait for the very render that asks"""
IDLE_S = 0.02
"""between looks whether another thread asks for something"""

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


def drop_device(device: Device) -> None:
    """It has failed: the next call opens another. Not closed, as others may still hold what is on it."""
    with _lock:
        for name in [name for name, each in _devices.items() if each is device]:
            del _devices[name]


def is_bound_to_main_thread(name: str) -> bool:
    return name == "gpu"


def close_devices() -> None:
    """What they hold goes with them."""
    with _lock:
        while _devices:
            _devices.popitem()[1].close()
    free_put_by()


def register() -> None:
    """Called on the main thread: where there are windows, begin to serve what other threads ask it for."""
    _closed.clear()
    if hasattr(bpy.app.handlers, "exit_pre"):
        bpy.app.handlers.exit_pre.append(refuse_calls)
    if not bpy.app.background:
        bpy.app.timers.register(_serve_calls, persistent=True)


def unregister() -> None:
    if bpy.app.timers.is_registered(_serve_calls):
        bpy.app.timers.unregister(_serve_calls)
    if hasattr(bpy.app.handlers, "exit_pre"):
        bpy.app.handlers.exit_pre.remove(refuse_calls)
    refuse_calls()
    close_devices()


class _Call:
    """Of a function on the main thread, asked for by another."""

    def __init__(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
        self._function, self._arguments = function, arguments
        self._begin_lock = threading.Lock()
        self._has_begun = False
        self.done = threading.Event()
        self.result: Any = None
        self.error: BaseException | None = None

    def _begin(self) -> bool:
        with self._begin_lock:
            begins, self._has_begun = not self._has_begun, True
        return begins

    def run(self) -> None:
        if self._begin():
            try:
                self.result = self._function(*self._arguments)
            except BaseException as error:  # belongs to the thread that waits
                self.error = error
            finally:
                self.done.set()

    def refuse(self) -> None:
        """Unless it has begun."""
        if self._begin():
            self.error = DeviceError("Blender did not hand its graphics over to the passes; choose the device OpenGL for renders with F12")
            self.done.set()


_calls: queue.SimpleQueue[_Call] = queue.SimpleQueue()
_closed = threading.Event()
"""the main thread will serve no more calls"""


def on_main_thread(function: Callable[..., Result], *arguments: Any) -> Result:
    """Call it on Blender's main thread and wait for its result. Exceptions arrive here.

    Raises DeviceError if the main thread does not get round to it: it may be waiting for the very thread that calls.
    """
    if threading.current_thread() is threading.main_thread():
        return function(*arguments)
    call = _Call(function, arguments)
    _calls.put(call)
    if _closed.is_set() or not call.done.wait(MAIN_THREAD_WAIT_S):
        call.refuse()
    call.done.wait()
    if call.error is not None:
        raise call.error
    return cast(Result, call.result)


def ask_main_thread(function: Callable[..., Any], *arguments: Any) -> None:
    """Call it on Blender's main thread when that gets round to it, at once if this is the one."""
    call = _Call(function, arguments)
    if threading.current_thread() is threading.main_thread():
        call.run()
    else:
        _calls.put(call)


@bpy.app.handlers.persistent
def refuse_calls(*_: Any) -> None:
    """Blender's handler, before it quits: the main thread will wait for renders to end, which must not wait for it."""
    if globals().get("_closed") is None:  # Blender as a Python module quits when Python has emptied this one
        return
    _closed.set()
    for call in _waiting_calls():
        call.refuse()


def _waiting_calls() -> Iterator[_Call]:
    with contextlib.suppress(queue.Empty):
        while True:
            yield _calls.get_nowait()


def _serve_calls() -> float:
    """Blender's timer. One for all calls, as registering another is safe on the main thread only."""
    interval_s = IDLE_S
    for call in _waiting_calls():
        call.run()
        interval_s = 0.0  # whoever asked will ask again
    return interval_s
