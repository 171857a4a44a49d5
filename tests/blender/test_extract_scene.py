"""Whole scenes: what is in the snapshot, what is not and why, and that neither names' order nor place in the world matters."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from vir_addon.blender.extract import snapshot  # noqa: E402  (bpy decides whether this file runs)
from vir_addon.blender.extract.instances import choose_world_origin  # noqa: E402
from vir_addon.blender.render_depsgraph import with_render_depsgraph  # noqa: E402
from vir_addon.core.errors import SceneError  # noqa: E402
from vir_addon.core.scene import Mesh  # noqa: E402


def shown_names(taken) -> list[str]:
    """Object name of every instance, sorted"""
    return sorted(taken.instances.object_names[index] for index in taken.instances.object_index)


def bounds_ws(taken, name: str | None = None) -> np.ndarray:
    """(2, 3) in Blender's world coordinates, of all instances or those of one object"""
    points = []
    instances = taken.instances
    for mesh_index, world_from_object, object_index in zip(
        instances.mesh_index, instances.world_from_object, instances.object_index, strict=True
    ):
        if name in (None, instances.object_names[object_index]):
            mesh = taken.meshes[mesh_index]
            used = mesh.positions_os[np.unique(mesh.triangles)].astype(np.float64)
            points.append(used @ world_from_object[:3, :3].T + world_from_object[:3, 3] + taken.world_origin_m)
    stacked = np.concatenate(points)
    return np.stack([stacked.min(axis=0), stacked.max(axis=0)])


def test_empty_scene_is_no_error(take):
    taken = take()
    assert len(taken.instances) == 0
    assert taken.instances.world_from_object.shape == (0, 4, 4)
    assert taken.meshes == taken.lights == taken.left_out == taken.notes == ()
    assert taken.extract_ms > 0.0


def test_scene_without_camera_is_refused_in_words(scene):
    scene.camera = None
    with pytest.raises(SceneError, match="'Scene' has no camera"):
        with_render_depsgraph(scene, scene.view_layers[0], snapshot)
    with pytest.raises(SceneError, match="'Scene' has no camera"):
        snapshot(bpy.context.evaluated_depsgraph_get())


def test_names_and_frame(scene, take):
    scene.frame_set(17)
    taken = take()
    assert (taken.scene_name, taken.view_layer_name, taken.frame) == ("Scene", "ViewLayer", 17)


def test_curves_texts_surfaces_and_metaballs_are_surfaces(scene, take):
    bpy.ops.curve.primitive_bezier_circle_add()
    bpy.context.object.name = "Bevelled"
    bpy.context.object.data.bevel_depth = 0.1
    bpy.ops.curve.primitive_bezier_curve_add()
    bpy.context.object.name = "Bare"
    bpy.ops.object.text_add()
    bpy.context.object.name = "Text"
    bpy.ops.surface.primitive_nurbs_surface_sphere_add()
    bpy.context.object.name = "Surface"
    bpy.ops.object.metaball_add(type="BALL")
    bpy.context.object.name = "Ball"
    bpy.ops.object.metaball_add(type="BALL", location=(1.0, 0.0, 0.0))
    bpy.context.object.name = "Ball.001"  # of one family by name
    taken = take()
    assert shown_names(taken) == ["Ball", "Bevelled", "Surface", "Text"]
    assert taken.left_out == ()
    assert bounds_ws(taken, "Ball")[1, 0] > 1.0, "both balls are in the mother's mesh"
    assert bounds_ws(taken, "Bevelled")[1, 2] == pytest.approx(0.1, abs=0.01)


def test_curve_evaluated_twice_is_there_once(scene, add, take):
    bpy.ops.curve.primitive_bezier_circle_add()
    curve = bpy.context.object
    curve.data.bevel_depth = 0.1
    add.object("Copy", curve.data, location=(3.0, 0.0, 0.0))
    taken = take()
    assert len(taken.instances) == 2


