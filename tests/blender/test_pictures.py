"""Whole ways from a Blender scene to passes: far from the origin, with light linking, without anything to see."""

import itertools

import numpy as np
import pytest

from vir_addon.core.errors import SceneError
from vir_addon.core.settings import Method, Settings
from vir_addon.device.open import open_device

bpy = pytest.importorskip("bpy")

from vir_addon.blender.job import frame_jobs, run  # noqa: E402  (bpy decides whether this file runs)

FAR_M = (100_000.0, -100_000.0, 100_000.0)
RESOLUTION = (96, 54)


@pytest.fixture(scope="module")
def device():
    opened = open_device("moderngl")
    yield opened
    opened.close()


def passes_of(scene, device, resolution=RESOLUTION, **settings):
    settings = {"method": Method.MVR, "view_count": 16, "map_resolution_px": 512, **settings}
    (job,) = frame_jobs(scene, scene.frame_current, Settings(**settings), resolution).values()
    return run(job, device).images


@pytest.fixture
def still_life(scene, add):
    """At multiples of 1/64 m, which float32 holds 100 km away too: Blender's own matrices would move things elsewhere."""
    square = [(-6, -6, 0), (6, -6, 0), (6, 6, 0), (-6, 6, 0)]
    add.mesh("Floor", square, [(0, 1, 2, 3)])
    add.cube("Box", location=(-1.0, 0.25, 0.5), scale=(0.5, 0.5, 0.5), rotation_euler=(0, 0, 0.5))
    add.cube("Lamella", location=(0.75, -0.5, 1.0), scale=(0.5, 0.25, 0.03125), rotation_euler=(0.2, 0.1, 0))
    add.light("Key", data={"energy": 300.0, "size": 1.0}, location=(2.0, -2.0, 5.0), rotation_euler=(0.5, 0.0, 0.75))
    add.light("Rim", data={"energy": 100.0, "size": 0.5}, location=(-3.0, 1.0, 4.0), rotation_euler=(0.0, -0.6, 0.0))
    scene.camera.location, scene.camera.rotation_euler = (0.5, -7.0, 4.0), (1.1, 0.0, 0.0)
    return scene


@pytest.mark.parametrize("method", [Method.MVR, Method.IVIR, Method.MICRO])
def test_far_from_the_origin_is_the_same_picture(still_life, device, method):
    near = passes_of(still_life, device, method=method)
    for placed in still_life.objects:
        placed.location = [at + shift for at, shift in zip(placed.location, FAR_M, strict=True)]
    far = passes_of(still_life, device, method=method)
    assert list(near) == list(far) == ["VIR Shadow", "VIR Shadow Key", "VIR Shadow Rim"]
    for name, image in near.items():
        assert image.std() > 0.1
        assert np.abs(far[name] - image).max() <= 1 / 255, name


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_mirrored_camera_sees_the_mirrored_picture(still_life, device, kind):
    """With all of the scene within it. Without a filter: its offsets are not those of a mirrored pixel."""
    still_life.objects["Floor"].scale = (0.25, 0.25, 1.0)
    still_life.render.filter_size = 0.0
    still_life.camera.data.type, still_life.camera.data.ortho_scale = kind, 6.0
    upright = passes_of(still_life, device)
    still_life.camera.scale.x = -1.0
    mirrored = passes_of(still_life, device)
    for name, image in upright.items():
        assert image.std() > 0.05
        np.testing.assert_allclose(mirrored[name][:, ::-1], image, atol=1e-6)


@pytest.mark.parametrize(("factor", "shift_m"), [(1, (100_003, -99_997, 100_001)), (1000, FAR_M), (1000, (0, 0, 0)), (1e-3, (0, 0, 0))])
@pytest.mark.parametrize("kind", ["SUN", "AREA"])
def test_in_another_unit_and_far_away_is_the_same_picture(still_life, add, device, factor, shift_m, kind):
    """Whatever grid the origin is moved on."""
    if kind == "SUN":
        objects = still_life.objects
        for name in ("Key", "Rim"):
            bpy.data.objects.remove(objects[name])
        add.light("Low", "SUN", data={"energy": 3.0, "angle": 0.1}, location=(3.0, 1.0, 2.0), rotation_euler=(0.0, 1.1, 0.3))
    add.light("Noon", kind, data={"energy": 2.0}, location=(-1.0, 2.0, 6.0), rotation_euler=(-0.3, -0.2, 0.0))
    near = passes_of(still_life, device)
    for placed in still_life.objects:
        placed.location = [factor * at + shift for at, shift in zip(placed.location, shift_m, strict=True)]
        if placed.type == "MESH":
            placed.scale = [factor * size for size in placed.scale]
        if placed.type == "LIGHT" and kind == "AREA":
            placed.data.size *= factor
            placed.data.energy *= factor**2
    still_life.camera.data.clip_start *= factor
    still_life.camera.data.clip_end *= factor
    far = passes_of(still_life, device)
    for name, image in near.items():
        assert image.std() > 0.1
        assert np.abs(far[name] - image).max() <= 1 / 255, name


