"""In how many batches reflections are traced, within which memory, and what lights are fitted to."""

from __future__ import annotations

import dataclasses
import re
import time
from types import SimpleNamespace

import numpy as np
import pytest

from tests.scenes import (
    area_light,
    box,
    floor,
    matte,
    mirror,
    perspective_camera,
    prepared_renderer,
    rectangle,
    render_passes,
    rmse,
    snapshot,
)
from vir_addon.core import light_work, reach, render
from vir_addon.core.cost import eye_ms
from vir_addon.core.errors import UsageError
from vir_addon.core.light_work import LightWork, fit_both
from vir_addon.core.material import World
from vir_addon.core.passes.reflection_maps import BYTES_PER_TEXEL
from vir_addon.core.plan import check_device, plan
from vir_addon.core.reach import select_receivers
from vir_addon.core.reflections import work as reflection_work
from vir_addon.core.reflections.reflectors import memory_for_maps
from vir_addon.core.reflections.rounds import MAX_HITS_MIB, hits_mib, plan_rounds
from vir_addon.core.settings import Effect, Settings
from vir_addon.device.interface import LINEAR_TEXTURE_WIDTH

BOTH = (Effect.SHADOW, Effect.REFLECTION)


def mirrored_scene(width=64, height=36, roughness=0.0, more=()):
    """A lit floor with a box on it, and maybe other meshes, before a mirror."""
    wall = rectangle("wall", (-2, 2, -0.5), (4, 0, 0), (0, 0, 4))
    meshes = [floor(4.0), box("box", (0.3, 0.5, 0.3), (0.3, 0.3, 0.3)), wall, *more]
    camera = perspective_camera((0.0, -3.0, 1.6), (0.0, 2.0, 0.9), width, height, 0.3)
    light = area_light(eye=(0.0, -1.0, 3.0), target=(0, 0, 0))
    return snapshot(
        meshes,
        [light],
        camera,
        width,
        height,
        materials=[matte(), matte(), mirror(roughness=roughness), *(matte() for _ in more)],
        world=World(),
    )


def test_more_rays_are_more_rounds_of_the_batches_that_shadows_have():
    scene = mirrored_scene()
    shadows = plan(scene, Settings(effects=(Effect.SHADOW,)))
    both = plan(scene, Settings(effects=BOTH, reflection_sample_count=32))
    assert both.batch_count == shadows.batch_count
    assert both.eye_samples_per_batch * both.batch_count >= 32
    assert any("shadows may differ a little" in note for note in both.notes)
    assert not any("shadows may differ" in note for note in plan(scene, Settings(effects=(Effect.REFLECTION,))).notes)


@pytest.mark.parametrize("view_count", [1, 4])
@pytest.mark.parametrize("sample_count", [1, 2, 5, 32])
def test_without_shadow_passes_there_are_as_many_rays_as_asked_for(view_count, sample_count):
    """Shadows' edges call for more eye samples than that."""
    found = plan(mirrored_scene(), Settings(effects=(Effect.REFLECTION,), view_count=view_count, reflection_sample_count=sample_count))
    ray_count = found.batch_count * found.eye_samples_per_batch
    assert sample_count <= ray_count < sample_count + found.eye_samples_per_batch
    assert found.eye_sample_count >= sample_count


@pytest.mark.parametrize(("key_views", "fill_views"), [(16, 6), (24, 1)])
def test_more_rays_do_not_change_what_lights_count_in_the_combined_pass(device, key_views, fill_views):
    """Where a batch has more eye samples than a light has views, each of them looks at all of these."""
    lights = [
        area_light(name="Key", eye=(-1.0, -1.0, 3.0), target=(0, 0, 0)),
        area_light(name="Fill", eye=(1.5, -1.0, 2.5), target=(0, 0, 0), size_m=(0.2, 0.2), own_view_count=fill_views),
    ]
    camera = perspective_camera((0.0, -3.0, 2.5), (0.3, 0.6, 0.3), 64, 36, 0.6)
    scene = dataclasses.replace(mirrored_scene(), lights=lights, camera=camera)
    shares = []
    for effects in ((Effect.SHADOW,), BOTH):
        passes = render_passes(scene, device, effects=effects, view_count=key_views, reflection_sample_count=32)
        key, fill, combined = (passes[name] for name in ("VIR Shadow Key", "VIR Shadow Fill", "VIR Shadow"))
        differ = np.abs(fill - key) > 0.3
        assert differ.sum() > 20
        shares.append((combined - key)[differ] / (fill - key)[differ])
    np.testing.assert_allclose(np.median(shares[0]), np.median(shares[1]), rtol=0.03)


