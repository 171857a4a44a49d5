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
        # 0.010 if a centre that sees the floor told of all of its texel
        ("leaning board", 512, MVR, 0.001),
        ("leaning board", 512, IVIR, 0.025),
        ("stairs", 512, MVR, 0.005),
        ("stairs", 512, IVIR, 0.015),
        # the light is within a degree of the floor, where what stands within 8 footprints may be lost: measured 0.069 and 0.021
        ("wall on a grazed floor", 512, MVR, 0.08),
        ("wall on a grazed floor", 512, IVIR, 0.03),
        # 0.099 if far points above the receiver's plane were allowed what near ones are
        ("bumpy sphere at its terminator", 128, MVR, 0.07),
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


def test_sheets_that_hover_have_no_feet(device):
    """0.015 of acne if any plane above the receiver's were taken for a wall."""
    error = Measurement(SCENES["sheets on a floor"](), device).error(MVR, 512)
    print(error)
    assert error.acne <= 0.001


def test_points_tell_no_planes(device):
    """0.077 if what vwss splats were taken for rasterized."""
    error = Measurement(SCENES["stairs"](), device).error(Method.VWSS, 256)
    print(error)
    assert error.acne <= 0.055


def test_ground_of_folds_is_lit(device):
    """A scan's facets, two texels wide: more tolerance would let light through contacts, less has the ground speckled."""
    measurement = Measurement(SCENES["rough ground"](), device)
    mvr, ivir = (measurement.error(method, 40) for method in (MVR, IVIR))
    print(mvr, ivir)
    assert mvr.acne <= 0.07
    assert ivir.acne <= 0.04


@pytest.mark.parametrize(
    ("name", "of_mvr", "of_ivir"),
    [
        ("cube on a floor", 0.001, 0.006),
        ("sphere on a floor", 0.001, 0.003),
        ("coarse sphere, flat", 0.001, 0.01),
        ("coarse sphere, smooth", 0.001, 0.004),
        ("fine sphere, flat", 0.001, 0.01),
    ],
)
def test_what_is_seen_edge_on_does_not_shadow_itself(device, name, of_mvr, of_ivir):
    """A cube's side that the light grazes within a degree, and spheres where their light ends."""
    measurement = Measurement(SCENES[name](), device)
    mvr, ivir = (measurement.error(method, 512) for method in (MVR, IVIR))
    print(mvr, ivir)
    assert mvr.acne <= of_mvr
    assert ivir.acne <= of_ivir
