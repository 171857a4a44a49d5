"""The scene's camera, picture size and pixel filter -> `core.scene.Camera`, `PixelFilter`."""

from __future__ import annotations

from dataclasses import dataclass, replace

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
    world_from_view, is_mirrored = split_rigid(world_from_camera, name)
    window = _crop(compute_window(data, render, picture.frame_width_px, picture.frame_height_px), picture)
    if not np.isfinite(window).all() or window[0] == window[1] or window[2] == window[3]:
        raise SceneError(f"The camera '{name}' shows nothing: check its focal length, sensor or orthographic scale.")
    camera = Camera(
        name=name,
        is_orthographic=data.type == "ORTHO",
        world_from_view=world_from_view,
        window=window,
        clip_start_m=data.clip_start,
        clip_end_m=data.clip_end,
    )
    if is_mirrored:
        left, right, bottom, top = window
        return replace(camera, window=(-left, -right, bottom, top))
    return camera


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


def split_rigid(world_from_camera: np.ndarray, name: str) -> tuple[np.ndarray, bool]:
    """(4, 4) right-handed and orthonormal, and whether the camera was mirrored.

    Blender takes the lengths out of the axes. It leaves a mirrored camera mirrored, and its picture with it; here the x axis is turned
    round, and the caller turns the window round (left > right), which gives the same picture. Shear, which Blender passes on to the
    picture, is removed with the viewing direction kept: `shear_of` says how much there is.
    """
    axes = world_from_camera[:3, :3]
    lengths = np.linalg.norm(axes, axis=0)
    if not np.isfinite(world_from_camera).all() or (lengths == 0.0).any():
        raise SceneError(f"The camera '{name}' has a scale of zero or a position that is not a number. Reset its scale and position.")
    backward = axes[:, 2] / lengths[2]
    up = axes[:, 1] / lengths[1]
    up -= backward * (up @ backward)
    if np.linalg.norm(up) < 1e-6:
        raise SceneError(f"The camera '{name}' is sheared flat. Reset its scale and that of its parents.")
    up /= np.linalg.norm(up)
    right = np.cross(up, backward)
    world_from_view = np.eye(4)
    world_from_view[:3, :3] = np.stack([right, up, backward], axis=1)
    world_from_view[:3, 3] = world_from_camera[:3, 3]
    return world_from_view, bool(right @ axes[:, 0] < 0.0)


LARGEST_SHEAR = 1e-3
"""that is not worth a word: half a pixel at the edge of a thousand"""


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
