"""Places, sizes, names and strengths of lights; what they light and what blocks them."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Matrix  # noqa: E402  (bpy decides whether this file runs)

from vir_addon.blender.extract.lights import LightRow, place_light  # noqa: E402
from vir_addon.core.errors import SceneError  # noqa: E402
from vir_addon.core.plan import plan  # noqa: E402
from vir_addon.core.sampling import light_samples  # noqa: E402
from vir_addon.core.scene import LightShape  # noqa: E402
from vir_addon.core.settings import Settings  # noqa: E402
from vir_addon.core.views import light_axes  # noqa: E402


def ellipse_row(world_from_object, size_x_m, size_y_m):
    return LightRow(
        object_name="Key",
        instancer_name=None,
        persistent_id=(),
        world_from_object=world_from_object,
        object_uid=1,
        shape=LightShape.ELLIPSE,
        size_x_m=size_x_m,
        size_y_m=size_y_m,
        spread_rad=math.pi,
        strength_rgb=np.ones(3),
        casts_shadow=True,
        has_soft_falloff=False,
        cone_rad=2 * math.pi,
        cone_blend=0.0,
        is_wanted=True,
        own_view_count=None,
    )


def only_light(taken):
    (light,) = taken.lights
    return light


@pytest.mark.parametrize(
    ("shape", "expected", "width", "height"),
    [
        ("SQUARE", LightShape.RECTANGLE, 2.0, 2.0),
        ("RECTANGLE", LightShape.RECTANGLE, 2.0, 0.5),
        ("DISK", LightShape.ELLIPSE, 2.0, 2.0),
        ("ELLIPSE", LightShape.ELLIPSE, 2.0, 0.5),
    ],
)
def test_area_shapes_and_sizes(add, take, shape, expected, width, height):
    add.light("Key", data={"shape": shape, "size": 2.0, "size_y": 0.5, "spread": 1.0}, scale=(3.0, 0.5, 9.0))
    light = only_light(take())
    assert light.shape is expected
    assert (light.size_x_m, light.size_y_m) == pytest.approx((3.0 * width, 0.5 * height))
    assert light.spread_rad == pytest.approx(1.0)


@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1), (1, -2, 1), (1, 1, -1), (-1, -2, -3), (2, 3, 0)])
def test_area_light_shines_where_blender_shines(add, take, scale):
    """Along the object's -z, also where scale is negative; right-handed and orthonormal always."""
    key = add.light("Key", data={"size": 1.0}, scale=scale, location=(1.0, 2.0, 3.0), rotation_euler=(0.3, 0.5, 0.7))
    taken = take()
    light = only_light(taken)
    rotation = light.world_from_light[:3, :3]
    assert light.world_from_light.dtype == np.float64
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    object_axes = np.array(key.matrix_world)[:3, :3]
    if scale[2]:
        assert np.allclose(rotation[:, 2], object_axes[:, 2] / np.linalg.norm(object_axes[:, 2]), atol=1e-5)
    assert (light.size_x_m, light.size_y_m) == pytest.approx((abs(scale[0]), abs(scale[1])), rel=1e-5)
    assert np.allclose(light.world_from_light[:3, 3] + taken.world_origin_m, (1.0, 2.0, 3.0), atol=1e-6)


def test_sheared_area_light_keeps_its_plane_and_its_area(add, take):
    key = add.light("Key", data={"size": 1.0})
    key.parent = add.object("Parent", None)
    # an object's own matrix cannot be sheared
    key.matrix_parent_inverse = Matrix(((1, 0.5, 0, 0), (0, 2, 0, 0), (0, 0.25, 1, 0), (0, 0, 0, 1)))
    taken = take()
    light = only_light(taken)
    axes = np.array(key.matrix_world)[:3, :3]
    normal = np.cross(axes[:, 0], axes[:, 1])
    assert light.size_x_m * light.size_y_m == pytest.approx(np.linalg.norm(normal), rel=1e-5)
    assert np.allclose(light.world_from_light[:3, 2], normal / np.linalg.norm(normal), atol=1e-5)
    (note,) = taken.notes
    assert note.startswith("The light 'Key' is sheared")
    # its plane is turned, but it is a square
    key.matrix_parent_inverse = Matrix(((2, 0, 0.5, 0), (0, 3, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)))
    assert not take().notes


