// What a surface looks like at a point, from its material (core/passes/surface_data.py lays them out; core/material.py says what they mean).
#include "lib/scene_data.glsl"
#include "lib/material_image.glsl"

struct Surface {
    vec3 normal_ws;  // of shading, on the geometric normal's side
    vec3 diffuse;
    float dielectric_weight;
    float ior;
    vec3 specular_tint;
    float metal_weight;
    vec3 metal;
    bool metal_fresnel;
    float roughness;
    float coat_weight;
    float coat_roughness;
    float coat_ior;
    vec3 emission;
};

// A point on a triangle, in what its material may ask for.
struct SurfacePoint {
    vec3 weights;      // barycentric
    int triangle;      // of its mesh
    int layer_table;   // of its mesh: where the values at its triangles' corners start
};

// What a layer has at the corners of a point's triangle: uvs with 0, or colours. A mesh without the layer has zeros there.
// Software rasterizers execute every branch of what follows, so fetches are shared by all of them.
struct Corners {
    bool exist;
    bool are_uvs;
    vec4 texels[3];
};

Corners corners_of(SurfacePoint point, int layer) {
    vec4 entry = texelFetch(surface_data, linear_texel(point.layer_table + layer), 0);
    Corners corners;
    corners.exist = entry.z > 0.5;
    corners.are_uvs = entry.w < 2.5;
    int first = integer_of(entry.xy) + int(entry.w) * point.triangle;
    for (int k = 0; k < 3; k++) {
        corners.texels[k] = texelFetch(surface_data, linear_texel(first + k), 0);
    }
    return corners;
}

vec3 corner_value(Corners corners, int k) {
    vec3 uv = k == 0 ? vec3(corners.texels[0].xy, 0.0) : k == 1 ? vec3(corners.texels[0].zw, 0.0) : vec3(corners.texels[1].xy, 0.0);
    return corners.exist ? (corners.are_uvs ? uv : corners.texels[k].xyz) : vec3(0.0);
}

vec3 interpolated(Corners corners, vec3 weights) {
    return weights.x * corner_value(corners, 0) + weights.y * corner_value(corners, 1) + weights.z * corner_value(corners, 2);
}

vec3 power_of(vec3 a, vec3 b) {
    vec3 magnitude = pow(max(abs(a), vec3(1e-30)), b);
    bvec3 real = bvec3(a.x >= 0.0 || b.x == floor(b.x), a.y >= 0.0 || b.y == floor(b.y), a.z >= 0.0 || b.z == floor(b.z));
    vec3 odd = mod(abs(b), 2.0);
    vec3 signs = vec3(a.x < 0.0 && odd.x == 1.0 ? -1.0 : 1.0, a.y < 0.0 && odd.y == 1.0 ? -1.0 : 1.0, a.z < 0.0 && odd.z == 1.0 ? -1.0 : 1.0);
    return vec3(real) * signs * magnitude;
}

vec3 divided(vec3 a, vec3 b) {
    return vec3(b.x == 0.0 ? 0.0 : a.x / b.x, b.y == 0.0 ? 0.0 : a.y / b.y, b.z == 0.0 ? 0.0 : a.z / b.z);
}

vec3 hsv_of(vec3 c) {
    float value = max(c.r, max(c.g, c.b));
    float range = value - min(c.r, min(c.g, c.b));
    if (range <= 0.0) {
        return vec3(0.0, 0.0, value);
    }
    float hue = value == c.r ? (c.g - c.b) / range : value == c.g ? 2.0 + (c.b - c.r) / range : 4.0 + (c.r - c.g) / range;
    return vec3(fract(hue / 6.0), range / value, value);
}

vec3 color_of_hsv(vec3 hsv) {
    vec3 pure = clamp(abs(mod(6.0 * hsv.x + vec3(0.0, 4.0, 2.0), 6.0) - 3.0) - 1.0, 0.0, 1.0);
    return hsv.z * mix(vec3(1.0), pure, hsv.y);
}

// The first channel of `at` chooses a place between the first and the last entry.
vec3 looked_up(float at, int first, int entry_count) {
    float place = clamp(at, 0.0, 1.0) * float(entry_count - 1);
    int low = clamp(int(place), 0, max(entry_count - 2, 0));
    vec3 before = texelFetch(surface_data, linear_texel(first + low), 0).xyz;
    vec3 after = texelFetch(surface_data, linear_texel(first + low + 1), 0).xyz;
    return mix(before, after, place - float(low));
}

