"""EXR files: nothing lost, nothing half-written, read by Blender as it reads its own."""

import os
import resource
import signal
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vir_addon.core.errors import DeviceError, UsageError
from vir_addon.core.exr import channel_name, write_exr
from vir_addon.core.files import whole_file
from vir_addon.core.pass_set import PASS_NAME_BYTES_MAX, PassSet, PassStatistics, SetStatistics, unique_pass_names


def make_passes(light_names: list[str], height: int = 5, width: int = 7) -> PassSet:
    random = np.random.default_rng(7)
    names = ["VIR Shadow", *unique_pass_names(light_names).values()]
    made = [PassStatistics("VIR Shadow Key", "Key", "ivir buffered", "", view_count=64, map_resolution_px=1024, error_estimate=0.0042)]
    return PassSet({name: random.random((height, width), dtype=np.float32) for name in names}, SetStatistics(passes=made))


def write(target: Path, passes: PassSet, view_layer_name: str = "ViewLayer") -> Path:
    write_exr(target, {view_layer_name: passes}, scene_name="Scene", frame=12)
    return target


def read(path: Path) -> tuple[dict, dict[str, np.ndarray]]:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        assert len(file.parts) == 1
        return dict(file.header()), {name: np.array(channel.pixels) for name, channel in file.channels().items()}


def test_every_pass_comes_back_bit_equal_and_upside_down(tmp_path):
    passes = make_passes(["Key", "Fill.001", "主光"])
    passes.images["VIR Shadow"][0, 0] = np.float32(1e-40)  # a denormal: no conversion on the way keeps it
    header, channels = read(write(tmp_path / "a.exr", passes, "View.Layer"))
    assert set(channels) == {f"View_Layer.VIR Shadow{light}.V" for light in ("", " Key", " Fill_001", " 主光")}
    for name, image in passes.images.items():
        stored = channels[channel_name("View.Layer", name)]
        assert stored.dtype == np.float32
        np.testing.assert_array_equal(stored.view(np.uint32), image[::-1].view(np.uint32))
    assert header["compression"] == OpenEXR.ZIP_COMPRESSION
    assert (header["Frame"], header["vir:frame"], header["Scene"]) == ("12", 12, "Scene")
    assert header["vir:View_Layer.VIR Shadow Key.V"] == "ivir buffered, 64 views at 1024 px, standard error 0.0042"


def test_an_interrupted_write_leaves_the_old_file_and_nothing_else(tmp_path):
    target = tmp_path / "a.exr"
    target.write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt), whole_file(target) as temporary:
        temporary.write_bytes(b"half")
        raise KeyboardInterrupt
    assert target.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a.exr"]


def test_a_full_disk_is_said_and_leaves_nothing(tmp_path):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
    try:
        with pytest.raises(UsageError, match=r"cannot write .*a\.exr"):
            write(tmp_path / "a.exr", make_passes(["Key"], 200, 300))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert os.listdir(tmp_path) == []


def test_a_folder_that_cannot_be_is_said(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match=r"cannot write .*file/a\.exr"):
        write(tmp_path / "file" / "a.exr", make_passes(["Key"]))
    with pytest.raises(UsageError, match="cannot write"):
        write(tmp_path, make_passes(["Key"]))  # a folder of that name is in the way
    assert sorted(os.listdir(tmp_path)) == ["file"]


def test_pipes_and_devices_are_not_renamed_over(tmp_path):
    target = tmp_path / "pipe"
    os.mkfifo(target)
    with pytest.raises(UsageError, match="pipe or a device"):
        write(target, make_passes(["Key"]))
    assert target.is_fifo() and os.listdir(tmp_path) == ["pipe"]


def test_missing_folders_are_made_and_files_are_readable_by_others(tmp_path):
    target = write(tmp_path / "new" / "deeper" / "a.exr", make_passes(["Key"]))
    mask = os.umask(0)
    os.umask(mask)
    assert target.stat().st_mode & 0o777 == 0o666 & ~mask


def test_no_pass_is_lost_to_a_shared_channel(tmp_path):
    image = np.zeros((2, 2), np.float32)
    with pytest.raises(UsageError, match="two passes"):
        write(tmp_path / "a.exr", PassSet({"VIR Shadow A.b": image, "VIR Shadow A_b": image}, SetStatistics()))
    with pytest.raises(UsageError, match="no pass"):
        write(tmp_path / "a.exr", PassSet({}, SetStatistics()))


def test_names_that_collide_are_numbered_and_the_plain_one_stays():
    assert unique_pass_names(["Key.001", "Key_001"]) == {"Key.001": "VIR Shadow Key_001_2", "Key_001": "VIR Shadow Key_001"}
    long_names = ["é" * 40 + end for end in "ab"]
    first, second = unique_pass_names(long_names).values()
    assert first != second and second.endswith("_2")


@given(st.lists(st.text(alphabet="aé光._2", max_size=70), unique=True, max_size=12), st.randoms())
def test_pass_names_are_unique_short_and_independent_of_order(light_names, random):
    names = unique_pass_names(light_names)
    assert set(names) == set(light_names)
    assert len({*names.values(), "VIR Shadow"}) == len(light_names) + 1
    assert all(len(name.encode()) <= PASS_NAME_BYTES_MAX and "." not in name for name in names.values())
    random.shuffle(light_names)
    assert unique_pass_names(light_names) == names


def test_a_missing_package_is_named_with_what_installs_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(DeviceError, match=r"pip install OpenEXR"):
        write_exr(tmp_path / "a.exr", {}, scene_name="Scene", frame=1)