def test_kinds_that_cannot_be_rendered_are_named(scene, take):
    bpy.ops.object.volume_add()
    bpy.context.object.name = "Smoke"
    bpy.ops.object.add(type="LATTICE")
    bpy.ops.object.grease_pencil_add(type="MONKEY")
    bpy.context.object.name = "Drawing"
    taken = take()
    assert [(one.object_name, one.reason.split(" VIR")[0]) for one in taken.left_out] == [
        ("Drawing", "grease pencil is not a surface that"),
        ("Smoke", "volumes are not surfaces that"),
    ]


def test_hair_particles_are_named_and_their_emitter_is_there(add, take):
    cube = add.cube("Head")
    settings = cube.modifiers.new("Hair", "PARTICLE_SYSTEM").particle_system.settings
    settings.type = "HAIR"
    taken = take()
    assert shown_names(taken) == ["Head"]
    assert "hair of its particle system" in taken.left_out[0].reason
    cube.show_instancer_for_render = False
    assert shown_names(take()) == []


def test_render_levels_and_render_visibility(add, take):
    smooth = add.cube("Smooth").modifiers.new("Subdivision", "SUBSURF")
    smooth.levels, smooth.render_levels = 0, 2
    hidden_collection = bpy.data.collections.new("Hidden")
    bpy.context.scene.collection.children.link(hidden_collection)
    hidden_collection.hide_render = True
    add.cube("In hidden collection", collection=hidden_collection)
    add.cube("Hidden", hide_render=True)
    add.cube("Hidden in viewport", hide_viewport=True)
    taken = take()
    assert shown_names(taken) == ["Hidden in viewport", "Smooth"]
    assert taken.unique_triangle_count == 12 + 2 * 6 * 4**2


def test_viewport_depsgraph_shows_no_more_than_a_render_and_says_so(add):
    hidden_collection = bpy.data.collections.new("Hidden")
    bpy.context.scene.collection.children.link(hidden_collection)
    hidden_collection.hide_render = True
    add.cube("In hidden collection", collection=hidden_collection)
    add.cube("Hidden", hide_render=True)
    add.light("Hidden light", hide_render=True)
    smooth = add.cube("Smooth").modifiers.new("Subdivision", "SUBSURF")
    smooth.levels, smooth.render_levels = 1, 3
    taken = snapshot(bpy.context.evaluated_depsgraph_get())
    assert shown_names(taken) == ["Smooth"]
    assert taken.unique_triangle_count == 2 * 6 * 4
    assert taken.lights == ()
    assert any("viewport" in note for note in taken.notes)


def test_excluded_collections_are_not_there_and_indirect_only_ones_not_seen(scene, add, take):
    for name in ("Shown", "Excluded", "Indirect", "Holdout"):
        collection = bpy.data.collections.new(name)
        scene.collection.children.link(collection)
        add.cube(name, collection=collection)
    layers = bpy.context.view_layer.layer_collection.children
    layers["Excluded"].exclude = True
    layers["Indirect"].indirect_only = True
    layers["Holdout"].holdout = True
    taken = take()
    seen = dict(zip(taken.instances.object_names, taken.instances.visible_to_camera.tolist(), strict=True))
    assert seen == {"Holdout": True, "Indirect": False, "Shown": True}
    assert taken.instances.casts_shadow.all()
    assert any("Holdout" in note for note in taken.notes)


def test_ray_visibility(add, take):
    add.cube("All")
    add.cube("No camera", visible_camera=False)
    add.cube("No shadow", visible_shadow=False)
    instances = take().instances
    assert instances.object_names == ("All", "No camera", "No shadow")
    assert instances.visible_to_camera[np.argsort(instances.object_index)].tolist() == [True, False, True]
    assert instances.casts_shadow[np.argsort(instances.object_index)].tolist() == [True, True, False]


def test_duplicates_and_instances_share_one_mesh(add, take):
    cube = add.cube("A")
    add.object("B", cube.data)
    bricks = bpy.data.collections.new("Bricks")
    bricks.objects.link(cube)
    add.instance_of(bricks, "Wall", location=(0.0, 0.0, 5.0))
    add.object("Other", cube.data).modifiers.new("Subdivision", "SUBSURF")
    taken = take()
    assert len(taken.meshes) == 2
    assert shown_names(taken) == ["A", "A", "B", "Other"]
    assert len(set(taken.instances.stable_id.tolist())) == 4
    assert bounds_ws(taken)[1, 2] == pytest.approx(6.0)


