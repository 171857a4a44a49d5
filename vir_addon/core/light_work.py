"""One light's share of the streamed loop: its samples, fitted faces, method per face and running sums."""

from __future__ import annotations

import numpy as np

from ..device.interface import Device, Texture
from .fit import FittedFace, fit_light, instance_corners, select_receivers
from .methods import depth_map_method
from .methods.base import DepthMapMethod, cullable_instances
from .pass_set import PassStatistics
from .passes.accumulate import PassAccumulator
from .passes.eye import EyePass
from .passes.scene_data import SceneData
from .passes.shadow_maps import RESOLVE, DepthMaps, face_table, views_table
from .plan import PlannedPass, RenderPlan
from .sampling import area_light_samples
from .scene import Light, SceneSnapshot
from .settings import Method
from .stopwatch import Stopwatch


class MapStore:
    """Textures that all lights share because only one batch uses them at a time."""

    def __init__(self, device: Device, width: int, height: int) -> None:
        self.device = device
        self.batch_sums: Texture = device.upload_texture(np.zeros((height, width, 4), np.float32))
        self.no_receivers: Texture = device.upload_array(np.ones((1, 4), np.float32))
        self._maps: dict[tuple[int, int, int], DepthMaps] = {}

    def maps(self, width_px: int, height_px: int, view_count: int) -> DepthMaps:
        key = (max(width_px, 1), max(height_px, 1), view_count)
        if key not in self._maps:
            self._maps[key] = DepthMaps(self.device, *key)
        return self._maps[key]

    def release(self) -> None:
        for thing in (self.batch_sums, self.no_receivers, *self._maps.values()):
            thing.release()


class LightWork:
    def __init__(self, planned: PlannedPass, plan: RenderPlan, scene_data: SceneData, store: MapStore) -> None:
        snapshot = scene_data.snapshot
        self.planned, self.plan, self.scene_data, self.store = planned, plan, scene_data, store
        self.device = scene_data.device
        self.light: Light = next(light for light in snapshot.lights if light.name == planned.light_name)
        self.samples_m = area_light_samples(self.light, planned.view_count)
        self.accumulator = PassAccumulator(self.device, snapshot.width_px, snapshot.height_px)
        self.resolve_flags: list[str] = []
        self.receivers = store.no_receivers
        if self.light.receivers is not None:
            rows = np.zeros((len(self.light.receivers), 4), np.float32)
            rows[:, 0] = self.light.receivers
            self.receivers = self.device.upload_array(rows)
            self.resolve_flags.append("RECEIVER_LINKING")
        self.statistics = PassStatistics(
            planned.pass_name,
            planned.light_name,
            planned.method.value + (f" {planned.points.value}" if planned.points else ""),
            planned.reason,
            view_count=planned.view_count,
            map_resolution_px=planned.map_resolution_px,
        )
        self.faces: list[tuple[FittedFace, np.ndarray, DepthMapMethod | None]] = []

    def fit(self, snapshot: SceneSnapshot, eye: EyePass, stopwatch: Stopwatch) -> None:
        """Fit the views to the surfaces of the current eye G-buffer and make what all batches share."""
        with stopwatch.stage("points"):
            receivers = select_receivers(self.device.read(eye.positions), self.device.read(eye.normals), self.light)
            corners_ws = instance_corners(snapshot)
            fitted_faces, is_cube = fit_light(snapshot, self.light, self.samples_m, corners_ws, receivers, self.planned.map_resolution_px)
            if is_cube:
                self.resolve_flags.append("MANY_FACES")
            culled = cullable_instances(snapshot, self.light, self.samples_m)
            for fitted in fitted_faces:
                self.faces.append(self._face(fitted, culled))
            for _, _, method in self.faces:
                if method is not None:
                    method.prepare()
        self._update_statistics()

    def _face(self, fitted: FittedFace, culled: np.ndarray) -> tuple[FittedFace, np.ndarray, DepthMapMethod | None]:
        matrix = self.light.world_from_light
        table = face_table(fitted.views, matrix[:3, 3], -matrix[:3, 2], self.light.spread_rad)
        if not len(fitted.caster_indices):
            return fitted, table, None
        method = depth_map_method(
            self.planned, self.scene_data, fitted, table, culled, self.light, self.samples_m, self.plan.settings
        )
        return fitted, table, method

    def _update_statistics(self) -> None:
        methods = [method for _, _, method in self.faces if method is not None]
        self.statistics.face_count = len(self.faces)
        self.statistics.point_count = sum(method.point_count for method in methods)
        self.statistics.portion_count = max((method.portion_count for method in methods), default=1)
        self.statistics.caster_triangle_count = max((method.caster_triangle_count for method in methods), default=0)

    def batch_views(self, batch: int) -> range:
        """The views of a batch. A light with fewer views than there are batches shows one of them again in each."""
        views, batches = self.planned.view_count, self.plan.batch_count
        if views < batches:
            return range(batch % views, batch % views + 1)
        return range(batch * views // batches, (batch + 1) * views // batches)

    def render_batch(self, batch: int, eye: EyePass, stopwatch: Stopwatch) -> None:
        selected = self.batch_views(batch)
        self.accumulator.batch_count += 1
        for index, (fitted, table, method) in enumerate(self.faces):
            maps = self.store.maps(fitted.views.map_width_px, fitted.views.map_height_px, len(selected))
            if method is not None:
                with stopwatch.stage("splat or raster"):
                    method.fill(maps, selected)
            with stopwatch.stage("resolve"):
                self._resolve(eye, fitted, table, maps, selected, index)
        if self.planned.method is Method.IVIR:
            self._update_statistics()
        if not self.faces:
            with stopwatch.stage("resolve"):
                self._count_surfaces(eye)

    def _resolve(self, eye: EyePass, fitted: FittedFace, table: np.ndarray, maps: DepthMaps, selected: range, index: int) -> None:
        self._dispatch_resolve(
            eye, table, views_table(fitted.views, selected), len(selected), maps, first=index == 0, last=index == len(self.faces) - 1
        )

    def _count_surfaces(self, eye: EyePass) -> None:
        """Nothing visible is reached: surfaces still have to be told from the background."""
        self._dispatch_resolve(eye, np.zeros((8, 4)), np.zeros((2, 4)), 0, self.store.maps(1, 1, 1), first=True, last=True)

    def _dispatch_resolve(
        self, eye: EyePass, table: np.ndarray, views: np.ndarray, view_count: int, maps: DepthMaps, *, first: bool, last: bool
    ) -> None:
        width, height = eye.size
        self.device.compute_kernel(RESOLVE, *self.resolve_flags).dispatch(
            (-(-width // 8), -(-height // 8), 1),
            positions=eye.positions,
            normals=eye.normals,
            depth_maps=maps.texture,
            receivers=self.receivers,
            moments=self.accumulator.moments,
            coverage=self.accumulator.coverage,
            batch_sums=self.store.batch_sums,
            width=width,
            height=height,
            view_count=view_count,
            first_face=int(first),
            last_face=int(last),
            face=table,
            views=views,
        )

    def release(self) -> None:
        for _, _, method in self.faces:
            if method is not None:
                method.release()
        self.accumulator.release()
        if self.receivers is not self.store.no_receivers:
            self.receivers.release()
