// A lattice before the rasterizer: T_align turns the triangle into the picture's plane, and S_ortho makes a cell one pixel (Gavane & Watson
// 2022, section 3.1), whose first one is at (1, 1).

// Corners are snapped to 256ths of a pixel. Fragments test their cells once more, exactly.
const float STRIP_MARGIN_PX = 1.0 / 16.0;

void emit_corner(AlignedTriangle t, Cells cells, vec2 corner_px) {
    corners_uv = vec4(t.corner_uv[0], t.corner_uv[1]);
    third_corner_uv = t.corner_uv[2];
    cell_counts = vec2(cells.count_x, cells.count_y);
    first_cell = vec4(cells.first_center, cells.size);
    centroid_fs = t.centroid_fs;
    along_u = t.u;
    along_v = t.v;
    normal_fs = t.n;
    gl_Position = vec4((1.0 + corner_px) * (2.0 / float(LATTICE_VIEWPORT_PX)) - 1.0, 0.0, 1.0);
    EmitVertex();
}

// Conservative rasterization: a cell touches the triangle if its centre lies in the sum of the triangle and a cell around the
// origin. As u runs along the longest edge, that is a hexagon whose corners are those of the base and the apex, half a cell aside.
void emit_triangle(AlignedTriangle t, Cells cells) {
    vec2 low = min(min(t.corner_uv[0], t.corner_uv[1]), t.corner_uv[2]);
    vec2 high = max(max(t.corner_uv[0], t.corner_uv[1]), t.corner_uv[2]);
    vec2 apex = t.corner_uv[0].y == high.y ? t.corner_uv[0] : (t.corner_uv[1].y == high.y ? t.corner_uv[1] : t.corner_uv[2]);
    // a triangle may have no height to a lattice, whose cells then have none
    vec2 per_cell = 1.0 / max(cells.size, vec2(1e-30));
    vec2 origin = cells.first_center - 0.5 * cells.size;
    vec2 base_px = (high - low) * per_cell;
    vec2 apex_px = (apex - origin) * per_cell;
    float aside = 0.5 + STRIP_MARGIN_PX;
    emit_corner(t, cells, vec2(-aside, -aside));
    emit_corner(t, cells, vec2(base_px.x + aside, -aside));
    emit_corner(t, cells, vec2(-aside, aside));
    emit_corner(t, cells, vec2(base_px.x + aside, aside));
    emit_corner(t, cells, apex_px + vec2(-aside, aside));
    emit_corner(t, cells, apex_px + aside);
    EndPrimitive();
}

// Of a part of a large triangle.
void emit_rectangle(AlignedTriangle t, Cells cells) {
    vec2 size_px = vec2(cells.count_x, cells.count_y);
    for (int k = 0; k < 4; k++) {
        emit_corner(t, cells, size_px * vec2(k & 1, k >> 1));
    }
    EndPrimitive();
}
