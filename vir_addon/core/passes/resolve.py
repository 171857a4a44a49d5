"""Looking the picture up in the depth maps of a batch."""

from __future__ import annotations

from ...device.declaration import ComputeDeclaration, Constant, Sampled, Stored
from .accumulate import PROBED_LIGHT_TEXT, ROUND_SUMS_TEXT, SETTLED_DEFINES
from .shadow_maps import FACE_TABLE, MIXED_MAPS_FLAG, ORTHOGRAPHIC_FLAG, SAMPLES_TABLE, VIEWS_TABLE
from .tiles import PROBES_FLAG, SIZE_CONSTANTS, TILE_CONSTANTS, TILE_DEFINES, TILE_PX, TILE_TEXTURES

LOOKED_UP_VIEWS = {
    "first_view": Constant("int", "the first view of the batch to look up"),
    "view_count": Constant("int", "how many to look up"),
}

TILE_FACES = ComputeDeclaration(
    name="tile_faces",
    text="finds the faces of a light's cube that each tile of the picture needs",
    source="tile_faces.comp.glsl",
    local_size=(8, 8, 1),
    textures={"positions": Sampled("sampler2D", "position (world space) and instance number, -1 for the background")},
    images={"tile_faces": Stored("R32UI", "write", "a bit a face")},
    constants={**SIZE_CONSTANTS, **LOOKED_UP_VIEWS},
    tables={"face": FACE_TABLE, "samples": SAMPLES_TABLE},
    defines={"TILE_PX": TILE_PX},
)

LATE_FACES = 0x3F
FIRST_FACE = 0x40
LAST_FACE = 0x80
WAS_LIT = 0x100
TURN_DEFINES = {"LATE_FACES": LATE_FACES, "FIRST_FACE": FIRST_FACE, "LAST_FACE": LAST_FACE, "WAS_LIT": WAS_LIT}
"""What RESOLVE knows of a tile's turn in a round: faces before this one that count as they did before, as lit or as dark, and whether it
begins or ends the round's sums."""

FAR_TEXELS = 5e8
"""more than any receiver is aside of a window"""
LIT_WINDOW, UNKNOWN_WINDOW = -2 * FAR_TEXELS, 2 * FAR_TEXELS
"""where windows are that receivers are all far to the right of, and to the left: what casts is nowhere before them; nobody knew of them"""

TOLERANCES: dict[str, int | float] = {
    # What is stored deeper than the receiver by more does not hide it: within a texel the receiver's own plane runs no deeper, up to 70
    # degrees from facing the light, and what lies beyond a silhouette is another surface.
    "MAX_DEEPER_FOOTPRINTS": 2.0,
    # What stands nearer than the receiver by more, and not above its plane, is its own surface only if that ends before it rises above the
    # plane: a wall that crosses the plane within the texel goes on to its upper side.
    "CERTAIN_FOOTPRINTS": 2.0,
    # What stands nearer than the receiver by more may be something else, although the plane of one seen edge-on passes before it; ...
    "MAX_NEARER_FOOTPRINTS": 8.0,
    # ... so may what is nearer by this share of its distance, where maps are so coarse that it is less.
    "MAX_NEARER_SHARE": 1 / 8,
    # What stands before the receiver by less, and by less than that share, may touch it within a texel: so steep are walls that are told
    # from outlines.
    "CONTACT_FOOTPRINTS": 16.0,
    # What is higher above the plane in the next texel, too, has not come down to it before: folds within a texel are lower.
    "GOES_ON_FOOTPRINTS": 1 / 2,
    # Rasterizers round corners to 256ths of a texel, which moves a plane by at most sqrt(2) of these.
    "COPLANAR_FOOTPRINTS": 1 / 128,
    # How high above the tangent plane a stored point may lie and still be the receiver: curvature, as an angle, ...
    "BIAS_ANGLE": 1 / 32,
    # ... planes of facets that points carry past the facets' edges, half a texel, ...
    "POINT_BIAS_FOOTPRINTS": 1 / 4,
    # ... and facets of about a texel: the same folds.
    "RASTER_BIAS_FOOTPRINTS": 1 / 8,
    # How far within outlines points end on average: half of an outline's cells have their centre inside, up to half a cell away.
    "POINT_MARGIN_TEXELS": 0.09,
    # Planes that points carry past facets' edges rise above the receiver's by no more, and what of a grazed surface's outline is higher
    # than the least of these is not such a plane.
    "POINT_MAX_RISE_FOOTPRINTS": 5 / 8,
    "POINT_MIN_RISE_FOOTPRINTS": 2 / 5,
    # What is higher above the plane may be a wall that stands on it between the texel's centre and the receiver, ...
    "FOOT_FOOTPRINTS": 1 / 32,
    # ... if it is a plane: what the third texel is off a line through two, of what that rises. Rasterized corners move its foot.
    "PLANE_MAX_BEND": 1 / 64,
    "FOOT_ROUNDING_TEXELS": 1 / 32,
    # Normals of neighbouring pixels that differ by less are of one facet, or of a plane.
    "FLAT_NORMAL_DIFFERENCE": 1e-5,
    # Outlines between texels, of surfaces that are round: what rises from the second texel to the third, of what rises before, ...
    "OUTLINE_MIN_BEND": 1 / 2,
    "OUTLINE_MAX_BEND": 0.95,
    # ... and which shares of a parabola through the receiver put them above it or below.
    "OUTLINE_ABOVE_SHARE": 1 / 4,
    "OUTLINE_BELOW_SHARE": 1 / 2,
}
"""of a look-up. Where they come from: docs/passes.md; what each costs: the benchmark `tolerances`"""

