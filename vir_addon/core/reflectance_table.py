"""How much a rough surface reflects of light from everywhere, integrated once and looked up on the device.

A GGX lobe with Smith's height-correlated masking, of roughness r (GGX width r squared), seen under the cosine mu, has the directional
albedo E without a Fresnel term. With one, f(cosine to the microfacet), its mean over the lobe is needed: of Schlick's (1 - c)^5, of
c (1 - c)^6 (what the F82 tint adds), and of the dielectric curve between its reflectance straight on and 1.
"""

from __future__ import annotations

import functools

import numpy as np

ROUGHNESS_COUNT, COSINE_COUNT = 16, 32
TABLE_TEXELS = 2
LEAST_Z, LARGEST_Z = 0.15, 0.75
"""of the curve's cubic in z = sqrt(F0's root), where z^2 = (ior - 1) / (ior + 1): from an index of 1.05 to 3.6; below it falls to 0"""
_SAMPLE_COUNT = 512
_LEAST_WIDTH = 1e-4


def fresnel_dielectric(cosine: np.ndarray, ior: np.ndarray | float) -> np.ndarray:
    """Reflectance of unpolarized light that meets a denser medium."""
    g = np.sqrt(np.maximum(np.square(ior) - 1.0 + cosine * cosine, 0.0))
    first = (g - cosine) / np.maximum(g + cosine, 1e-12)
    second = (cosine * (g + cosine) - 1.0) / (cosine * (g - cosine) + 1.0)
    return 0.5 * first * first * (1.0 + second * second)


def ggx_lobe(width: np.ndarray, cosine: np.ndarray, count: int = _SAMPLE_COUNT) -> tuple[np.ndarray, np.ndarray]:
    """Visible normals' cosines to the direction of view, and what each counts of the lobe's albedo: both (..., count).

    width: GGX alpha, cosine: of the direction of view, both (...). Sampled as Dupuy and Benyoub 2023, "Sampling Visible GGX Normals with
    Spherical Caps"; points of a lattice after Korobov.
    """
    index = np.arange(count)
    first, second = (index + 0.5) / count, (index * 0.6180339887498949 + 0.5) % 1.0
    width, cosine = np.asarray(width)[..., None], np.asarray(cosine)[..., None]
    sine = np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0))
    length = np.hypot(width * sine, cosine)
    x, z = width * sine / length, cosine / length
    cap = (1.0 - second) * (1.0 + z) - z
    ring = np.sqrt(np.clip(1.0 - cap * cap, 0.0, 1.0))
    half = np.stack([width * (ring * np.cos(2 * np.pi * first) + x), width * ring * np.sin(2 * np.pi * first), np.maximum(cap + z, 0.0)])
    half /= np.linalg.norm(half, axis=0)
    to_half = half[0] * sine + half[2] * cosine
    out = 2.0 * to_half * half[2] - cosine
    masking = _smith(width, cosine)
    weight = np.where(out > 0.0, (1.0 + masking) / (1.0 + masking + _smith(width, np.maximum(out, 1e-6))), 0.0)
    return to_half, weight


def _smith(width: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    return 0.5 * (np.sqrt(1.0 + width * width * (1.0 / (cosine * cosine) - 1.0)) - 1.0)


@functools.cache
def reflectance_table() -> np.ndarray:
    """(ROUGHNESS_COUNT, COSINE_COUNT, TABLE_TEXELS, 4) float32, both axes from 0 to 1: first E, the means of (1 - c)^5 and c (1 - c)^6 over
    the lobe and E's mean over all directions; then the coefficients of 1, z, z^2, z^3 of the dielectric curve's mean."""
    roughness = np.linspace(0.0, 1.0, ROUGHNESS_COUNT)
    cosine = np.maximum(np.linspace(0.0, 1.0, COSINE_COUNT), 1e-3)
    trapezoids = np.convolve(np.diff(cosine), (0.5, 0.5))
    table = np.zeros((ROUGHNESS_COUNT, COSINE_COUNT, TABLE_TEXELS, 4))
    nodes = np.linspace(LEAST_Z, LARGEST_Z, 10)
    fit = np.linalg.pinv(np.vander(nodes, 4, increasing=True))
    for row, width in enumerate(np.maximum(roughness**2, _LEAST_WIDTH)):
        to_half, weight = ggx_lobe(np.full(COSINE_COUNT, width), cosine)
        albedo = weight.mean(axis=-1)
        schlick = (1.0 - to_half) ** 5
        table[row, :, 0, 0] = albedo
        table[row, :, 0, 1] = (weight * schlick).mean(axis=-1) / albedo
        table[row, :, 0, 2] = (weight * to_half * schlick * (1.0 - to_half)).mean(axis=-1) / albedo
        table[row, :, 0, 3] = 2.0 * (albedo * cosine) @ trapezoids
        curves = []
        for z in nodes:
            straight_on = z**4
            curve = (fresnel_dielectric(to_half, (1.0 + z * z) / (1.0 - z * z)) - straight_on) / (1.0 - straight_on)
            curves.append((weight * curve).mean(axis=-1) / albedo)
        table[row, :, 1] = (fit @ np.array(curves)).T
    return table.astype(np.float32)
