"""Declarations refuse what no device could bind."""

import numpy as np
import pytest

from vir_addon.device.declaration import ComputeDeclaration, Constant, Sampled, Stored, Table


def declaration(**parts):
    return ComputeDeclaration(name="thing", text="for a test", source="thing.comp.glsl", **parts)


BOUND = declaration(
    textures={"cloud": Sampled("sampler2D", "points")},
    images={"maps": Stored("R32UI", "atomic", "depth")},
    constants={"count": Constant("int", "points")},
    tables={"views": Table(2, "views")},
    flags={"FAST": "quicker"},
)


def test_every_name_must_be_bound_and_none_besides():
    BOUND.check_bindings({"cloud", "maps", "count", "views"})
    with pytest.raises(TypeError, match=r"kernel thing: missing \['cloud', 'views'\], unknown \['clouds'\]"):
        BOUND.check_bindings(["clouds", "maps", "count"])
    with pytest.raises(TypeError, match=r"kernel thing: unknown \['extra'\]$"):
        BOUND.check_bindings(["cloud", "maps", "count", "views", "extra"])


def test_unknown_flag_is_told_with_those_there_are():
    BOUND.check_flags(["FAST"])
    with pytest.raises(TypeError, match=r"unknown flags \['SLOW'\], it has \['FAST'\]"):
        BOUND.check_flags(["FAST", "SLOW"])


def test_constants_fill_what_is_guaranteed_and_no_more():
    full = {"a": Constant("mat4", "-"), "b": Constant("mat4", "-")}
    assert declaration(constants=full).binding_names == {"a", "b"}
    with pytest.raises(ValueError, match="kernel thing: 132 bytes of constants, 128 are guaranteed; use a table"):
        declaration(constants={**full, "c": Constant("float", "-")})


def test_tables_are_padded_with_zeros():
    packed = np.frombuffer(Table(3, "-").pack("rows", [[1, 2, 3, 4], [5, 6, 7, 8]]), np.float32)
    np.testing.assert_array_equal(packed.reshape(3, 4), [[1, 2, 3, 4], [5, 6, 7, 8], [0, 0, 0, 0]])


@pytest.mark.parametrize("shape", [(4, 4), (2, 3), (4,), (1, 2, 4)])
def test_tables_refuse_other_shapes(shape):
    with pytest.raises(TypeError, match="table rows takes at most 3 rows of 4 floats"):
        Table(3, "-").pack("rows", np.zeros(shape))
