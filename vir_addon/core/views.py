"""Views of a light and how they are fitted.

Face space of a light: origin at the light's centre, axes (right, up, forward), forward being the direction of sight;
z is linear depth in metres and a point projects to tangents (x/z, y/z). One face looks along the light's axis (points and spots: one
of its axes) as long as all receivers lie within MAX_SINGLE_FACE_TANGENT of it; otherwise it takes a cube, for area lights its front half.

All views of a face share its orientation and its texel size, they differ in the view's centre (the light sample) and in the
window's place on the texel lattice. Texel sizes come from a geometric ladder and windows start at whole texels, so a
moving camera shifts lattices by whole texels and shadows do not swim. What is measured in metres, for suns, hangs on the scene's largest
object: its size is a step of the ladder and its middle a place of the lattice, so the picture does not depend on units or the origin.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .scene import Light

MAX_SINGLE_FACE_TANGENT = math.tan(math.radians(50))
"""one frustum of at most 100 degrees; beyond it the texels at the rim become too much coarser than needed at the centre"""
LADDER_STEPS_PER_OCTAVE = 8
"""texel sizes are powers of 2^(1/8): at most 9 % of a map's width is lost to the ladder"""
WINDOW_MARGIN_TEXELS = 2
MAP_SIZE_STEP_PX = 32
"""of maps that are as large as the picture asks for: changes by less are not worth a change"""
MIN_PARALLAX_SHARE = 0.5
"""A map is at least this share as wide as its window wanders from view to view. A few pixels that see a corner of a room would
ask for any density of points over everything between them and the light, to resolve what its size blurs."""
LEAST_WIDTH = 1e-6
"""of a window, in the ladder's unit: one that nothing is seen in has a texel's size as well"""
MAX_LATTICE_INDEX = 1 << 18
"""float32 still tells thirty-second parts of a texel apart"""
LATTICE_STRIDE = 1 << 12
"""texels by which a sun's face space is moved to the picture: where windows move by less it stays, to the last bit"""
NEAR_SHARE_OF_FAR = 1e-4
"""Surfaces nearer to a view than this share of the farthest receiver neither cast nor count: the light touches them."""
MIN_RECEIVER_MARGIN = 0.02
"""Windows are wider than the receivers seen first by this share: later eye samples shift by parts of a pixel and see a little more."""


@dataclass(frozen=True)
class Face:
    """An orientation that all views of a light share."""

    name: str
    index: int
    """0 front, then right, left, top, bottom, back: the axis of the light's space along which a direction is longest"""
    face_from_world: np.ndarray
    """(3, 3) float64 rows right, up, forward"""
    limits: tuple[float, float, float, float]
    """tangents left, right, bottom, top beyond which another face (or nothing) is responsible"""


def _rows(right: np.ndarray, up: np.ndarray, forward: np.ndarray) -> np.ndarray:
    return np.stack([right, up, forward])


def light_axes(light: Light) -> np.ndarray:
    """(3, 3) float64 rows right, up, forward of the light's space: lights with a direction shine along their -z. Left-handed, so
    that right x up points against forward, as on a screen seen by the light."""
    x, y, z = light.world_from_light[:3, :3].T
    return _rows(x, y, -z)


def area_light_faces(light: Light, needs_cube: bool) -> tuple[Face, ...]:
    right, up, forward = light_axes(light)
    if not needs_cube:
        t = MAX_SINGLE_FACE_TANGENT
        return (Face("front", 0, _rows(right, up, forward), (-t, t, -t, t)),)
    # the sides see only what lies before the light's plane: their forward half towards the axis
    return (
        Face("front", 0, _rows(right, up, forward), (-1, 1, -1, 1)),
        Face("right", 1, _rows(-forward, up, right), (-1, 0, -1, 1)),
        Face("left", 2, _rows(forward, up, -right), (0, 1, -1, 1)),
        Face("top", 3, _rows(right, -forward, up), (-1, 1, -1, 0)),
        Face("bottom", 4, _rows(right, forward, -up), (-1, 1, 0, 1)),
    )


