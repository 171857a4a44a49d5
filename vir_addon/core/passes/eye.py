"""The eye G-buffer: what every pixel sees, at a sub-pixel offset that changes from batch to batch."""

from __future__ import annotations

import numpy as np

from ...device.declaration import ComputeDeclaration, Constant, RasterDeclaration, Sampled, Stored, Table, Varying
from ...device.interface import Device, TextureFormat
from ..bounds import SceneBounds, cullable_instances
from ..scene import Camera, SceneSnapshot
from .scene_data import SCENE_DEFINES, SCENE_TEXTURES, SceneData

VISIBILITY = RasterDeclaration(
    name="visibility",
    text="rasterizes instance and triangle numbers",
    vertex_source="visibility.vert.glsl",
    fragment_source="visibility.frag.glsl",
    textures={"instances": SCENE_TEXTURES["instances"]},
    constants={
        "clip_from_world": Constant("mat4", "of the camera, shifted by the sub-pixel offset"),
        "first_instance": Constant("int", "instance number of the draw's first instance"),
    },
    varyings={"instance_id": Varying("int", "flat", "instance number")},
    output_name="visible",
    output_type="uvec2",
    defines=SCENE_DEFINES,
)

SURFACE = ComputeDeclaration(
    name="surface",
    text="positions and normals from visibility",
    source="surface.comp.glsl",
    local_size=(8, 8, 1),
    textures={
        **SCENE_TEXTURES,
        "corner_normals": Sampled("sampler2D", "three packed normals of every triangle of meshes that need them"),
        "visibility": Sampled("usampler2D", "instance number + 1 and triangle number"),
    },
    images={
        "positions": Stored("RGBA32F", "write", "position (world space) and instance number, -1 for the background"),
        "normals": Stored("RGBA32F", "write", "geometric normal (world space, towards the eye) and packed shading normal"),
    },
    constants={"width": Constant("int", "of the picture, pixels"), "height": Constant("int", "of the picture, pixels")},
    tables={"eye": Table(5, "point of the image plane at pixel (0, 0), steps per pixel in x and y, eye (w: orthographic), direction")},
    defines=SCENE_DEFINES,
)


def clip_from_view(camera: Camera, near_m: float, far_m: float) -> np.ndarray:
    """(4, 4) float64 OpenGL projection of the camera's window."""
    left, right, bottom, top = camera.window
    m = np.zeros((4, 4))
    m[0, 0], m[1, 1] = 2 / (right - left), 2 / (top - bottom)
    if camera.is_orthographic:
        m[:2, 3] = -(right + left) / (right - left), -(top + bottom) / (top - bottom)
        m[2, 2:] = -2 / (far_m - near_m), -(far_m + near_m) / (far_m - near_m)
        m[3, 3] = 1
    else:
        m[:2, 2] = (right + left) / (right - left), (top + bottom) / (top - bottom)
        m[2, 2:] = -(far_m + near_m) / (far_m - near_m), -2 * far_m * near_m / (far_m - near_m)
        m[3, 2] = -1
    return m


class EyePass:
    """Renders G-buffers of the snapshot's camera; `positions` and `normals` hold the latest."""

    def __init__(self, snapshot: SceneSnapshot, scene_data: SceneData, device: Device, bounds: SceneBounds) -> None:
        self.camera, self.size = snapshot.camera, (snapshot.width_px, snapshot.height_px)
        self.scene_data, self.device = scene_data, device
        width, height = self.size
        self.visibility = device.create_texture(width, height, TextureFormat.RG32UI)
        self.depth = device.create_texture(width, height, TextureFormat.DEPTH32F)
        self.target = device.create_target(self.visibility, self.depth)
        self.positions = device.create_texture(width, height, TextureFormat.RGBA32F)
        self.normals = device.create_texture(width, height, TextureFormat.RGBA32F)
        self.rasterize = device.raster_kernel(VISIBILITY)
        self.surface = device.compute_kernel(SURFACE)
        # an orthographic camera sees from infinitely far away, as far as culling can tell: everything is drawn
        eye_ws = snapshot.camera.world_from_view[None, :3, 3]
        culled = None if snapshot.camera.is_orthographic else cullable_instances(snapshot, bounds, eye_ws)
        self.draws = scene_data.draws(np.flatnonzero(snapshot.instances.visible_to_camera), culled)

    def render(self, offset_px: np.ndarray) -> None:
        """offset_px: (2,) sub-pixel offset of the sample from the pixel's centre"""
        width, height = self.size
        left, right, bottom, top = self.camera.window
        step_x, step_y = (right - left) / width, (top - bottom) / height
        shift = np.eye(4)
        shift[:2, 3] = -2 * offset_px[0] / width, -2 * offset_px[1] / height
        near, far = self.camera.clip_start_m, self.camera.clip_end_m
        view_from_world = np.linalg.inv(self.camera.world_from_view)
        clip_from_world = shift @ clip_from_view(self.camera, near, far) @ view_from_world
        self.device.fill(self.visibility, 0)
        self.device.fill(self.depth, 0)
        self.rasterize.draw(
            self.target, (0, 0, width, height), self.draws, clip_from_world=clip_from_world, instances=self.scene_data.instances
        )
        rotation, eye = self.camera.world_from_view[:3, :3], self.camera.world_from_view[:3, 3]
        plane_z = 0.0 if self.camera.is_orthographic else -1.0
        corner = eye + rotation @ [left + step_x * offset_px[0], bottom + step_y * offset_px[1], plane_z]
        table = np.zeros((5, 4))
        table[:, :3] = corner, rotation[:, 0] * step_x, rotation[:, 1] * step_y, eye, -rotation[:, 2]
        table[3, 3] = self.camera.is_orthographic
        self.surface.dispatch(
            (-(-width // 8), -(-height // 8), 1),
            **self.scene_data.bindings,
            corner_normals=self.scene_data.corner_normals,
            visibility=self.visibility,
            positions=self.positions,
            normals=self.normals,
            width=width,
            height=height,
            eye=table,
        )

    def release(self) -> None:
        for thing in (self.target, self.visibility, self.depth, self.positions, self.normals):
            thing.release()