def test_sheared_ellipse_is_an_ellipse_along_other_axes(add, take):
    """Every place of its rim is one of the sheared rim."""
    key = add.light("Key", data={"shape": "ELLIPSE", "size": 2.0, "size_y": 0.75})
    key.parent = add.object("Parent", None)
    key.matrix_parent_inverse = Matrix(((1, 0.75, 0, 3), (0, 2, 0, 1), (0, 0.25, 1, 5), (0, 0, 0, 1)))
    taken = take()
    light = only_light(taken)
    assert not taken.notes
    rotation = light.world_from_light[:3, :3]
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    angle = np.linspace(0, 2 * np.pi, 100)
    rim = np.stack([light.size_x_m / 2 * np.cos(angle), light.size_y_m / 2 * np.sin(angle), 0 * angle, 1 + 0 * angle])
    x, y, z, _ = np.linalg.inv(np.array(key.matrix_world, np.float64)) @ light.world_from_light @ rim
    assert np.allclose((x / 1.0) ** 2 + (y / 0.375) ** 2, 1, atol=1e-5) and np.allclose(z, 0, atol=1e-6)


@pytest.mark.parametrize(
    ("size_y_m", "scale", "least_cosine"),
    [
        (0.4, (1.0, 1.3, 0.7), 0.99),
        (0.4, (-1.0, 1.3, 0.7), 0.99),
        # the shear, which stays in the world, counts for more than the ellipse, which turns: x and y change places where its axes are at
        # 45 degrees to the light's
        (0.9, (1.0, 1.3, 0.7), -1e-3),
    ],
)
def test_sheared_ellipse_turns_without_a_jump(size_y_m, scale, least_cosine):
    """Once around in steps of half a degree: neither its places that are sampled nor its axes are elsewhere a step later."""
    tilt = np.array(Matrix.Rotation(0.5, 3, "X"))
    before = None
    for angle in np.radians(np.arange(0.0, 360.5, 0.5)):
        world_from_object = np.eye(4)
        world_from_object[:3, :3] = np.diag(scale) @ np.array(Matrix.Rotation(angle, 3, "Z")) @ tilt
        light = place_light(ellipse_row(world_from_object, 1.0, size_y_m), "Key", np.zeros(3))
        x, samples = light.world_from_light[:3, 0], light_samples(light, 64) @ light_axes(light)
        if before is not None:
            assert x @ before[0] > least_cosine, np.degrees(angle)
            assert np.linalg.norm(samples - before[1], axis=1).max() < 0.02, np.degrees(angle)
        before = x, samples


@pytest.mark.parametrize("scale_x", [1.0, -1.0])
def test_samples_of_a_sheared_ellipse_are_those_of_its_disc(scale_x):
    """Where the light's matrix takes them: lights that are hardly sheared and taken without it have the same ones."""
    straight, sheared = np.diag([scale_x, 1.0, 1.0, 1.0]), np.diag([scale_x, 1.0, 1.0, 1.0])
    sheared[:2, :2] = [[0.9 * scale_x, 0.7], [-0.2 * scale_x, 1.1]]
    unit, moved = (place_light(ellipse_row(matrix, 1.0, 0.75), "Key", np.zeros(3)) for matrix in (straight, sheared))
    unit_ws, moved_ws = (light_samples(light, 64) @ light_axes(light) for light in (unit, moved))
    assert moved.disc_turn_rad != 0
    np.testing.assert_allclose(moved_ws, unit_ws @ (sheared @ np.linalg.inv(straight))[:3, :3].T, atol=1e-12)


@pytest.mark.parametrize("kind", ["POINT", "SPOT", "SUN"])
def test_other_lights_carry_their_soft_size(add, take, kind):
    data = {"angle": 0.2} if kind == "SUN" else {"shadow_soft_size": 0.3}
    add.light("Lamp", kind, data=data, scale=(2.0, 2.0, 2.0), rotation_euler=(0.0, math.pi / 2, 0.0))
    light = only_light(take())
    assert light.shape is LightShape[kind]
    expected = 2.0 * math.tan(0.1) if kind == "SUN" else 0.6
    assert (light.size_x_m, light.size_y_m) == pytest.approx((expected, expected))
    assert np.allclose(light.world_from_light[:3, 2], (1.0, 0.0, 0.0), atol=1e-6)