def test_instances_on_vertices_of_an_invisible_instancer(add, take):
    frame = add.mesh("Frame", [(0, 0, 0), (10, 0, 0), (10, 10, 0)], [(0, 1, 2)], instance_type="VERTS", show_instancer_for_render=False)
    add.cube("Post", parent=frame)
    taken = take()
    assert shown_names(taken) == ["Post"] * 3
    assert len(taken.meshes) == 1
    assert np.allclose(bounds_ws(taken), [(-1, -1, -1), (11, 11, 1)], atol=1e-5)
    frame.show_instancer_for_render = True
    assert shown_names(take()) == ["Frame"] + ["Post"] * 3


def test_object_particles_are_instances(add, take):
    ball = add.cube("Flake", location=(100.0, 0.0, 0.0))
    emitter = add.mesh("Cloud", [(0, 0, 0), (10, 0, 0), (10, 10, 0)], [(0, 1, 2)], show_instancer_for_render=False)
    settings = emitter.modifiers.new("Flakes", "PARTICLE_SYSTEM").particle_system.settings
    settings.count, settings.frame_start, settings.frame_end, settings.physics_type = 25, 0, 0, "NO"
    settings.render_type, settings.instance_object, settings.lifetime = "OBJECT", ball, 1000
    taken = take()
    assert shown_names(taken) == ["Flake"] * 26
    assert len(taken.meshes) == 1
    assert len(set(taken.instances.stable_id.tolist())) == 26


