"""One device for the tests of the core; tests/device holds both devices to the same pictures."""

import pytest

from vir_addon.device.open import open_device


@pytest.fixture(scope="session")
def device():
    opened = open_device("moderngl")
    yield opened
    opened.close()
