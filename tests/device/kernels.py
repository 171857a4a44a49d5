"""Declarations of the kernels that only tests run; their bodies are in shaders/."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from vir_addon.core.passes.points import SAMPLING_CONSTANTS, SAMPLING_TABLES
from vir_addon.core.passes.scene_data import SCENE_DEFINES, SCENE_TEXTURES
from vir_addon.core.passes.surface_data import REFLECTANCE_DEFINES, SURFACE_DEFINES, SURFACE_FLAGS, SURFACE_TEXTURES, WORLD_FLAGS
from vir_addon.device.declaration import (
    ComputeDeclaration,
    Constant,
    GeometryDeclaration,
    RasterDeclaration,
    Sampled,
    Stored,
    Table,
    Varying,
)

SHADERS = Path(__file__).resolve().parent / "shaders"


def compute(name: str, **parts: Any) -> ComputeDeclaration:
    return ComputeDeclaration(name=f"test_{name}", text="for a test", source=str(SHADERS / f"{name}.comp.glsl"), **parts)


INVOCATION_NUMBERS = compute(
    "invocation_numbers",
    local_size=(4, 1, 1),
    images={"numbers": Stored("R32UI", "write", "each texel's own number + 1")},
    constants={"invocation_count": Constant("int", "numbers to write")},
)
COPY_FLOATS = compute(
    "copy_floats",
    textures={"given": Sampled("sampler2D", "anything")},
    images={"copied": Stored("RGBA32F", "write", "the same")},
)
ATOMIC_MIN = compute(
    "atomic_min",
    images={"lowest": Stored("R32UI", "atomic", "lowest number tried in each texel")},
    constants={"invocation_count": Constant("int", "numbers to try"), "width": Constant("int", "texels")},
)
ADD_COUNTS = compute(
    "add_counts",
    local_size=(8, 8, 1),
    textures={"seen": Sampled("usampler2D", "what is added")},
    images={"counts": Stored("R32UI", "read_write", "running sums")},
)
ECHO = compute(
    "echo",
    local_size=(1, 1, 1),
    images={"heard": Stored("RGBA32F", "write", "what arrived")},
    constants={
        "an_int": Constant("int", "-"),
        "a_float": Constant("float", "-"),
        "a_vec2": Constant("vec2", "-"),
        "a_vec3": Constant("vec3", "-"),
        "a_vec4": Constant("vec4", "-"),
        "a_mat4": Constant("mat4", "-"),
        "unused": Constant("int", "the compiler drops it, which is no error"),
    },
    tables={"first_table": Table(3, "-"), "second_table": Table(2, "-")},
    flags={"SCALED": "writes the shared number"},
    defines={"SCALE": 2.5},
)
REFUSED = compute("refused")
NUMBER_TRIANGLES = RasterDeclaration(
    name="test_number_triangles",
    text="instance * 10 + triangle + 1",
    vertex_source=str(SHADERS / "number_triangles.vert.glsl"),
    fragment_source=str(SHADERS / "number_triangles.frag.glsl"),
    constants={"clip_from_object": Constant("mat4", "-"), "first_instance": Constant("int", "number of a draw's first instance")},
    tables={"offsets": Table(4, "clip space offset of every instance")},
    varyings={"instance_number": Varying("int", "flat", "-")},
    output_name="number",
    output_type="uint",
)

NUMBER_BY_DEPTH = replace(
    NUMBER_TRIANGLES,
    name="test_number_by_depth",
    text="the same; what has the lowest instance number is nearest",
    fragment_source=str(SHADERS / "number_by_depth.frag.glsl"),
    writes_depth=True,
)
COLUMNS = GeometryDeclaration(
    name="test_columns",
    text="a column of the picture for every number",
    geometry_source=str(SHADERS / "columns.geom.glsl"),
    fragment_source=str(SHADERS / "columns.frag.glsl"),
    most_vertices=4,
    images={"counts": Stored("R32UI", "atomic", "texel 0: columns, 1: fragments")},
    constants={"column_count": Constant("int", "-")},
    varyings={"column_number": Varying("int", "flat", "-")},
    output_name="number",
    output_type="uint",
)
DIRECTIONS = compute(
    "directions",
    textures={"directions": Sampled("sampler2D", "unit vectors, and packed by the host")},
    images={"unpacked": Stored("RGBA32F", "write", "two texels a direction")},
    constants={"direction_count": Constant("int", "-")},
)
HASHES = compute(
    "hashes",
    images={
        "integer_hashes": Stored("R32UI", "write", "of 0, 1, 2, ..."),
        "position_hashes": Stored("R32UI", "write", "of a lattice"),
        "unit_floats": Stored("RGBA32F", "write", "of integer_hashes"),
    },
    constants={"hash_count": Constant("int", "-")},
)
SHADOW_VOLUMES = compute(
    "shadow_volumes",
    textures={"balls": Sampled("sampler2D", "centre and radius")},
    images={"distances": Stored("RGBA32F", "write", "a texel a ball")},
    constants={"ball_count": Constant("int", "-"), **SAMPLING_CONSTANTS},
    tables=SAMPLING_TABLES,
    defines={"EYE_DENSITY": 1},
)
ENLARGED_FACES = compute(
    "enlarged_faces",
    textures={"triangle_corners": Sampled("sampler2D", "three texels a triangle")},
    images={"faces": Stored("R32UI", "write", "a texel a triangle")},
    constants={"triangle_count": Constant("int", "-")},
)
TRIANGLE_FUNCTIONS = compute(
    "triangle_functions",
    textures={
        "triangle_corners": Sampled("sampler2D", "three texels a triangle"),
        "queries": Sampled("sampler2D", "two texels a triangle: a point; a rectangle in its plane, centre and half its size"),
    },
    images={"answers": Stored("RGBA32F", "write", "five texels a triangle")},
    constants={**SAMPLING_CONSTANTS, "triangle_count": Constant("int", "-")},
    tables=SAMPLING_TABLES,
)
MATERIAL_FUNCTIONS = compute(
    "material_functions",
    textures={
        **SCENE_TEXTURES,
        **SURFACE_TEXTURES,
        "queries": Sampled(
            "sampler2D",
            "four texels: instance, triangle and two barycentric weights; to the eye; to the light and the least width; geometric normal",
        ),
    },
    images={"answers": Stored("RGBA32F", "write", "six texels a query")},
    constants={"query_count": Constant("int", "-")},
    flags={**SURFACE_FLAGS, **WORLD_FLAGS},
    defines={**SCENE_DEFINES, **SURFACE_DEFINES, **REFLECTANCE_DEFINES},
)
