"""Blender's objects are freed on the thread of their context, whichever thread drops what holds them."""

import gc
import threading
import weakref

import numpy as np
import pytest

from tests.device.kernels import INVOCATION_NUMBERS
from vir_addon.device.blender_gpu_device import BlenderComputeKernel
from vir_addon.device.interface import TextureFormat

FREED = []
"""threads"""


def witness():
    """Stands for one of Blender's objects; which thread frees it is noted. Not an object of Python's, whose end the collector would bring
    about itself."""
    thing = np.zeros(1)
    weakref.finalize(thing, lambda: FREED.append(threading.current_thread()))
    return thing


@pytest.fixture
def dropped(device_called):
    """The device with what is left of a failed step: holders in a circle that nobody else knows."""
    device = device_called("gpu")

    def drop():
        color, depth = (device.create_texture(4, 4, kind) for kind in (TextureFormat.R32UI, TextureFormat.DEPTH32F))
        mesh = device.upload_mesh(np.zeros((3, 3), np.float32), np.arange(3, dtype=np.int32).reshape(1, 3))
        target = device.create_target(color, depth)
        assert target.framebuffer.handle
        kernel = BlenderComputeKernel(device, INVOCATION_NUMBERS, ())
        color.handle, depth.handle, mesh.batch = (witness() for _ in range(3))
        target.framebuffer._handle = witness()
        kernel.shader = kernel.bindings.shader = witness()
        circle = [color, depth, mesh, target, kernel]
        circle.append(circle)

    gc.collect()
    gc.disable()
    FREED.clear()
    try:
        drop()
        yield device
    finally:
        gc.enable()


def test_what_another_thread_drops_waits_for_the_next_call(dropped):
    thread = threading.Thread(target=gc.collect)
    thread.start()
    thread.join()
    assert FREED == [], "freed where another context is current, or none"
    dropped.run(int)
    assert FREED.count(threading.current_thread()) == len(FREED) == 5


def test_what_the_own_thread_drops_is_freed_at_once(dropped):
    gc.collect()
    assert FREED.count(threading.current_thread()) == len(FREED) == 5
