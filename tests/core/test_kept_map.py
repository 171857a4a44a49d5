"""Lights without size: what all batches show is made once and kept."""

import collections

import numpy as np
import pytest

from tests.scenes import (
    area_light,
    box,
    bumpy_sphere,
    floor,
    matte,
    mirror,
    perspective_camera,
    point_light,
    prepared_renderer,
    rectangle,
    render_batches,
    render_passes,
    snapshot,
    spot_light,
    sun_light,
    with_opacity,
)
from vir_addon.core import methods
from vir_addon.core.cost import resolve_ms
from vir_addon.core.light_work import MapStore
from vir_addon.core.material import World
from vir_addon.core.methods.hybrid import HybridRasterization
from vir_addon.core.methods.ivir import ImprovedViewIndependentRasterization
from vir_addon.core.methods.kept_map import KeptMap
from vir_addon.core.methods.micro import MicroTriangleRasterization
from vir_addon.core.methods.mvr import MultiviewRasterization
from vir_addon.core.passes.shadow_maps import MAX_BATCH_VIEWS
from vir_addon.core.plan import plan
from vir_addon.core.settings import Effect, Method, PointStorage, Settings

WIDTH, HEIGHT = 64, 36
BATCHES = 8
HARD = (
    point_light("Bulb", eye=(0.2, -0.4, 1.6), radius_m=0),
    spot_light("Beam", eye=(2, -2, 4), radius_m=0),
    sun_light("Sun", angle_rad=0),
)
CLASSES = {
    Method.MVR: MultiviewRasterization,
    Method.MICRO: MicroTriangleRasterization,
    Method.IVIR: ImprovedViewIndependentRasterization,
    Method.HYBRID: HybridRasterization,
}


def scene_of(lights, *more_meshes):
    """A lamp among balls and boxes: it takes several faces."""
    meshes = [floor(6.0), bumpy_sphere("ball", (0.9, 0.3, 0.7), 0.5, 40), box("box", (-1, 0.6, 0.5), (0.4, 0.4, 0.5))]
    camera = perspective_camera((0.5, -6.0, 3.5), (0.0, 0.0, 0.5), WIDTH, HEIGHT)
    return snapshot([*meshes, *more_meshes], lights, camera, WIDTH, HEIGHT)


def rendered_and_counted(scene, device, monkeypatch, method, map_resolution_px=256, **settings):
    """Passes, and how often each light's method has filled each of its faces' maps: light name -> [count]"""
    fill = CLASSES[method]._fill
    counts = collections.defaultdict(collections.Counter)
    lights = {}

    def counting(self, maps, selected):
        counts[lights[id(self.fitted.views)]][self.fitted.views.face.index] += 1
        fill(self, maps, selected)

    make = methods._method_of_face

    def noting(planned, job):
        lights[id(job.fitted.views)] = planned.light_name
        return make(planned, job)

    with monkeypatch.context() as patched:
        patched.setattr(CLASSES[method], "_fill", counting)
        patched.setattr(methods, "_method_of_face", noting)
        passes = render_passes(scene, device, method=method, map_resolution_px=map_resolution_px, **settings)
    return passes, {name: list(of_faces.values()) for name, of_faces in counts.items()}


@pytest.mark.parametrize("method", CLASSES)
def test_one_map_a_face(device, monkeypatch, method):
    scene = scene_of([*HARD, area_light("Key", eye=(-2, -2, 5))])
    passes, counts = rendered_and_counted(scene, device, monkeypatch, method, view_count=64)
    assert set(counts["Key"]) == {BATCHES}
    assert len(counts["Bulb"]) > 1
    for light in HARD:
        assert set(counts[light.name]) == {1}
    # as with maps made in every batch
    monkeypatch.setattr(methods, "KeptMap", lambda job, maker: maker)
    made_again, counts = rendered_and_counted(scene, device, monkeypatch, method, view_count=64)
    for light in HARD:
        assert set(counts[light.name]) == {BATCHES}
    for name, image in passes.items():
        np.testing.assert_array_equal(image, made_again[name])
        assert np.ptp(image) > 0.5


