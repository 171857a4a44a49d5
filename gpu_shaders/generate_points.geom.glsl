// generate_points.comp.glsl for a geometry shader, a primitive for an invocation: it decides and places as the kernel does, and
// what the kernel walks over, the cells of a lattice, is left to the rasterizer.
#include "generate_points.comp.glsl"