def test_geometry_nodes_instances(add, take):
    group = bpy.data.node_groups.new("Points of cubes", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    nodes, link = group.nodes, group.links.new
    source, target = nodes.new("NodeGroupInput"), nodes.new("NodeGroupOutput")
    placed, cube = nodes.new("GeometryNodeInstanceOnPoints"), nodes.new("GeometryNodeMeshCube")
    link(source.outputs[0], placed.inputs["Points"])
    link(cube.outputs[0], placed.inputs["Instance"])
    link(placed.outputs[0], target.inputs[0])
    frame = add.mesh("Frame", [(0, 0, 0), (10, 0, 0), (10, 10, 0)], [])
    frame.modifiers.new("Cubes", "NODES").node_group = group
    taken = take()
    assert shown_names(taken) == ["Frame"] * 3
    assert len(taken.meshes) == 1
    assert taken.instanced_triangle_count == 36
    assert np.allclose(bounds_ws(taken), [(-0.5, -0.5, -0.5), (10.5, 10.5, 0.5)], atol=1e-5)


def test_animated_and_deformed_meshes_are_those_of_the_frame(scene, add, take):
    mover = add.cube("Mover")
    for frame, height in ((1, 0.0), (11, 10.0)):
        mover.location.z = height
        mover.keyframe_insert("location", frame=frame)
    bent = add.cube("Bent")
    bent.shape_key_add()
    stretched = bent.shape_key_add()
    for point in stretched.data:
        point.co *= 3.0
    for frame, value in ((1, 0.0), (11, 1.0)):
        stretched.value = value
        stretched.keyframe_insert("value", frame=frame)
    scene.frame_set(11)
    taken = take()
    assert bounds_ws(taken, "Mover")[1, 2] == pytest.approx(11.0, abs=1e-4)
    assert bounds_ws(taken, "Bent")[1, 2] == pytest.approx(3.0, abs=1e-4)


def test_mesh_in_edit_mode_is_there_as_edited(add, take):
    """Files are often saved in edit mode; the evaluated mesh has no polygons of its own then."""
    cube = add.cube("Cube")
    bpy.context.view_layer.objects.active = cube
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        assert take().instanced_triangle_count == 12
        bpy.ops.mesh.select_all(action="SELECT")
        bpy.ops.mesh.subdivide()
        assert take().instanced_triangle_count == 48
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")


def test_armature_deforms(scene, add, take):
    bpy.ops.object.armature_add()
    armature = bpy.context.object
    cube = add.cube("Skin", parent=armature)
    cube.vertex_groups.new(name="Bone").add(list(range(8)), 1.0, "REPLACE")
    cube.modifiers.new("Armature", "ARMATURE").object = armature
    armature.pose.bones["Bone"].location = (0.0, 4.0, 0.0)  # the bone's y axis stands up
    assert bounds_ws(take(), "Skin")[1, 2] == pytest.approx(5.0, abs=1e-4)


@pytest.mark.parametrize("scale", [(0.0, 0.0, 0.0), (1.0, 0.0, 1.0)])
def test_object_scaled_to_nothing_is_left_out(add, take, scale):
    add.cube("Flat", scale=scale)
    add.cube("Small", scale=(1e-4, 1e-4, 1e-4))
    add.cube("Mirrored", scale=(-1.0, 2.0, 3.0))
    taken = take()
    assert shown_names(taken) == ["Mirrored", "Small"]
    assert [(one.object_name, one.reason) for one in taken.left_out] == [("Flat", "has a scale of zero along at least one axis")]


def test_object_at_no_place_is_left_out(add, take):
    add.cube("Lost").location.x = math.nan
    add.cube("Here")
    taken = take()
    assert shown_names(taken) == ["Here"]
    assert "finite" in taken.left_out[0].reason
    assert np.isfinite(taken.world_origin_m).all()


def test_broken_vertices_are_reported_by_object(add, take):
    add.mesh("Broken", [(0, 0, 0), (1, 0, 0), (0, 1, 0), (math.nan, 0, 0)], [(0, 1, 2), (1, 2, 3)])
    taken = take()
    assert taken.unique_triangle_count == 1
    (one,) = taken.left_out
    assert (one.object_name, one.instance_count, one.vertex_count, one.triangle_count) == ("Broken", 0, 1, 1)
    assert one.text.startswith("Broken: has vertices") and one.text.endswith("(vertices: 1, triangles: 1)")


def test_meshes_that_lose_all_triangles_are_left_out(scene, add, take):
    group = bpy.data.collections.new("Group")
    add.mesh("Broken", [(math.nan, 0, 0), (1, math.nan, 0), (0, 1, math.inf)], [(0, 1, 2)], group)
    add.mesh("Vertex", [(math.nan, 0, 0)], [], group)
    for number in range(2):
        add.instance_of(group, location=(number, 0.0, 0.0))
    add.cube("Here")
    taken = take()
    assert shown_names(taken) == ["Here"]
    reason = "has no triangle whose coordinates are finite numbers (and below 1e15)"
    assert [(one.object_name, one.text, one.instance_count) for one in taken.left_out] == [
        ("Broken", f"Broken: {reason} (instances: 2)", 2)
    ]


def test_what_is_left_out_is_counted_where_it_would_stand(scene, add, take):
    """By instance, not by the meshes that one is taken apart into; what stands nowhere, by object."""
    group = bpy.data.collections.new("Group")
    add.object("Smoke", bpy.data.volumes.new("Smoke"), group)
    flat = add.cube("Flat", group, scale=(1.0, 1.0, 0.0))
    for alpha in (1.0, 0.5):
        material = bpy.data.materials.new("material")
        if bpy.app.version < (5, 0):
            material.use_nodes = True
        material.node_tree.nodes["Principled BSDF"].inputs["Alpha"].default_value = alpha
        flat.data.materials.append(material)
    flat.data.polygons[0].material_index = 1
    for number in range(3):
        add.instance_of(group, location=(number, 0.0, 0.0))
    add.light("Nowhere", scale=(0.0, 0.0, 0.0))
    taken = take()
    assert [(one.object_name, one.instance_count) for one in taken.left_out] == [("Flat", 3), ("Nowhere", 1), ("Smoke", 3)]
    assert taken.left_out[2].text.endswith("yet (instances: 3)") and "(" not in taken.left_out[1].text


def test_triangles_without_area_are_counted(add, take):
    corners = [(0, 0, 0), (1, 1, 1), (2, 2, 2), (0, 0, 0), (1, 0, 0), (0, 1e-3, 0)]
    add.mesh("Slivers", corners, [(0, 1, 2), (0, 3, 4), (0, 4, 5), (1, 4, 5)])
    for name in ("Cube", "Copy"):
        add.cube(name)
    assert take().flat_triangle_count == 2


def build(add, names):
    for name in names:
        number = float(ord(name))
        add.cube(name, location=(number, 0.0, 0.0))
        add.light(f"Light {name}", data={"energy": number})


def test_order_of_creation_does_not_matter(scene, add, take):
    build(add, "ABCD")
    first = take()
    for kept in [*bpy.data.objects]:
        if kept is not scene.camera and kept.type != "CAMERA":
            bpy.data.objects.remove(kept)
    for data in [*bpy.data.meshes, *bpy.data.lights]:
        (bpy.data.meshes if isinstance(data, bpy.types.Mesh) else bpy.data.lights).remove(data)
    build(add, "CADB")
    second = take()
    for name in ("mesh_index", "world_from_object", "object_index", "stable_id"):
        assert np.array_equal(getattr(first.instances, name), getattr(second.instances, name)), name
    assert first.instances.object_names == second.instances.object_names == ("A", "B", "C", "D")
    assert [light.name for light in first.lights] == [light.name for light in second.lights]
    assert [mesh.name for mesh in first.meshes] == [mesh.name for mesh in second.meshes]


def test_stable_ids_do_not_depend_on_other_objects(add, take):
    build(add, "AC")
    alone = take()
    build(add, "B")
    together = take()
    assert set(alone.instances.stable_id.tolist()) < set(together.instances.stable_id.tolist())


def test_far_from_the_origin_nothing_is_lost(scene, add, take):
    """A cube of 2 cm at 100 km: float32 knows positions there to 8 mm only, and Blender's own matrix no better, but not worse either."""
    add.cube("Far", location=(100_000.0, -50_000.0, 0.0), scale=(0.01, 0.01, 0.01))
    taken = take()
    assert np.abs(taken.instances.world_from_object[0, :3, 3]).max() < 0.02
    assert np.allclose(bounds_ws(taken), [(99999.99, -50000.01, -0.01), (100000.01, -49999.99, 0.01)], atol=1e-6)
    assert any("far from the origin" in note for note in taken.notes)


def cube_mesh() -> Mesh:
    positions = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float32)
    return Mesh("cube", positions, np.array([(0, 1, 2), (5, 6, 7)], dtype=np.int32))


