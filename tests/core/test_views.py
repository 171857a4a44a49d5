"""Faces and windows: every direction belongs to one face, and maps of whatever windows lie on whole texels of one lattice."""

import math

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.scenes import area_light
from vir_addon.core.views import LADDER_STEPS_PER_OCTAVE, area_light_faces, fit_windows, light_axes, snap_up_to_ladder

LIGHT = area_light(eye=(1.0, -2.0, 3.0), target=(0.5, 0.3, 0.1))
FACE = area_light_faces(LIGHT, needs_cube=False)[0]
SIZES = st.floats(1e-6, 1e3)
EDGES = st.floats(-1.1, 1.1)


@given(SIZES)
def test_ladder(size):
    step = snap_up_to_ladder(size)
    number = math.log2(step) * LADDER_STEPS_PER_OCTAVE
    assert abs(number - round(number)) < 1e-9
    # the smallest that is large enough, up to the rounding that keeps a step on itself
    assert size * (1 - 1e-9) <= step < size * 2 ** (1 / LADDER_STEPS_PER_OCTAVE) * (1 + 1e-9)
    assert snap_up_to_ladder(step) == step


@st.composite
def window_sets(draw, view_count=4):
    """(view_count, 4) left, right, bottom, top"""
    windows = []
    for _ in range(view_count):
        x, y = (sorted((draw(EDGES), draw(EDGES))) for _ in range(2))
        windows.append([*x, *y])
    return np.array(windows)


def fitted(windows, resolution_px):
    centers = np.zeros((len(windows), 3))
    return fit_windows(FACE, centers, centers, windows, resolution_px, 1e-3, 10.0, np.zeros(3))


@given(windows=window_sets(), resolution_px=st.integers(16, 4096))
def test_maps_cover_their_windows(windows, resolution_px):
    views = fitted(windows, resolution_px)
    for number, (left, right, bottom, top) in enumerate(windows):
        low_x, high_x, low_y, high_y = views.window_tangents(number)
        # the outermost place still has a texel around it, for look-ups between texels
        assert low_x + views.texel_tangent[0] <= left and right <= high_x - views.texel_tangent[0]
        assert low_y + views.texel_tangent[1] <= bottom and top <= high_y - views.texel_tangent[1]


@given(first=window_sets(), second=window_sets(), resolution_px=st.integers(16, 4096), place=st.tuples(EDGES, EDGES))
def test_windows_lie_on_one_lattice(first, second, resolution_px, place):
    """Where within its texel a direction falls does not depend on the window but by a step of the ladder."""
    a, b = fitted(first, resolution_px), fitted(second, resolution_px)
    for axis in (0, 1):
        steps = math.log2(a.texel_tangent[axis] / b.texel_tangent[axis]) * LADDER_STEPS_PER_OCTAVE
        assert abs(steps - round(steps)) < 1e-9
        if round(steps):
            continue
        falls = [
            (place[axis] - views.window_tangents(number)[2 * axis]) / views.texel_tangent[axis] for views in (a, b) for number in range(4)
        ]
        apart = np.array(falls) - falls[0]
        assert np.abs(apart - np.round(apart)).max() < 1e-6


@given(window=window_sets(1), shift=st.tuples(st.integers(-500, 500), st.integers(-500, 500)), resolution_px=st.integers(64, 2048))
def test_a_window_that_moves_by_texels_takes_its_map_along(window, shift, resolution_px):
    before = fitted(window, resolution_px)
    tx, ty = before.texel_tangent
    moved = window + np.array([shift[0] * tx, shift[0] * tx, shift[1] * ty, shift[1] * ty])
    # a window edge on a texel's edge may be rounded to either side
    corner = window[0, [0, 2]] / before.texel_tangent
    assume(np.abs(corner - np.round(corner)).min() > 1e-6)
    after = fitted(moved, resolution_px)
    assume(after.texel_tangent == before.texel_tangent)
    np.testing.assert_array_equal(after.window_texels - before.window_texels, [shift])


@given(direction=st.tuples(*[st.floats(-1, 1)] * 3))
def test_one_face_of_the_half_cube_for_every_direction_before_the_light(direction):
    assume(np.linalg.norm(direction) > 1e-3)
    along = light_axes(LIGHT) @ direction
    share = np.sort(np.abs(along))
    assume(abs(along[2]) > 1e-3 and share[2] - share[1] > 1e-6)
    responsible = []
    for face in area_light_faces(LIGHT, needs_cube=True):
        np.testing.assert_allclose(face.face_from_world @ face.face_from_world.T, np.eye(3), atol=1e-12)
        x, y, z = face.face_from_world @ direction
        left, right, bottom, top = face.limits
        if z > 0 and left * z <= x <= right * z and bottom * z <= y <= top * z:
            responsible.append(face.index)
    axis = int(np.argmax(np.abs(along)))
    expected = 0 if axis == 2 else 1 + 2 * axis + int(along[axis] < 0)
    assert responsible == ([expected] if along[2] > 0 else [])