RESOLVE = ComputeDeclaration(
    name="resolve",
    text="looks visible surfaces up in the maps of a batch and accumulates the pass",
    source="resolve.comp.glsl",
    local_size=(TILE_PX, TILE_PX, 1),
    textures={
        "positions": Sampled("sampler2D", "position (world space) and instance number, -1 for the background"),
        "normals": Sampled("sampler2D", "geometric normal (world space) and packed shading normal"),
        "depth_maps": Sampled("usampler2D", "depth maps of the batch"),
        "receivers": Sampled(
            "sampler2D", "of an instance, x: whether it receives this light; y: whether windows were fitted to some of it"
        ),
        **TILE_TEXTURES,
    },
    images={
        "round_sums": Stored("RGBA32F", "read_write", ROUND_SUMS_TEXT),
        "batch_sums": Stored("RGBA32F", "read_write", "s and d of the faces of this round so far"),
        "disagreeing": Stored("R32UI", "write", "with PROBES: 1 for tiles of which a pixel is not as all of them were before"),
        "probed_light": Stored("RGBA32F", "read_write", f"with PROBES: {PROBED_LIGHT_TEXT}"),
    },
    constants={
        **SIZE_CONSTANTS,
        **TILE_CONSTANTS,
        **LOOKED_UP_VIEWS,
        "rounds_before": Constant("int", "rounds of the picture before this one"),
        "map_face": Constant("int", "number of the face that the maps are of; with MANY_FACES"),
        "face_mask": Constant(
            "int", "faces that this dispatch looks up: that of the maps and, in the first, all without casters; MANY_FACES"
        ),
    },
    tables={"face": FACE_TABLE, "views": VIEWS_TABLE, "samples": SAMPLES_TABLE},
    flags={
        **ORTHOGRAPHIC_FLAG,
        "OMNI": "the light shines from its centre to all sides, not from a plane",
        "SPHERE": "with OMNI: from a sphere around its centre",
        "CONE": "with OMNI: into a spot's cone only",
        "SPREAD": "an area light's cone is narrower than what lies before it",
        "SEALED": "something closes around the light: nothing sees it, without a map",
        "RECEIVER_LINKING": "leave out instances that the light does not illuminate",
        "MANY_FACES": "several faces share the directions",
        "LIT_BEYOND": "beyond the only map lie faces without casters",
        "POINT_MAPS": "the maps were splatted: undo the half texel by which that enlarges outlines",
        **PROBES_FLAG,
        **MIXED_MAPS_FLAG,
        "SMALL_FACETS": "with MIXED_MAPS: points are of small triangles alone",
        "THIN_WALLS": "casters may be walls without thickness: receivers right behind their foot",
    },
    defines={**TILE_DEFINES, **TURN_DEFINES, **SETTLED_DEFINES, **TOLERANCES, "FAR_TEXELS": FAR_TEXELS},
)

DELIVERED_FLAGS = ("ORTHOGRAPHIC", "OMNI", "SPHERE", "CONE", "SPREAD")
"""what lib/delivered.glsl asks for"""
