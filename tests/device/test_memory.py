"""What a render holds on the device: one batch of maps however many views there are, and nothing once it is closed."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from tests.scenes import METHODS_AND_HYBRID, area_light, box, bumpy_sphere, floor, perspective_camera, rectangle, snapshot
from vir_addon.core.passes.shadow_maps import MAX_BATCH_VIEWS
from vir_addon.core.plan import plan
from vir_addon.core.render import render
from vir_addon.core.scene import LightShape
from vir_addon.core.settings import Method, PointGeneration, PointStorage, Resolve, Settings
from vir_addon.device.interface import Device, Texture, TextureFormat

WIDTH, HEIGHT = 64, 36
MAKERS = ("create_texture", "upload_texture", "upload_mesh", "create_target")


class OutOfMemoryError(Exception):
    pass


@dataclass
class Holdings:
    """Everything a device was asked for and not yet told to release."""

    live: dict[int, Any] = field(default_factory=dict)
    made_count: int = 0
    room_for: float = np.inf
    """how many things there is memory for"""
    released_twice: list[str] = field(default_factory=list)
    peak_bytes: dict[TextureFormat, int] = field(default_factory=dict)

    def add(self, thing: Any) -> Any:
        release = thing.release
        self.live[id(thing)] = thing
        self.made_count += 1

        def released() -> None:
            if self.live.pop(id(thing), None) is None:
                self.released_twice.append(type(thing).__name__)
            release()

        thing.release = released
        for texture_format in TextureFormat:
            own = sum(held.byte_count for held in self.live.values() if isinstance(held, Texture) and held.format is texture_format)
            self.peak_bytes[texture_format] = max(self.peak_bytes.get(texture_format, 0), own)
        return thing


@contextlib.contextmanager
def counted(device: Device, monkeypatch: pytest.MonkeyPatch) -> Iterator[Holdings]:
    holdings = Holdings()

    def counting(make: Any) -> Any:
        def made(*arguments: Any) -> Any:
            if holdings.made_count >= holdings.room_for:
                raise OutOfMemoryError
            return holdings.add(make(*arguments))

        return made

    with monkeypatch.context() as patch:
        for name in MAKERS:
            patch.setattr(device, name, counting(getattr(device, name)))
        yield holdings


def scene(light_count: int = 1, *, lamps: bool = False):
    """The second light stands in a corner and takes a cube, and does not light the box. lamps: both shine to all sides"""
    meshes = [
        floor(3.0),
        rectangle("wall", (-3, 2, 0), (6, 0, 0), (0, 0, 3)),
        box("box", (-0.9, 0.3, 0.5), (0.4, 0.5, 0.5), turn_rad=0.4),
        bumpy_sphere("ball", (0.8, 0.0, 0.8), 0.6, 24),
    ]
    lights = [
        area_light("Key", (2.0, -2.0, 5.0)),
        area_light("Rim", (-2.0, 1.0, 1.5), (0.0, 0.5, 0.5), (0.5, 0.5), receivers=np.array([True, True, False, True])),
    ]
    if lamps:
        lights = [dataclasses.replace(light, shape=LightShape.POINT) for light in lights]
    camera = perspective_camera((0.5, -6.0, 3.5), (0.0, 0.0, 0.5), WIDTH, HEIGHT)
    return snapshot(meshes, lights[:light_count], camera, WIDTH, HEIGHT)


@pytest.mark.parametrize("method", METHODS_AND_HYBRID)
def test_memory_is_bounded_by_the_batch(device, monkeypatch, method):
    """128 maps of 1024^2 would take 512 MiB."""
    resolution_px, view_count = 1024, 128
    taken = scene()
    work = plan(taken, Settings(method=method, view_count=view_count, map_resolution_px=resolution_px))
    peaks, at_batches = None, []
    with counted(device, monkeypatch) as holdings, contextlib.closing(render(taken, work, device)) as steps:
        for _ in steps:
            at_batches.append(len(holdings.live))
        peaks = holdings.peak_bytes
    batch_bytes = 4 * resolution_px**2 * MAX_BATCH_VIEWS
    counters_bytes = 1 << 10
    settling_bytes = 2 * 4 * WIDTH * HEIGHT  # for a moment, to find pixels that need not be looked up any more
    eye_bytes = 12 * 9 * (WIDTH + 12) * (HEIGHT + 12)
    assert batch_bytes <= peaks[TextureFormat.R32UI] <= batch_bytes + counters_bytes + settling_bytes
    assert peaks[TextureFormat.DEPTH32F] <= (0 if method is Method.IVIR else batch_bytes) + eye_bytes
    # a map is nowhere read back or kept as anything else, and the rest does not grow with the batches either
    assert peaks[TextureFormat.RGBA32F] < batch_bytes
    assert len(at_batches) == view_count // MAX_BATCH_VIEWS
    assert at_batches[1] == at_batches[-1]


STOPS = {"before the first batch": 0, "after one": 1, "after three": 3, "at the end": 8}
HOW = {
    "mvr": {"method": Method.MVR},
    "micro": {"method": Method.MICRO},
    "buffered": {"method": Method.IVIR},
    "bufferless": {"method": Method.IVIR, "points": PointStorage.BUFFERLESS},
    "by rasterizer": {"method": Method.IVIR, "point_generation": PointGeneration.RASTERIZER},
    "vir": {"method": Method.VIR},
    "vwss": {"method": Method.VWSS},
    "vwss bufferless": {"method": Method.VWSS, "points": PointStorage.BUFFERLESS},
    "epr": {"method": Method.EPR},
    "epr bufferless": {"method": Method.EPR, "points": PointStorage.BUFFERLESS},
    "hybrid": {"method": Method.HYBRID},
    "pcss": {"method": Method.PCSS},
    "hybrid bufferless": {"method": Method.HYBRID, "points": PointStorage.BUFFERLESS},
}


@pytest.mark.parametrize(
    ("stop", "how"),
    [
        # these take long, and hold what others hold
        pytest.param(stop, how, marks=pytest.mark.slow if how in ("by rasterizer", "epr bufferless") and stop != "after one" else ())
        for stop in STOPS
        for how in HOW
    ],
)
def test_closing_leaves_nothing(device, monkeypatch, stop, how):
    if HOW[how]["method"] is Method.VWSS and not device.stores_from_fragments:
        pytest.skip("refused on this device: test_parity.py")
    if "point_generation" in HOW[how] and not device.stores_from_geometry:
        pytest.skip("refused on this device: test_parity.py")
    taken = scene(light_count=2, lamps=HOW[how]["method"] is Method.EPR)
    work = plan(taken, Settings(view_count=16, map_resolution_px=64, **HOW[how]))
    assert work.batch_count == STOPS["at the end"]
    with counted(device, monkeypatch) as holdings:
        steps = render(taken, work, device)
        for _ in range(STOPS[stop]):
            progress = next(steps)
            assert np.isfinite(progress.passes["VIR Shadow"]).all()
        assert bool(holdings.live) == (STOPS[stop] > 0)
        steps.close()
        assert (holdings.made_count > 20) == (STOPS[stop] > 0)
        assert not holdings.live, [type(thing).__name__ for thing in holdings.live.values()]
        assert not holdings.released_twice


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_an_error_between_batches_leaves_nothing(device, monkeypatch, error):
    """What Ctrl-C, or a front end that fails, does to the generator."""
    taken = scene(light_count=2)
    with counted(device, monkeypatch) as holdings:
        steps = render(taken, plan(taken, Settings(view_count=16, map_resolution_px=64)), device)
        next(steps)
        with pytest.raises(error):
            steps.throw(error("stop"))
        assert holdings.made_count > 20 and not holdings.live


@pytest.mark.slow
@pytest.mark.parametrize("how", [how for how in HOW if how not in ("vir", "vwss bufferless", "epr bufferless")])
def test_whatever_there_is_no_memory_for(device_called, monkeypatch, how):
    """Each thing in turn is the one that cannot be had: what was made before it is released, once.

    `vir` makes what `ivir` makes, `vwss` less without a buffer, and `epr` what `ivir` makes then."""
    # what a device does is not asked for, only how often
    device, taken = device_called("moderngl"), scene(light_count=2, lamps=HOW[how]["method"] is Method.EPR)
    # so little that what is replayed is let go and made again, and so many batches that hidden parts and settled pixels are left out
    settings = Settings(view_count=64, map_resolution_px=64, replay_buffer_mib=1, resolve=Resolve.ADAPTIVE, **HOW[how])
    work = dataclasses.replace(plan(taken, settings), batch_count=8)
    room_for = 0
    while True:
        with counted(device, monkeypatch) as holdings:
            holdings.room_for = room_for
            steps = render(taken, work, device)
            try:
                for _ in range(2):
                    next(steps)
            except OutOfMemoryError:
                pass
            steps.close()
            assert not holdings.live, (room_for, [type(thing).__name__ for thing in holdings.live.values()])
            assert not holdings.released_twice, room_for
        if holdings.made_count < room_for:
            break
        room_for += 1
    assert room_for > 30
