"""The scene's camera, picture size and pixel filter -> `core.scene.Camera`, `PixelFilter`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import bpy
import numpy as np

from ...core.errors import SceneError
from ...core.scene import Camera, FilterShape, PixelFilter

Window = tuple[float, float, float, float]
"""left, right, bottom, top; of the plane at distance 1 m (perspective) or in metres (orthographic)"""


@dataclass(frozen=True)
class Picture:
    """What is rendered: the frame as a whole, or the region that a cropping render border leaves of it."""

    width_px: int
    height_px: int
    frame_width_px: int
    frame_height_px: int
    left_px: int = 0
    """first column of the region in the frame"""
    bottom_px: int = 0


def extract_picture(render: bpy.types.RenderSettings, resolution: tuple[int, int] | None) -> Picture:
    """Pixel sizes as Blender rounds them.

    resolution: width and height of the frame in place of the scene's, percentage included; a cropping border still crops it.
    """
    if resolution is None:
        width_px = render.resolution_x * render.resolution_percentage // 100
        height_px = render.resolution_y * render.resolution_percentage // 100
    else:
        width_px, height_px = resolution
    if width_px < 1 or height_px < 1:
        raise SceneError(f"The picture would be {width_px} x {height_px} pixels. Raise the resolution or its percentage.")
    if not (render.use_border and render.use_crop_to_border):
        return Picture(width_px, height_px, width_px, height_px)
    left_px, right_px = (_border_px(edge, width_px) for edge in (render.border_min_x, render.border_max_x))
    bottom_px, top_px = (_border_px(edge, height_px) for edge in (render.border_min_y, render.border_max_y))
    if right_px <= left_px or top_px <= bottom_px:
        raise SceneError("The render border holds no pixel. Draw a larger one, or switch it off.")
    return Picture(right_px - left_px, top_px - bottom_px, width_px, height_px, left_px, bottom_px)


def _border_px(edge: float, size_px: int) -> int:
    """Blender multiplies in single precision and cuts off; with double precision one border in some thousands is a pixel off."""
    return int(np.float32(edge) * np.float32(size_px))


def extract_camera(
    camera_object: bpy.types.Object | None, render: bpy.types.RenderSettings, picture: Picture, world_origin_m: np.ndarray
) -> Camera:
    """camera_object: evaluated. world_origin_m: (3,) float64, subtracted from its position."""
    if camera_object is None:
        raise SceneError("The scene has no camera. Add one, or make one the active camera.")
    name = camera_object.name
    data = camera_object.data
    if camera_object.type != "CAMERA":
        raise SceneError(f"The active camera '{name}' is a {camera_object.type.lower()}, not a camera. Choose a camera.")
    if data.type not in ("PERSP", "ORTHO"):
        kind = "panoramic" if data.type == "PANO" else data.type.lower()
        raise SceneError(f"The camera '{name}' is {kind}. Only perspective and orthographic cameras can be rendered.")
    world_from_camera = np.array(camera_object.matrix_world, dtype=np.float64)
    world_from_camera[:3, 3] -= world_origin_m
    is_orthographic = data.type == "ORTHO"
    parted = split_rigid(world_from_camera, name, is_orthographic=is_orthographic)
    window = _crop(compute_window(data, render, picture.frame_width_px, picture.frame_height_px), picture)
    if not np.isfinite(window).all() or window[0] == window[1] or window[2] == window[3]:
        raise SceneError(f"The camera '{name}' shows nothing: check its focal length, sensor or orthographic scale.")
    return Camera(
        name=name,
        is_orthographic=is_orthographic,
        world_from_view=parted.world_from_view,
        window=parted.window(window),
        clip_start_m=parted.depth * data.clip_start,
        clip_end_m=parted.depth * data.clip_end,
        skew=parted.skew,
    )


def compute_window(data: bpy.types.Camera, render: bpy.types.RenderSettings, width_px: int, height_px: int) -> Window:
    """The view plane of the whole frame, as `BKE_camera_params_compute_viewplane` makes it."""
    aspect_x, aspect_y = render.pixel_aspect_x, render.pixel_aspect_y
    height_in_widths = height_px * aspect_y / aspect_x
    """the frame's height in units of a pixel's width"""
    is_fit_to_width = data.sensor_fit == "HORIZONTAL" or (data.sensor_fit == "AUTO" and width_px * aspect_x >= height_px * aspect_y)
    fitted = width_px if is_fit_to_width else height_in_widths
    if data.type == "ORTHO":
        fitted_size = data.ortho_scale
    else:
        sensor_mm = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
        fitted_size = sensor_mm / data.lens
    pixel_size = fitted_size / fitted
    centre_x, centre_y = data.shift_x * fitted, data.shift_y * fitted
    return (
        (centre_x - 0.5 * width_px) * pixel_size,
        (centre_x + 0.5 * width_px) * pixel_size,
        (centre_y - 0.5 * height_in_widths) * pixel_size,
        (centre_y + 0.5 * height_in_widths) * pixel_size,
    )


def _crop(window: Window, picture: Picture) -> Window:
    left, right, bottom, top = window
    per_column = (right - left) / picture.frame_width_px
    per_row = (top - bottom) / picture.frame_height_px
    return (
        left + per_column * picture.left_px,
        left + per_column * (picture.left_px + picture.width_px),
        bottom + per_row * picture.bottom_px,
        bottom + per_row * (picture.bottom_px + picture.height_px),
    )


@dataclass(frozen=True)
class RigidCamera:
    """A camera's matrix, parted into a rigid one and what that does not hold of its window."""

    world_from_view: np.ndarray
    """(4, 4) float64 right-handed and orthonormal"""
    width: float
    """what the window's sides are multiplied with; negative for a mirrored camera"""
    height: float
    shift: tuple[float, float]
    """what is added to them then"""
    depth: float
    """along the view's axis, of what lies one unit along the camera's"""
    skew: float
    """as of `Camera`"""

    def window(self, sides: Window) -> Window:
        left, right, bottom, top = sides
        x, y = self.shift
        return self.width * left + x, self.width * right + x, self.height * bottom + y, self.height * top + y


