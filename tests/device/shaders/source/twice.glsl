#include "a.glsl"
#include "b.glsl"
#include "a.glsl"
last
