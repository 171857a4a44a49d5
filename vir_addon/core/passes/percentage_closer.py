"""Looking the picture up in one map from a light's centre: percentage-closer soft shadows (Fernando 2005).

What a pass is stays the same, the sum of what reaches a surface over what would without shadows. What differs is how it is found
whether a point of the light is seen: in a map of the centre, at the place where the ray to the point has the mean depth of the blockers.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from ...device.declaration import ComputeDeclaration, Constant, Sampled, Stored, Table
from ...device.interface import EMPTY_DEPTH_BITS, Device, TextureFormat
from ..sampling import light_samples, sample_weights
from ..scene import Light, LightShape
from ..settings import MAX_TAPS, Settings
from ..views import Face, light_axes
from .resolve import LOOKED_UP_VIEWS, RESOLVE, TOLERANCES
from .shadow_maps import DepthMaps

GOLDEN_RATIO = (math.sqrt(5) - 1) / 2
BLOCK_PX = 16
_FLAGS_OF_OTHERS = ("POINT_MAPS", "MIXED_MAPS", "SMALL_FACETS", "THIN_WALLS", "SEALED", "LIT_BEYOND")
"""of maps that are splatted, and of lights without one"""

PERCENTAGE_CLOSER = replace(
    RESOLVE,
    name="percentage_closer",
    text="looks visible surfaces up in a map from the light's centre, through a filter as wide as their penumbra, accumulates the pass",
    source="percentage_closer.comp.glsl",
    constants={
        **{name: constant for name, constant in RESOLVE.constants.items() if name != "first_view"},
        "view_count": LOOKED_UP_VIEWS["view_count"],
        "search_count": Constant("int", "taps that search for blockers"),
        "filter_count": Constant("int", "taps of the filter"),
        "nearest_depth": Constant("float", "the smallest in the map, metres"),
        "reach": Constant("float", "how far from the light's centre a line to the light may pass, metres; suns: a metre of depth"),
    },
    tables={
        **{name: table for name, table in RESOLVE.tables.items() if name != "samples"},
        "light_points": Table(
            2 * MAX_TAPS,
            "points of the light (face space; suns: unit directions): the search's and where it looks, the filter's and what they count",
        ),
    },
    flags={name: text for name, text in RESOLVE.flags.items() if name not in _FLAGS_OF_OTHERS},
    defines={**{name: number for name, number in RESOLVE.defines.items() if name not in (*TOLERANCES, "FAR_TEXELS")}, "MAX_TAPS": MAX_TAPS},
)


NEAREST_DEPTH = ComputeDeclaration(
    name="nearest_depth",
    text="finds the smallest depth in a map",
    source="nearest_depth.comp.glsl",
    local_size=(8, 8, 1),
    textures={"depth_maps": Sampled("usampler2D", "the map")},
    images={"nearest": Stored("R32UI", "atomic", "one texel")},
    constants={"width": Constant("int", "of the map, texels"), "height": Constant("int", "of the map, texels")},
    defines={"BLOCK_PX": BLOCK_PX},
)


def light_radius_m(light: Light) -> float:
    """Of a ball around the light; suns: of the disc of directions a metre away"""
    if light.shape is LightShape.RECTANGLE:
        return float(np.hypot(light.size_x_m, light.size_y_m)) / 2
    return max(light.size_x_m, light.size_y_m) / 2


class LightTaps:
    """Points of a light that taps stand for. All pixels share them, as they share the samples of other methods, and every round has others:
    runs of one sequence, whose union is as evenly spread as each."""

    def __init__(self, light: Light, settings: Settings, round_count: int) -> None:
        self.light = light
        self.counts = settings.blocker_sample_count, settings.filter_sample_count
        self.samples_m = light_samples(light, max(2, round_count * max(self.counts)))
        """(n, 3) as of `light_samples`"""
        self.weights = sample_weights(light, self.samples_m)

    def bindings(self, face: Face, nearest_m: float, round_number: int) -> dict[str, Any]:
        """Of PERCENTAGE_CLOSER for a face with one view.

        nearest_m: of what its map stores
        """
        points = self._points(face)
        search, of_filter = (range(round_number * count, (round_number + 1) * count) for count in self.counts)
        return {
            "light_points": np.concatenate(
                [
                    np.column_stack([points[search], search_shares(search.start, len(search))]),
                    np.column_stack([points[of_filter], self.weights[of_filter]]),
                ]
            ),
            "search_count": len(search),
            "filter_count": len(of_filter),
            "nearest_depth": nearest_m,
            "reach": light_radius_m(self.light),
        }

    def _points(self, face: Face) -> np.ndarray:
        """(n, 3) float64 in face space; suns: unit directions"""
        if self.light.shape is LightShape.SUN:
            rays = np.add(self.samples_m, (0, 0, 1))
            return rays / np.linalg.norm(rays, axis=1, keepdims=True)
        return self.samples_m @ light_axes(self.light) @ face.face_from_world.T


def search_shares(first: int, count: int) -> np.ndarray:
    """(count,) float64 in [0, 1]: how far towards the nearest caster taps of the search lie, counted in how wide the light is in the map.

    As published, all lie at it. That finds what hides a sliver of the light where the nearest caster does; deeper blockers matter only in
    a small part of the light's outline there, which few taps would meet. So one half of them is spread out, most of it near the
    receiver. Multiples of the golden ratio are even, and independent of the points' coordinates, which are binary fractions.
    """
    shares = ((first + np.arange(count) + 0.5) * GOLDEN_RATIO % 1) ** 2
    shares[: count - count // 2] = 1
    return shares


class NearestDepth:
    """Finds the smallest depth in a map."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.texture = device.create_texture(1, 1, TextureFormat.R32UI)

    def find(self, maps: DepthMaps) -> float:
        """Metres; the largest finite float if nothing is stored"""
        self.device.fill(self.texture, EMPTY_DEPTH_BITS)
        width, height = maps.texture.width, maps.texture.height
        blocks = -(-width // BLOCK_PX), -(-height // BLOCK_PX)
        bindings = {"depth_maps": maps.texture, "nearest": self.texture, "width": width, "height": height}
        self.device.compute_kernel(NEAREST_DEPTH).dispatch_grid(blocks, **bindings)
        return float(self.device.read(self.texture).view(np.float32)[0, 0])

    def release(self) -> None:
        self.texture.release()