@pytest.mark.parametrize("effects", [(Effect.REFLECTION,), BOTH])
def test_the_rest_of_the_picture_is_rendered_for_shadows_alone(device, effects):
    wide = perspective_camera((0.0, -3.0, 1.6), (0.0, 2.0, 0.9), 128, 72, 0.9)
    scene = dataclasses.replace(mirrored_scene(128, 72), camera=wide)
    with prepared_renderer(scene, device, effects=effects, view_count=4, reflection_sample_count=2) as renderer:
        shown = renderer.reflections.tiles_shown
        assert shown.any() and not shown.all()
        np.testing.assert_array_equal(renderer.eye.tiles.is_walked, shown | (Effect.SHADOW in effects))


@pytest.mark.parametrize("view_count", [1, 3, 5, 12, 64])
@pytest.mark.parametrize("sample_count", [1, 32, 100, 1024])
def test_every_view_counts_as_often_as_others(view_count, sample_count):
    scene = mirrored_scene()
    work = LightWork.__new__(LightWork)
    work.plan = plan(scene, Settings(effects=BOTH, view_count=view_count, reflection_sample_count=sample_count))
    (work.planned,) = work.plan.passes
    shown = np.bincount([view for batch in range(work.plan.batch_count) for view in work.batch_views(batch)], minlength=view_count)
    most_rays = work.plan.batch_count * work.plan.eye_samples_per_batch
    assert most_rays >= sample_count
    assert len(set(shown.tolist())) == 1


def test_what_rays_meet_keeps_to_its_memory_with_a_note():
    small, large = mirrored_scene(1920, 1080), mirrored_scene(3840, 2160)
    settings = Settings(effects=BOTH, bounces=8)
    assert plan_rounds(small, settings, 2, 8, [64]) == (8, 4, 2, None)
    found = plan_rounds(large, settings, 8, 8, [64])
    assert found.bounces < 8 and f"bounce {found.bounces} times, not 8" in found.note
    assert hits_mib(large, found.rounds_per_batch, found.bounces) <= MAX_HITS_MIB
    planned = plan(large, settings)
    assert planned.reflections.bounces == found.bounces and found.note in planned.notes


@pytest.mark.parametrize("view_count", [1, 8, 64])
@pytest.mark.parametrize("sample_count", [2, 8, 32])
def test_rounds_for_shadows_keep_to_that_memory_too(view_count, sample_count):
    """Shadows may call for more eye samples a batch than rays do, and each has hits of its own."""
    scene = mirrored_scene(3840, 2160)
    found = plan(scene, Settings(effects=BOTH, view_count=view_count, reflection_sample_count=sample_count, bounces=8))
    assert hits_mib(scene, found.eye_samples_per_batch, found.reflections.bounces) <= MAX_HITS_MIB
    assert found.eye_samples_per_batch * found.batch_count >= sample_count
    small = plan(mirrored_scene(), Settings(effects=BOTH, view_count=view_count, reflection_sample_count=sample_count))
    shadows = plan(mirrored_scene(), Settings(effects=(Effect.SHADOW,), view_count=view_count))
    assert small.eye_sample_count >= shadows.eye_sample_count