def moved(*position: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = position
    return matrix[None]


def test_world_origin_stands_still_while_things_move():
    index = np.zeros(1, dtype=np.int32)
    assert choose_world_origin((cube_mesh(),), index, moved(0.4, -0.3, 0.9)).tolist() == [0.0, 0.0, 0.0]
    origins = {tuple(choose_world_origin((cube_mesh(),), index, moved(1e6 + step, 0.0, 0.0))) for step in np.linspace(-0.9, 0.9, 19)}
    assert origins == {(1e6, 0.0, 0.0)}


def test_world_origin_is_within_the_scenes_size():
    random = np.random.default_rng(3)
    for _ in range(50):
        position = random.normal(size=3) * 10.0 ** random.uniform(0, 7)
        origin = choose_world_origin((cube_mesh(),), np.zeros(1, dtype=np.int32), moved(*position))
        assert np.abs(origin - position).max() <= 1.0 + 1e-9


def test_what_moves_or_deforms_is_known(add, take):
    add.cube("Still").modifiers.new("Fine", "SUBSURF")
    add.cube("Moved").keyframe_insert("location", frame=1)
    add.cube("Deformed").modifiers.new("Waves", "OCEAN")
    add.cube("Keyed").shape_key_add(name="Basis")
    add.cube("Held").constraints.new("COPY_LOCATION")
    add.cube("Driven").driver_add("location", 0)
    add.cube("Carried").parent = bpy.data.objects["Moved"]
    add.cube("Parent, still").parent = bpy.data.objects["Still"]
    instances = take().instances
    staying = {instances.object_names[index] for index in instances.object_index[instances.stays]}
    assert staying == {"Still", "Parent, still"}
    assert len(instances) == 8