def test_no_maps_are_lent_for_it(device, monkeypatch):
    """Those that all lights share are a batch's, and textures of their own."""
    lent = []
    lend = MapStore.maps
    monkeypatch.setattr(MapStore, "maps", lambda store, view_count: lent.append(view_count) or lend(store, view_count))
    passes = render_passes(scene_of([HARD[2]]), device, method=Method.MICRO, map_resolution_px=256)
    assert not lent and np.ptp(passes["VIR Shadow Sun"]) > 0.5


@pytest.mark.parametrize(
    ("method", "points"),
    [
        (Method.MVR, PointStorage.BUFFERED),
        (Method.MICRO, PointStorage.BUFFERED),
        (Method.HYBRID, PointStorage.BUFFERED),
        (Method.HYBRID, PointStorage.BUFFERLESS),
    ],
)
def test_maps_are_let_go_of_where_there_is_no_memory(device, monkeypatch, method, points):
    """One of 512 x 512 takes 1 MiB; what a buffer of points takes pushes all of them out."""
    arguments = {"monkeypatch": monkeypatch, "method": method, "points": points, "map_resolution_px": 512}
    (passes, kept), (scarce, dropped) = (
        rendered_and_counted(scene_of(HARD), device, replay_buffer_mib=mib, **arguments) for mib in (256, 2)
    )
    made_once, made_again = (sum(sum(of_faces) for of_faces in counts.values()) for counts in (kept, dropped))
    assert made_once == sum(len(of_faces) for of_faces in kept.values())
    pushes_all_out = method.uses_points and points is PointStorage.BUFFERED
    assert made_once < made_again < BATCHES * made_once + pushes_all_out
    for name, image in passes.items():
        np.testing.assert_array_equal(image, scarce[name])


@pytest.mark.parametrize("points", PointStorage)
def test_what_a_kept_map_was_made_of_is_still_counted(device, monkeypatch, points):
    def counted():
        arguments = {"method": Method.HYBRID, "points": points, "map_resolution_px": 64}
        with prepared_renderer(scene_of(HARD[2:]), device, **arguments) as renderer:
            render_batches(renderer)
            return renderer.works[0].statistics

    kept = counted()
    monkeypatch.setattr(methods, "KeptMap", lambda job, maker: maker)
    made_again = counted()
    assert kept.large_triangle_count == made_again.large_triangle_count > 0
    assert kept.point_count == made_again.point_count > 0


def test_cut_outs_are_made_for_every_batch(device, monkeypatch):
    """Each has thresholds of its own."""
    pane = rectangle("pane", (-0.5, -1.5, 1.8), (1, 0, 0), (0, 1, 0))
    pane = with_opacity(pane, np.full((2, 2), 0.5), [(0, 0), (1, 0), (1, 1), (0, 1)])
    passes, counts = rendered_and_counted(scene_of([HARD[2]], pane), device, monkeypatch, Method.MVR)
    assert counts["Sun"] == [BATCHES]
    shares = next(image for name, image in passes.items() if "Sun" in name)
    assert (np.abs(shares - 0.5) < 1e-5).any()


def test_plan_forecasts_one_map():
    """What a kept map takes does not grow with the batches; beyond its memory, and with cut-outs, it is made for each."""
    pane = rectangle("pane", (-0.5, -1.5, 1.8), (1, 0, 0), (0, 1, 0))
    pane = with_opacity(pane, np.full((2, 2), 0.5), [(0, 0), (1, 0), (1, 1), (0, 1)])

    def maps_ms(*meshes, **settings):
        """Look-ups are the same with other triangles, and so is what is neither."""
        (line,) = plan(scene_of([HARD[0]], *meshes), Settings(method=Method.MVR, map_resolution_px=2048, **settings)).passes
        (bare,) = plan(scene_of([HARD[0]]), Settings(method=Method.MVR, map_resolution_px=16, **settings)).passes
        assert line.view_count == 1
        return line.predicted_ms - bare.predicted_ms

    kept = maps_ms(replay_buffer_mib=256)
    assert kept > 0
    assert 4 * kept < maps_ms(replay_buffer_mib=1)
    assert 4 * kept < maps_ms(pane, replay_buffer_mib=256)


