"""Maps of what reflectors may see: six faces around a centre, or one view of a mirrored eye. Each texel tells which triangle its centre
sees and between which depths, coarser levels between which depths all texels below them.

All maps of a frame are one list of texels:
    map_headers     ten texels a map: centre and whether it is a cube; three axes, with width, height and the number of the first of its
                    reflector's OWN_CUBES cubes of itself, -1: none; corner and size of a texel in tangents; where its texels begin
                    (halves), nearest and farthest depth; FURTHER_MAPS numbers of others, -1: none; three rows of what takes the box
                    around all that it shows to the cube from -1 to 1
    map_texels      of every map, from the finest level on: range of depths, instance number and triangle number, -1 where nothing is
"""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...device.declaration import ComputeDeclaration, Constant, Sampled, Stored
from ...device.interface import LINEAR_TEXTURE_WIDTH, RenderTarget, Texture, TextureFormat, split_integers
from ...device.owned import Owned
from ..bounds import SceneBounds
from ..settings import ReflectionMethod
from ..steps import compiling
from .eye import VISIBILITY, VISIBILITY_OF_CUT_OUTS
from .scene_data import SCENE_DEFINES, SCENE_TEXTURES, WORK_GROUP_SIZE, SceneData
from .shadow_maps import WORK_TABLE
from .small_triangles import COPY_TEXELS

MAP_LEVELS = 6
"""so many that a texel of the coarsest is MAP_SIZE_STEP_PX wide"""
MAP_SIZE_STEP_PX = 1 << (MAP_LEVELS - 1)
HEADER_TEXELS, FURTHER_MAPS, OWN_CUBES = 10, 4, 2
HEADER_DEFINE = {"HEADER_TEXELS": HEADER_TEXELS}
BYTES_PER_TEXEL = 16
TURNED_BOX_INSTANCES = 32
"""More than these have a box along the world's axes around them."""
LEAST_BOX_SHARE = 1e-4
"""of its largest side that boxes of flat things are thick"""
NOTHING_NEARER = 1e30
"""the smallest depth where nothing is"""

MAP_TEXTURES = {
    "map_headers": Sampled("sampler2D", "centre, axes, size and place of every map"),
    "map_texels": Sampled("sampler2D", "depths and triangle of every texel of every map"),
}
MAP_NUMBER = Constant("int", "which map")
VISIBILITY_TEXT = "instance number + 1 and triangle number, the map's faces from bottom to top"

REFLECTION_TEXELS = ComputeDeclaration(
    name="reflection_texels",
    text="depths and triangle of every texel of a reflector's map, from visibility",
    source="reflection_texels.comp.glsl",
    local_size=(8, 8, 1),
    textures={
        **SCENE_TEXTURES,
        "map_headers": MAP_TEXTURES["map_headers"],
        "visibility": Sampled("usampler2D", VISIBILITY_TEXT, channel_count=2),
    },
    images={"map_texels": Stored("RGBA32F", "write", MAP_TEXTURES["map_texels"].text)},
    constants={"map_number": MAP_NUMBER},
    defines={**SCENE_DEFINES, **HEADER_DEFINE, "NOTHING_NEARER": NOTHING_NEARER},
)

NEAREST_DEPTHS_TEXT = "bits of the smallest depth"
NEAREST_NUMBERS_TEXT = "the smallest number of a triangle at that depth"

REFLECTION_TEXELS_OF_CLOUD = replace(
    REFLECTION_TEXELS,
    name="reflection_texels_of_cloud",
    text="the same of a cube that was splatted, and in which the rasterizer drew what has opacity maps",
    textures={
        **REFLECTION_TEXELS.textures,
        "nearest_depths": Sampled("usampler2D", NEAREST_DEPTHS_TEXT),
        "nearest_numbers": Sampled("usampler2D", NEAREST_NUMBERS_TEXT),
        "work_table": WORK_TABLE,
    },
    constants={
        **REFLECTION_TEXELS.constants,
        "first_texel": Constant("int", "the cube's first texel"),
        "is_drawn": Constant("int", "1: the rasterizer drew something"),
    },
    defines={**REFLECTION_TEXELS.defines, "OF_CLOUD": 1, "WORK_GROUP_SIZE": WORK_GROUP_SIZE},
)

