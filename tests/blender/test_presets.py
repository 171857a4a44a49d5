"""Shipped presets: found by Blender, valid, different from each other; users add theirs."""

import pytest

bpy = pytest.importorskip("bpy")

from vir_addon import blender  # noqa: E402  (bpy decides whether this file runs)
from vir_addon.blender import panels, presets, properties  # noqa: E402
from vir_addon.core.settings import Settings  # noqa: E402
from vir_addon.resources import preset_folder  # noqa: E402

NAMES = ("Draft", "Balanced", "Final", "Reference")


@pytest.fixture
def registered(scene):
    blender.register()
    yield scene
    blender.unregister()


def execute(name):
    path = bpy.utils.preset_find(name, presets.SUBFOLDER)
    assert path, f"Blender does not find {name}"
    bpy.ops.script.execute_preset(filepath=path, menu_idname="VIR_PT_presets")


def test_all_are_found_and_valid_and_get_finer(registered):
    settings = []
    for name in NAMES:
        execute(name)
        settings.append(properties.settings_of(registered))
        assert presets.matching_preset(registered.vir) == name
    views = [one.view_count for one in settings]
    assert views == sorted(set(views)) and settings[NAMES.index("Balanced")] == Settings()
    assert [one.map_resolution_px for one in settings] == sorted(one.map_resolution_px for one in settings)


def test_each_says_everything_that_a_preset_says(registered):
    for name in NAMES:
        text = (preset_folder() / presets.SUBFOLDER / f"{name}.py").read_text()
        said = [line.partition(" = ")[0].removeprefix("vir.") for line in text.splitlines() if line.startswith("vir.")]
        assert sorted(said) == sorted(presets.PRESET_PROPERTIES), name


def test_presets_leave_the_scenes_choices_alone(registered):
    registered.vir.use_omni_shadows, registered.vir.device, registered.vir.use_on_render = False, "GPU", True
    for name in NAMES:
        execute(name)
    assert (registered.vir.use_omni_shadows, registered.vir.device, registered.vir.use_on_render) == (False, "GPU", True)


def test_users_add_and_remove_their_own(registered, tmp_path, monkeypatch):
    monkeypatch.setattr(bpy.utils, "user_resource", lambda kind, path="", create=False: make(tmp_path / path))
    monkeypatch.setattr(bpy.utils, "preset_paths", lambda subfolder: [str(tmp_path / "presets" / subfolder)])

    def make(folder):
        folder.mkdir(parents=True, exist_ok=True)
        return str(folder)

    registered.vir.view_count, registered.vir.method = 40, "IVIR"
    bpy.ops.vir.preset_add(name="Mine")
    (written,) = (tmp_path / "presets" / presets.SUBFOLDER).iterdir()
    registered.vir.view_count, registered.vir.method = 8, "AUTO"
    bpy.ops.script.execute_preset(filepath=str(written), menu_idname="VIR_PT_presets")
    assert (registered.vir.view_count, registered.vir.method) == (40, "IVIR")
    (written.parent / "broken.py").write_text("vir.view_count = ")
    assert presets.matching_preset(registered.vir) == "Mine"
    registered.vir.view_count = 41
    assert presets.matching_preset(registered.vir) == ""
    (written.parent / "broken.py").unlink()
    bpy.ops.vir.preset_add(name="Mine", remove_name=True)
    assert not written.exists()


def test_what_the_panel_shows_for_a_method_is_in_every_preset():
    shown = {name for names in panels.METHOD_PROPERTIES.values() for name in names}
    assert shown and shown <= set(presets.PRESET_PROPERTIES)