def omni_faces(light: Light) -> tuple[Face, ...]:
    """The cube around a light that shines to all sides."""
    right, up, forward = light_axes(light)
    limits = (-1.0, 1.0, -1.0, 1.0)
    return (
        Face("front", 0, _rows(right, up, forward), limits),
        Face("right", 1, _rows(-forward, up, right), limits),
        Face("left", 2, _rows(forward, up, -right), limits),
        Face("top", 3, _rows(right, -forward, up), limits),
        Face("bottom", 4, _rows(right, forward, -up), limits),
        Face("back", 5, _rows(-right, up, -forward), limits),
    )


def single_omni_face(light: Light, receivers_ws: np.ndarray, samples_m: np.ndarray) -> Face | None:
    """One frustum of at most 100 degrees along one of the light's axes, the first that has all receivers in it as seen from any
    light sample; None when it takes a cube. Other axes than the light's own would turn with the camera, and shadows swim."""
    t = MAX_SINGLE_FACE_TANGENT
    for face in omni_faces(light):
        if fits_single_face(face, light, receivers_ws, samples_m):
            return Face(face.name, 0, face.face_from_world, (-t, t, -t, t))
    return None


def fits_single_face(face: Face, light: Light, receivers_ws: np.ndarray, samples_m: np.ndarray) -> bool:
    """Whether a frustum of MAX_SINGLE_FACE_TANGENT in the face's direction holds all receivers, seen from any light sample."""
    p = (receivers_ws - light.world_from_light[:3, 3]) @ face.face_from_world.T
    spread = np.abs(samples_m @ light_axes(light) @ face.face_from_world.T).max(axis=0)
    reach = np.abs(p[:, :2]) + spread[:2]
    return bool((reach <= MAX_SINGLE_FACE_TANGENT * (1 - MIN_RECEIVER_MARGIN) * (p[:, 2:] - spread[2])).all())


@dataclass(frozen=True)
class FaceViews:
    """The views of one face, fitted. Lengths in metres, tangents without unit."""

    face: Face
    centers_fs: np.ndarray
    """(view_count, 3) float64 view centres in face space; of suns, within half a texel of its axis, as whole ones are the window's"""
    samples_m: np.ndarray
    """(view_count, 3) float64 the same in the light's space"""
    texel_tangent: tuple[float, float]
    """width and height of a texel in tangents, common to all views"""
    window_texels: np.ndarray
    """(view_count, 2) int64: the map's texel (0, 0) has this index on the lattice that starts at tangent 0"""
    map_width_px: int
    map_height_px: int
    near_m: float
    far_m: float
    origin_ws: np.ndarray
    """(3,) float64 world-space origin of face space: the light's centre; of suns, whole texels aside from the axis through the middle of
    the scene's largest object"""
    is_orthographic: bool = False
    """Views of a sun: texels and windows are in metres across its axis, samples are offsets a metre of depth."""

    @property
    def view_count(self) -> int:
        return len(self.centers_fs)

    @property
    def light_diameter_m(self) -> float:
        """of the ball around the middle of all view centres: diagonal of a rectangle, diameter of a sphere"""
        if self.is_orthographic:
            return 0.0
        middle = (self.centers_fs.min(axis=0) + self.centers_fs.max(axis=0)) / 2
        return 2 * float(np.linalg.norm(self.centers_fs - middle, axis=1).max())

    @property
    def is_planar(self) -> bool:
        """All views lie in the plane that the face looks away from: what is at one depth before one is so before all."""
        return not self.is_orthographic and bool(np.abs(self.centers_fs[:, 2]).max() <= 1e-9 * np.abs(self.centers_fs).max())

    def window_tangents(self, view: int) -> tuple[float, float, float, float]:
        """left, right, bottom, top"""
        (tx, ty), (x, y) = self.texel_tangent, self.window_texels[view]
        return x * tx, (x + self.map_width_px) * tx, y * ty, (y + self.map_height_px) * ty


