"""The preview of one viewport, without any window: reads the scene from its viewport depsgraph and makes the picture in slices.

How fine the picture is follows from what its steps take: each level is coarser than the one before, down to where a step fits the
budget, and up again where there is room.
"""

from __future__ import annotations

import math
import time
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np

from ...core.errors import UsageError
from ...core.picture import Choice, Picture, Shown
from ...core.plan import settings_for
from ...core.progressive import AIMED_SHARE, HOST_WAIT_SHARE, ProgressiveRender
from ...core.scene import SceneSnapshot, has_same_picture, has_same_surfaces, is_same_light
from ...core.settings import Effect, Settings
from ...device.interface import Device
from ..extract import ReadSurfaces, SceneReading
from ..extract.mesh_cache import MeshCache
from ..extract.viewport_view import ViewportView

ROOM_SHARE = 0.25
"""Steps that take less of the budget leave room for a finer level, whose steps take up to four times as long."""

VISIBILITY_TEXELS = 1 << 24
"""128 MiB: to clear textures of more takes longer than a step may"""
SLOW_TRIES = 2
"""A level that was too slow so often is not tried again: once it may have been another program."""


@dataclass(frozen=True)
class Level:
    pixel_size: int
    """pixels of the viewport along the side of one of the picture's"""
    map_resolution_px: int
    """at most"""
    batch_view_count: int


LEVELS = (Level(1, 8192, 8), Level(2, 1024, 8), Level(2, 512, 4), Level(4, 512, 2), Level(4, 256, 1), Level(8, 128, 1))
FIRST_LEVEL, FIRST_LEVEL_OF_SOFTWARE = 0, 3


class _Reading:
    """Of the scene, in slices."""

    def __init__(self, scene: SceneReading, depsgraph: bpy.types.Depsgraph) -> None:
        self.scene = scene
        self.busy_ms = 0.0
        self._address = depsgraph.as_pointer()
        self._steps = scene.steps(depsgraph)
        self._pending: Future[Any] | None = None

    def is_of(self, depsgraph: bpy.types.Depsgraph) -> bool:
        return depsgraph.as_pointer() == self._address

    @property
    def is_waiting(self) -> bool:
        return self._pending is not None and not self._pending.done()

    def advance(self, executor: Executor, budget_s: float) -> bool:
        """For about so long; whether the snapshot is there."""
        start = time.perf_counter()
        try:
            while True:
                answer = None
                if self._pending is not None:
                    answer = self._pending.result(timeout=max(HOST_WAIT_SHARE * (budget_s - (time.perf_counter() - start)), 0.0))
                    self._pending = None
                host_work = self._steps.send(answer)
                if host_work is None:
                    return False
                self._pending = executor.submit(host_work)
        except TimeoutError:
            return False
        except StopIteration:
            return True
        finally:
            self.busy_ms += (time.perf_counter() - start) * 1e3


