"""Settings live in the .blend: what is set survives saving, appending and linking, and files of older versions are brought up to date."""

import dataclasses

import pytest

bpy = pytest.importorskip("bpy")

from vir_addon import blender  # noqa: E402  (bpy decides whether this file runs)
from vir_addon.blender import object_names, panels, properties  # noqa: E402
from vir_addon.blender.extract import snapshot  # noqa: E402
from vir_addon.core.errors import UsageError  # noqa: E402
from vir_addon.core.plan import plan  # noqa: E402
from vir_addon.core.quality import map_resolution_of_views, quality_of_views, views_of_quality  # noqa: E402
from vir_addon.core.settings import Method, PointGeneration, PointStorage, Resolve, Settings  # noqa: E402


@pytest.fixture
def registered(scene):
    blender.register()
    yield scene
    blender.unregister()


def save(tmp_path, name="saved.blend"):
    path = tmp_path / name
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True, check_existing=False)
    return path


def open_file(path):
    bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
    return bpy.context.scene


def linked_lights(path, link: bool):
    with bpy.data.libraries.load(str(path), link=link) as (source, target):
        target.lights = source.lights
    return target.lights


def test_an_untouched_scene_asks_for_the_cores_defaults(registered):
    assert properties.settings_of(registered) == Settings()


def test_every_setting_of_the_core_can_be_set(registered):
    chosen = {
        "method": "IVIR", "points": "BUFFERLESS", "point_generation": "RASTERIZER", "view_count": 24, "map_resolution_px": 512,
        "use_soft_shadows": False, "use_omni_shadows": False, "stochastic_culling": False, "culling_area_texels": 0.5, "resolve": "FULL",
        "cull_hidden": False, "watertight": False, "small_triangle_points": 5, "back_faces": True, "views_per_thread": 2,
        "blocker_sample_count": 7, "filter_sample_count": 9, "replay_buffer_mib": 100,
        "use_reflections": True, "bounces": 3, "reflection_method": "EPR", "planar": False, "points_per_eye_pixel": 0.25,
        "reflection_look_up": "DIRECTION", "per_reflector": True, "reflection_map_mib": 64,
    }  # fmt: skip
    for name, value in chosen.items():
        setattr(registered.vir, name, value)
    wanted, default = properties.settings_of(registered), Settings()
    # lights have a switch each instead of light_names; previews choose their batches and textures; the device decides the hardware
    not_offered = {"light_names", "reflection_sample_count", "batch_view_count", "visibility_texel_count", "hardware"}
    # cubes of one size whatever they show, words of ivir's, and fewer eye samples than rays, are for comparing with the papers
    not_offered |= {"reflection_cube_px", "reflection_words", "reflection_filter"}
    same = [field.name for field in dataclasses.fields(Settings) if getattr(wanted, field.name) == getattr(default, field.name)]
    assert set(same) == not_offered


def test_the_panel_offers_what_the_core_has(registered):
    kinds = {"method": Method, "points": PointStorage, "point_generation": PointGeneration, "resolve": Resolve}
    for name, kind in kinds.items():
        offered = {item.identifier for item in registered.vir.bl_rna.properties[name].enum_items}
        assert {choice.value.upper() for choice in kind} == offered


def test_every_property_says_what_it_does(registered):
    for group in properties.CLASSES:
        for described in group.bl_rna.properties:
            if described.identifier not in ("rna_type", "name"):
                assert described.name and described.description and not described.description.endswith("."), described.identifier
                for item in getattr(described, "enum_items", ()):
                    assert item.description, f"{described.identifier} {item.identifier}"


def test_asking_for_nothing_is_an_error_in_words(registered):
    registered.vir.use_soft_shadows = registered.vir.use_omni_shadows = False
    with pytest.raises(UsageError, match="switch Soft Shadows, Omni Shadows or Reflections on"):
        properties.settings_of(registered)


def test_what_another_method_left_behind_says_nothing(registered):
    registered.vir.method, registered.vir.points, registered.vir.point_generation = "IVIR", "BUFFERLESS", "RASTERIZER"
    assert properties.settings_of(registered).points.value == "bufferless"
    for item in registered.vir.bl_rna.properties["method"].enum_items:
        registered.vir.method = item.identifier
        properties.settings_of(registered)


def test_the_slider_and_the_numbers_say_the_same(registered):
    group = registered.vir
    for quality in (0.0, 0.2, 0.5, 0.9, 1.0):
        group.quality = quality
        assert group.view_count == views_of_quality(quality) and group.map_resolution_px == map_resolution_of_views(group.view_count)
        assert group.quality == pytest.approx(quality, abs=0.05), "more than half a batch away"
    group.view_count = 64
    assert group.quality == pytest.approx(0.5)


