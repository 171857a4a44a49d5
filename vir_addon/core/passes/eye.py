"""The eye G-buffer: what every pixel sees, at sub-pixel offsets that change from batch to batch.

Rasterizing a million triangles costs far more than filling pixels, so visibility is rasterized with up to 6 x 6 samples a pixel and
serves as many offsets, which are moved to the nearest of its samples (by at most half of their distance).
"""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ...device.declaration import ComputeDeclaration, Constant, RasterDeclaration, Sampled, Stored, Table, Varying
from ...device.interface import Device, Texture, TextureFormat
from ...device.owned import Owned, Shared
from ..bounds import SceneBounds, cullable_instances
from ..scene import Camera
from ..settings import Settings
from ..steps import Allocation, compiling, compiling_raster, run_steps
from .opacity_maps import of_cut_outs
from .scene_data import SCENE_DEFINES, SCENE_TEXTURES, SceneData, portions
from .tiles import PROBES_FLAG, SIZE_CONSTANTS, TILE_CONSTANTS, TILE_DEFINES, TILE_PX, TILE_TEXTURES, Tiles, TileSplit, grid_shape

MAX_SAMPLES_PER_PX = 6
"""visibility samples along a pixel's side: as many as there are offsets, or as the settings leave texels for"""
"""400 MiB of visibility and depth"""
TRIANGLES_A_PORTION = 1 << 18
"""that a software rasterizer draws without a pause: .03 to .06 s of its time"""

VISIBILITY = RasterDeclaration(
    name="visibility",
    text="rasterizes instance and triangle numbers",
    vertex_source="visibility.vert.glsl",
    fragment_source="visibility.frag.glsl",
    textures={"instances": SCENE_TEXTURES["instances"]},
    constants={
        "clip_from_world": Constant("mat4", "of the camera, shifted by the sub-pixel offset"),
        "first_instance": Constant("int", "instance number of the draw's first instance"),
        "first_triangle": Constant("int", "number of the draw's first triangle in its mesh"),
        "is_orthographic": Constant("int", "1: seen along one direction"),
    },
    varyings={
        "instance_id": Varying("int", "flat", "instance number"),
        "tie_breaker": Varying("int", "flat", "3 bits of where one of the triangle's corners is in its mesh"),
    },
    output_name="visible",
    output_type="uvec2",
    writes_depth=True,
    defines=SCENE_DEFINES,
)

VISIBILITY_OF_CUT_OUTS = of_cut_outs(
    VISIBILITY,
    "visibility_of_cut_outs",
    "rasterizes instance and triangle numbers of what has an opacity map",
    {"rasterization": Constant("int", "its number: each has thresholds of its own")},
)

SURFACE = ComputeDeclaration(
    name="surface",
    text="positions and normals from visibility",
    source="surface.comp.glsl",
    local_size=(TILE_PX, TILE_PX, 1),
    textures={
        **SCENE_TEXTURES,
        "corner_normals": Sampled("sampler2D", "three packed normals of every triangle of meshes that need them"),
        "visibility": Sampled("usampler2D", "instance number + 1 and triangle number", channel_count=2),
        **TILE_TEXTURES,
    },
    images={
        "positions": Stored("RGBA32F", "read_write", "position (world space) and instance number, -1 for the background"),
        "normals": Stored("RGBA32F", "read_write", "geometric normal (world space, towards the eye) and packed shading normal"),
    },
    constants={
        **SIZE_CONSTANTS,
        **TILE_CONSTANTS,
        "margin_px": Constant("int", "pixels around the picture that visibility has too: filters reach beyond its edge"),
        "samples_per_px": Constant("int", "visibility samples along a pixel's side"),
        "sample_x": Constant("int", "which of them, counted from the pixel's first; may be a neighbour's"),
        "sample_y": Constant("int", "the same in y"),
    },
    tables={"eye": Table(5, "from the eye to the image plane at pixel (0, 0), steps a pixel in x and y, eye (w: orthographic), direction")},
    flags=PROBES_FLAG,
    defines={**SCENE_DEFINES, **TILE_DEFINES},
)

SURFACE_WITH_TRIANGLES = replace(
    SURFACE,
    name="surface_with_triangles",
    text="the same, and where in which triangle that is",
    images={**SURFACE.images, "surfaces": Stored("RGBA32F", "write", "triangle number, weights of its second and third corner")},
    defines={**SURFACE.defines, "WITH_TRIANGLES": 1},
)


