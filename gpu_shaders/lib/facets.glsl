// Directions that a GGX lobe reflects to, one by one (Heitz 2018, "Sampling the GGX Distribution of Visible Normals").
#include "lib/microfacets.glsl"

const float MIRROR_WIDTH = 1.0e-4;    // narrower lobes are mirrors: float32 could not tell their directions apart
const float TWO_PI = 6.28318531;

// A shading normal that looks away from the eye shows what one at right angles to the direction of sight would.
vec3 seen_normal(vec3 normal, vec3 to_eye) {
    float facing = dot(normal, to_eye);
    return facing > 1.0e-4 ? normal : normalize(normal + (1.0e-4 - facing) * to_eye);
}

// The normal of a facet that `view` sees; both in the surface's own space, z along its normal. place: in the unit square
vec3 visible_facet(vec3 view, float width, vec2 place) {
    vec3 stretched = normalize(vec3(width * view.xy, view.z));
    float squared = dot(stretched.xy, stretched.xy);
    vec3 side = squared > 0.0 ? vec3(-stretched.y, stretched.x, 0.0) * inversesqrt(squared) : vec3(1.0, 0.0, 0.0);
    vec3 up = cross(stretched, side);
    float radius = sqrt(place.x);
    float angle = TWO_PI * place.y;
    vec2 disk = radius * vec2(cos(angle), sin(angle));
    float share = 0.5 * (1.0 + stretched.z);
    disk.y = mix(sqrt(max(1.0 - disk.x * disk.x, 0.0)), disk.y, share);
    vec3 facet = disk.x * side + disk.y * up + sqrt(max(1.0 - dot(disk, disk), 0.0)) * stretched;
    return normalize(vec3(width * facet.xy, max(facet.z, 1.0e-6)));
}

// The same in world space. masked: what the lobe's Fresnel factor is multiplied by
vec3 facet_of(vec3 normal, vec3 to_eye, float width, vec2 place, out float masked) {
    vec3 aside = abs(normal.z) < 0.9 ? normalize(cross(vec3(0.0, 0.0, 1.0), normal)) : normalize(cross(vec3(1.0, 0.0, 0.0), normal));
    vec3 up = cross(normal, aside);
    vec3 view = vec3(dot(aside, to_eye), dot(up, to_eye), dot(normal, to_eye));
    vec3 local = visible_facet(view, width, place);
    float leaving = reflect(-view, local).z;
    float hidden = smith(width, view.z);
    masked = leaving > 0.0 ? (1.0 + hidden) / (1.0 + hidden + smith(width, leaving)) : 0.0;
    return local.x * aside + local.y * up + local.z * normal;
}
