// Which triangle an invocation has in a dispatch of a group for every row of a work table (core/passes/scene_data.py).
#include "lib/linear_texel.glsl"
#include "lib/linear_invocation.glsl"

// group: counted from first_group; work: its row. False for invocations that have no triangle
bool find_work(out int group, out vec4 work, out int triangle_index) {
    group = linear_group();
    work = vec4(0.0);
    triangle_index = 0;
    if (group >= group_count) {
        return false;
    }
    work = texelFetch(work_table, linear_texel(group + first_group), 0);
    triangle_index = int(work.y) + int(gl_LocalInvocationID.x);
    return triangle_index < int(work.z);
}