def _surface_declaration(with_triangles: bool) -> ComputeDeclaration:
    return SURFACE_WITH_TRIANGLES if with_triangles else SURFACE


def compiling_eye(device: Device, with_triangles: bool) -> Generator[None, None, None]:
    """What every `EyePass` runs, in steps."""
    yield from compiling_raster(device, VISIBILITY)
    yield from compiling(device, _surface_declaration(with_triangles))


def clip_from_view(camera: Camera, near_m: float, far_m: float) -> np.ndarray:
    """(4, 4) float64 OpenGL projection of the camera's window."""
    left, right, bottom, top = camera.window
    m = np.zeros((4, 4))
    m[0, 0], m[1, 1] = 2 / (right - left), 2 / (top - bottom)
    m[1, 0] = -camera.skew * m[1, 1]
    if camera.is_orthographic:
        m[:2, 3] = -(right + left) / (right - left), -(top + bottom) / (top - bottom)
        m[2, 2:] = -2 / (far_m - near_m), -(far_m + near_m) / (far_m - near_m)
        m[3, 3] = 1
    else:
        m[:2, 2] = (right + left) / (right - left), (top + bottom) / (top - bottom)
        m[2, 2:] = -(far_m + near_m) / (far_m - near_m), -2 * far_m * near_m / (far_m - near_m)
        m[3, 2] = -1
    return m


class GBuffer(NamedTuple):
    """Textures of what the pixels see at one sub-pixel offset."""

    positions: Texture
    normals: Texture


