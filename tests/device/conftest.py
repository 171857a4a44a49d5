"""Both devices, each opened once and kept open beside the other, as in a Blender that uses both."""

import pytest

from vir_addon.core.errors import DeviceError
from vir_addon.device.open import DEVICE_NAMES, open_device


@pytest.fixture(scope="session")
def opened():
    devices = {}
    yield devices
    for device in devices.values():
        device.close()


@pytest.fixture(scope="session")
def device_called(opened):
    """device_called("gpu") -> the device, or the test is skipped where this Blender has none."""

    def called(name):
        if name == "gpu":
            bpy = pytest.importorskip("bpy")
            if bpy.app.version < (5, 2):
                pytest.skip("before 5.2 Blender has no GPU in background")
        if name not in opened:
            try:
                opened[name] = open_device(name)
            except DeviceError as error:
                pytest.fail(str(error))
        return opened[name]

    return called


@pytest.fixture(scope="session", params=DEVICE_NAMES)
def device(request, device_called):
    return device_called(request.param)


@pytest.fixture(scope="session")
def both(device_called):
    return [device_called(name) for name in DEVICE_NAMES]


LONG_ON_BOTH_DEVICES = (
    "test_checkered_card",
    "test_checkered_card_in_splatted_maps",
    "test_other_methods_draw_the_same_cut_outs",
    "test_panes_let_their_share_through",
)
"""what belongs to the first device's passes; test_devices_draw_the_same_cut_outs holds the second one to it"""


def pytest_collection_modifyitems(items):
    """CI has twenty minutes."""
    for item in items:
        if item.originalname in LONG_ON_BOTH_DEVICES and "[gpu" in item.name:
            item.add_marker(pytest.mark.slow)