class ViewportPreview:
    """Tell it where the viewport looks and when the scene has changed; `advance` does the rest."""

    def __init__(self, device: Device, executor: Executor, cache: MeshCache) -> None:
        """cache: of the view layer that the viewport shows"""
        self.render = ProgressiveRender(device, executor)
        self.cache, self.executor = cache, executor
        self.view: ViewportView | None = None
        self.read_ms = 0.0
        """that reading the scene took last, of the main thread's time"""
        self.level_index = FIRST_LEVEL_OF_SOFTWARE if device.is_software else FIRST_LEVEL
        self._slow_counts = [0] * len(LEVELS)
        """how often a step of each level was found too slow"""
        self.must_read = True
        """the scene, when it is next given time"""
        self._reading: _Reading | None = None
        """under way"""
        self._surfaces: ReadSurfaces | None = None
        """of the last one, as long as at most lights have changed"""
        self._read_view: ViewportView | None = None
        """of the snapshot that is rendered"""
        self._picture_view: ViewportView | None = None
        self.reference: Picture | None = None
        """what `picture` is compared with: of the same view, when that had come to its end for the first time"""
        self._reference_of: tuple[ViewportView, Choice] | None = None
        self._wanted: Settings | None = None
        self._budget_s = 0.0
        self._has_failed = False
        """what was shown last could not be"""

    @property
    def level(self) -> Level:
        return LEVELS[self.level_index]

    @property
    def is_done(self) -> bool:
        is_read = not self.must_read and self._reading is None and self._read_view is self.view
        return self.view is None or (is_read and self.render.is_done)

    @property
    def is_reading(self) -> bool:
        """The scene, from the very depsgraph that it was handed last."""
        return self._reading is not None

    @property
    def is_waiting(self) -> bool:
        """For what happens in the executor."""
        return self._reading.is_waiting if self._reading is not None else self.render.is_waiting

    @property
    def picture(self) -> Picture | None:
        """Of what the viewport looks at now, or nothing."""
        return self.render.picture if self.render.picture_of is not None and self._picture_view is self.view else None

    def look(self, view: ViewportView) -> None:
        """From there, in the viewport's own resolution."""
        if self.view is None or not is_same_view(view, self.view):
            if self.view is None or view.hidden_uids != self.view.hidden_uids:
                self.note_change()
            self.view = view

    def note_change(self, *, only_lights: bool = False) -> None:
        """Anything in the scene may be different from now on, or only_lights."""
        self.must_read = True
        self._reading = None
        if not only_lights:
            self._surfaces = None

    def advance(self, depsgraph: bpy.types.Depsgraph, settings: Settings, budget_s: float) -> bool:
        """Work for about so long; whether there is another picture. Raises VirError, to be called again when something has changed.

        depsgraph: evaluated, of the viewport
        """
        start = time.perf_counter()
        if self.view is None:
            return False
        settings = replace(settings, effects=self._wanted_effects(settings))
        if (settings, budget_s) != (self._wanted, self._budget_s):
            self._wanted, self._budget_s, self._read_view = settings, budget_s, None
            self._slow_counts = [0] * len(LEVELS)
        if self._reading is not None and not self._reading.is_of(depsgraph):
            self.note_change()
        must_read = self.must_read or self._reading is not None
        if must_read or self._read_view is not self.view:
            self._show(depsgraph, self.view, settings, budget_s)
            if self._reading is not None or (must_read and time.perf_counter() - start > AIMED_SHARE * budget_s):
                return False
        try:
            has_changed = self.render.advance(max(budget_s - (time.perf_counter() - start), 0.0))
        except Exception:
            self._has_failed = True
            raise
        if has_changed:
            self._picture_view = self._read_view
        self._choose_level(budget_s)
        return has_changed

    def _wanted_effects(self, settings: Settings) -> tuple[Effect, ...]:
        """What has to be made of what the artist has switched on. UsageError: nothing."""
        effects = self.render.choice.shown.effects_of(settings.effects)
        if not effects:
            missing = "shadows" if self.render.choice.shown is Shown.SHADOW else "reflections"
            raise UsageError(f"{missing} are switched off: switch them on under Effects, or let the preview show other passes")
        return effects

    def _show(self, depsgraph: bpy.types.Depsgraph, view: ViewportView, settings: Settings, budget_s: float) -> None:
        width_px, height_px = (math.ceil(extent / self.level.pixel_size) for extent in (view.width_px, view.height_px))
        scaled = replace(view, width_px=width_px, height_px=height_px)
        before = self.render.snapshot
        reflects = Effect.REFLECTION in settings.effects
        has_materials = self._reading.scene.with_materials if self._reading is not None else before is not None and before.world is not None
        if reflects and not has_materials:
            self.note_change()
        must_read = self.must_read or self._reading is not None or before is None
        # whatever happens now does not happen again before something changes
        self.must_read, self._read_view = False, view
        taken = self._read(depsgraph, scaled, budget_s, with_materials=reflects) if must_read else before
        if taken is None:
            return
        if before is not None and taken is not before and not has_same_surfaces(taken, before):
            # it may have become lighter
            self._slow_counts = [min(count, SLOW_TRIES - 1) for count in self._slow_counts]
        taken = replace(taken, camera=scaled.camera(taken.world_origin_m), width_px=scaled.width_px, height_px=scaled.height_px)
        wanted = replace(
            settings_for(self.render.device, settings),
            per_reflector=False,
            map_resolution_px=min(settings.map_resolution_px, self.level.map_resolution_px),
            batch_view_count=min(settings.batch_view_count, self.level.batch_view_count),
            visibility_texel_count=min(settings.visibility_texel_count, VISIBILITY_TEXELS),
        )
        if before is None or self._has_failed or self.render.settings != wanted or not is_same_scene(taken, before):
            self._has_failed = False
            self.render.show(taken, wanted)

    def _read(self, depsgraph: bpy.types.Depsgraph, view: ViewportView, budget_s: float, *, with_materials: bool) -> SceneSnapshot | None:
        """Some of the scene; None: there is more."""
        if self._reading is None:
            surfaces = self._surfaces if self._surfaces is None or not with_materials or self._surfaces.appearance else None
            self._reading = _Reading(SceneReading(view=view, with_materials=with_materials, cache=self.cache, surfaces=surfaces), depsgraph)
        reading = self._reading
        self.cache.begin(AIMED_SHARE * budget_s)
        try:
            if not reading.advance(self.executor, budget_s):
                return None
        except BaseException:
            # what there is of before is not what the scene looks like
            self._reading, self.must_read = None, True
            raise
        self._reading, self._surfaces, self.read_ms = None, reading.scene.surfaces, reading.busy_ms
        return reading.scene.snapshot

    def _choose_level(self, budget_s: float) -> None:
        share = self.render.slowest_step_ms / (budget_s * 1e3)
        chosen = self.level_index
        if share > 1.0 and chosen + 1 < len(LEVELS):
            self._slow_counts[chosen] += 1
            chosen += 1
        elif self.render.is_done and share < ROOM_SHARE and chosen > 0 and self.render.standing.views_total:
            chosen -= self._slow_counts[chosen - 1] < SLOW_TRIES
        if chosen != self.level_index:
            self.level_index, self._read_view = chosen, None

    def compare(self, is_wanted: bool) -> None:
        """Keep a reference for the view and the light that are shown, or none. To be called whenever there may be another picture."""
        shown = None if self.view is None else (self.view, self.render.choice)
        if self.reference is not None and not (is_wanted and self._reference_of == shown):
            self.reference.release()
            self.reference = self._reference_of = None
        if is_wanted and self.reference is None and self.is_done and self.picture is not None:
            self.reference, self._reference_of = self.render.copy_picture(), shown

    def close(self) -> None:
        self._reading = self._surfaces = None
        self.compare(False)
        self.render.close()


def is_same_view(one: ViewportView, other: ViewportView) -> bool:
    return one is other or (
        all(getattr(one, name) == getattr(other, name) for name in one.__dataclass_fields__ if name != "world_from_view")
        and np.array_equal(one.world_from_view, other.world_from_view)
    )


def is_same_scene(one: SceneSnapshot, other: SceneSnapshot) -> bool:
    """Whether both give the same passes."""
    return (
        has_same_picture(one, other)
        and len(one.lights) == len(other.lights)
        and all(is_same_light(a, b) for a, b in zip(one.lights, other.lights, strict=True))
        and ((one.world is None and other.world is None) or has_same_surfaces(one, other))
    )
