"""What is rendered, as plain numpy: the only form in which a scene crosses from Blender into the core.

Spaces
    object   a mesh's own coordinates
    world    Blender's world, shifted by `SceneSnapshot.world_origin_m` in float64 before it became float32
    view     of the camera or of a light's view: x right, y up, looking down -z
Matrices are row-major numpy arrays that multiply column vectors: `point_ws = world_from_object @ point_os`.
Lengths are metres in the sense of Blender units. Image row 0 is the *bottom* row, as in OpenGL and `bpy.types.Image.pixels`.
"""

from __future__ import annotations

import enum
import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from .errors import UsageError
from .material import Extension, Layer, Material, Rgb, World
from .mesh_topology import parts_of, welded

SAMPLED_TRIANGLES = 2048
"""of a mesh, for predictions: at most twice as many"""

_BLOCK = 1 << 14
"""triangles looked at together: temporaries stay in the cache"""


@dataclass(frozen=True, eq=False)
class OpacityMap:
    """Which share of a surface is there, as an image upon it: leaves on a card, a lace curtain, a tinted pane."""

    name: str
    """of the material"""
    texels: np.ndarray
    """(height, width) uint8, row 0 at the bottom, v = 0"""
    opacity: np.ndarray
    """(256,) float32: 0 lets everything through, 1 nothing; of texel values 0 to 255, linear between them, looked up after the image is
    interpolated"""
    extension: Extension = Extension.REPEAT
    is_interpolated: bool = True
    """bilinearly between texels' centres; otherwise a texel is one value throughout"""


