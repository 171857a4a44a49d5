import bpy

vir = bpy.context.scene.vir

vir.view_count = 64
vir.map_resolution_px = 1024
vir.method = "AUTO"
vir.points = "BUFFERED"
vir.point_generation = "COMPUTE"
vir.resolve = "AUTO"
vir.stochastic_culling = True
vir.culling_area_texels = 0.1
vir.cull_hidden = True
vir.watertight = True
vir.small_triangle_points = 8
vir.back_faces = False
vir.views_per_thread = 8
vir.blocker_sample_count = 32
vir.filter_sample_count = 64
vir.bounces = 0
vir.reflection_method = "AUTO"
vir.planar = True
vir.points_per_eye_pixel = 0.5
vir.reflection_look_up = "MARCH"