@pytest.mark.parametrize("kind", ["AREA", "POINT", "SPOT", "SUN"])
def test_light_scaled_to_nothing_is_no_crash(add, take, kind):
    add.light("Lamp", kind, scale=(0.0, 0.0, 0.0))
    taken = take()
    if kind == "AREA":
        assert not taken.lights
        assert [one.object_name for one in taken.left_out] == ["Lamp"]
    else:
        assert np.allclose(only_light(taken).world_from_light[:3, :3], np.eye(3))


def test_strength_of_each_kind(add, take):
    """Factors that were compared with pictures by Cycles, to 0.03 %, for all of these."""
    color = {"color": (1.0, 0.5, 0.25), "energy": 10.0}
    luminance = 0.2126 + 0.7152 * 0.5 + 0.0722 * 0.25
    add.light("1 area", data=color)
    add.light("2 brighter", data={**color, "exposure": 2.0})
    add.light("3 larger", data={**color, "size": 5.0})
    add.light("4 per area", data={**color, "size": 3.0, "normalize": False})
    add.light("5 point", "POINT", data=color)
    add.light("6 sun", "SUN", data=color)
    add.light("7 negative", data={**color, "energy": -10.0})
    area = 10.0 * luminance / math.pi
    expected = [area, 4.0 * area, area, 9.0 * area, area / 4.0, 10.0 * luminance, -area]
    assert [light.strength for light in take().lights] == pytest.approx(expected, rel=1e-5)


def test_narrow_spread_is_brighter_ahead(add, take):
    """The integral of cos * max(0, 1 - tan / tan_half) over the hemisphere falls by what the strength gains."""
    add.light("wide", data={"energy": 10.0})
    angle = (np.arange(200_000) + 0.5) * (0.5 * math.pi / 200_000)
    for spread in (2.5, 1.0, 0.1, 0.01):
        add.light(f"narrow {spread}", data={"energy": 10.0, "spread": spread})
    by_name = {light.name: light for light in take().lights}
    whole = (np.cos(angle) * np.sin(angle)).sum()
    for spread in (2.5, 1.0, 0.1):
        factor = np.maximum(0.0, 1.0 - np.tan(angle) / math.tan(0.5 * spread))
        kept = (np.cos(angle) * np.sin(angle) * factor).sum() / whole
        assert by_name[f"narrow {spread}"].strength * kept == pytest.approx(by_name["wide"].strength, rel=1e-3)
    assert np.isfinite(by_name["narrow 0.01"].strength)


def test_emission_node_counts(add, take):
    key = add.light("Key", data={"energy": 10.0})
    if bpy.app.version < (5, 0, 0):
        key.data.use_nodes = True
    emission = next(node for node in key.data.node_tree.nodes if node.type == "EMISSION")
    before = only_light(take()).strength
    emission.inputs["Strength"].default_value = 3.0
    assert only_light(take()).strength == pytest.approx(3.0 * before)


def test_temperature_counts(add, take):
    key = add.light("Key", data={"use_temperature": True, "temperature": 2000.0})
    rgb = np.array(key.data.temperature_color)
    assert rgb[0] > 2.0 * rgb[2]
    assert only_light(take()).strength == pytest.approx(key.data.energy / math.pi * (rgb @ (0.2126, 0.7152, 0.0722)), rel=1e-4)


def test_lights_without_shadow_and_hidden_lights(add, take):
    add.light("open", data={"use_shadow": False})
    add.light("hidden", hide_render=True)
    add.light("hidden in the viewport", hide_viewport=True)
    assert {light.name: light.casts_shadow for light in take().lights} == {"hidden in the viewport": True, "open": False}