@dataclass(frozen=True)
class Mesh:
    """Triangles in object space, stored once however many instances show them.

    A mesh has one opacity map or none: what of a Blender mesh has another material is a mesh of its own here, with instances of its own.

    Shading normals: `point_normals` where a vertex has one normal, `corner_normals` where corners of one vertex
    differ (sharp edges, custom normals), neither for a mesh that is flat shaded throughout.
    """

    name: str
    positions_os: np.ndarray
    """(vertex_count, 3) float32"""
    triangles: np.ndarray
    """(triangle_count, 3) int32, indices into `positions_os`, counter-clockwise seen from the front"""
    point_normals_os: np.ndarray | None = None
    """(vertex_count, 3) float32 unit vectors"""
    corner_normals_os: np.ndarray | None = None
    """(triangle_count, 3, 3) float32 unit vectors"""
    is_closed: bool = False
    """Every directed edge is met by its reverse, and all faces look outwards: from outside front faces are before back faces. False with an
    opacity map: back faces are seen through the holes."""
    opacity_map: OpacityMap | None = None
    """None: opaque"""
    uvs: np.ndarray | None = None
    """(vertex_count, 2) float32 places in the opacity map, whose corners are (0, 0) and (1, 1); with an opacity map only"""
    material_slot: np.ndarray | None = None
    """(triangle_count,) uint8 into an entry of `SceneSnapshot.material_sets`; None: 0 throughout"""
    layers: Mapping[Layer, np.ndarray] = field(default_factory=lambda: MappingProxyType({}))
    """(triangle_count, 3, 2) float32 uvs or (triangle_count, 3, 3) float32 linear colours or coordinates of every triangle's corners, those
    that materials ask for; only in snapshots with materials"""

    @property
    def vertex_count(self) -> int:
        return len(self.positions_os)

    @property
    def triangle_count(self) -> int:
        return len(self.triangles)

    @functools.cached_property
    def bounds_os(self) -> np.ndarray:
        """(2, 3) float32: smallest and largest corner of the vertices that triangles use."""
        used = self.positions_os[self.triangles.ravel()] if self.vertex_count > 4 * self.triangle_count else self.positions_os
        # column by column: numpy's min over the first axis of (n, 3) takes thirty times longer
        return np.array([[column.min() for column in used.T], [column.max() for column in used.T]])

    @functools.cached_property
    def sampled_sizes(self) -> tuple[np.ndarray, np.ndarray]:
        """(n,) areas (m^2) and (n,) perimeters (m) of a regular subset of the triangles, object space, by perimeter: for predictions."""
        step = max(1, self.triangle_count // SAMPLED_TRIANGLES)
        a, b, c = np.moveaxis(self.positions_os[self.triangles[::step]].astype(np.float64), 1, 0)
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        perimeter = sum(np.linalg.norm(d, axis=1) for d in (b - a, c - b, a - c))
        order = np.argsort(perimeter)
        return area[order], perimeter[order]

    @functools.cached_property
    def welded_triangles(self) -> np.ndarray:
        """(triangle_count, 3) int32: as `triangles`, of places instead of vertices, which may coincide."""
        return welded(self.positions_os)[self.triangles]

    @functools.cached_property
    def part_of_triangle(self) -> np.ndarray:
        """(triangle_count,) int32 below the number of vertices: equal for triangles that hang together, at vertices that coincide, too"""
        return parts_of(self.welded_triangles, self.vertex_count)

    @functools.cached_property
    def flat_triangle_count(self) -> int:
        """Triangles without area, as single precision has it: no picture shows them. Takes 10 ms a million, 28 where all are upright."""
        axes = np.ascontiguousarray(self.positions_os.T)  # one axis at a time is twice as fast as rows of three
        count = 0
        for start in range(0, self.triangle_count, _BLOCK):
            corners = self.triangles[start : start + _BLOCK].T.astype(np.intp)  # as what is indexed wants it, once for all axes
            (x1, x2), (y1, y2) = (_edges(axis, corners) for axis in axes[:2])
            # most have an area seen along z already
            upright = np.flatnonzero(x1 * y2 == y1 * x2)
            if len(upright):
                x1, x2, y1, y2 = x1[upright], x2[upright], y1[upright], y2[upright]
                z1, z2 = _edges(axes[2], corners[:, upright])
                count += int(np.count_nonzero((y1 * z2 == z1 * y2) & (z1 * x2 == x1 * z2)))
        return count


@dataclass(frozen=True)
class Instances:
    """One row per placed mesh, as arrays so that a hundred thousand of them stay cheap."""

    mesh_index: np.ndarray
    """(instance_count,) int32"""
    world_from_object: np.ndarray
    """(instance_count, 4, 4) float32, after the shift of the origin"""
    object_index: np.ndarray
    """(instance_count,) int32 into `object_names`"""
    object_names: tuple[str, ...]
    visible_to_camera: np.ndarray
    """(instance_count,) bool"""
    casts_shadow: np.ndarray
    """(instance_count,) bool: `visible_shadow` of the object"""
    stable_id: np.ndarray
    """(instance_count,) uint32 made from names and persistent ids; does not change when other objects come or go"""
    visible_in_reflections: np.ndarray | None = None
    """(instance_count,) bool: `visible_glossy` of the object; None: a snapshot without materials"""
    material_set: np.ndarray | None = None
    """(instance_count,) int32 into `SceneSnapshot.material_sets`; None: a snapshot without materials"""
    reflector_mark: np.ndarray | None = None
    """(instance_count,) int8 what the artist asks for (custom property `vir_reflector`): 1 a reflector, 0 none, -1 what the material
    calls for; None: a snapshot without materials"""
    stays: np.ndarray | None = None
    """(instance_count,) bool: nothing moves or deforms it in other frames, as far as can be told beforehand; None: not known of any"""

    def __len__(self) -> int:
        return len(self.mesh_index)


class LightShape(enum.Enum):
    RECTANGLE = "rectangle"
    ELLIPSE = "ellipse"
    POINT = "point"
    SPOT = "spot"
    SUN = "sun"

    @property
    def is_area(self) -> bool:
        return self in (LightShape.RECTANGLE, LightShape.ELLIPSE)

    @property
    def is_omni(self) -> bool:
        """Shines to all sides, or into a cone, from a sphere or a point."""
        return self in (LightShape.POINT, LightShape.SPOT)


@dataclass(frozen=True)
class Light:
    """A light as it stands in the frame. Area lights lie in the xy plane of their space and emit along its -z; spots and suns
    shine along -z too."""

    name: str
    shape: LightShape
    world_from_light: np.ndarray
    """(4, 4) float64, orthonormal rotation (scale is already in the sizes) and position after the origin's shift"""
    size_x_m: float
    """full width along x: rectangle side or ellipse diameter, scale of the object included; diameter of the sphere of points and
    spots; suns: of the disc of directions at a distance of 1 m"""
    size_y_m: float
    spread_rad: float
    """full angle of the emission cone of area lights; pi is the plain cosine emitter"""
    strength: float
    """Weighs the light in the combined pass, sign kept: irradiance = strength * mean over light samples of
    cos_receiver cos_light / d^2 max(0, 1 - tan(angle) / tan(spread / 2)), with the luminance of the light's colour"""
    casts_shadow: bool
    receivers: np.ndarray | None = None
    """(instance_count,) bool: which instances the light illuminates (light linking); None: all"""
    blockers: np.ndarray | None = None
    """(instance_count,) bool: which instances may cast its shadow (shadow linking and visible_shadow);
    None: `casts_shadow` of the instances"""
    has_soft_falloff: bool = False
    """points and spots: from outside the sphere looks like a disc through its centre that faces the surface (Blender's "Soft Falloff");
    otherwise it is the sphere itself"""
    cone_rad: float = 2 * math.pi
    """full angle of a spot's cone where the object is not scaled"""
    cone_blend: float = 0.0
    """share of the cone, counted in the cosine of the angle to the axis, over which a spot fades"""
    cone_scale: tuple[float, float] = (1.0, 1.0)
    """factors by which a spot's cone is wider along x and y: the object's scale there over that along z"""
    disc_turn_rad: float = 0.0
    """of ellipses: by how much the disc is turned that they are made of by the sizes. It is the same light, but its samples lie elsewhere:
    those of a sheared ellipse stay where they are on it, whichever of its axes is x"""
    strength_rgb: Rgb | None = None
    """`strength` of the red, green and blue channel, whose luminance it is; None: `strength` in each"""
    is_wanted: bool = True
    """False: the artist has switched its pass off"""
    own_view_count: int | None = None
    """the artist's own number of views for this light instead of that of the settings"""

    def __post_init__(self) -> None:
        if self.own_view_count is not None and not 1 <= self.own_view_count <= 4096:
            raise UsageError(f"the views of {self.name!r} must be 1 to 4096, not {self.own_view_count}")

    @property
    def is_spread_limited(self) -> bool:
        """of area lights"""
        return self.shape.is_area and self.spread_rad < math.pi - 1e-4

    @property
    def radius_m(self) -> float:
        """of points and spots"""
        return self.size_x_m / 2

    @property
    def has_size(self) -> bool:
        return self.size_x_m > 0 or self.size_y_m > 0

    @property
    def widest_half_cone_rad(self) -> float:
        """half the angle of a round cone around all that a point light or spot lights"""
        half = self.cone_rad / 2
        if half >= math.pi / 2:
            return half
        return math.atan(math.tan(half) * max(*self.cone_scale, 1e-6))


@dataclass(frozen=True)
class Camera:
    """Perspective or orthographic; shift, sensor fit, pixel aspect and a cropping render border are already in the window."""

    name: str
    is_orthographic: bool
    world_from_view: np.ndarray
    """(4, 4) float64, rigid, after the origin's shift"""
    window: tuple[float, float, float, float]
    """left, right, bottom, top: of the plane at distance 1 m (perspective, tangents) or in metres (orthographic);
    left > right, or bottom > top, for a mirrored camera"""
    clip_start_m: float
    clip_end_m: float
    skew: float = 0.0
    """of a sheared camera: by how much higher the window is for each unit of x, so that it is a parallelogram"""

    @property
    def is_mirrored(self) -> bool:
        """Whether pictures have left and right swapped: mirrored along both axes they are turned."""
        left, right, bottom, top = self.window
        return (left > right) != (bottom > top)


class FilterShape(enum.Enum):
    BOX = "box"
    GAUSSIAN = "gaussian"
    BLACKMAN_HARRIS = "blackman-harris"


@dataclass(frozen=True)
class PixelFilter:
    """The scene's own reconstruction filter: passes are anti-aliased like the beauty they are multiplied with."""

    shape: FilterShape = FilterShape.BLACKMAN_HARRIS
    width_px: float = 3.0
    """full width of the support: twice what Cycles calls the width of its Blackman-Harris filter"""


@dataclass(frozen=True)
class LeftOut:
    """Something of the scene that is not in the snapshot, in words for the plan and the statistics."""

    object_name: str
    reason: str
    instance_count: int = 0
    """how often the whole object would be in the snapshot; 0: it is there, but for a part or a property"""
    vertex_count: int = 0
    """dropped vertices, where that is what happened"""
    triangle_count: int = 0
    """triangles that went with them"""
    is_light: bool = False
    is_never_surface: bool = False
    """it is a point cloud, hair, a volume or of coordinates that are not numbers: without anything else there is nothing to render"""

    @property
    def text(self) -> str:
        counts = {
            "instances": self.instance_count if self.instance_count > 1 else 0,
            "vertices": self.vertex_count,
            "triangles": self.triangle_count,
        }
        counted = ", ".join(f"{what}: {count:,}" for what, count in counts.items() if count)
        return f"{self.object_name}: {self.reason}" + (f" ({counted})" if counted else "")


@dataclass(frozen=True)
class SceneSnapshot:
    scene_name: str
    view_layer_name: str
    frame: int
    width_px: int
    height_px: int
    meshes: tuple[Mesh, ...]
    instances: Instances
    lights: tuple[Light, ...]
    """sorted by name: the order in the file must not change the picture"""
    camera: Camera
    pixel_filter: PixelFilter
    world_origin_m: np.ndarray
    """(3,) float64, what was subtracted from Blender's world coordinates"""
    left_out: tuple[LeftOut, ...] = ()
    lights_elsewhere: tuple[str, ...] = ()
    """names, sorted, of lights that are not rendered here and may be in other frames or view layers: nothing has to be mended"""
    notes: tuple[str, ...] = ()
    """decisions taken on the way in that the user should know, e.g. about the render border"""
    materials: tuple[Material, ...] = ()
    """empty unless asked for, as everything about materials"""
    material_sets: tuple[tuple[int, ...], ...] = ()
    """what the slots of objects hold: indices into `materials`, at least one each"""
    world: World | None = None
    """None: a snapshot without materials"""
    extract_ms: float = field(default=0.0, compare=False)

    @property
    def unique_triangle_count(self) -> int:
        return sum(mesh.triangle_count for mesh in self.meshes)

    @property
    def instanced_triangle_count(self) -> int:
        counts = np.array([mesh.triangle_count for mesh in self.meshes], dtype=np.int64)
        return int(counts[self.instances.mesh_index].sum()) if len(self.instances) else 0

    @property
    def flat_triangle_count(self) -> int:
        """Of the unique ones, those without area."""
        return sum(mesh.flat_triangle_count for mesh in self.meshes)


def _edges(axis: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """From the first of (3, n) corners to the second and to the third, along an axis."""
    first = axis[corners[0]]
    return axis[corners[1]] - first, axis[corners[2]] - first


def has_same_meshes(one: SceneSnapshot, other: SceneSnapshot) -> bool:
    """Whether both show the very same meshes; equal ones that were read twice do not count."""
    return len(one.meshes) == len(other.meshes) and all(a is b for a, b in zip(one.meshes, other.meshes, strict=True))


def has_same_picture(one: SceneSnapshot, other: SceneSnapshot) -> bool:
    """Whether the same surfaces stand at the same places before the same camera, whatever lights them."""
    return (
        has_same_meshes(one, other)
        and (one.width_px, one.height_px, one.pixel_filter) == (other.width_px, other.height_px, other.pixel_filter)
        and _has_same_values(one.camera, other.camera)
        and _has_same_values(one.instances, other.instances)
        and np.array_equal(one.world_origin_m, other.world_origin_m)
    )


def has_same_surfaces(one: SceneSnapshot, other: SceneSnapshot) -> bool:
    """Whether the same surfaces look the same, wherever they stand; materials and images that were read twice do not count."""
    return (
        has_same_meshes(one, other)
        and one.material_sets == other.material_sets
        and len(one.materials) == len(other.materials)
        and all(a is b for a, b in zip(one.materials, other.materials, strict=True))
        and (one.world is other.world or (one.world is not None and other.world is not None and _has_same_values(one.world, other.world)))
        and all(np.array_equal(getattr(one.instances, name), getattr(other.instances, name)) for name in ("material_set", "mesh_index"))
    )


def is_same_light(one: Light, other: Light) -> bool:
    return _has_same_values(one, other)


def _has_same_values(one: Camera | Instances | Light | World, other: Camera | Instances | Light | World) -> bool:
    """`==` of dataclasses with arrays."""
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in one.__dataclass_fields__)
