"""What reflectors show: rays leave what the eye sees, meet surfaces in the reflectors' maps, and leave these again.

Where rays hit is a G-buffer of the eye's layout, so whatever looks lights up for the eye looks them up there.
"""

from __future__ import annotations

from ...device.declaration import ComputeDeclaration, Constant, Sampled, Stored, Table
from ..settings import ADAPTIVE_STEP
from .emitters import EMITTER_CONSTANTS, EMITTER_TEXTURES
from .reflection_maps import FURTHER_MAPS, HEADER_DEFINE, MAP_LEVELS, MAP_TEXTURES, OWN_CUBES
from .resolve import DELIVERED_FLAGS, RESOLVE
from .scene_data import SCENE_DEFINES, SCENE_TEXTURES
from .shadow_maps import FACE_TABLE, MAX_BATCH_VIEWS
from .surface_data import LUMINANCE_DEFINES, REFLECTANCE_DEFINES, SURFACE_DEFINES, SURFACE_FLAGS, SURFACE_TEXTURES, WORLD_FLAGS
from .tiles import SIZE_CONSTANTS, TILE_DEFINES, TILE_PX, TILE_TEXTURES, WALK_CONSTANTS

MAX_STEPS = 1024
"""Cells that a ray may cross: several times what any needs in a map of 1024 texels; a GPU must not hang."""
NO_RAY, REFLECTED_NOTHING, REFLECTED_SURFACE, REFLECTED_BY_DIRECTION, REFLECTED_OUT_OF_VIEW, REFLECTED_BEHIND = range(6)
"""What became of a pixel's ray: there is none, it left the scene, it met a surface, it did behind something that hid it from the map's
centre, and this is what the map shows in its direction, it left what the maps show, or it met a surface after it had passed behind
something, where what the map does not show may be nearer"""
MAP_NUMBERS_DEFINE = {"MAP_NUMBERS": 4096}
"""more than there are maps"""
MARCH_DEFINES = {
    "REFLECTED_NOTHING": REFLECTED_NOTHING,
    "REFLECTED_SURFACE": REFLECTED_SURFACE,
    "REFLECTED_BY_DIRECTION": REFLECTED_BY_DIRECTION,
    "REFLECTED_OUT_OF_VIEW": REFLECTED_OUT_OF_VIEW,
    "REFLECTED_BEHIND": REFLECTED_BEHIND,
    "MAP_LEVELS": MAP_LEVELS,
    "MAX_STEPS": MAX_STEPS,
    **HEADER_DEFINE,
    "FURTHER_MAPS": FURTHER_MAPS,
    "OWN_CUBES": OWN_CUBES,
    **MAP_NUMBERS_DEFINE,
}
BY_DIRECTION_FLAG = {"BY_DIRECTION": "look maps up by direction alone"}

POSITIONS = "position (world space) and instance number, -1 for the background"
NORMALS = "geometric normal (world space, towards where it is seen from) and packed shading normal; of hits: by their normal maps"
SURFACES = "triangle number, weights of its second and third corner; of hits: what became of the ray"
ORIGINS = "where the ray begins (world space) and number of the map that it is followed through, -1 where there is none"
DIRECTIONS = "unit direction of the ray and how far along it nothing is met"
THROUGHPUTS = (
    "what the light that the ray finds is multiplied by, and its other maps: 1 + the number of that beside the first, 0 none, and "
    "MAP_NUMBERS times the same of that of the reflector itself"
)
SCATTERINGS = "radiance towards the eye for an irradiance of 1, of the diffuse lobe; the gloss at grazing angles, negative of metal"
GLOSSES = "reflectance of the gloss straight on, what the light is multiplied by included; its GGX width, negative of reflectors"
INSTANCE_MAPS = "of every instance: its maps for what the eye sees, for rays from others, beside the first and of itself; -1: none"
LEAST_LIT_WIDTH = 0.02
"""GGX alpha that lobes have at least where lights are looked up: what reflects a light without size in a narrower one is a spark"""
RADIANCES = "light that the picture's reflections bring in this round, what they are multiplied by included"
COLORS = "what reflected light is multiplied by at the first reflector, and whether the pixel shows one"
SETTLED = "after how many rays the pixel settled, 0: it has not; variance of what these found, or the last that were looked at"
ADAPTIVE_FLAG = {"ADAPTIVE": "pixels have no more rays than it takes"}
BOUNCE = Constant("int", "how often what the eye sees has been reflected already")