def test_light_linking_reaches_the_picture(still_life, add, device):
    """Key's shadow does not come from the box, Rim does not light it; the lamella casts nothing at all at last."""
    plain = passes_of(still_life, device)
    objects = still_life.objects
    blockers, receivers = (bpy.data.collections.new(name) for name in ("blockers", "receivers"))
    blockers.objects.link(objects["Box"])
    receivers.objects.link(objects["Box"])
    objects["Key"].light_linking.blocker_collection = blockers
    objects["Rim"].light_linking.receiver_collection = receivers
    blockers.collection_objects[0].light_linking.link_state = "EXCLUDE"
    receivers.collection_objects[0].light_linking.link_state = "EXCLUDE"
    linked = passes_of(still_life, device)
    lamella = still_life.objects["Lamella"]
    lamella.visible_shadow = False
    unshadowing = passes_of(still_life, device)

    # taking blockers away only brightens (but for a map of other texels, as fewer casters take a smaller window)
    for before, after in ((plain, linked), (linked, unshadowing)):
        change = after["VIR Shadow Key"] - before["VIR Shadow Key"]
        assert np.mean(change > 0.5) > 0.01 and np.mean(change < -0.25) < 0.001
    # with nothing left that casts, surfaces are lit, or turned away
    objects["Box"].visible_shadow = False
    assert set(np.unique(passes_of(still_life, device)["VIR Shadow Key"])) == {0.0, 1.0}
    # the only difference at Rim: the box's dark side is 1
    changed = linked["VIR Shadow Rim"] != plain["VIR Shadow Rim"]
    assert 20 < changed.sum() < 0.2 * changed.size
    assert (linked["VIR Shadow Rim"][changed] > 0.5).all()


def test_scene_without_any_surface_is_refused_and_names_what_it_has(scene, add):
    add.light("Key", location=(0, 0, 5))
    with pytest.raises(SceneError, match=r"'Scene' has no surface.*add a mesh"):
        frame_jobs(scene, 1, Settings())
    add.object("Smoke", bpy.data.volumes.new("Smoke"))
    add.object("Curtain", bpy.data.hair_curves.new("Curtain"))
    with pytest.raises(SceneError, match=r"'Scene' has no surface.*left out: .*Smoke: volumes are not surfaces"):
        frame_jobs(scene, 1, Settings())