class EyePass(Shared):
    """Renders G-buffers of the snapshot's camera; `buffers` holds those of the current batch."""

    def __init__(
        self,
        scene_data: SceneData,
        bounds: SceneBounds,
        offsets_px: np.ndarray,
        samples_per_batch: int = 1,
        with_triangles: bool = False,
        visibility_texel_count: int = Settings.visibility_texel_count,
    ) -> None:
        """offsets_px: (n, 2) sub-pixel offsets from pixels' centres that `render` chooses among
        with_triangles: also tell which triangles pixels see (`triangles`)
        visibility_texel_count: as of `Settings`"""
        snapshot, device = scene_data.snapshot, scene_data.device
        self.camera, self.size = snapshot.camera, (snapshot.width_px, snapshot.height_px)
        self.scene_data, self.device = scene_data, device
        self.margin_px = _margin_px(offsets_px)
        self.samples_per_px = visibility_samples_per_px(offsets_px, self.size, visibility_texel_count, device.max_texture_size_px)
        self.visibility_index, self.base_offsets_px, self.samples = share_visibility(offsets_px, self.samples_per_px)
        self._current_visibility = -1
        self._indices: Sequence[int] = ()
        """of the current batch's offsets"""
        self.rasterize = device.raster_kernel(VISIBILITY)
        self.surface_declaration = _surface_declaration(with_triangles)
        self.surface = device.compute_kernel(self.surface_declaration)
        # An orthographic camera sees from infinitely far away, as far as culling can tell, and in a mirrored picture front faces are wound
        # like back faces: everything is drawn.
        eye_ws = snapshot.camera.world_from_view[None, :3, 3]
        draws_all = snapshot.camera.is_orthographic or snapshot.camera.is_mirrored
        culled = None if draws_all else cullable_instances(snapshot, bounds, eye_ws)
        visible = snapshot.instances.visible_to_camera
        draws = scene_data.draws(np.flatnonzero(visible & ~scene_data.cut_out), culled)
        self.portions = list(portions(draws, TRIANGLES_A_PORTION)) if device.is_software else [draws]
        """what is rasterized without a pause"""
        self.cut_out_draws = scene_data.draws(np.flatnonzero(visible & scene_data.cut_out))
        self._samples_per_batch, self._with_triangles = samples_per_batch, with_triangles
        self.buffers: list[GBuffer] = []
        """from the first rendering on"""
        self.triangles: list[Texture] = []
        """of each of the batch's samples: where in which triangle pixels see something"""
        self.tiles = TileSplit(device, np.ones(grid_shape(*self.size), bool))
        """walked: what some light still looks up"""
        self._owned = Owned()

    def _allocating(self) -> Generator[None, None, None]:
        """Create what is rendered into. Closed halfway it leaves nothing."""
        create, count = self.device.create_texture, self._samples_per_batch
        with Owned() as owned:
            allocation = Allocation(owned)
            visibility = yield from allocation.keeping(create, *self._visibility_size, TextureFormat.RG32UI)
            depth = yield from allocation.keeping(create, *self._visibility_size, TextureFormat.DEPTH32F)
            target = owned.own(self.device.create_target(visibility, depth))
            textures = []
            for _ in range((2 + self._with_triangles) * count):
                textures.append((yield from allocation.keeping(create, *self.size, TextureFormat.RGBA32F)))
            self.visibility, self.depth, self.target = visibility, depth, target
            self.buffers = [GBuffer(*pair) for pair in zip(textures[:count], textures[count : 2 * count], strict=True)]
            self.triangles = textures[2 * count :]
            self._owned = owned.pop_all()

    @property
    def _visibility_size(self) -> tuple[int, int]:
        return _visibility_size(self.size, self.margin_px, self.samples_per_px)

    def render(self, indices: Sequence[int], batch: int) -> None:
        """A G-buffer of each offset with these numbers, in the wanted tiles and at the batch's probes of all others; elsewhere they keep
        what they have."""
        run_steps(self.rendering(indices, batch))

    def rendering(self, indices: Sequence[int], batch: int) -> Generator[None, None, None]:
        """`render`, pausing while triangles are rasterized and once all are, and where a kernel is compiled or much memory is taken."""
        if not self.buffers:
            yield from self._allocating()
        self._indices = indices
        for part, index in enumerate(indices):
            if (yield from self._seeing(index)):
                yield
            bindings = self._bindings(part, index)
            yield from self.tiles.walked.walking(self.surface, **bindings)
            if self.tiles.probed.count:
                kernel = yield from compiling(self.device, self.surface_declaration, "PROBES")
                yield from self.tiles.probed.probing(kernel, batch, **bindings)

    def _seeing(self, index: int) -> Generator[None, None, bool]:
        """Have `visibility` be that of an offset; returns whether it was another."""
        number = int(self.visibility_index[index])
        if number == self._current_visibility:
            return False
        self._current_visibility = -1
        yield from self._rasterizing(self.base_offsets_px[number] + 0.5 - 0.5 / self.samples_per_px, number)
        self._current_visibility = number
        return True

    def _bindings(self, part: int, index: int) -> dict[str, Any]:
        """What SURFACE is bound to for an offset, the batch's part-th."""
        triangles = {"surfaces": self.triangles[part]} if self.triangles else {}
        return {**self._surface_bindings(index, self.buffers[part]), **triangles}

    def want_only(self, wanted: np.ndarray) -> None:
        """From now on render these tiles only, (rows, columns) bool."""
        tiles = TileSplit(self.device, wanted)
        self.tiles.release()
        self.tiles = tiles

    def want_all(self) -> None:
        if not self.tiles.is_walked.all():
            self.want_only(np.ones_like(self.tiles.is_walked))

    def want_also(self, added: np.ndarray) -> None:
        """Render these tiles as well, from this batch on, (rows, columns) bool."""
        missing = added & ~self.tiles.is_walked
        if missing.any():
            with Owned() as temporary:
                tiles = temporary.own(Tiles(self.device, missing))
                for part, index in enumerate(self._indices):
                    run_steps(self._seeing(index))
                    tiles.dispatch(self.surface, **self._bindings(part, index))
            self.want_only(self.tiles.is_walked | missing)

    def _surface_bindings(self, index: int, buffer: GBuffer) -> dict[str, Any]:
        width, height = self.size
        sample = self.samples[index]
        return {
            **self.scene_data.bindings,
            **buffer._asdict(),
            "corner_normals": self.scene_data.corner_normals,
            "visibility": self.visibility,
            "width": width,
            "height": height,
            "margin_px": self.margin_px,
            "samples_per_px": self.samples_per_px,
            "sample_x": int(sample[0]),
            "sample_y": int(sample[1]),
            "eye": self.eye_table(index),
        }

    def _rasterizing(self, shift_px: np.ndarray, visibility_number: int) -> Generator[None, None, None]:
        """Pauses between portions of triangles. shift_px: (2,) from a pixel's centre to the middle between its samples"""
        width, height = self.size
        scale = np.eye(4)
        margin = 2 * self.margin_px
        scale[0, 0], scale[1, 1] = width / (width + margin), height / (height + margin)
        scale[:2, 3] = -2 * shift_px[0] / (width + margin), -2 * shift_px[1] / (height + margin)
        projection = clip_from_view(self.camera, self.camera.clip_start_m, self.camera.clip_end_m)
        self.device.fill(self.visibility, 0)
        self.device.fill(self.depth, 0)
        viewport = (0, 0, *self._visibility_size)
        clip_from_world = scale @ projection @ np.linalg.inv(self.camera.world_from_view)
        bindings = {
            "clip_from_world": clip_from_world,
            "instances": self.scene_data.instances,
            "first_triangle": 0,
            "is_orthographic": int(self.camera.is_orthographic),
        }
        for number, draws in enumerate(self.portions):
            if number:
                yield
            self.rasterize.draw(self.target, viewport, draws, **bindings)
        if self.scene_data.opacity_maps is not None:
            kernel = yield from compiling_raster(self.device, VISIBILITY_OF_CUT_OUTS)
            kernel.draw(
                self.target,
                viewport,
                self.cut_out_draws,
                **bindings,
                **self.scene_data.opacity_maps.bindings,
                rasterization=visibility_number,
            )

    def eye_table(self, index: int) -> np.ndarray:
        """(5, 4) rows of the table `eye` for the offset of this number"""
        offset_px = self.base_offsets_px[self.visibility_index[index]] + self.samples[index] / self.samples_per_px
        width, height = self.size
        left, right, bottom, top = self.camera.window
        step_x, step_y = (right - left) / width, (top - bottom) / height
        rotation, eye = self.camera.world_from_view[:3, :3], self.camera.world_from_view[:3, 3]
        plane_z = 0.0 if self.camera.is_orthographic else -1.0
        # from the eye: near 1 m off, it would drown in the rounding of an eye that stands kilometres from the origin
        x = left + step_x * offset_px[0]
        corner = rotation @ [x, bottom + step_y * offset_px[1] + self.camera.skew * x, plane_z]
        table = np.zeros((5, 4))
        table[:, :3] = corner, rotation @ [step_x, self.camera.skew * step_x, 0.0], rotation[:, 1] * step_y, eye, -rotation[:, 2]
        table[3, 3] = self.camera.is_orthographic
        return table

    def _free(self) -> None:
        self.tiles.release()
        self._owned.close()


