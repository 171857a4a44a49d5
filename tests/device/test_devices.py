"""What every device must do, asked of each in turn."""

from __future__ import annotations

import _thread
import dataclasses
import re
import signal
import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from tests.device.kernels import (
    ADD_COUNTS,
    ATOMIC_MIN,
    COLUMNS,
    COPY_FLOATS,
    ECHO,
    INVOCATION_NUMBERS,
    NUMBER_BY_DEPTH,
    NUMBER_TRIANGLES,
    REFUSED,
)
from vir_addon.core.errors import DeviceError, UsageError
from vir_addon.device import open as device_opening
from vir_addon.device.interface import EMPTY_DEPTH_BITS, LINEAR_TEXTURE_WIDTH, MAX_GROUPS_PER_ROW, Draw, TextureFormat

LARGEST_UNSIGNED = 0xFFFFFFFF


def test_description_and_limits(device):
    assert device.description and device.max_texture_size_px >= 4096


def test_uploads_come_back_bit_for_bit(device):
    random = np.random.default_rng(1)
    texels = random.integers(0, 1 << 32, (37, 53, 4), np.uint32)
    # neither NaNs nor denormal numbers, which a device may replace
    exponent = (texels >> 23) & 0xFF
    texels[(exponent == 0) | (exponent == 255)] = np.float32(-0.0).view(np.uint32)
    texture = device.upload_texture(texels.view(np.float32))
    assert (texture.width, texture.height, texture.byte_count) == (53, 37, 37 * 53 * 16)
    read = device.read(texture)
    assert read.dtype == np.float32
    np.testing.assert_array_equal(read.view(np.uint32), texels)
    texture.release()


@pytest.mark.parametrize("value", [0, 7, EMPTY_DEPTH_BITS, LARGEST_UNSIGNED])
def test_fill_unsigned(device, value):
    texture = device.create_texture(33, 17, TextureFormat.R32UI)
    device.fill(texture, value)
    np.testing.assert_array_equal(device.read(texture), np.full((17, 33), value, np.uint32))
    texture.release()


def test_arrays_are_addressed_over_several_rows(device):
    rows = np.random.default_rng(2).random((3 * LINEAR_TEXTURE_WIDTH + 5, 4), np.float32)
    given = device.upload_array(rows)
    copied = device.create_texture(given.width, given.height, TextureFormat.RGBA32F)
    device.compute_kernel(COPY_FLOATS).dispatch_linear(len(rows), given=given, copied=copied)
    np.testing.assert_array_equal(device.read(copied).reshape(-1, 4)[: len(rows)], rows)


def test_long_kernels_fetch_what_short_ones_do(device_called):
    device = device_called("moderngl")
    rows = np.random.default_rng(3).random((70, 4), np.float32)
    given = device.upload_array(rows)
    short, long = (device.compute_kernel(each) for each in (COPY_FLOATS, dataclasses.replace(COPY_FLOATS, name="copy_long", is_long=True)))
    assert short.bindings.fetches_from_images is device.is_software and not long.bindings.fetches_from_images
    for kernel in (short, long):
        copied = device.create_texture(given.width, given.height, TextureFormat.RGBA32F)
        kernel.dispatch_linear(len(rows), given=given, copied=copied)
        np.testing.assert_array_equal(device.read(copied).reshape(-1, 4)[: len(rows)], rows)
    if device.is_software:
        with pytest.raises(TypeError, match="given is declared as RGBA32F"):
            short.dispatch_linear(1, given=device.create_texture(4, 1, TextureFormat.R32UI), copied=copied)


def test_an_empty_array_is_still_a_texture(device):
    assert device.read(device.upload_array(np.zeros((0, 4), np.float32))).shape == (1, LINEAR_TEXTURE_WIDTH, 4)


def test_an_array_that_fits_no_texture_is_refused(device, monkeypatch):
    monkeypatch.setattr(device, "max_texture_size_px", 1)
    with pytest.raises(UsageError, match="split the scene"):
        device.upload_array(np.zeros((LINEAR_TEXTURE_WIDTH + 1, 4), np.float32))