def test_quality_is_monotonic_and_in_whole_batches():
    steps = [views_of_quality(step / 100) for step in range(-5, 106)]
    assert steps == sorted(steps) and steps[0] == 8 and steps[-1] == 512 and all(count % 8 == 0 for count in steps)
    assert all(views_of_quality(quality_of_views(count)) == count for count in steps)
    assert (quality_of_views(1), quality_of_views(4096)) == (0.0, 1.0)


def test_settings_survive_saving_and_opening(registered, add, tmp_path):
    lamp = add.light("Key")
    registered.vir.method, registered.vir.view_count, registered.vir.preview_slice_ms = "EPR", 40, 120.0
    lamp.data.vir.use_own_views, lamp.data.vir.view_count, lamp.vir.reflector = True, 12, "NEVER"
    scene = open_file(save(tmp_path))
    assert (scene.vir.method, scene.vir.view_count, scene.vir.preview_slice_ms) == ("EPR", 40, 120.0)
    assert scene.vir.version == properties.VERSION
    lamp = bpy.data.objects["Key"]
    assert (lamp.data.vir.use_own_views, lamp.data.vir.view_count, lamp.vir.reflector) == (True, 12, "NEVER")
    assert lamp.data.vir.version == properties.VERSION


@pytest.mark.parametrize("link", [True, False], ids=["linked", "appended"])
def test_settings_of_lights_come_along(registered, add, tmp_path, link):
    add.light("Key").data.vir.use_pass = False
    path = save(tmp_path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    (light,) = linked_lights(path, link)
    assert not light.vir.use_pass and light.vir.version == properties.VERSION


def test_files_that_never_used_vir_are_not_touched(registered, add, tmp_path):
    lamp = add.light("Key")
    assert registered.vir.quality == pytest.approx(0.5) and lamp.vir.reflector == "AUTO" and lamp.data.vir.use_pass
    scene = open_file(save(tmp_path))
    for group in (scene.vir, bpy.data.lights["Key"].vir):
        assert group.version == 0 and not properties.stored_values(group).keys()
    assert properties.REFLECTOR_PROPERTY not in bpy.data.objects["Key"]


@pytest.fixture
def later_version(monkeypatch):
    """A version in which lights count their views in batches of eight, under another name."""

    def count_in_batches(group):
        held = properties.stored_values(group)
        if "view_count" in held:
            held["batches"] = held["view_count"] // 8

    monkeypatch.setattr(properties, "VERSION", properties.VERSION + 1)
    monkeypatch.setitem(properties.MIGRATIONS, properties.VERSION - 1, count_in_batches)


@pytest.mark.parametrize("way", ["opened", "appended", "linked"])
def test_older_files_are_brought_up_to_date_once(registered, add, tmp_path, request, way):
    add.light("Key").data.vir.view_count = 48
    path = save(tmp_path)
    request.getfixturevalue("later_version")
    if way == "opened":
        open_file(path)
        light = bpy.data.lights["Key"]
    else:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        (light,) = linked_lights(path, link=way == "linked")
    assert light.vir.version == properties.VERSION
    assert properties.stored_values(light.vir)["batches"] == 6
    properties.stored_values(light.vir)["view_count"] = 800
    light.use_fake_user = True
    open_file(save(tmp_path, "again.blend"))
    if way != "linked":
        assert properties.stored_values(bpy.data.lights["Key"].vir)["batches"] == 6, "brought up to date twice"


def test_settings_of_a_newer_version_are_left_as_they_are(registered, tmp_path):
    registered.vir.view_count = 40
    registered.vir.version = properties.VERSION + 5
    scene = open_file(save(tmp_path))
    assert properties.is_newer(scene.vir) and scene.vir.version == properties.VERSION + 5 and scene.vir.view_count == 40


def test_a_file_opens_without_the_extension_and_keeps_its_settings(registered, tmp_path):
    registered.vir.view_count = 40
    path = save(tmp_path)
    blender.unregister()
    try:
        open_file(path)
        path = save(tmp_path, "without.blend")
    finally:
        blender.register()
    assert open_file(path).vir.view_count == 40


def test_lights_wishes_reach_the_plan(registered, add, take):
    add.cube()
    add.light("Key", location=(0.0, -3.0, 3.0)).data.vir.use_own_views = True
    bpy.data.lights["Key"].vir.view_count = 24
    add.light("Off", location=(1.0, -3.0, 3.0)).data.vir.use_pass = False
    add.light("Lamp", "POINT", location=(0.0, -3.0, 3.0), data={"shadow_soft_size": 0.2})
    registered.vir.use_omni_shadows = False
    lines = {planned.light_name: planned for planned in plan(take(resolution=(32, 18)), properties.settings_of(registered)).passes}
    assert lines["Key"].runs and lines["Key"].view_count == 24
    assert not lines["Off"].runs and "switched off for this light" in lines["Off"].reason
    assert not lines["Lamp"].runs and "omni shadows are switched off" in lines["Lamp"].reason


def test_one_group_that_cannot_be_brought_up_to_date_leaves_the_others(registered, add, tmp_path, monkeypatch, capsys):
    for name in ("First", "Second"):
        add.light(name).data.vir.view_count = 48
    path = save(tmp_path)

    def refuse_the_first(group):
        if group.id_data.name == "First":
            raise ValueError("not understood")

    monkeypatch.setattr(properties, "VERSION", properties.VERSION + 1)
    monkeypatch.setitem(properties.MIGRATIONS, properties.VERSION - 1, refuse_the_first)
    open_file(path)
    assert [bpy.data.lights[name].vir.version for name in ("First", "Second")] == [properties.VERSION - 1, properties.VERSION]
    save(tmp_path)
    assert bpy.data.lights["First"].vir.version == properties.VERSION - 1, "to be tried again"
    assert "not understood" in capsys.readouterr().err


def test_the_chosen_light_stays_chosen_when_others_come(registered, add):
    add.light("Key")
    registered.vir.active_light_index = registered.objects.find("Key")
    for name in ("Added", "Before", "Zenith"):
        add.cube(name)
    assert registered.objects[registered.vir.active_light_index].name == registered.vir.active_light == "Key"


@pytest.mark.parametrize(("mark", "expected"), [("yes", "AUTO"), (0, "NEVER"), (False, "NEVER"), (2.5, "ALWAYS")])
def test_marks_of_reflectors_that_others_have_set(registered, add, mark, expected):
    cube = add.cube("Cube")
    cube["vir_reflector"] = mark
    bpy.context.view_layer.update()
    assert cube.vir.reflector == expected
    assert panels.reflector_names(registered) == (set() if expected == "AUTO" else {"Cube"})
    taken = snapshot(bpy.context.evaluated_depsgraph_get(), with_materials=True)
    assert taken.instances.reflector_mark.tolist() == [{"AUTO": -1, "NEVER": 0, "ALWAYS": 1}[expected]]


def test_the_light_that_is_shown_may_be_renamed(registered, add, tmp_path):
    key = add.light("Key")
    add.light("Fill")
    wishes = registered.vir
    wishes.preview_light_now = "Key"
    key.name = "Main"
    assert wishes.preview_light_now == "Main" and wishes.preview_light == "Key"
    bpy.data.objects["Fill"].name = "Key"
    assert wishes.preview_light_now == "Main", "the one that has the old name now"
    wishes.preview_light = "Key"
    assert wishes.preview_light_now == "Key", "a script means what has the name now"
    assert object_names.named_object(wishes, "preview_light").name == "Key"
    wishes.preview_light_now = "Main"
    key.name = "Hero"
    # what is saved is its name
    opened = open_file(save(tmp_path))
    assert opened.vir.preview_light == opened.vir.preview_light_now == "Hero"
    # renamed before anybody has asked for it
    bpy.data.objects["Hero"].name = "Again"
    assert opened.vir.preview_light_now == "Again"
    bpy.data.objects.remove(bpy.data.objects["Again"])
    assert object_names.named_object(opened.vir, "preview_light") is None


def test_what_another_session_meant_says_nothing(registered, add, tmp_path):
    """A file has numbers of its session, which other objects have in this one."""
    key, fill = add.light("Key"), add.light("Fill")
    wishes = registered.vir
    wishes.preview_light = "Key"
    wishes.preview_light_meant = wishes.preview_light_meant.replace(object_names._SESSION, "0" * len(object_names._SESSION))
    wishes.preview_light_meant = wishes.preview_light_meant.replace(f" {key.session_uid} ", f" {fill.session_uid} ")
    assert object_names.named_object(wishes, "preview_light") == key
    opened = open_file(save(tmp_path))
    bpy.data.objects["Key"].name = "Main"
    assert object_names.named_object(opened.vir, "preview_light").name == "Main"
