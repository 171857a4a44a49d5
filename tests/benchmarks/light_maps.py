"""The depth maps of a scene's first light, fitted and batched as a render does it, and nothing looked up: what benches of maps time."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from vir_addon.core.bounds import compute_bounds
from vir_addon.core.errors import UsageError
from vir_addon.core.light_plan import PlannedPass
from vir_addon.core.light_work import LightWork, MapStore
from vir_addon.core.methods.base import DepthMapMethod
from vir_addon.core.passes.eye import EyePass
from vir_addon.core.passes.scene_data import SceneData
from vir_addon.core.plan import RenderPlan, check_device, plan, settings_for
from vir_addon.core.scene import SceneSnapshot
from vir_addon.core.settings import Method, Settings
from vir_addon.core.steps import run_steps
from vir_addon.core.stopwatch import Stopwatch
from vir_addon.device.interface import EMPTY_DEPTH_BITS, Device

REPLAYED_COUNTS = ("kept_point_count", "kept_small_triangle_count")
PREPARED_COUNTS = ("point_count", "small_triangle_count", "large_triangle_count")


@dataclass(frozen=True)
class Timing:
    points_ms: float
    """making what all batches share"""
    maps_ms: float
    cpu_ms: float
    """processor time of all threads for both"""
    batches_done: int
    """fewer than there are if time ran out"""
    batches_total: int
    face_count: int
    map_size_px: int
    """the larger side of the largest"""
    counts: dict[str, int]
    """of `PassStatistics`, over all faces"""

    @property
    def total_ms(self) -> float:
        return self.points_ms + self.maps_ms

    @property
    def is_complete(self) -> bool:
        return self.batches_done == self.batches_total


@dataclass(frozen=True)
class Variant:
    plan: RenderPlan
    planned: PlannedPass


def planned_variant(snapshot: SceneSnapshot, settings: Settings, device: Device) -> Variant:
    """What the plan makes of the settings for the scene's first light. UsageError if that cannot be."""
    render_plan = plan(snapshot, replace(settings_for(device, settings), light_names=(snapshot.lights[0].name,)))
    check_device(render_plan, device)
    return Variant(render_plan, render_plan.passes[0])


def possible_variants(snapshot: SceneSnapshot, settings: Settings, device: Device) -> tuple[dict[Method, Variant], dict[Method, str]]:
    """Every method, `auto` too, that can make this light's maps, and why the others cannot."""
    possible, impossible = {}, {}
    for method in Method:
        try:
            possible[method] = planned_variant(snapshot, replace(settings, method=method), device)
        except UsageError as error:
            impossible[method] = str(error)
    return possible, impossible


class StageTimes(Stopwatch):
    """Stages one by one, with the processor time of all threads. Fitting the views is host work and not among them."""

    def __init__(self, device: Device) -> None:
        super().__init__(device)
        self.timed: list[tuple[float, float]] = []
        """milliseconds, waited and of processors"""

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        self.device.finish()
        start_s, start_cpu_s = time.perf_counter(), time.process_time()
        yield
        self.device.finish()
        self.timed.append(((time.perf_counter() - start_s) * 1e3, (time.process_time() - start_cpu_s) * 1e3))


class LightMaps:
    """A scene on the device, and what of it is in the picture."""

    def __init__(self, snapshot: SceneSnapshot, device: Device) -> None:
        self.snapshot, self.device = snapshot, device
        self.scene_data = SceneData(snapshot, device)
        eye = EyePass(self.scene_data, compute_bounds(snapshot), np.zeros((1, 2)))
        device.run(eye.render, [0], 0)
        self.positions, self.normals = (device.read(texture) for texture in eye.buffers[0])
        eye.release()

    @contextlib.contextmanager
    def prepared(self, variant: Variant, stopwatch: StageTimes) -> Iterator[tuple[LightWork, MapStore]]:
        """Views fitted, and everything made that batches share."""
        store = MapStore(self.device, self.snapshot.width_px, self.snapshot.height_px, variant.plan)
        run_steps(store.allocating())
        light = next(light for light in self.snapshot.lights if light.name == variant.planned.light_name)
        work = LightWork(variant.planned, light, variant.plan, self.scene_data, store)
        try:
            self.device.run(work.fit, self.positions, self.normals, stopwatch)
            yield work, store
        finally:
            work.release()
            store.release()

    def time(self, variant: Variant, limit_ms: float = math.inf, batch_limit: int | None = None) -> Timing:
        """limit_ms: give up after the first batch that ends later. batch_limit: make no more than so many batches"""
        stopwatch = StageTimes(self.device)
        with self.prepared(variant, stopwatch) as (work, store):
            prepared = np.sum(stopwatch.timed, axis=0)
            all_batches = min(variant.plan.batch_count, variant.planned.view_count)
            batches = range(all_batches if batch_limit is None else min(batch_limit, all_batches))
            for batch in batches:
                with stopwatch.stage("splat or raster"):
                    fill(work, store, batch)
                spent = np.sum(stopwatch.timed, axis=0)
                if spent[0] > limit_ms:
                    break
            methods = [method for _, _, method in work.mapped if method is not None]
            faces = [fitted.views for fitted, _, method in work.mapped if method is not None]
            return Timing(
                points_ms=float(prepared[0]),
                maps_ms=float(spent[0] - prepared[0]),
                cpu_ms=float(spent[1]),
                batches_done=batch + 1,
                batches_total=all_batches,
                face_count=len(faces),
                map_size_px=max((max(views.map_width_px, views.map_height_px) for views in faces), default=0),
                counts=total_counts(methods),
            )

    def covered(self, variant: Variant) -> np.ndarray:
        """(rows, columns) bool: which texels of the last batch's maps have a depth, of the last face."""
        with self.prepared(variant, StageTimes(self.device)) as (work, store):
            for batch in (0, variant.plan.batch_count - 1):  # what the first leaves out, the last may miss
                fill(work, store, batch)
            return self.device.read(store.maps(work.largest_batch).texture) != EMPTY_DEPTH_BITS

    def release(self) -> None:
        self.scene_data.release()


def fill(work: LightWork, store: MapStore, batch: int) -> None:
    """The maps of a batch, one face's over the other's."""
    for _, _, method in work.mapped:
        if method is not None:
            method.fill(store.maps(work.largest_batch), work.batch_views(batch))


def total_counts(methods: list[DepthMapMethod]) -> dict[str, int]:
    counts: dict[str, int] = {"portion_count": 1}
    for method in methods:
        for name, count in method.counts().items():
            counts[name] = counts.get(name, 0) + count
        counts["portion_count"] = max(counts["portion_count"], method.portion_count)
        counts["culled_triangle_count"] = counts.get("culled_triangle_count", 0) + getattr(method, "culled_triangle_count", 0)
    return counts


def prepared_count(counts: dict[str, int]) -> int:
    return sum(counts.get(name, 0) for name in PREPARED_COUNTS)


def replayed_count(counts: dict[str, int]) -> int:
    """What is left after the first batch has found the others hidden; all that was prepared if none were left out."""
    return sum(counts.get(name, 0) for name in REPLAYED_COUNTS) or prepared_count(counts)
