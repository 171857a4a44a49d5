"""What one map from the light's centre cannot know: errors of pcss and of many maps against rays in float64."""

from __future__ import annotations

from typing import Any

from tests.penumbrae import DELIVERED_FLOOR, SCENES, traced_pass
from tests.scenes import prepared_renderer, render_batches
from vir_addon.core.pass_set import shadow_pass_name
from vir_addon.core.settings import Method
from vir_addon.device.open import open_device

from .options import Options
from .tables import BenchTable, Column

VARIANTS: dict[str, dict[str, Any]] = {
    "pcss, 32 + 64 samples": {"method": Method.PCSS},
    "pcss, 64 + 96 samples": {"method": Method.PCSS, "blocker_sample_count": 64, "filter_sample_count": 96},
    "mvr, 16 views": {"method": Method.MVR, "view_count": 16},
    "mvr, 64 views": {"method": Method.MVR, "view_count": 64},
}


def run(options: Options) -> list[BenchTable]:
    width, height = options.pick((96, 54), (32, 18))
    sample_count = options.pick(256, 64)
    rows = []
    device = open_device(options.device_name)
    try:
        for scene_name, make in SCENES.items():
            scene, truth = make(width, height), None
            for name, settings in VARIANTS.items():
                with prepared_renderer(scene, device, **settings) as renderer:
                    if truth is None:
                        truth = traced_pass(scene, device.run(device.read, renderer.eye.buffers[0].positions), sample_count)
                    render_batches(renderer)
                    image = renderer.read_passes()[shadow_pass_name(scene.lights[0].name)]
                rows.append({"scene": scene_name, "variant": name, **truth.errors(image)})
    finally:
        device.close()
    return [
        BenchTable(
            title=f"Shadow passes by one map and by many, {width} x {height}",
            compared=(
                f"RMSE against rays in float64 to {sample_count} samples of the light, over pixels that receive more than "
                f"{DELIVERED_FLOOR:.0%} of what the brightest receives, and over those of them that are in a penumbra, lit and dark."
            ),
            columns=(
                Column("scene", "scene"),
                Column("variant", "method"),
                Column("all", "RMSE", "{:.4f}"),
                Column("penumbra", "in the penumbra", "{:.4f}"),
                Column("lit", "where lit", "{:.4f}"),
                Column("dark", "where dark", "{:.4f}"),
            ),
            rows=rows,
        )
    ]