SEEN = {
    "positions": Sampled("sampler2D", POSITIONS),
    "normals": Sampled("sampler2D", NORMALS),
    "surfaces": Sampled("sampler2D", SURFACES),
}

REFLECT = ComputeDeclaration(
    name="reflect",
    text="reflected rays, and what the light that they find is multiplied by",
    source="reflect.comp.glsl",
    is_long=True,
    local_size=(TILE_PX, TILE_PX, 1),
    textures={
        **SCENE_TEXTURES,
        **SURFACE_TEXTURES,
        **SEEN,
        "corner_normals": Sampled("sampler2D", "three packed normals of every triangle of meshes that need them"),
        "instance_maps": Sampled("sampler2D", INSTANCE_MAPS),
        "settled": Sampled("sampler2D", SETTLED),
        **TILE_TEXTURES,
    },
    images={
        "ray_origins": Stored("RGBA32F", "read_write", ORIGINS),
        "ray_directions": Stored("RGBA32F", "read_write", DIRECTIONS),
        "throughputs": Stored("RGBA32F", "read_write", THROUGHPUTS),
        "colors": Stored("RGBA32F", "write", COLORS),
    },
    constants={
        **SIZE_CONSTANTS,
        **WALK_CONSTANTS,
        "bounce": BOUNCE,
        "sample_x": Constant("float", "of a rough surface's facets, in the unit square"),
        "sample_y": Constant("float", "the same in y"),
        "place_x": Constant("float", "of the ray with FILTERED, from where the eye's sample is, pixels"),
        "place_y": Constant("float", "the same in y"),
        "share": Constant("float", "what the light is multiplied by besides: more than 1 where fewer rays go on than come"),
    },
    tables={"eye": Table(5, "as of SURFACE; with FROM_EYE")},
    flags={
        **SURFACE_FLAGS,
        **ADAPTIVE_FLAG,
        "FROM_EYE": "reflects what the eye sees, not what rays met",
        "FILTERED": "from another place in the pixel than the eye's sample, by the normal's gradient there",
    },
    defines={**SCENE_DEFINES, **TILE_DEFINES, **SURFACE_DEFINES, **REFLECTANCE_DEFINES, **MAP_NUMBERS_DEFINE},
)

MARCH_REFLECTIONS = ComputeDeclaration(
    name="march_reflections",
    text="follows rays through maps to the surfaces that they meet",
    source="march_reflections.comp.glsl",
    is_long=True,
    local_size=(TILE_PX, TILE_PX, 1),
    textures={
        **SCENE_TEXTURES,
        "corner_normals": Sampled("sampler2D", "three packed normals of every triangle of meshes that need them"),
        **MAP_TEXTURES,
        "ray_origins": Sampled("sampler2D", ORIGINS),
        "ray_directions": Sampled("sampler2D", DIRECTIONS),
        "throughputs": Sampled("sampler2D", THROUGHPUTS),
        **TILE_TEXTURES,
    },
    images={
        "positions": Stored("RGBA32F", "write", POSITIONS),
        "normals": Stored("RGBA32F", "write", NORMALS),
        "surfaces": Stored("RGBA32F", "write", SURFACES),
    },
    constants={**SIZE_CONSTANTS, **WALK_CONSTANTS},
    flags=BY_DIRECTION_FLAG,
    defines={**SCENE_DEFINES, **TILE_DEFINES, **MARCH_DEFINES, "NO_RAY": NO_RAY},
)