def forecasts_ms(lights, method, **settings):
    """sun's name -> what making its maps is predicted to take, look-ups left out"""
    scene, settings = scene_of(lights), Settings(method=method, map_resolution_px=2048, **settings)
    work = plan(scene, settings)
    rounds = work.batch_count * work.eye_samples_per_batch
    look_ups_ms = resolve_ms(scene, settings, rounds, rounds)
    return {line.light_name: line.predicted_ms - look_ups_ms for line in work.passes if line.view_count == 1}


@pytest.mark.parametrize(("replay_buffer_mib", "kept_count", "light_count"), [(20, 1, 3), (36, 2, 3), (52, 3, 4), (64, 4, 4)])
def test_lights_share_the_memory_for_their_maps_as_forecast(device, monkeypatch, replay_buffer_mib, kept_count, light_count):
    """A map of 2048 x 2048 takes 16 MiB: what does not fit beside those before it pushes none of them out."""
    suns = [sun_light(name, angle_rad=0) for name in "ABCD"[:light_count]]
    made = collections.Counter()

    class Counted(KeptMap):
        def __init__(self, job, maker):
            super().__init__(job, maker)
            self.light_name = job.light.name

        def _making(self):
            made[self.light_name] += 1
            yield from super()._making()

    monkeypatch.setattr(methods, "KeptMap", Counted)
    settings = {"method": Method.MVR, "replay_buffer_mib": replay_buffer_mib}
    with prepared_renderer(scene_of(suns), device, map_resolution_px=2048, **settings) as renderer:
        render_batches(renderer)
    assert [made[sun.name] for sun in suns] == [1] * kept_count + [BATCHES] * (light_count - kept_count)
    once = forecasts_ms(suns[:1], **settings)["A"]
    for name, predicted_ms in forecasts_ms(suns, **settings).items():
        assert predicted_ms == pytest.approx(made[name] * once)


@pytest.mark.parametrize("method", [Method.MICRO, Method.IVIR])
def test_plan_forecasts_that_maps_made_again_are_made_from_the_scene(method):
    """What a map that was to be kept was made of is let go of, though there would have been memory for it."""
    suns = [sun_light(name, angle_rad=0) for name in ("A", "B")]
    kept, scarce = (forecasts_ms(suns, method, replay_buffer_mib=mib)["B"] for mib in (64, 20))
    assert scarce == pytest.approx(BATCHES * kept)


@pytest.mark.parametrize(("replay_buffer_mib", "kept"), [(20, "A "), (36, "A A'"), (52, "A A' B "), (64, "A A' B B'")])
def test_maps_of_picture_and_reflections_share_the_memory(replay_buffer_mib, kept):
    """A light of both makes two, one after the other: forecast were two for the picture and two more where the memory is for two."""
    wall = rectangle("mirror", (-3, 3, 0), (6, 0, 0), (0, 0, 3))
    meshes = [floor(6.0), bumpy_sphere("ball", (0.9, 0.3, 0.7), 0.5, 40), wall]
    suns = [sun_light(name, angle_rad=0) for name in ("A", "B")]
    camera = perspective_camera((0.5, -6.0, 3.5), (0.0, 0.0, 0.5), WIDTH, HEIGHT)
    scene = snapshot(meshes, suns, camera, WIDTH, HEIGHT, materials=[matte(), matte(), mirror()], world=World())
    effects = (Effect.SHADOW, Effect.REFLECTION)
    work = plan(scene, Settings(method=Method.MVR, effects=effects, map_resolution_px=2048, replay_buffer_mib=replay_buffer_mib))
    found = {f"{line.light_name} ": line.kept_map_bytes for line in work.passes}
    found |= {f"{line.light_name}'": line.kept_map_bytes for line in work.reflected_lights}
    assert found == {name: (16 << 20) * (name in kept) for name in ("A ", "A'", "B ", "B'")}


def test_plan_forecasts_batches_of_all_lights_for_each():
    """Beside a light of 256 views one without size has 32 batches, too; alone it has 16."""
    sun, key = sun_light("Sun", angle_rad=0), area_light("Key", eye=(-2, -2, 5))
    alone, beside = (forecasts_ms(lights, Method.MVR, view_count=256, replay_buffer_mib=1)["Sun"] for lights in ([sun], [sun, key]))
    assert beside == pytest.approx(256 / MAX_BATCH_VIEWS / 16 * alone)