@pytest.mark.parametrize("effects", [(Effect.SHADOW,), (Effect.REFLECTION,), BOTH])
def test_advice_on_too_large_maps_is_the_largest_that_does(effects):
    device = SimpleNamespace(name="small", stores_from_fragments=True, stores_from_geometry=True, max_texture_size_px=4096)

    def check(resolution_px):
        settings = Settings(effects=effects, view_count=32, reflection_sample_count=32, map_resolution_px=resolution_px)
        check_device(plan(mirrored_scene(), settings), device)

    with pytest.raises(UsageError) as refused:
        check(4097)
    advised_px = int(re.search(r"map resolution of (\d+)", str(refused.value)).group(1))
    check(advised_px)
    with pytest.raises(UsageError):
        check(advised_px + 1)


def test_maps_have_as_much_memory_as_a_texture_holds(device):
    asked = Settings(effects=BOTH, reflection_map_mib=1 << 16)
    check_device(plan(mirrored_scene(), asked), device)
    held_mib = memory_for_maps(device, asked).reflection_map_mib
    assert 64 <= held_mib < 1 << 16
    assert -(-(held_mib << 20) // (BYTES_PER_TEXEL * LINEAR_TEXTURE_WIDTH)) <= device.max_texture_size_px
    assert memory_for_maps(device, dataclasses.replace(asked, reflection_map_mib=32)).reflection_map_mib == 32


def test_a_note_says_that_a_texture_holds_too_little_for_the_maps(device, monkeypatch):
    def held(device, settings):
        return dataclasses.replace(settings, reflection_map_mib=1)

    monkeypatch.setattr(render, "memory_for_maps", held)
    with prepared_renderer(mirrored_scene(160, 90), device, effects=(Effect.REFLECTION,), view_count=1) as renderer:
        assert any("largest texture holds 1 MiB" in note for note in renderer.statistics.notes)
        assert sum(each.texel_count for each in renderer.reflections.maps.maps) * BYTES_PER_TEXEL <= 1 << 20


def test_lights_are_fitted_to_what_rough_reflectors_may_show_in_later_batches(device, monkeypatch):
    fitted = []

    def select(positions, normals, light, beyond_px):
        fitted.append(positions[positions[..., 3] >= 0][:, :3])
        return select_receivers(positions, normals, light, beyond_px)

    monkeypatch.setattr(light_work, "select_receivers", select)
    with prepared_renderer(mirrored_scene(32, 18, roughness=0.3), device, effects=(Effect.REFLECTION,), view_count=8) as renderer:
        reflections, outside, count = renderer.reflections, 0, 0
        low, high = fitted[0].min(axis=0), fitted[0].max(axis=0)
        first = np.concatenate([reflections.read_hits(hits)[0] for hits in reflections.hits[0]])
        first = first[first[..., 3] >= 0][:, :3]
        assert len(fitted[0]) > 6 * len(first)
        for batch in range(renderer.plan.batch_count):
            for _ in reflections.tracing(renderer._current_offsets, batch, renderer.stopwatch):
                pass
            for hits in reflections.all_hits:
                positions = reflections.read_hits(hits)[0]
                places = positions[positions[..., 3] >= 0][:, :3]
                outside += ((places < low) | (places > high)).any(axis=1).sum()
                count += len(places)
        assert outside < 0.01 * count


def split_scene():
    """What stands behind the camera is in the mirror alone. (A mirror with a shadow would take large maps itself.)"""
    more = [box("over the box", (0.2, 0.1, 1.2), (0.1, 0.1, 0.02)), box("behind", (-1.0, -2.0, 0.3), (0.3, 0.3, 0.3))]
    scene = mirrored_scene(more=more)
    casts_shadow = np.array([mesh.name != "wall" for mesh in scene.meshes])
    return dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, casts_shadow=casts_shadow))