@pytest.mark.parametrize("texture_format", [TextureFormat.RGBA32F, TextureFormat.RG32UI])
def test_a_texture_that_there_is_no_memory_for_is_refused(device, texture_format):
    if not device.is_software:
        pytest.skip("a GPU may have the memory, and takes it of others")
    side = device.max_texture_size_px
    with pytest.raises(DeviceError, match=f"no memory for a texture of {side} x {side} texels .* lower resolution"):
        device.create_texture(side, side, texture_format)
    assert device.read(device.upload_texture(np.ones((2, 3, 4), np.float32))).sum() == 24


@pytest.mark.parametrize("invocation_count", [1, 4 * MAX_GROUPS_PER_ROW, 4 * 65536 + 3])
def test_a_dispatch_larger_than_one_dimension_reaches_every_number_once(device, invocation_count):
    height = -(-invocation_count // LINEAR_TEXTURE_WIDTH)
    numbers = device.create_texture(LINEAR_TEXTURE_WIDTH, height, TextureFormat.R32UI)
    device.fill(numbers, 0)
    device.compute_kernel(INVOCATION_NUMBERS).dispatch_linear(invocation_count, numbers=numbers, invocation_count=invocation_count)
    expected = np.zeros(LINEAR_TEXTURE_WIDTH * height, np.uint32)
    expected[:invocation_count] = np.arange(1, invocation_count + 1)
    np.testing.assert_array_equal(device.read(numbers).ravel(), expected)


def test_nothing_is_dispatched_for_nothing(device):
    numbers = device.create_texture(4, 1, TextureFormat.R32UI)
    device.fill(numbers, 7)
    device.compute_kernel(INVOCATION_NUMBERS).dispatch_linear(0, numbers=numbers, invocation_count=4)
    np.testing.assert_array_equal(device.read(numbers), np.full((1, 4), 7))


def test_atomic_minimum(device):
    count, width = 100_000, 16
    lowest = device.create_texture(width, 1, TextureFormat.R32UI)
    device.fill(lowest, EMPTY_DEPTH_BITS)
    device.compute_kernel(ATOMIC_MIN).dispatch_linear(count, lowest=lowest, invocation_count=count, width=width)
    # invocation i tries count - i in texel i % width
    np.testing.assert_array_equal(device.read(lowest)[0], np.arange(width, 0, -1))


def test_a_dispatch_sees_what_dispatches_and_fills_before_it_wrote(device):
    seen, counts = (device.create_texture(64, 64, TextureFormat.R32UI) for _ in range(2))
    device.fill(seen, 1)
    device.fill(counts, 0)
    kernel = device.compute_kernel(ADD_COUNTS)
    for _ in range(10):
        # each becomes the sum of both, in turn: Fibonacci's numbers
        kernel.dispatch((8, 8, 1), seen=seen, counts=counts)
        kernel.dispatch((8, 8, 1), seen=counts, counts=seen)
    np.testing.assert_array_equal(device.read(counts), np.full((64, 64), 6765))
    np.testing.assert_array_equal(device.read(seen), np.full((64, 64), 10946))


ECHO_BINDINGS = {
    "an_int": -3,
    "a_float": 0.25,
    "a_vec2": (1, 2),
    "a_vec3": np.array([3.0, 4.0, 5.0]),
    "a_vec4": [1, 10, 100, 1000],
    "a_mat4": np.arange(16.0).reshape(4, 4),
    "unused": 1,
    "first_table": np.arange(8.0).reshape(2, 4),
    "second_table": np.full((2, 4), 9.0),
}


def test_constants_and_tables_arrive(device):
    heard = device.create_texture(10, 1, TextureFormat.RGBA32F)
    device.compute_kernel(ECHO, "SCALED").dispatch((1, 1, 1), heard=heard, **ECHO_BINDINGS)
    expected = [
        [-3, 0.25, 0, 0],
        [1, 2, 0, 0],
        [3, 4, 5, 0],
        [1, 10, 100, 1000],
        ECHO_BINDINGS["a_mat4"] @ ECHO_BINDINGS["a_vec4"],
        [0, 1, 2, 3],
        [4, 5, 6, 7],
        [0, 0, 0, 0],
        [9, 9, 9, 9],
        [2.5, 2.5, 2.5, 2.5],
    ]
    np.testing.assert_array_equal(device.read(heard)[0], np.float32(expected))


def test_what_is_bound_for_one_dispatch_is_gone_in_the_next(device):
    heard = device.create_texture(10, 1, TextureFormat.RGBA32F)
    kernel = device.compute_kernel(ECHO, "SCALED")
    kernel.dispatch((1, 1, 1), heard=heard, **ECHO_BINDINGS)
    kernel.dispatch((1, 1, 1), heard=heard, **{**ECHO_BINDINGS, "an_int": 8, "first_table": np.ones((1, 4))})
    read = device.read(heard)[0]
    assert read[0, 0] == 8
    np.testing.assert_array_equal(read[5:8], [[1] * 4, [0] * 4, [0] * 4])


def test_wrong_bindings_are_refused(device):
    kernel = device.compute_kernel(ECHO)
    with pytest.raises(TypeError, match=r"kernel test_echo: missing \['heard'\]"):
        kernel.dispatch((1, 1, 1), **ECHO_BINDINGS)
    with pytest.raises(TypeError, match=r"unknown \['hard'\]"):
        kernel.dispatch((1, 1, 1), hard=1, heard=None, **ECHO_BINDINGS)
    with pytest.raises(TypeError, match="unknown flags"):
        device.compute_kernel(ECHO, "SCALDE")


def test_variants_are_compiled_once(device):
    assert device.compute_kernel(ECHO) is device.compute_kernel(ECHO)
    assert device.compute_kernel(ECHO) is not device.compute_kernel(ECHO, "SCALED")


def test_a_refused_shader_names_kernel_file_and_line(device):
    with pytest.raises(DeviceError, match=r"kernel test_refused: .*refused\.comp\.glsl:4: int missing") as refusal:
        device.compute_kernel(REFUSED)
    # once in the line that is shown, once in what the driver says
    assert str(refusal.value).count("name_that_is_not_there") >= 2


# drawing: a right triangle over the viewport's lower left half, and one behind it that covers all

IDENTITY = np.eye(4)
COUNTER_CLOCKWISE = np.array([[-1, -1, 0.5], [1, -1, 0.5], [-1, 1, 0.5]], np.float32)
TWO_DEPTHS = np.array([[-1, -1, 0.5], [1, -1, 0.5], [-1, 1, 0.5], [-1, -1, 0], [3, -1, 0], [-1, 3, 0]], np.float32)


@pytest.fixture
def canvas(device):
    """(16 x 16 target, function that draws on the cleared target and reads it)"""
    color = device.create_texture(16, 16, TextureFormat.R32UI)
    depth = device.create_texture(16, 16, TextureFormat.DEPTH32F)
    target = device.create_target(color, depth)
    device.fill(color, 0)
    device.fill(depth, 0)

    def drawn(draws, viewport=(0, 0, 16, 16), clip_from_object=IDENTITY, offsets=((0, 0, 0, 0),)):
        kernel = device.raster_kernel(NUMBER_TRIANGLES)
        kernel.draw(target, viewport, draws, clip_from_object=clip_from_object, offsets=offsets)
        return device.read(color)

    yield drawn
    for thing in (target, color, depth):
        thing.release()


def mesh(device, positions, triangles=((0, 1, 2),)):
    return device.upload_mesh(np.array(positions, np.float32), np.array(triangles, np.int32))


def half(count=16):
    """(count, count) bool, row 0 at the bottom: texels whose centre is in the lower left half"""
    rows, columns = np.indices((count, count))
    return rows + columns < count - 1


def inside(count=16):
    """`half` without the diagonal, which lies on the triangle's edge"""
    rows, columns = np.indices((count, count))
    return rows + columns != count - 1


def test_row_0_is_the_bottom_row(device, canvas):
    picture = canvas([Draw(mesh(device, COUNTER_CLOCKWISE), 1, {"first_instance": 0})])
    np.testing.assert_array_equal((picture == 1)[inside()], half()[inside()])


def test_drawing_nothing_leaves_the_picture(canvas):
    np.testing.assert_array_equal(canvas([]), np.zeros((16, 16)))


def test_instances_and_constants_of_draws(device, canvas):
    small = mesh(device, COUNTER_CLOCKWISE * [0.25, 0.25, 1])
    offsets = np.array([[x, y, 0, 0] for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    picture = canvas([Draw(small, 3, {"first_instance": 0}), Draw(small, 1, {"first_instance": 3})], offsets=offsets)
    for instance, (row, column) in enumerate([(2, 2), (2, 10), (10, 2), (10, 10)]):
        assert picture[row, column] == instance * 10 + 1
    assert set(np.unique(picture)) == {0, 1, 11, 21, 31}


def test_back_faces_are_culled_where_a_draw_says_so(device, canvas):
    front, back = mesh(device, COUNTER_CLOCKWISE), mesh(device, COUNTER_CLOCKWISE[::-1])
    assert canvas([Draw(back, 1, {"first_instance": 0}, cull_back_faces=True)]).max() == 0
    picture = canvas(
        [
            Draw(back, 1, {"first_instance": 1}, cull_back_faces=True),
            Draw(front, 1, {"first_instance": 2}, cull_back_faces=True),
        ]
    )
    assert picture[0, 0] == 21
    assert canvas([Draw(mesh(device, COUNTER_CLOCKWISE[::-1] - [0, 0, 0.1]), 1, {"first_instance": 0})])[0, 0] == 1


@pytest.mark.parametrize("order", [[[0, 1, 2], [3, 4, 5]], [[3, 4, 5], [0, 1, 2]]])
def test_the_nearest_triangle_is_seen_in_any_order(device, canvas, order):
    # clip space looks along +z here: depth 0 is before 0.5
    picture = canvas([Draw(mesh(device, TWO_DEPTHS, order), 1, {"first_instance": 0})])
    np.testing.assert_array_equal(picture, np.full((16, 16), 1 + order.index([3, 4, 5])))


def test_equal_depth_does_not_replace(device, canvas):
    both = mesh(device, COUNTER_CLOCKWISE, [[0, 1, 2], [0, 1, 2]])
    assert canvas([Draw(both, 1, {"first_instance": 0})])[0, 0] == 1


def test_fragments_may_say_their_depth_to_the_last_bit(device):
    color = device.create_texture(16, 16, TextureFormat.R32UI)
    depth = device.create_texture(16, 16, TextureFormat.DEPTH32F)
    target = device.create_target(color, depth)
    everywhere = mesh(device, TWO_DEPTHS[3:])
    for order in ([3, 1, 0, 2], [0, 1, 2, 3]):
        device.fill(depth, 0)
        draws = [Draw(everywhere, 1, {"first_instance": instance}) for instance in order]
        device.raster_kernel(NUMBER_BY_DEPTH).draw(target, (0, 0, 16, 16), draws, clip_from_object=IDENTITY, offsets=np.zeros((4, 4)))
        np.testing.assert_array_equal(device.read(color), np.full((16, 16), 1))
    for thing in (target, color, depth):
        thing.release()


def test_viewport(device, canvas):
    everywhere = mesh(device, TWO_DEPTHS[3:])
    picture = canvas([Draw(everywhere, 1, {"first_instance": 0})], viewport=(4, 8, 6, 3))
    expected = np.zeros((16, 16))
    expected[8:11, 4:10] = 1
    np.testing.assert_array_equal(picture, expected)


def test_matrices_are_applied_from_the_left(device, canvas):
    shifted = np.eye(4)
    shifted[0, 3] = 1.0  # half the picture to the right
    picture = canvas([Draw(mesh(device, TWO_DEPTHS[3:]), 1, {"first_instance": 0})], clip_from_object=shifted)
    np.testing.assert_array_equal(picture, np.where(np.arange(16) >= 8, 1, 0) * np.ones((16, 1)))


def test_a_depth_fill_forgets_what_was_near(device):
    color = device.create_texture(4, 4, TextureFormat.R32UI)
    depth = device.create_texture(4, 4, TextureFormat.DEPTH32F)
    target = device.create_target(color, depth)
    kernel = device.raster_kernel(NUMBER_TRIANGLES)
    bindings = {"clip_from_object": IDENTITY, "offsets": np.zeros((4, 4))}
    everywhere = mesh(device, TWO_DEPTHS[3:])
    device.fill(depth, 0)
    for instance, fill_between, expected in ((0, False, 1), (1, False, 1), (2, True, 21)):
        if fill_between:
            device.fill(depth, 0)
        kernel.draw(target, (0, 0, 4, 4), [Draw(everywhere, 1, {"first_instance": instance})], **bindings)
        np.testing.assert_array_equal(device.read(color), np.full((4, 4), expected))


@pytest.mark.parametrize("column_count", [0, 1, 5, 16])
def test_strips_are_made_of_numbers(device, canvas, column_count):
    """By a geometry shader, which counts them, and so do the fragments."""
    if not device.stores_from_geometry:
        with pytest.raises(DeviceError, match=r"test_columns.*the device moderngl"):
            device.geometry_kernel(COLUMNS)
        return
    canvas([Draw(mesh(device, TWO_DEPTHS[3:]), 1, {"first_instance": 99})])
    color = device.create_texture(16, 16, TextureFormat.R32UI)
    depth = device.create_texture(16, 16, TextureFormat.DEPTH32F)
    target = device.create_target(color, depth)
    counts = device.create_texture(2, 1, TextureFormat.R32UI)
    for texture in (color, counts, depth):
        device.fill(texture, 0)
    device.geometry_kernel(COLUMNS).draw(target, (0, 0, 16, 8), column_count, counts=counts, column_count=column_count)
    expected = np.zeros((16, 16), int)
    if column_count:
        expected[:8] = (np.arange(16) + 0.5) * column_count // 16 + 1
    np.testing.assert_array_equal(device.read(color), expected)
    np.testing.assert_array_equal(device.read(counts)[0], [column_count, 128 * bool(column_count)])
    for thing in (target, color, depth, counts):
        thing.release()


def test_a_draw_then_a_dispatch_then_a_draw_see_each_other(device, canvas):
    copy, picture = (device.create_texture(16, 16, TextureFormat.R32UI) for _ in range(2))
    device.fill(copy, 100)
    depth = device.create_texture(16, 16, TextureFormat.DEPTH32F)
    target = device.create_target(picture, depth)
    everywhere = mesh(device, TWO_DEPTHS[3:])
    kernel = device.raster_kernel(NUMBER_TRIANGLES)
    for instance in range(3):
        device.fill(depth, 0)
        draws = [Draw(everywhere, 1, {"first_instance": instance})]
        kernel.draw(target, (0, 0, 16, 16), draws, clip_from_object=IDENTITY, offsets=np.zeros((4, 4)))
        device.compute_kernel(ADD_COUNTS).dispatch((2, 2, 1), seen=picture, counts=copy)
    np.testing.assert_array_equal(device.read(copy), np.full((16, 16), 100 + 1 + 11 + 21))


def test_a_mesh_is_drawn_by_two_kernels_and_released(device, canvas):
    triangle = mesh(device, TWO_DEPTHS[3:])
    np.testing.assert_array_equal(canvas([Draw(triangle, 1, {"first_instance": 0})]), np.full((16, 16), 1))
    color = device.create_texture(8, 8, TextureFormat.R32UI)
    depth = device.create_texture(8, 8, TextureFormat.DEPTH32F)
    device.fill(color, 3)
    device.fill(depth, 0)
    other = device.raster_kernel(dataclasses.replace(NUMBER_TRIANGLES, name="number_triangles_again"))
    draws = [Draw(triangle, 1, {"first_instance": 1})]
    other.draw(device.create_target(color, depth), (0, 0, 8, 8), draws, clip_from_object=IDENTITY, offsets=np.zeros((4, 4)))
    np.testing.assert_array_equal(device.read(color), np.full((8, 8), 11))
    triangle.release()


# threads, opening, closing


def test_run_returns_and_raises(device):
    assert device.run(lambda a, b: a + b, 1, 2) == 3
    with pytest.raises(ZeroDivisionError):
        device.run(lambda: 1 / 0)
    # within itself it does not wait for itself
    assert device.run(lambda: device.run(lambda: 5)) == 5


def test_blender_s_gpu_refuses_other_threads(device_called):
    device = device_called("gpu")
    refused = []

    def use():
        try:
            device.create_texture(4, 4, TextureFormat.R32UI)
        except DeviceError as error:
            refused.append(str(error))

    thread = threading.Thread(target=use)
    thread.start()
    thread.join()
    assert refused and re.search("works only on the thread that opened the device", refused[0])


def test_blender_s_gpu_does_not_pretend_to_read_what_it_cannot(device_called):
    device = device_called("gpu")
    with pytest.raises(DeviceError, match="cannot read RG32UI"):
        device.read(device.create_texture(4, 4, TextureFormat.RG32UI))


def test_two_channels_are_filled(device_called):
    device = device_called("moderngl")
    texture = device.create_texture(5, 3, TextureFormat.RG32UI)
    device.fill(texture, LARGEST_UNSIGNED)
    np.testing.assert_array_equal(device.read(texture), np.full((3, 5, 2), LARGEST_UNSIGNED, np.uint32))


def test_a_device_closes_and_opens_again(device_called):
    device_called("moderngl")
    second = device_opening.open_device("moderngl")
    texture = second.create_texture(4, 4, TextureFormat.R32UI)
    second.fill(texture, 5)
    assert second.read(texture).min() == 5
    second.close()


def test_unknown_and_missing_devices_say_what_to_do(monkeypatch):
    with pytest.raises(DeviceError, match="unknown device 'vulkan'; there are moderngl and gpu"):
        device_opening.open_device("vulkan")
    monkeypatch.setitem(sys.modules, "moderngl", None)
    with pytest.raises(DeviceError, match="pip install moderngl"):
        device_opening.open_device("moderngl")
    monkeypatch.setitem(sys.modules, "bpy", None)
    with pytest.raises(DeviceError, match="use the device moderngl"):
        device_opening.open_device("gpu")


def test_blenders_module_is_refused_before_5_2_also_in_a_window(monkeypatch):
    blender = SimpleNamespace(app=SimpleNamespace(version=(5, 0, 1), version_string="5.0.1", background=False))
    monkeypatch.setitem(sys.modules, "bpy", blender)
    monkeypatch.setitem(sys.modules, "gpu", SimpleNamespace())
    with pytest.raises(DeviceError, match=r"Blender 5\.0\.1 .* moderngl"):
        device_opening.open_device("gpu")


@pytest.fixture
def hears_ctrl_c():
    """What a script starts in the background ignores Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("hears_ctrl_c")
def test_a_wait_hears_ctrl_c_that_reached_another_thread(device_called):
    device = device_called("moderngl")
    asking = threading.Timer(0.1, _thread.interrupt_main)
    asking.start()
    start_s = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        device.run(time.sleep, 2.0)
    assert time.perf_counter() - start_s < 1.5
    device.finish()
