"""Composing shader text: includes, mistakes told with file and line, and the check over all kernels. No GPU."""

from __future__ import annotations

import dataclasses
import re

import pytest

from tests.device.kernels import ADD_COUNTS, COLUMNS, ECHO, NUMBER_TRIANGLES, SHADERS
from vir_addon.core.errors import DeviceError
from vir_addon.device import check_shaders, shader_source
from vir_addon.device.declaration import ComputeDeclaration, Constant, Sampled, Stored


@pytest.fixture
def test_sources(monkeypatch):
    monkeypatch.setattr(shader_source, "shader_folder", lambda: SHADERS / "source")


@pytest.mark.usefixtures("test_sources")
def test_each_file_is_included_once_and_before_who_asks():
    assert shader_source.load("twice.glsl").splitlines() == ["in_a", "in_b", "last"]


@pytest.mark.usefixtures("test_sources")
@pytest.mark.parametrize(
    ("file_name", "message"),
    [
        ("nowhere.glsl", "shader file nowhere.glsl cannot be read: No such file"),
        ("missing_include.glsl", "shader file not_there.glsl cannot be read (included by missing_include.glsl:2)"),
        ("circle.glsl", "shader file circle.glsl includes itself through circle.glsl -> circle_back.glsl (included by circle_back.glsl:2)"),
        ("interface_in_body.glsl", "interface_in_body.glsl:3: the interface belongs in the kernel's declaration: uniform int given;"),
    ],
)
def test_mistakes_are_told_with_their_place(file_name, message):
    with pytest.raises(DeviceError, match=re.escape(message)):
        shader_source.load(file_name)


@pytest.mark.usefixtures("test_sources")
def test_lines_of_composed_text_are_found_in_their_files():
    composed = "declared\n" + shader_source.load("twice.glsl")
    assert [shader_source.describe_line(composed, "twice.glsl", number) for number in (1, 2, 3, 4)] == [
        "twice.glsl: in the declared interface: declared",
        "a.glsl:1: in_a",
        "b.glsl:2: in_b",
        "twice.glsl:4: last",
    ]
    assert shader_source.describe_line(composed, "twice.glsl", 99) == "twice.glsl: line 99 of the composed text"


def test_flags_and_shared_numbers_become_defines():
    lines = shader_source.opengl_compute(ECHO, ["SCALED"]).splitlines()
    assert "#define SCALED 1" in lines and "#define SCALE 2.5" in lines
    assert "#define SCALED 1" not in shader_source.opengl_compute(ECHO, []).splitlines()
    with pytest.raises(TypeError, match="unknown flags"):
        shader_source.opengl_compute(ECHO, ["SCALDE"])


def test_textures_are_images_where_these_are_fetched_from_faster():
    declared = ADD_COUNTS.textures["seen"], ADD_COUNTS.images["counts"]
    assert [each.texture_format for each in declared] == ["R32UI", "R32UI"]
    lines = shader_source.opengl_compute(ADD_COUNTS, []).splitlines()
    assert "uniform usampler2D seen;" in lines and not any("imageLoad(name" in line for line in lines)
    lines = shader_source.opengl_compute(ADD_COUNTS, [], for_software=True).splitlines()
    assert "layout(r32ui, binding = 1) uniform readonly uimage2D seen;" in lines and not any("sampler2D" in line for line in lines)
    assert "#define texelFetch(name, place, level) imageLoad(name, place)" in lines
    assert [Sampled("usampler2D", "-", channel_count=2).texture_format, Sampled("sampler2D", "-").texture_format] == ["RG32UI", "RGBA32F"]


def test_rows_that_are_named_are_looked_up_once():
    named = ECHO.tables["second_table"]
    declared = dataclasses.replace(
        ECHO, tables={"plain": ECHO.tables["first_table"], "named": dataclasses.replace(named, has_named_rows=True)}
    )
    added = {"vec4 named_rows[2] = vec4[](named[0], named[1]);", "#define named named_rows"}
    assert added <= set(shader_source.opengl_compute(declared, [], for_software=True).splitlines())
    assert not added & set(shader_source.opengl_compute(declared, []).splitlines())
    assert "plain_rows" not in shader_source.opengl_compute(declared, [], for_software=True)