def visibility_samples_per_px(offsets_px: np.ndarray, size: tuple[int, int], texel_count: int, max_side_px: float = math.inf) -> int:
    """Along a pixel's side. offsets_px: (n, 2); size: of the picture, width and height; texel_count: as of
    `Settings.visibility_texel_count`; max_side_px: of a texture"""
    most = min(math.ceil(math.sqrt(len(offsets_px))), MAX_SAMPLES_PER_PX)
    for samples_per_px in range(most, 1, -1):
        visibility_size = _visibility_size(size, _margin_px(offsets_px), samples_per_px)
        if max(visibility_size) <= max_side_px and math.prod(visibility_size) <= texel_count:
            return samples_per_px
    return 1


def least_visibility_size(size: tuple[int, int], offsets_px: np.ndarray) -> tuple[int, int]:
    """Width and height of the largest texture that a picture of this size takes, with one visibility sample a pixel."""
    return _visibility_size(size, _margin_px(offsets_px), 1)


def _margin_px(offsets_px: np.ndarray) -> int:
    return math.ceil(np.abs(offsets_px).max()) + 1


def _visibility_size(size: tuple[int, int], margin_px: int, samples_per_px: int) -> tuple[int, int]:
    width, height = size
    return samples_per_px * (width + 2 * margin_px), samples_per_px * (height + 2 * margin_px)


def share_visibility(offsets_px: np.ndarray, samples_per_px: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which offsets share a rasterization: (n,) its number, (m, 2) where the samples of each lie, (n, 2) int64 samples.

    Offset i becomes base[index[i]] + samples[i] / samples_per_px. Consecutive offsets share a base, within half a sample of 0; the
    first of them is exact, the others are moved to the nearest sample.
    """
    index = np.arange(len(offsets_px)) // samples_per_px**2
    first = offsets_px[:: samples_per_px**2]
    base = first - np.round(first * samples_per_px) / samples_per_px
    return index, base, np.round((offsets_px - base[index]) * samples_per_px).astype(np.int64)