HIT_MATERIALS = ComputeDeclaration(
    name="hit_materials",
    text="what the surfaces that rays met emit, and what they make of light",
    source="hit_materials.comp.glsl",
    is_long=True,
    local_size=(TILE_PX, TILE_PX, 1),
    textures={
        **SCENE_TEXTURES,
        **SURFACE_TEXTURES,
        "positions": SEEN["positions"],
        "surfaces": SEEN["surfaces"],
        "corner_normals": Sampled("sampler2D", "three packed normals of every triangle of meshes that need them"),
        "ray_directions": Sampled("sampler2D", DIRECTIONS),
        "throughputs": Sampled("sampler2D", THROUGHPUTS),
        "instance_maps": Sampled("sampler2D", INSTANCE_MAPS),
        **TILE_TEXTURES,
    },
    images={
        "normals": Stored("RGBA32F", "read_write", NORMALS),
        "scatterings": Stored("RGBA32F", "write", SCATTERINGS),
        "glosses": Stored("RGBA32F", "write", GLOSSES),
        "radiances": Stored("RGBA32F", "read_write", RADIANCES),
    },
    constants={**SIZE_CONSTANTS, **WALK_CONSTANTS, "bounce": BOUNCE},
    flags={**SURFACE_FLAGS, **WORLD_FLAGS},
    defines={
        **SCENE_DEFINES,
        **TILE_DEFINES,
        **SURFACE_DEFINES,
        **REFLECTANCE_DEFINES,
        "NO_RAY": NO_RAY,
        "REFLECTED_NOTHING": REFLECTED_NOTHING,
        "REFLECTED_OUT_OF_VIEW": REFLECTED_OUT_OF_VIEW,
    },
)

LIGHT_HITS = ComputeDeclaration(
    name="light_hits",
    text="adds what a light brings to the surfaces that rays met",
    source="light_hits.comp.glsl",
    local_size=(TILE_PX, TILE_PX, 1),
    textures={
        "positions": SEEN["positions"],
        "normals": SEEN["normals"],
        "seen_from": Sampled("sampler2D", "positions of where the rays began"),
        "scatterings": Sampled("sampler2D", SCATTERINGS),
        "glosses": Sampled("sampler2D", GLOSSES),
        "batch_sums": Sampled("sampler2D", "x: light that arrives, as RESOLVE sums it"),
        **TILE_TEXTURES,
    },
    images={"radiances": Stored("RGBA32F", "read_write", RADIANCES)},
    constants={
        **SIZE_CONSTANTS,
        **WALK_CONSTANTS,
        "light_rgb": Constant("vec3", "irradiance for a sum of 1"),
        "point_count": Constant("int", "points of the light"),
        "point_reach": Constant("float", "radius of what each of all the light's points stands for, metres; suns: at a metre"),
    },
    tables={
        "face": FACE_TABLE,
        "lamp": Table(4, "the light's shape, as of lib/lamp.glsl"),
        "light_points": Table(MAX_BATCH_VIEWS, "points of the light (face space; suns: unit directions of rays) and what each counts"),
    },
    flags={name: RESOLVE.flags[name] for name in DELIVERED_FLAGS},
    defines={**TILE_DEFINES, "LEAST_LIT_WIDTH": LEAST_LIT_WIDTH},
)

_AROUND_TEXTURES = {
    **SCENE_TEXTURES,
    **SURFACE_TEXTURES,
    **MAP_TEXTURES,
    **EMITTER_TEXTURES,
    "positions": SEEN["positions"],
    "normals": SEEN["normals"],
    "ray_origins": Sampled("sampler2D", ORIGINS),
    "ray_directions": Sampled("sampler2D", DIRECTIONS),
    "throughputs": Sampled("sampler2D", THROUGHPUTS),
    "scatterings": Sampled("sampler2D", SCATTERINGS),
    "glosses": Sampled("sampler2D", GLOSSES),
    "instance_maps": Sampled("sampler2D", INSTANCE_MAPS),
    **TILE_TEXTURES,
}
_AROUND_CONSTANTS = {
    **SIZE_CONSTANTS,
    **WALK_CONSTANTS,
    "bounce": BOUNCE,
    "is_last": Constant("int", "1: no ray goes on from what was met, whatever it is"),
    "sample_x": Constant("float", "of directions or places, in the unit square"),
    "sample_y": Constant("float", "the same in y"),
}
_AROUND_DEFINES = {
    **SCENE_DEFINES,
    **TILE_DEFINES,
    **SURFACE_DEFINES,
    **REFLECTANCE_DEFINES,
    **MARCH_DEFINES,
    "LEAST_LIT_WIDTH": LEAST_LIT_WIDTH,
}
LIGHT_BY_SURROUNDINGS = ComputeDeclaration(
    name="light_by_surroundings",
    text="adds what the world and surfaces that shine bring to those that rays met, along directions of their lobes",
    source="light_by_surroundings.comp.glsl",
    is_long=True,
    local_size=(TILE_PX, TILE_PX, 1),
    textures=_AROUND_TEXTURES,
    images={"radiances": Stored("RGBA32F", "read_write", RADIANCES)},
    constants=_AROUND_CONSTANTS,
    flags={**SURFACE_FLAGS, **WORLD_FLAGS, **BY_DIRECTION_FLAG, "EMISSION": "some surface shines"},
    defines=_AROUND_DEFINES,
)