def test_named_rows_are_named_by_number():
    """An array that is asked for by anything else could not stay in registers."""
    tables = {
        (name, body)
        for each in check_shaders.declarations()
        for name in each.tables
        for body in check_shaders.bodies(each)
        if each.tables[name].has_named_rows
    }
    assert any("face[6]" in body for _, body in tables)
    for name, body in tables:
        assert not re.search(rf"\b{name}\[(?!\d+\])", body)


def test_stages_agree_on_what_passes_between_them():
    vertex, fragment = shader_source.opengl_raster(NUMBER_TRIANGLES, [])
    assert "flat out int instance_number;" in vertex.splitlines()
    assert "flat in int instance_number;" in fragment.splitlines()
    assert "out uint number;" in fragment.splitlines()

    _, geometry, fragment = (text.splitlines() for text in shader_source.opengl_geometry(COLUMNS, []))
    assert {"flat out int column_number;", "layout(triangle_strip, max_vertices = 4) out;"} <= set(geometry)
    assert {"flat in int column_number;", "out uint number;"} <= set(fragment)
    assert "layout(r32ui, binding = 0) uniform uimage2D counts;" in set(geometry) & set(fragment)


@pytest.mark.parametrize(
    ("defined", "left"),
    [
        ([], ["always", "not_left", "not_right", "many", "few"]),
        (["LEFT"], ["always", "left", "not_right", "many", "few"]),
        (["LEFT", "RIGHT"], ["always", "left", "many", "few"]),
    ],
)
def test_conditions_on_names_are_followed_and_expressions_are_not(defined, left):
    text = (SHADERS / "source" / "choices.glsl").read_text()
    assert list(check_shaders.active_lines(text, defined)) == left


def test_check_finds_what_is_unused_and_what_is_undeclared():
    declaration = ComputeDeclaration(
        name="strays",
        text="for a test",
        source=str(SHADERS / "source" / "strays.comp.glsl"),
        images={"numbers": Stored("R32UI", "write", "-"), "idle": Stored("R32UI", "write", "-")},
        constants={"lazy": Constant("int", "-")},
        flags={"UNASKED": "-"},
        defines={"FORGOTTEN": 0},
    )
    others = frozenset({"views", "declared", "hull", "point_count", "numbers"})
    problems, variant_count = check_shaders.check(declaration, others)
    assert variant_count == 2
    assert problems == [
        "nothing uses FORGOTTEN",
        "nothing uses idle",
        "nothing uses lazy",
        "no condition asks for the flag UNASKED",
        "with flags []: point_count is used but not declared",
        "with flags ['UNASKED']: point_count is used but not declared",
    ]


@pytest.mark.slow  # `make check` does the same
def test_every_kernel_of_the_passes_is_well(capsys):
    assert check_shaders.main() == 0, capsys.readouterr().out
    told = capsys.readouterr().out
    assert all(f"{name}: " in told for name in ("visibility", "splat_points", "resolve"))


def test_check_fails_for_a_kernel_that_is_not_well(monkeypatch, capsys):
    broken = ComputeDeclaration(name="broken", text="-", source="nowhere.glsl")
    strays = ComputeDeclaration(name="broken", text="-", source=str(SHADERS / "source" / "strays.comp.glsl"))
    monkeypatch.setattr(check_shaders, "declarations", lambda: [broken, strays])
    assert check_shaders.main() == 1
    lines = capsys.readouterr().out.splitlines()
    assert "nowhere.glsl cannot be read" in lines[0]
    assert "another kernel has the same name" in lines[1] and "no kernel has the flag MISSPELT" in lines[1]