def test_lights_of_other_frames_and_view_layers_are_named(add, take, scene):
    """Not those that no frame shows."""
    lamps, props, never = (bpy.data.collections.new(name) for name in ("Lamps", "Props", "Never"))
    add.light("Bulb", "POINT", collection=lamps)
    post = add.instance_of(lamps, "Post")
    scene.collection.objects.unlink(post)
    props.objects.link(post)
    street = add.instance_of(props, "Street")
    street.hide_render = True
    for hidden in (add.light("Keyed"), street):
        hidden.hide_render = True
        hidden.keyframe_insert("hide_render", frame=1)
    add.light("Hidden", hide_render=True)
    add.light("Key")
    for collection in (back := bpy.data.collections.new("Back"), never):
        scene.collection.children.link(collection)
        scene.view_layers[0].layer_collection.children[collection.name].exclude = True
    never.hide_render = True
    add.light("Rim", collection=back)
    add.light("Rim hidden", collection=back, hide_render=True)
    add.light("Never", collection=never)
    scene.view_layers.new("Second")
    taken = take()
    assert [light.name for light in taken.lights] == ["Key"]
    assert taken.lights_elsewhere == ("Bulb (Street)", "Keyed", "Rim")
    street.animation_data_clear()
    street.hide_render = False
    assert [light.name for light in take().lights] == ["Bulb (Street)", "Key"], "and by the names that they have there"


def test_instanced_lights_have_stable_names_of_their_own(add, take):
    lamps = bpy.data.collections.new("Lamps")
    add.light("Key", collection=lamps, location=(0.0, 0.0, 1.0))
    add.light("Key", "POINT")  # becomes Key.001
    add.instance_of(lamps, "Right", location=(5.0, 0.0, 0.0))
    add.instance_of(lamps, "Left", location=(-5.0, 0.0, 0.0))
    lights = take().lights
    assert [light.name for light in lights] == ["Key (Left)", "Key (Right)", "Key.001"]
    assert [light.world_from_light[0, 3] for light in lights] == pytest.approx([-5.0, 5.0, 0.0])


def test_lights_of_one_instancer_are_numbered(add, take):
    lamps = bpy.data.collections.new("Lamps")
    add.light("Key", collection=lamps)
    spread_out = add.mesh("Frame", [(k, 0, 0) for k in range(3)], [], instance_type="VERTS")
    bpy.data.objects["Key"].parent = spread_out
    bpy.context.scene.collection.objects.link(bpy.data.objects["Key"])
    names = [light.name for light in take().lights]
    assert names == ["Key (Frame)", "Key (Frame) 2", "Key (Frame) 3"]


def test_portals_are_left_out_for_cycles_only(scene, add, take):
    portal = add.light("Window")
    portal.data.cycles.is_portal = True
    assert len(take().lights) == 1
    scene.render.engine = "CYCLES"
    taken = take()
    assert not taken.lights
    assert taken.left_out[0].object_name == "Window"


def linked_names(taken, mask) -> list[str] | None:
    """Names of the objects whose instances the mask lets through"""
    if mask is None:
        return None
    return sorted({taken.instances.object_names[index] for index in taken.instances.object_index[mask]})


@pytest.fixture
def linked(add, take):
    """Cubes A to D, and light Key with a receiver and a blocker collection; entries are (name, state)."""

    def build(entries, which="receiver_collection", nested=()):
        for name in "ABCD":
            add.cube(name)
        key = add.light("Key")
        collection = bpy.data.collections.new("Linked")
        for name, state in entries:
            collection.objects.link(bpy.data.objects[name])
            collection.collection_objects[-1].light_linking.link_state = state
        for names, state in nested:
            outer, inner = bpy.data.collections.new("Outer"), bpy.data.collections.new("Inner")
            outer.children.link(inner)
            for name in names:
                inner.objects.link(bpy.data.objects[name])
            collection.children.link(outer)
            collection.collection_children[-1].light_linking.link_state = state
        setattr(key.light_linking, which, collection)
        taken = take()
        return taken, only_light(taken)

    return build


def test_no_linking_is_none(linked):
    _, light = linked([])
    assert light.receivers is None
    assert light.blockers is None


def test_included_receivers_are_the_only_ones(linked):
    taken, light = linked([("A", "INCLUDE"), ("C", "INCLUDE")])
    assert linked_names(taken, light.receivers) == ["A", "C"]
    assert light.blockers is None