LIGHT_BY_EMITTERS = ComputeDeclaration(
    name="light_by_emitters",
    text="adds what surfaces that shine bring to those that rays met, from places drawn on them",
    source="light_by_emitters.comp.glsl",
    is_long=True,
    local_size=(TILE_PX, TILE_PX, 1),
    textures=_AROUND_TEXTURES,
    images={"radiances": Stored("RGBA32F", "read_write", RADIANCES)},
    constants={**_AROUND_CONSTANTS, **EMITTER_CONSTANTS},
    flags=SURFACE_FLAGS,
    defines=_AROUND_DEFINES,
)

ADD_REFLECTIONS = ComputeDeclaration(
    name="add_reflections",
    text="adds a round to the sums of the reflection passes",
    source="add_reflections.comp.glsl",
    local_size=(TILE_PX, TILE_PX, 1),
    textures={"radiances": Sampled("sampler2D", RADIANCES), "colors": Sampled("sampler2D", COLORS), **TILE_TEXTURES},
    images={
        "radiance_sums": Stored("RGBA32F", "read_write", "sums over rounds of radiance and of its squared luminance"),
        "color_sums": Stored("RGBA32F", "read_write", "sums over rounds of what it is multiplied by, and of rounds that show a reflector"),
        "settled": Stored("RGBA32F", "read_write", SETTLED),
    },
    constants={
        **SIZE_CONSTANTS,
        **WALK_CONSTANTS,
        "round_number": Constant("int", "rounds that are in the sums"),
        "least_rounds": Constant("int", "before which nothing settles; with ADAPTIVE"),
    },
    flags=ADAPTIVE_FLAG,
    defines={**TILE_DEFINES, **LUMINANCE_DEFINES, "ADAPTIVE_STEP": ADAPTIVE_STEP},
)

SHOW_REFLECTIONS = ComputeDeclaration(
    name="show_reflections",
    text="draws what reflectors show into a picture that stays on the device",
    source="show_reflections.comp.glsl",
    local_size=(TILE_PX, TILE_PX, 1),
    textures={
        "radiance_sums": Sampled("sampler2D", "sums over rounds of radiance"),
        "color_sums": Sampled("sampler2D", "sums over rounds of what it is multiplied by, and of rounds that show a reflector"),
    },
    images={"picture": Stored("RGBA32F", "write", "colour times the share of reflectors in the pixel, and this share; of light to add: 0")},
    constants={
        **SIZE_CONSTANTS,
        "round_count": Constant("int", "rounds in the sums"),
        "shown": Constant("int", "0: the reflection, 1: its colour, 2: both multiplied, which is light to add"),
    },
)

REFLECTION_ERROR = ComputeDeclaration(
    name="reflection_error",
    text="sums the squared standard error of what reflections add over tiles",
    source="reflection_error.comp.glsl",
    local_size=(8, 8, 1),
    textures={
        "radiance_sums": Sampled("sampler2D", "sums over rounds of radiance and of its squared luminance"),
        "color_sums": Sampled("sampler2D", "sums over rounds of what it is multiplied by, and of rounds that show a reflector"),
        "settled": Sampled("sampler2D", SETTLED),
    },
    images={"tile_sums": Stored("RGBA32F", "write", "sum of squared errors and number of pixels that show a reflector of every tile")},
    constants={**SIZE_CONSTANTS, "round_count": Constant("int", "rounds in the sums")},
    flags=ADAPTIVE_FLAG,
    defines=LUMINANCE_DEFINES,
)
