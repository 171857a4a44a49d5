import bpy

vir = bpy.context.scene.vir

vir.view_count = 128
vir.map_resolution_px = 2048
vir.method = "AUTO"
vir.points = "BUFFERED"
vir.point_generation = "COMPUTE"
vir.resolve = "AUTO"
vir.stochastic_culling = True
vir.culling_area_texels = 0.1
vir.cull_hidden = True
vir.watertight = True