def split_rigid(world_from_camera: np.ndarray, name: str, *, is_orthographic: bool = False) -> RigidCamera:
    """Blender takes the lengths out of the axes. It leaves a mirrored camera mirrored, a sheared one sheared, and the picture with it.

    A camera with the unit axes X, Y, Z shows at (u, v) of its plane what lies along u X + v Y - Z. The view looks across the plane of X and
    Y, with Y upright. Its axes have X at (a, b, 0), Y at (0, d, 0) and Z at (c, e, f), so that place is seen under the tangents
    ((a u - c) / f, (b u + d v - e) / f). Orthographic cameras look along Z, and X and Y are seen as far as they lie across it.
    """
    axes = world_from_camera[:3, :3]
    lengths = np.linalg.norm(axes, axis=0)
    if not np.isfinite(world_from_camera).all() or (lengths == 0.0).any():
        raise SceneError(f"The camera '{name}' has a scale of zero or a position that is not a number. Reset its scale and position.")
    is_sheared = shear_of(axes) > ROUNDED_SHEAR
    x, y, z = (axes / lengths).T
    normal = np.cross(x, y)
    if min(np.linalg.norm(normal), abs(normal @ z)) < FLAT:
        raise SceneError(f"The camera '{name}' is sheared flat. Reset its scale and that of its parents.")
    backward = z
    if is_sheared and not is_orthographic:
        backward = math.copysign(1.0, normal @ z) * normal / np.linalg.norm(normal)
    up = y - backward * (y @ backward)
    up /= np.linalg.norm(up)
    right = np.cross(up, backward)
    world_from_view = np.eye(4)
    world_from_view[:3, :3] = np.stack([right, up, backward], axis=1)
    world_from_view[:3, 3] = world_from_camera[:3, 3]
    a, b, d = float(x @ right), float(x @ up), float(y @ up)
    c, e, f = (float(z @ axis) for axis in (right, up, backward))
    if not is_sheared:
        return RigidCamera(world_from_view, math.copysign(1.0, a), 1.0, (0.0, 0.0), 1.0, 0.0)
    skew = b / a
    return RigidCamera(world_from_view, a / f, d / f, (-c / f, (skew * c - e) / f), f, skew)


FLAT = 1e-6
"""sine of the angle between axes that are taken for one direction"""
ROUNDED_SHEAR = 1e-6
"""of axes that are perpendicular in single precision"""


def shear_of(axes: np.ndarray) -> float:
    """Cosine between those of the (3, n) axes that are the least perpendicular to each other."""
    lengths = np.linalg.norm(axes, axis=0)
    unit = axes / np.where(lengths > 0.0, lengths, 1.0)
    return float(np.abs(np.triu(unit.T @ unit, 1)).max())


def extract_pixel_filter(scene: bpy.types.Scene, engine: str) -> PixelFilter:
    """The full width of the filter's support, which no engine's setting is.

    Cycles widens its setting inside: Blackman-Harris by 2, Gauss by 3 (so exp(-8 x^2 / setting^2), sigma = full width / 12), box not.
    EEVEE takes the setting as the radius of (a Gauss curve fitted to) Blackman-Harris; 1.5 pixels mean the same in both.
    """
    if engine != "CYCLES" or not hasattr(scene, "cycles"):
        return PixelFilter(FilterShape.BLACKMAN_HARRIS, 2.0 * scene.render.filter_size)
    setting_px = scene.cycles.filter_width
    match scene.cycles.pixel_filter_type:
        case "BOX":
            return PixelFilter(FilterShape.BOX, setting_px)
        case "GAUSSIAN":
            return PixelFilter(FilterShape.GAUSSIAN, 3.0 * setting_px)
        case _:
            return PixelFilter(FilterShape.BLACKMAN_HARRIS, 2.0 * setting_px)