def snap_up_to_ladder(size: float, unit: float = 1.0) -> float:
    """The smallest power of 2^(1/8), times the unit, that is at least `size`."""
    return unit * 2.0 ** (math.ceil(math.log2(size / unit) * LADDER_STEPS_PER_OCTAVE - 1e-9) / LADDER_STEPS_PER_OCTAVE)


def snap_down_to_ladder(size: float) -> float:
    """The largest power of 2^(1/8) that is at most `size`."""
    return 2.0 ** (math.floor(math.log2(size) * LADDER_STEPS_PER_OCTAVE + 1e-9) / LADDER_STEPS_PER_OCTAVE)


def fit_windows(
    face: Face,
    centers_fs: np.ndarray,
    samples_m: np.ndarray,
    windows: np.ndarray,
    resolution_px: int,
    near_m: float,
    far_m: float,
    origin_ws: np.ndarray,
    shear_depth_m: float | None = None,
    finest_tangent: float | None = None,
    unit: float = 1.0,
) -> FaceViews:
    """Place one map per view over its window.

    windows: (view_count, 4) float64 tangents (suns: metres) left, right, bottom, top that the maps must cover.
    shear_depth_m: of a sun, from the first caster to the last receiver; how far windows wander there is what parallax is to others.
    finest_tangent: texels need not be finer, and maps are then smaller than `resolution_px`, in steps of MAP_SIZE_STEP_PX.
    unit: a step of the ladder; of a sun, a length of the scene
    """
    is_sun = shear_depth_m is not None
    usable = resolution_px - 2 * WINDOW_MARGIN_TEXELS - 1
    tangents, sizes, middles = [], [], []
    coarsest = 0.0 if finest_tangent is None else snap_down_to_ladder(finest_tangent)
    for axis, (low, high) in enumerate((windows[:, :2].T, windows[:, 2:].T)):
        wander = float(np.ptp(low + high)) / 2 if shear_depth_m is None else float(np.ptp(samples_m[:, axis])) * shear_depth_m
        width = max(float((high - low).max()), MIN_PARALLAX_SHARE * wander, LEAST_WIDTH * unit)
        # a sun's lattice may begin anywhere, and begins beside the windows
        place = centers_fs[:, axis] if is_sun else 0.0
        middles.append(float((low + place).min() + (high + place).max()) / 2 if is_sun else 0.0)
        farthest = max(float(np.abs(low + place - middles[axis]).max()), float(np.abs(high + place - middles[axis]).max()))
        tangents.append(snap_up_to_ladder(max(width / usable, farthest / MAX_LATTICE_INDEX, coarsest), unit))
        needed = math.ceil(width / tangents[axis]) + resolution_px - usable
        steps = -(-needed // MAP_SIZE_STEP_PX)
        sizes.append(resolution_px if finest_tangent is None else min(steps * MAP_SIZE_STEP_PX, resolution_px))
    first = np.stack([np.floor(windows[:, 2 * axis] / tangents[axis]).astype(np.int64) - WINDOW_MARGIN_TEXELS for axis in (0, 1)], axis=-1)
    if is_sun:
        # by whole texels, so that what float32 holds is small: the lattice stays where it is
        aside, begin = np.rint(centers_fs[:, :2] / tangents), LATTICE_STRIDE * np.rint(middles / (LATTICE_STRIDE * np.array(tangents)))
        first += (aside - begin).astype(np.int64)
        centers_fs = centers_fs - np.pad(aside * tangents, ((0, 0), (0, 1)))
        origin_ws = origin_ws + (begin * tangents) @ face.face_from_world[:2]
    return FaceViews(
        face=face,
        centers_fs=centers_fs,
        samples_m=samples_m,
        texel_tangent=(tangents[0], tangents[1]),
        window_texels=first,
        map_width_px=sizes[0],
        map_height_px=sizes[1],
        near_m=near_m,
        far_m=far_m,
        origin_ws=origin_ws,
        is_orthographic=is_sun,
    )
