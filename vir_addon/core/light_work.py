"""One light's share of the streamed loop: its samples, fitted faces, method per face and running sums."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..device.interface import Device, Texture
from ..device.owned import Owned
from .bounds import cullable_instances
from .fit import FittedFace, fit_light, light_hull, select_receivers
from .methods import depth_map_method
from .methods.base import DepthMapMethod, FaceJob
from .methods.shared import SharedByFaces
from .pass_set import PassStatistics
from .passes.accumulate import MIN_SETTLING_BATCHES, MIN_SETTLING_VIEWS, PassAccumulator
from .passes.eye import EyePass
from .passes.scene_data import SceneData
from .passes.shadow_maps import RESOLVE, DepthMaps, face_table, samples_table, views_table
from .plan import NO_MAP_REASON, PlannedPass, RenderPlan
from .sampling import light_samples, sample_weights
from .scene import Light, LightShape
from .settings import Resolve, Settings
from .stopwatch import Stopwatch


class MapStore:
    """Textures that all lights share because only one batch uses them at a time."""

    def __init__(self, device: Device, width: int, height: int, settings: Settings) -> None:
        self.device = device
        self._maps: dict[tuple[int, int, int], DepthMaps] = {}
        with Owned() as owned:
            self.shared = owned.own(SharedByFaces(device, settings))
            self.batch_sums: Texture = owned.own(device.upload_texture(np.zeros((height, width, 4), np.float32)))
            self.no_receivers: Texture = owned.own(device.upload_array(np.ones((1, 4), np.float32)))
            self._owned = owned.pop_all()

    def maps(self, width_px: int, height_px: int, view_count: int) -> DepthMaps:
        key = (max(width_px, 1), max(height_px, 1), view_count)
        if key not in self._maps:
            self._maps[key] = self._owned.own(DepthMaps(self.device, *key))
        return self._maps[key]

    def release(self) -> None:
        self._owned.close()


class LightWork:
    def __init__(self, planned: PlannedPass, plan: RenderPlan, scene_data: SceneData, store: MapStore) -> None:
        snapshot = scene_data.snapshot
        self.planned, self.plan, self.scene_data, self.store = planned, plan, scene_data, store
        self.device = scene_data.device
        self.light: Light = next(light for light in snapshot.lights if light.name == planned.light_name)
        self.samples_m = light_samples(self.light, planned.view_count)
        self.sample_weights = sample_weights(self.light, self.samples_m)
        self.resolve_flags: list[str] = []
        if planned.method.uses_points:
            self.resolve_flags.append("POINT_MAPS")
        if self.light.shape.is_omni:
            self.resolve_flags += ["OMNI"] + ["SPHERE"] * (planned.view_count > 1) + ["CONE"] * (self.light.shape is LightShape.SPOT)
        if self.light.shape is LightShape.SUN:
            self.resolve_flags.append("ORTHOGRAPHIC")
        self.receivers = store.no_receivers
        with Owned() as owned:
            self.accumulator = owned.own(PassAccumulator(self.device, snapshot.width_px, snapshot.height_px))
            if self.light.receivers is not None:
                rows = np.zeros((len(self.light.receivers), 4), np.float32)
                rows[:, 0] = self.light.receivers
                self.receivers = owned.own(self.device.upload_array(rows))
                self.resolve_flags.append("RECEIVER_LINKING")
            self._owned = owned.pop_all()
        self.statistics = PassStatistics(
            planned.pass_name,
            planned.light_name,
            planned.method.value + (f" {planned.points.value}" if planned.points else ""),
            planned.reason,
            view_count=planned.view_count,
            map_resolution_px=planned.map_resolution_px,
        )
        self.faces: list[tuple[FittedFace, np.ndarray, DepthMapMethod | None]] = []
        self.reference_m = 1.0
        """distance at which the light delivers 1 in the running sums, which keeps them near 1 in scenes of any scale"""

    def fit(self, positions: np.ndarray, normals: np.ndarray, stopwatch: Stopwatch) -> None:
        """Fit the views to the surfaces of an eye G-buffer, (height, width, 4) each, and make what all batches share."""
        with stopwatch.stage("points"):
            snapshot, bounds = self.scene_data.snapshot, self.plan.bounds
            receivers = select_receivers(positions, normals, self.light)
            fitted_faces, is_cube = fit_light(snapshot, self.light, self.samples_m, bounds, receivers, self.planned.map_resolution_px)
            if is_cube:
                self.resolve_flags.append("MANY_FACES")
            is_sun = self.light.shape is LightShape.SUN
            if not is_sun:
                self.reference_m = max((fitted.views.far_m for fitted in fitted_faces), default=1.0)
            culled = cullable_instances(snapshot, bounds, None if is_sun else light_hull(self.light, self.samples_m))
            self.faces = [self._face(fitted, culled) for fitted in fitted_faces]
        for _, _, method in self.faces:
            if method is not None:
                with stopwatch.stage("points"):
                    method.prepare()
        if not any(method for _, _, method in self.faces):
            self.statistics.method, self.statistics.map_resolution_px = "none", 0
            if self.planned.needs_maps:
                self.statistics.reason = f"{self.planned.reason}; {NO_MAP_REASON}"
        self._update_statistics()

    def _face(self, fitted: FittedFace, culled: np.ndarray) -> tuple[FittedFace, np.ndarray, DepthMapMethod | None]:
        table = face_table(fitted.views, self.light, self.reference_m)
        if not len(fitted.caster_indices):
            return fitted, table, None
        job = FaceJob(self.scene_data, fitted, table, culled, self.light, self.samples_m, self.plan.settings, self.store.shared)
        return fitted, table, self._owned.own(depth_map_method(self.planned, job))

    def _update_statistics(self) -> None:
        methods = [method for _, _, method in self.faces if method is not None]
        self.statistics.face_count = len(self.faces)
        self.statistics.settled_share = self.accumulator.settled_share
        for field in methods[0].counts() if methods else ():
            setattr(self.statistics, field, sum(method.counts()[field] for method in methods))
        self.statistics.portion_count = max((method.portion_count for method in methods), default=1)
        self.statistics.caster_triangle_count = max((method.caster_triangle_count for method in methods), default=0)

    def batch_views(self, batch: int) -> range:
        """The views of a batch. A light with fewer views than there are batches shows one of them again in each."""
        views, batches = self.planned.view_count, self.plan.batch_count
        if views < batches:
            return range(batch % views, batch % views + 1)
        return range(batch * views // batches, (batch + 1) * views // batches)

    @property
    def largest_batch(self) -> int:
        """views; batches may differ by one, and share their maps"""
        return -(-self.planned.view_count // self.plan.batch_count)

    def render_batch(self, batch: int, eye: EyePass, stopwatch: Stopwatch) -> None:
        selected = self.batch_views(batch)
        self.accumulator.begin_batch()
        # faces without casters need no map: the first dispatch looks them up too, or one of their own if there is no other
        mapped = [face for face in self.faces if face[2] is not None] or self.faces[:1]
        unmapped_mask = sum(1 << fitted.views.face.index for fitted, _, method in self.faces if method is None)
        done_mask = 0
        for index, (fitted, table, method) in enumerate(mapped):
            maps = self.store.maps(fitted.views.map_width_px, fitted.views.map_height_px, self.largest_batch)
            if method is not None:
                with stopwatch.stage("splat or raster"):
                    method.fill(maps, selected)
            face_mask = 1 << fitted.views.face.index | (unmapped_mask if index == 0 else 0)
            look_up = {
                "depth_maps": maps.texture,
                "face": table,
                "views": views_table(fitted.views, selected),
                "samples": samples_table(fitted.views, self.sample_weights, selected),
                "view_count": len(selected),
                "map_face": fitted.views.face.index,
                "face_mask": face_mask,
                "first_face": int(index == 0),
                "last_face": int(index == len(mapped) - 1),
            }
            with stopwatch.stage("resolve"):
                self._probe(batch, eye, done_mask, look_up)
                self._resolve(eye, look_up)
            done_mask |= face_mask
        if not self.faces:
            # nothing visible is reached; surfaces still have to be told from the background
            with stopwatch.stage("resolve"):
                nothing = {"view_count": 0, "map_face": 0, "face_mask": 0, "first_face": 1, "last_face": 1}
                empty = {name: np.zeros((1, 4)) for name in ("face", "views", "samples")}
                self._resolve(eye, {"depth_maps": self.store.maps(1, 1, 1).texture, **empty, **nothing})
        if self._may_settle(batch):
            with stopwatch.stage("resolve"):
                self.accumulator.settle(eye.positions, eye.normals)
        self._update_statistics()

    def _may_settle(self, batch: int) -> bool:
        """Once, as soon as enough is known, and not when no batch is left to gain from it."""
        return (
            self.plan.settings.resolve is Resolve.ADAPTIVE
            and not self.accumulator.settled_batch_count
            and MIN_SETTLING_BATCHES <= batch + 1 < self.plan.batch_count
            and (self.batch_views(batch).stop >= MIN_SETTLING_VIEWS or batch + 1 >= self.planned.view_count)
        )

    def _probe(self, batch: int, eye: EyePass, done_mask: int, look_up: dict[str, Any]) -> None:
        """Look settled tiles up at a few pixels, at others in every batch, and go on with those that are not what they were."""
        if not self.accumulator.tiles.probed.count:
            return
        self.device.fill(self.accumulator.disagreeing, 0)
        kernel = self.device.compute_kernel(RESOLVE, *self.resolve_flags, "PROBES")
        self.accumulator.tiles.probed.dispatch_probes(kernel, batch, **self._bindings(eye), **look_up)
        eye.want_also(self.accumulator.reopen(done_mask))

    def _resolve(self, eye: EyePass, look_up: dict[str, Any]) -> None:
        kernel = self.device.compute_kernel(RESOLVE, *self.resolve_flags)
        self.accumulator.tiles.walked.dispatch(kernel, **self._bindings(eye), **look_up)

    def _bindings(self, eye: EyePass) -> dict[str, Any]:
        width, height = eye.size
        return {
            "positions": eye.positions,
            "normals": eye.normals,
            "receivers": self.receivers,
            "moments": self.accumulator.moments,
            "coverage": self.accumulator.coverage,
            "disagreeing": self.accumulator.disagreeing,
            "batch_sums": self.store.batch_sums,
            "width": width,
            "height": height,
        }

    def release(self) -> None:
        self._owned.close()