// Runs the instructions of a material, which leave its inputs in the first registers. These are asked for by comparing numbers, at one
// place: indexed, they took a third of the time that it took to compile a kernel.
void run_program(int address, SurfacePoint point, inout vec3 r[REGISTERS]) {
    for (int step = 0; step < MAX_INSTRUCTIONS; step++) {
        vec4 instruction = texelFetch(surface_data, linear_texel(address), 0);
        int code = int(instruction.x);
        int operation = code & 63;
        if (operation == OP_END) {
            return;
        }
        address += 1;
        vec3 result;
        if (operation == OP_CONSTANT) {
            result = instruction.yzw;
        } else if (operation <= OP_CORNER) {
            result = interpolated(corners_of(point, int(instruction.y)), point.weights);
            if (operation == OP_IMAGE) {
                vec4 row_u = texelFetch(surface_data, linear_texel(address), 0);
                vec4 row_v = texelFetch(surface_data, linear_texel(address + 1), 0);
                vec2 place = vec2(dot(row_u.xyz, vec3(result.xy, 1.0)), dot(row_v.xyz, vec3(result.xy, 1.0)));
                result = image_color(integer_of(instruction.zw), place, int(row_u.w), int(row_v.w));
                address += 2;
            }
        } else {
            vec3 a = vec3(0.0);
            vec3 b = vec3(0.0);
            vec3 c = vec3(0.0);
            int operand_count = operation == OP_MIX ? 3 : operation == OP_TABLE ? 1 : 2;
            for (int k = 0; k < operand_count; k++) {
                int number = int(instruction[k + 1]);
                for (int n = 0; n < REGISTERS; n++) {
                    c = n == number ? r[n] : c;
                }
                a = k == 0 ? c : a;
                b = k == 1 ? c : b;
            }
            if (operation == OP_TABLE) {
                int entry_count = int(instruction.z);
                result = looked_up(a.x, address, entry_count);
                address += entry_count;
            } else if (operation == OP_ADD) {
                result = a + b;
            } else if (operation == OP_SUBTRACT) {
                result = a - b;
            } else if (operation == OP_MULTIPLY) {
                result = a * b;
            } else if (operation == OP_DIVIDE) {
                result = divided(a, b);
            } else if (operation == OP_POWER) {
                result = power_of(a, b);
            } else if (operation == OP_MINIMUM) {
                result = min(a, b);
            } else if (operation == OP_MAXIMUM) {
                result = max(a, b);
            } else if (operation == OP_GREATER_THAN) {
                result = vec3(greaterThan(a, b));
            } else if (operation == OP_FLOOR) {
                result = floor(a);
            } else if (operation == OP_ABSOLUTE) {
                result = abs(a);
            } else if (operation == OP_CLAMP) {
                result = clamp(a, 0.0, 1.0);
            } else if (operation == OP_MIX) {
                result = mix(a, b, c);
            } else if (operation == OP_RED) {
                result = a.rrr;
            } else if (operation == OP_GREEN) {
                result = a.ggg;
            } else if (operation == OP_BLUE) {
                result = a.bbb;
            } else if (operation == OP_LUMINANCE) {
                result = vec3(dot(a, vec3(LUMINANCE_RED, LUMINANCE_GREEN, LUMINANCE_BLUE)));
            } else if (operation == OP_RGB_TO_HSV) {
                result = hsv_of(a);
            } else {
                result = color_of_hsv(a);
            }
        }
        for (int n = 0; n < REGISTERS; n++) {
            r[n] = n == code >> 6 ? result : r[n];
        }
    }
}

#ifdef NORMAL_MAPS
// The normal map's direction around the shading normal. Tangents are those of the triangle's own u and v, at right angles to the normal.
vec3 mapped_normal(SurfacePoint point, int layer, TriangleData triangle, vec3 n, vec3 color, float strength) {
    Corners corners = corners_of(point, layer);
    if (!corners.exist) {
        return n;
    }
    vec2 uvs[3];
    for (int k = 0; k < 3; k++) {
        uvs[k] = corner_value(corners, k).xy;
    }
    vec3 edge_1 = triangle.position_ws[1] - triangle.position_ws[0];
    vec3 edge_2 = triangle.position_ws[2] - triangle.position_ws[0];
    vec2 uv_1 = uvs[1] - uvs[0];
    vec2 uv_2 = uvs[2] - uvs[0];
    float turned = uv_1.x * uv_2.y - uv_2.x * uv_1.y < 0.0 ? -1.0 : 1.0;
    vec3 along_u = turned * (edge_1 * uv_2.y - edge_2 * uv_1.y);
    vec3 along_v = turned * (edge_2 * uv_1.x - edge_1 * uv_2.x);
    vec3 tangent = along_u - n * dot(n, along_u);
    float squared = dot(tangent, tangent);
    if (squared <= 0.0) {
        return n;
    }
    tangent *= inversesqrt(squared);
    vec3 bitangent = cross(n, tangent);
    bitangent *= dot(bitangent, along_v) < 0.0 ? -1.0 : 1.0;
    vec3 local = 2.0 * color - 1.0;
    local.xy *= strength;
    local.z = mix(1.0, local.z, clamp(strength, 0.0, 1.0));
    vec3 mapped = local.x * tangent + local.y * bitangent + local.z * n;
    float length_squared = dot(mapped, mapped);
    return length_squared > 0.0 ? mapped * inversesqrt(length_squared) : n;
}
#endif