@pytest.fixture
def point_cloud_nodes():
    """A node tree that makes a point cloud of any mesh."""
    tree = bpy.data.node_groups.new("Points", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    nodes = [tree.nodes.new(kind) for kind in ("NodeGroupInput", "GeometryNodeMeshToPoints", "NodeGroupOutput")]
    for before, after in itertools.pairwise(nodes):
        tree.links.new(before.outputs[0], after.inputs[0])
    return tree


def test_scene_of_nothing_but_what_is_no_surface_is_refused(scene, add, point_cloud_nodes):
    """Meshes of edges, of coordinates that are not numbers, that nodes make points of, or that only show hair; not what may be a surface in
    another frame."""
    add.light("Key", location=(0, 0, 5))
    add.cube("Dust").modifiers.new("Points", "NODES").node_group = point_cloud_nodes
    add.mesh("Broken", [(0, 0, np.nan), (1, 0, np.nan), (1, 1, np.nan)], [(0, 1, 2)])
    add.mesh("Wire", [(0, 0, 0), (1, 0, 0)], [])
    fur = add.cube("Fur", show_instancer_for_render=False)
    fur.modifiers.new("Hair", "PARTICLE_SYSTEM").particle_system.settings.type = "HAIR"
    with pytest.raises(
        SceneError, match=r"'Scene' has no surface.*left out: Broken: has no triangle.*, Dust: point clouds are not.*, Fur: the hair"
    ):
        frame_jobs(scene, 1, Settings())
    hidden = add.cube("Hidden", hide_render=True)
    (job,) = frame_jobs(scene, 1, Settings()).values()
    assert not len(job.snapshot.instances)
    bpy.data.objects.remove(hidden)
    growing = add.mesh("Growing", [(0, 0, 0), (1, 0, 0)], [])
    growing.modifiers.new("Growing", "BUILD")
    assert frame_jobs(scene, 1, Settings())


def scaled_to_nothing(add, tree):
    thing = add.cube("Fur", scale=(0, 0, 0))
    thing.modifiers.new("Hair", "PARTICLE_SYSTEM").particle_system.settings.type = "HAIR"


def with_keyed_switch(add, tree):
    add.cube("Dust").modifiers.new("Points", "NODES").node_group = tree
    tree.nodes[1].inputs["Radius"].default_value = 0.2
    tree.nodes[1].inputs["Radius"].keyframe_insert("default_value", frame=1)


def that_reads_the_time(add, tree):
    add.cube("Dust").modifiers.new("Points", "NODES").node_group = tree
    group = bpy.data.node_groups.new("Within", "GeometryNodeTree")
    group.nodes.new("GeometryNodeInputSceneTime")
    tree.nodes.new("GeometryNodeGroup").node_tree = group


@pytest.mark.parametrize("put", [scaled_to_nothing, with_keyed_switch, that_reads_the_time])
def test_what_may_be_a_surface_in_another_frame_does_not_stop_a_range(scene, add, point_cloud_nodes, put):
    add.light("Key", location=(0, 0, 5))
    put(add, point_cloud_nodes)
    (job,) = frame_jobs(scene, 1, Settings()).values()
    assert not len(job.snapshot.instances)


def hide(thing):
    thing.hide_render = True


def shrink(thing):
    thing.scale = (0.0, 0.0, 0.0)


def leave_the_picture(thing):
    thing.location = (0.0, -50.0, 0.0)


@pytest.mark.parametrize("change", [hide, shrink, leave_the_picture])
def test_frames_that_show_nothing_are_white(scene, add, device, change):
    """A thing that appears later, pops up or walks through the picture must not stop the frames in which it is not there."""
    add.light("Key", location=(0, 0, 5))
    change(add.cube("Box"))
    for name, image in passes_of(scene, device).items():
        assert (image == 1).all(), name


def test_view_layer_without_surfaces_does_not_stop_the_others(scene, add, device):
    """A layer of its own for smoke is common."""
    add.light("Key", location=(0, 0, 5))
    things = bpy.data.collections.new("Things")
    scene.collection.children.link(things)
    add.cube("Box", things)
    smoke = scene.view_layers.new("Smoke")
    smoke.layer_collection.children["Things"].exclude = True
    jobs = frame_jobs(scene, 1, Settings(view_count=8, map_resolution_px=64), RESOLUTION)
    assert [job.plan.passes[0].runs for job in jobs.values()] == [True, False]
    assert "no surface" in jobs["Smoke"].plan.passes[0].reason
    assert (run(jobs["Smoke"], device).images["VIR Shadow Key"] == 1).all()


def test_instanced_collection_counts_as_a_surface(scene, add):
    """Its objects are not in the scene themselves; the instancer may be hidden for some frames."""
    add.light("Key", location=(0, 0, 5))
    asset = bpy.data.collections.new("Asset")
    add.cube("Box", asset)
    instancer = add.instance_of(asset)
    instancer.hide_render = True
    (job,) = frame_jobs(scene, 1, Settings()).values()
    assert not job.plan.passes[0].runs


@pytest.mark.parametrize(("seed", "kind"), [(3, "POINT"), (16, "AREA"), (41, "SPOT"), (54, "POINT")])
def test_nothing_leaves_a_closed_box_at_the_picture_s_border(scene, add, device, seed, kind):
    """Samples of the outermost pixels see beyond their centres, and faces of a cube may hold no more than that. The box does not show, so
    maps are made."""
    random = np.random.default_rng(seed)
    add.mesh("Floor", [(-60, -60, 0), (60, -60, 0), (60, 60, 0), (-60, 60, 0)], [(0, 1, 2, 3)])
    add.cube("Around", location=(0, 0, 1.5), scale=(0.6, 0.6, 0.6), rotation_euler=random.uniform(-0.6, 0.6, 3), visible_camera=False)
    data = {"size": 0.3} if kind == "AREA" else {"shadow_soft_size": 0.2}
    lamp = add.light("Lamp", kind, data=data, location=(0, 0, 1.5), rotation_euler=random.uniform(-0.6, 0.6, 3))
    if kind == "SPOT":
        lamp.data.spot_size = random.uniform(1, 3)
    scene.camera.location, scene.camera.rotation_euler = (0.4, -6.0, 5.2), (random.uniform(0.85, 1.1), 0, random.uniform(-0.2, 0.2))
    for map_px in (64, 512):
        image = passes_of(scene, device, (240, 135), map_resolution_px=map_px)["VIR Shadow Lamp"]
        assert image.max() == 0
