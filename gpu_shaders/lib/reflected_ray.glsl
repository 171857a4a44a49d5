// The ray that a surface reflects, and what of the light that it finds goes on.
#include "lib/brdf.glsl"
#include "lib/facets.glsl"
#include "lib/pixel_shift.glsl"

struct Reflected {
    vec3 direction;
    vec3 albedo;  // of the lobe
    vec3 share;   // of the light along this ray
};

// Rough surfaces reflect along one of their facets' normals. place: in the unit square, moved by what is the pixel's own
Reflected reflected_ray(Surface surface, vec3 geometric_ws, vec3 incoming, ivec2 pixel, vec2 place, int bounce) {
    vec3 n = seen_normal(surface.normal_ws, -incoming);
    surface.normal_ws = n;
    float cosine = max(-dot(n, incoming), LEAST_COSINE);
    Lobes lobes = lobes_of(surface, cosine);
    float roughness = reflection_roughness(surface, lobes);
    float width = roughness * roughness;
    vec3 facet = n;
    float masked = 1.0;
    if (width > MIRROR_WIDTH) {
        facet = facet_of(n, -incoming, width, shifted(pixel, place, bounce), masked);
    }
    Reflected found;
    found.direction = reflect(incoming, facet);
    float above = dot(found.direction, geometric_ws);
    if (above <= 0.0) {
        // a leaning shading normal would send it into the surface
        found.direction = normalize(found.direction - (above - 1.0e-3) * geometric_ws);
    }
    found.albedo = reflection_color(surface, lobes);
    // a coat has other facets than what it lies upon: those of the one that reflects more stand for both
    vec3 reflected = found.albedo;
    if (surface.coat_weight > 0.0) {
        // the mean of masking over facets is in it already
        masked /= width > MIRROR_WIDTH ? (roughness == surface.coat_roughness ? lobes.coat : lobes.base).albedo : 1.0;
    } else {
        reflected = lobe_fresnel(surface, lobes.base, clamp(-dot(facet, incoming), 0.0, 1.0));
    }
    found.share = masked * reflected;
    return found;
}

#ifdef FILTERED
// What the eye sees at another place of the picture (pixels): the surface goes on in the triangle's plane, its normal by the triangle's
// gradient; not so beyond where the plane ends. side: 1 where the triangle's front is seen, otherwise -1; traveled: from the eye
void move_in_pixel(vec2 at, InstanceData instance, TriangleData triangle, int triangle_index, float side, vec3 geometric_ws, vec3 shading,
                   float traveled, inout Surface surface, inout vec3 position, inout vec3 incoming) {
    vec3 to_plane = eye[0].xyz + at.x * eye[1].xyz + at.y * eye[2].xyz;
    bool orthographic = eye[3].w > 0.5;
    vec3 from = orthographic ? eye[3].xyz + to_plane : eye[3].xyz;
    vec3 toward = orthographic ? incoming : normalize(to_plane);
    vec3 moved = plane_weights(triangle, from, toward);
    vec3 place = moved.x * triangle.position_ws[0] + moved.y * triangle.position_ws[1] + moved.z * triangle.position_ws[2];
    float farther = dot(place - from, toward);
    if (dot(toward, geometric_ws) < 0.0 && (orthographic || (farther > 0.5 * traveled && farther < 2.0 * traveled))) {
        vec3 turned = surface.normal_ws + side * shading_normal(instance, triangle, triangle_index, moved, side * geometric_ws) - shading;
        surface.normal_ws = dot(turned, turned) > 0.0 ? normalize(turned) : surface.normal_ws;
        position = place;
        incoming = toward;
    }
}
#endif