// The surface at a point of a triangle. geometric_ws and shading_ws: unit, towards the side that is looked at.
Surface surface_at(
    int instance_index, InstanceData instance, TriangleData triangle, int triangle_index, vec3 weights, vec3 geometric_ws, vec3 shading_ws
) {
    vec4 bases = texelFetch(surface_data, linear_texel(INSTANCES_BASE + instance_index), 0);
    int slot = min(int(triangle.corners.w), int(bases.z));
    int material = integer_of(texelFetch(surface_data, linear_texel(integer_of(bases.xy) + slot), 0).xy);
    SurfacePoint point = SurfacePoint(weights, triangle_index, int(bases.w));

    vec3 r[REGISTERS];
    for (int k = 0; k < PAIRED_INPUTS; k += 2) {
        vec4 color_and_number = texelFetch(surface_data, linear_texel(material + 1 + k / 2), 0);
        r[k] = color_and_number.xyz;
        r[k + 1] = color_and_number.www;
    }
    vec4 coat = texelFetch(surface_data, linear_texel(material + 1 + PAIRED_INPUTS / 2), 0);
    r[INPUT_COAT_WEIGHT] = coat.xxx;
    r[INPUT_COAT_ROUGHNESS] = coat.yyy;
    r[INPUT_COAT_IOR] = coat.zzz;
    vec4 header = texelFetch(surface_data, linear_texel(material), 0);
#ifdef PROGRAMS
    if (header.x >= 0.0) {
        run_program(integer_of(header.xy), point, r);
    }
#endif
    Surface surface;
    surface.normal_ws = shading_ws;
#ifdef NORMAL_MAPS
    int normal_layer = int(header.z);
    if (normal_layer >= 0) {
        // a normal map is that of the front
        float side = shown_side(instance, triangle, geometric_ws);
        surface.normal_ws =
            side * mapped_normal(point, normal_layer, triangle, side * shading_ws, r[INPUT_NORMAL_COLOR], r[INPUT_NORMAL_STRENGTH].x);
    }
#endif
    surface.diffuse = max(r[INPUT_DIFFUSE], vec3(0.0));
    surface.dielectric_weight = clamp(r[INPUT_DIELECTRIC_WEIGHT].x, 0.0, 1.0);
    surface.ior = max(r[INPUT_IOR].x, 1.0);
    surface.specular_tint = max(r[INPUT_SPECULAR_TINT], vec3(0.0));
    surface.metal_weight = clamp(r[INPUT_METAL_WEIGHT].x, 0.0, 1.0);
    surface.metal = clamp(r[INPUT_METAL], 0.0, 1.0);
    surface.metal_fresnel = header.w > 0.5;
    surface.roughness = clamp(r[INPUT_ROUGHNESS].x, 0.0, 1.0);
#ifdef COATS
    surface.coat_weight = clamp(r[INPUT_COAT_WEIGHT].x, 0.0, 1.0);
#else
    surface.coat_weight = 0.0;  // by which compilers know that nothing that concerns coats is needed
#endif
    surface.coat_roughness = clamp(r[INPUT_COAT_ROUGHNESS].x, 0.0, 1.0);
    surface.coat_ior = max(r[INPUT_COAT_IOR].x, 1.0);
    surface.emission = r[INPUT_EMISSION];
    return surface;
}

// What arrives from the world along a unit direction.
vec3 world_radiance(vec3 direction_ws) {
    vec4 radiance = texelFetch(surface_data, linear_texel(WORLD_BASE), 0);
#ifdef WORLD_IMAGE
    vec3 direction;
    for (int k = 0; k < 3; k++) {
        direction[k] = dot(texelFetch(surface_data, linear_texel(WORLD_BASE + 1 + k), 0).xyz, direction_ws);
    }
    const float PI = 3.14159265;
    // asin is coarse on some devices
    float across = length(direction.xy);
    vec2 angles = vec2(across > 0.0 ? atan(direction.y, direction.x) : 0.0, atan(direction.z, across));
    vec2 place = 0.5 + vec2(-0.5, 1.0) * angles / PI;
    return radiance.xyz * image_color(int(radiance.w), place, EXTENSION_REPEAT, IMAGE_INTERPOLATED);
#else
    return radiance.xyz;
#endif
}
