"""Neither light where surfaces touch nor shadow where they curve or are grazed, against float64 ray tracing."""

import pytest

from tests.contacts import SCENES, Measurement
from vir_addon.core.settings import Method

MVR, IVIR = Method.MVR, Method.IVIR


@pytest.mark.parametrize(
    ("name", "map_resolution_px", "method", "leak"),
    [
        ("light in a cube on a floor", 128, MVR, 0.015),
        ("light in a cube on a floor", 128, IVIR, 0.03),
        ("thin wall", 512, MVR, 0.002),
        ("thin wall", 512, IVIR, 0.015),
        ("leaning board", 512, MVR, 0.008),
        ("leaning board", 512, IVIR, 0.025),
        ("stairs", 512, MVR, 0.005),
        ("stairs", 512, IVIR, 0.015),
        ("wall on a grazed floor", 512, MVR, 0.1),
        ("wall on a grazed floor", 512, IVIR, 0.13),
    ],
)
def test_no_light_leaks_where_surfaces_touch(device, name, map_resolution_px, method, leak):
    error = Measurement(SCENES[name](), device).error(method, map_resolution_px)
    print(error)
    assert error.leak <= leak


@pytest.mark.parametrize("method", [MVR, IVIR])
@pytest.mark.parametrize(
    "name",
    ["lit room", "grazed quads", "coarse waves, flat", "coarse waves, smooth", "coarse bowl, flat", "grazed waves", "fine bowl, flat"],
)
def test_no_acne_on_what_is_lit(device, name, method):
    """Joints, curved and coarse facets, triangles smaller than texels, at a slant and grazed."""
    error = Measurement(SCENES[name](), device).error(method, 512)
    print(error)
    assert error.acne <= 0.003


@pytest.mark.parametrize(
    ("name", "method", "acne"),
    [
        ("cube on a floor", MVR, 0.001),
        ("cube on a floor", IVIR, 0.006),
        ("sphere on a floor", MVR, 0.001),
        ("sphere on a floor", IVIR, 0.03),
        ("coarse sphere, flat", MVR, 0.001),
        ("coarse sphere, flat", IVIR, 0.015),
        ("coarse sphere, smooth", MVR, 0.001),
        ("coarse sphere, smooth", IVIR, 0.004),
        ("fine sphere, flat", MVR, 0.001),
        ("fine sphere, flat", IVIR, 0.01),
    ],
)
def test_what_is_seen_edge_on_does_not_shadow_itself(device, name, method, acne):
    """A cube's side that the light grazes within a degree, and spheres where their light ends."""
    error = Measurement(SCENES[name](), device).error(method, 512)
    print(error)
    assert error.acne <= acne