REFLECTION_LEVELS = ComputeDeclaration(
    name="reflection_levels",
    text="a coarser level of a reflector's map",
    source="reflection_levels.comp.glsl",
    local_size=(8, 8, 1),
    textures={"map_headers": MAP_TEXTURES["map_headers"]},
    images={"map_texels": Stored("RGBA32F", "read_write", MAP_TEXTURES["map_texels"].text)},
    constants={"map_number": MAP_NUMBER, "level": Constant("int", "which level is made, from 1")},
    defines={**HEADER_DEFINE, "NOTHING_NEARER": NOTHING_NEARER},
)


@dataclass(frozen=True, eq=False)
class ReflectionMap:
    """Where a map looks from and at what."""

    center_ws: np.ndarray
    """(3,) float64"""
    axes: np.ndarray
    """(3, 3) float64 rows; a single view looks along the last"""
    is_cube: bool
    width_px: int
    """of a face, a multiple of MAP_SIZE_STEP_PX"""
    height_px: int
    window: tuple[float, float, float, float]
    """tangents left, right, bottom, top"""
    near_m: float
    reach_m: float
    instances: np.ndarray
    """(n,) int64 what it may see"""
    clipped_by: np.ndarray | None = None
    """(4,) float64 plane (normal, offset): only what has normal . p + offset > 0 is there; of single views"""
    method: ReflectionMethod = ReflectionMethod.MVR
    """never AUTO; only cubes are splatted"""
    shows_farthest: bool = False
    """of all surfaces behind each other, not the nearest; the rasterizer's alone"""

    @property
    def face_count(self) -> int:
        return 6 if self.is_cube else 1

    @property
    def texel_count(self) -> int:
        """of all levels"""
        finest = self.face_count * self.width_px * self.height_px
        return sum(finest >> 2 * level for level in range(MAP_LEVELS))

    def face_axes(self, face: int) -> np.ndarray:
        """(3, 3) rows right, up, forward of a face; as `in_face` of lib/reflection_map.glsl has it"""
        axis, side = (2, 1.0) if not self.is_cube else (face // 2, 1.0 - 2.0 * (face % 2))
        return np.stack([self.axes[(axis + 1) % 3], self.axes[(axis + 2) % 3], side * self.axes[axis]])

    def clip_from_world(self, face: int) -> np.ndarray:
        """(4, 4) float64 OpenGL projection of a face"""
        left, right, bottom, top = self.window
        near, far = self.near_m, self.reach_m
        clip_from_face = np.array(
            [
                [2 / (right - left), 0, -(right + left) / (right - left), 0],
                [0, 2 / (top - bottom), -(top + bottom) / (top - bottom), 0],
                [0, 0, (far + near) / (far - near), -2 * far * near / (far - near)],
                [0, 0, 1, 0],
            ]
        )
        face_from_world = np.eye(4)
        face_from_world[:3, :3] = self.face_axes(face)
        face_from_world[:3, 3] = -self.face_axes(face) @ self.center_ws
        if self.clipped_by is not None:
            clip_from_face = _clipped(clip_from_face, self.clipped_by @ np.linalg.inv(face_from_world))
        if self.shows_farthest:
            clip_from_face[2] *= -1.0
        return clip_from_face @ face_from_world

    def header(self, base: int, further: np.ndarray, first_own: int, corners_ws: np.ndarray) -> np.ndarray:
        """(HEADER_TEXELS, 4). further: (FURTHER_MAPS,) numbers of maps, and first_own, as of `ReflectionMaps`; corners_ws:
        (instance_count, 8, 3) of the scene's boxes"""
        left, right, bottom, top = self.window
        rows = np.zeros((HEADER_TEXELS, 4))
        rows[0] = *self.center_ws, self.is_cube
        rows[1:4, :3] = self.axes
        rows[1:4, 3] = self.width_px, self.height_px, first_own
        rows[4] = left, bottom, (right - left) / self.width_px, (top - bottom) / self.height_px
        rows[5] = *split_integers(np.array(base)), self.near_m, self.reach_m
        rows[6] = further
        if len(self.instances):
            rows[7:10] = cube_from_box(corners_ws[self.instances])
        return rows


def cube_from_box(corners_ws: np.ndarray) -> np.ndarray:
    """(3, 4) what takes a box around all corners, (n, 8, 3), to the cube from -1 to 1: of those along the world's axes and, of few, along
    one's own, that of the smallest surface. A leaning sheet has next to no place beside and behind it in its own."""
    points = corners_ws.reshape(-1, 3).astype(np.float64)
    choices = [np.eye(3)]
    if len(corners_ws) <= TURNED_BOX_INSTANCES:
        for box in corners_ws.astype(np.float64):
            # of a box or a rectangle these are its edges
            choices.append(np.linalg.eigh(np.cov(box, rowvar=False))[1].T)
    sizes = np.array([np.ptp(points @ axes.T, axis=0) for axes in choices])
    x, y, z = sizes.T
    axes = choices[int(np.argmin(x * y + y * z + z * x))]
    low, high = (points @ axes.T).min(axis=0), (points @ axes.T).max(axis=0)
    half = np.maximum((high - low) / 2, LEAST_BOX_SHARE * max(float((high - low).max()), 1e-30))
    return np.column_stack([axes / half[:, None], -(low + high) / 2 / half])


def _clipped(clip_from_face: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """The projection whose near plane is another (Lengyel 2005, "Oblique View Frustum Depth Projection and Clipping"). plane: (4,) in
    face space"""
    corner = np.linalg.inv(clip_from_face) @ np.array([np.sign(plane[0]), np.sign(plane[1]), 1.0, 1.0])
    clipped = clip_from_face.copy()
    clipped[2] = 2 * (clip_from_face[3] @ corner) / (plane @ corner) * plane - clip_from_face[3]
    return clipped


def instances_in_face(drawn: ReflectionMap, face: int, corners_ws: np.ndarray) -> np.ndarray:
    """(n,) int64 those of the map's instances whose boxes, (instance_count, 8, 3), are not wholly outside one side of a face's pyramid."""
    left, right, bottom, top = drawn.window
    x, y, depth = np.moveaxis((corners_ws[drawn.instances] - drawn.center_ws) @ drawn.face_axes(face).T, -1, 0)
    sides = [depth - drawn.near_m, x - left * depth, right * depth - x, y - bottom * depth, top * depth - y]
    if drawn.clipped_by is not None:
        sides.append(corners_ws[drawn.instances] @ drawn.clipped_by[:3] + drawn.clipped_by[3])
    return drawn.instances[np.logical_and.reduce([(side >= 0).any(axis=1) for side in sides])]


class ReflectionMaps:
    """Maps of a frame, drawn once: by the hardware rasterizer, but for those that something else splats."""

    def __init__(
        self,
        scene_data: SceneData,
        bounds: SceneBounds,
        maps: Sequence[ReflectionMap],
        further: np.ndarray,
        first_own: np.ndarray,
        drawn_before: ReflectionMaps | None = None,
    ) -> None:
        """further: (map_count, FURTHER_MAPS) numbers of those that rays ask besides each; first_own: (map_count,) that of the first of
        OWN_CUBES cubes of its reflector itself; -1: none. drawn_before: the first of these maps, which need not be drawn again"""
        self.scene_data, self.device, self.maps = scene_data, scene_data.device, maps
        self.corners_ws = bounds.corners_ws
        self._drawn_count = 0
        bases = np.concatenate([[0], np.cumsum([each.texel_count for each in maps])]).astype(np.int64)
        rows_of = zip(maps, bases[:-1], further, first_own, strict=True)
        headers = np.concatenate([each.header(int(base), others, int(own), self.corners_ws) for each, base, others, own in rows_of])
        rows = max(1, -(-int(bases[-1]) // LINEAR_TEXTURE_WIDTH))
        with Owned() as owned:
            self.headers = owned.own(self.device.upload_array(headers))
            self.texels = owned.own(self.device.create_texture(LINEAR_TEXTURE_WIDTH, rows, TextureFormat.RGBA32F))
            if drawn_before is not None:
                self._drawn_count = len(drawn_before.maps)
                count = int(bases[self._drawn_count])
                self.device.compute_kernel(COPY_TEXELS).dispatch_linear(
                    count, original=drawn_before.texels, copied=self.texels, first_texel=0, texel_count=count
                )
            self._owned = owned.pop_all()

    @property
    def bindings(self) -> dict[str, Texture]:
        return {"map_headers": self.headers, "map_texels": self.texels}

    @property
    def pending(self) -> dict[int, ReflectionMap]:
        """Number -> those that have not been drawn"""
        return {number: each for number, each in enumerate(self.maps) if number >= self._drawn_count}

    def drawing(self) -> Generator[None, None, None]:
        """Those of the rasterizer that have not been, face by face, on the device's thread."""
        own = {number: each for number, each in self.pending.items() if each.method is ReflectionMethod.MVR}
        for size in sorted({_target_size(each) for each in own.values()}):
            # cleared for every map: no larger than it is
            with self._target(size) as target:
                for number, each in own.items():
                    if _target_size(each) != size:
                        continue
                    self._clear(target)
                    for face in range(each.face_count):
                        self._rasterize(target, each, face)
                        yield
                    yield from self._storing(REFLECTION_TEXELS, number, visibility=target.color)

    def end_drawing(self) -> None:
        """All that were pending have been drawn or splatted."""
        self._drawn_count = len(self.maps)

    @contextlib.contextmanager
    def _target(self, size: tuple[int, int]) -> Iterator[RenderTarget]:
        with Owned() as temporary:
            visibility = temporary.own(self.device.create_texture(*size, TextureFormat.RG32UI))
            depth = temporary.own(self.device.create_texture(*size, TextureFormat.DEPTH32F))
            yield temporary.own(self.device.create_target(visibility, depth))

    def _clear(self, target: RenderTarget) -> None:
        self.device.fill(target.color, 0)
        self.device.fill(target.depth, 0)

    def _rasterize(self, target: RenderTarget, drawn: ReflectionMap, face: int, *, only_cut_outs: bool = False) -> None:
        inside = instances_in_face(drawn, face, self.corners_ws)
        cut_out = self.scene_data.cut_out[inside]
        viewport = (0, face * drawn.height_px, drawn.width_px, drawn.height_px)
        bindings = {
            "clip_from_world": drawn.clip_from_world(face),
            "instances": self.scene_data.instances,
            "first_triangle": 0,
            "is_orthographic": 0,
        }
        if not only_cut_outs:
            self.device.raster_kernel(VISIBILITY).draw(target, viewport, self.scene_data.draws(inside[~cut_out]), **bindings)
        if self.scene_data.opacity_maps is not None:
            cut_out_draws = self.scene_data.draws(inside[cut_out])
            self.device.raster_kernel(VISIBILITY_OF_CUT_OUTS).draw(
                target, viewport, cut_out_draws, **bindings, **self.scene_data.opacity_maps.bindings, rasterization=0
            )

    def storing_splatted(
        self, number: int, nearest_depths: Texture, nearest_numbers: Texture, first_texel: int, work_table: Texture
    ) -> Generator[None, None, None]:
        """Make the map's texels of what was splatted, and of its cut-outs, which the rasterizer draws face by face. On the device's
        thread."""
        drawn = self.maps[number]
        has_cut_outs = bool(self.scene_data.cut_out[drawn.instances].any())
        with self._target(_target_size(drawn) if has_cut_outs else (1, 1)) as target:
            if has_cut_outs:
                self._clear(target)
                for face in range(drawn.face_count):
                    self._rasterize(target, drawn, face, only_cut_outs=True)
                    yield
            yield from self._storing(
                REFLECTION_TEXELS_OF_CLOUD,
                number,
                visibility=target.color,
                nearest_depths=nearest_depths,
                nearest_numbers=nearest_numbers,
                first_texel=first_texel,
                work_table=work_table,
                is_drawn=int(has_cut_outs),
            )
        yield

    def _storing(self, declaration: ComputeDeclaration, number: int, **seen: object) -> Generator[None, None, None]:
        """Pauses where a kernel is compiled."""
        drawn = self.maps[number]
        (yield from compiling(self.device, declaration)).dispatch_grid(
            (drawn.width_px, drawn.face_count * drawn.height_px),
            **self.scene_data.bindings,
            map_headers=self.headers,
            map_texels=self.texels,
            map_number=number,
            **seen,
        )
        for level in range(1, MAP_LEVELS):
            (yield from compiling(self.device, REFLECTION_LEVELS)).dispatch_grid(
                (drawn.width_px >> level, drawn.face_count * (drawn.height_px >> level)),
                map_headers=self.headers,
                map_texels=self.texels,
                map_number=number,
                level=level,
            )

    def release(self) -> None:
        self._owned.close()


def _target_size(drawn: ReflectionMap) -> tuple[int, int]:
    return drawn.width_px, drawn.face_count * drawn.height_px
