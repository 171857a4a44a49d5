import bpy

vir = bpy.context.scene.vir

vir.view_count = 512
vir.map_resolution_px = 2048
vir.method = "AUTO"
vir.points = "BUFFERED"
vir.point_generation = "COMPUTE"
vir.resolve = "FULL"
vir.stochastic_culling = False
vir.culling_area_texels = 0.1
vir.cull_hidden = True
vir.watertight = True
