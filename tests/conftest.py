"""For all tests."""

from hypothesis import settings

# A software rasterizer on a busy machine takes as long as it takes; a slow example is no failure.
settings.register_profile("vir", deadline=None)
settings.load_profile("vir")