def test_shadows_are_those_without_reflections_where_other_maps_would_be_coarser(device):
    scene = split_scene()
    settings = {"view_count": 16, "map_resolution_px": 256, "reflection_sample_count": 8}
    alone = plan(scene, Settings(effects=(Effect.SHADOW,), **settings))
    both = plan(scene, Settings(effects=BOTH, **settings))
    assert alone.has_same_steps(dataclasses.replace(both, settings=alone.settings))
    with prepared_renderer(scene, device, effects=BOTH, **settings) as renderer:
        of_picture, of_reflections = renderer.works
        assert of_picture.has_pass and not of_picture.lights_reflections
        assert of_reflections.lights_reflections and not of_reflections.has_pass
        assert of_picture.accumulator.round_sums.width == scene.width_px and of_reflections.accumulator.round_sums.width < 30
        for batch in range(both.batch_count):
            device.run(renderer.render_batch, batch)
        assert renderer.views_done(both.batch_count) == renderer.views_total == 16
    passes, expected = (render_passes(scene, device, effects=effects, **settings) for effects in (BOTH, (Effect.SHADOW,)))
    assert np.count_nonzero(expected["VIR Shadow Key"] < 0.9) > 10
    for name, image in expected.items():
        np.testing.assert_array_equal(passes[name], image)


def test_the_forecast_counts_both_sets_of_maps():
    both = plan(mirrored_scene(), Settings(effects=BOTH, view_count=16, reflection_sample_count=8))
    assert both.passes[0].predicted_ms > 0 and both.reflected_lights[0].predicted_ms > 0
    others_ms = both.reflections.predicted_ms + eye_ms(mirrored_scene(), both.settings, both.eye_sample_count)
    assert both.predicted_ms == pytest.approx(both.passes[0].predicted_ms + both.reflected_lights[0].predicted_ms + others_ms)


def test_one_set_of_maps_serves_both_where_it_is_as_fine(device):
    with prepared_renderer(mirrored_scene(), device, effects=BOTH, view_count=16) as renderer:
        (work,) = renderer.works
        assert work.has_pass and work.lights_reflections


@pytest.mark.parametrize(("scene", "fit_count"), [(split_scene(), 3), (mirrored_scene(), 2)])
def test_the_pass_counts_the_time_of_fitting_to_both(device, monkeypatch, scene, fit_count):
    fit_views, calls = light_work.fit_views, []

    def slow(*arguments):
        calls.append(arguments)
        time.sleep(0.2)
        return fit_views(*arguments)

    monkeypatch.setattr(light_work, "fit_views", slow)
    with prepared_renderer(scene, device, effects=BOTH, view_count=16, map_resolution_px=256) as renderer:
        assert len(renderer.works) == fit_count - 1
        (statistics,) = renderer.statistics.passes
        assert statistics.stage_ms["points"] >= 400
    assert len(calls) == fit_count


def test_many_pictures_of_what_is_seen_call_for_no_maps_of_their_own(device, monkeypatch):
    """They are looked at in larger steps, of which a margin is made."""
    scene = mirrored_scene(160, 90, more=[box("roof", (0.0, 0.0, 2.0), (3.0, 3.0, 0.02))])
    monkeypatch.setattr(reach, "MAX_RECEIVER_PIXELS", 160 * 90)
    with prepared_renderer(scene, device, effects=BOTH, view_count=16) as renderer:
        in_picture = tuple(renderer.device.read(buffer) for buffer in renderer.eye.buffers[0])
        (planned,), (light,) = renderer.plan.passes, scene.lights
        arguments = planned, planned, light, renderer.plan, renderer.scene_data, in_picture
        alone, _ = fit_both(*arguments, in_picture)
        fit, serves_both = fit_both(*arguments, tuple(np.concatenate(32 * [texels]) for texels in in_picture))
    assert serves_both
    assert 1.1 < alone.texel_growth(fit) < 1.5


def test_what_reflectors_show_may_be_thinned_out_more_than_the_picture(device, monkeypatch):
    scene, settings = mirrored_scene(65, 37), {"effects": BOTH, "view_count": 8}
    whole = render_passes(scene, device, **settings)["VIR Shadow Key"]
    monkeypatch.setattr(reflection_work, "MAX_FITTED_HITS", 65 * 37 // 4)
    assert rmse(render_passes(scene, device, **settings)["VIR Shadow Key"], whole) < 0.02