def test_excluded_receivers_leave_the_rest(linked):
    taken, light = linked([("A", "EXCLUDE")])
    assert linked_names(taken, light.receivers) == ["B", "C", "D"]


def test_with_an_included_one_excluded_ones_change_nothing(linked):
    taken, light = linked([("A", "INCLUDE"), ("B", "EXCLUDE")])
    assert linked_names(taken, light.receivers) == ["A"]


def test_nested_collections_count_and_an_own_entry_wins(linked):
    taken, light = linked([("B", "EXCLUDE")], nested=[("AB", "INCLUDE")])
    assert linked_names(taken, light.receivers) == ["A"]


def test_blockers(linked):
    taken, light = linked([("A", "INCLUDE")], which="blocker_collection")
    assert linked_names(taken, light.blockers) == ["A"]
    assert light.receivers is None


def test_blockers_must_also_be_visible_to_shadow_rays(add, linked, take):
    linked([("A", "EXCLUDE")], which="blocker_collection")
    bpy.data.objects["B"].visible_shadow = False
    taken = take()
    assert linked_names(taken, only_light(taken).blockers) == ["C", "D"]
    assert linked_names(taken, taken.instances.casts_shadow) == ["A", "C", "D"]


def test_instances_are_linked_by_their_object_or_by_their_instancer(scene, add, take):
    """As in Cycles: by the instancer if any collection names it, otherwise by the instanced object."""
    leaves = bpy.data.collections.new("Leaves")
    add.cube("Leaf", collection=leaves)
    add.instance_of(leaves, "Named")
    add.instance_of(leaves, "Unnamed")
    by_object, by_instancer = add.light("By object"), add.light("By instancer")
    for light, member in ((by_object, "Leaf"), (by_instancer, "Named")):
        light.light_linking.receiver_collection = bpy.data.collections.new(light.name)
        light.light_linking.receiver_collection.objects.link(bpy.data.objects[member])
    taken = take()
    of_named, of_unnamed = (light.receivers for light in taken.lights)
    assert [light.name for light in taken.lights] == ["By instancer", "By object"]
    assert len(taken.instances) == 2
    assert of_named.tolist() == [True, False]
    assert of_unnamed.tolist() == [False, True]


@pytest.mark.parametrize(
    ("kind", "data", "placed", "wrong"),
    [
        ("POINT", {"energy": math.nan}, {}, "strength or colour"),
        ("AREA", {"energy": math.inf}, {}, "strength or colour"),
        ("SUN", {"color": (math.inf, 1.0, 1.0)}, {}, "strength or colour"),  # which Blender keeps as the largest finite number
        ("POINT", {"shadow_soft_size": math.nan}, {}, "size or angle"),
        ("AREA", {"size": math.inf}, {}, "size or angle"),
        ("AREA", {"spread": math.nan}, {}, "size or angle"),
        ("SUN", {"angle": math.nan}, {}, "size or angle"),
        ("SPOT", {"spot_size": math.nan}, {}, "size or angle"),
        ("SPOT", {"spot_blend": math.nan}, {}, "size or angle"),
        ("SPOT", {}, {"location": (math.inf, 0.0, 0.0)}, "position or scale"),
        ("POINT", {}, {"scale": (math.nan, 1.0, 1.0)}, "position or scale"),
        ("AREA", {}, {"scale": (0.0, 0.0, 0.0)}, "scale of zero"),
    ],
)
def test_a_light_whose_numbers_are_no_numbers_is_named(add, take, kind, data, placed, wrong):
    add.cube("Cube")
    add.light("Lamp", kind, data=data, **placed)
    taken = take()
    assert not taken.lights
    (left_out,) = taken.left_out
    assert left_out.object_name == "Lamp" and wrong in left_out.reason
    with pytest.raises(SceneError, match=f"no light.*; Lamp is left out: the light has a .*{wrong}"):
        plan(taken, Settings())
    add.light("Key", "POINT")
    assert [planned.pass_name for planned in plan(take(), Settings()).passes] == ["VIR Shadow Key"]
