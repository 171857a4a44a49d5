#include "a.glsl"
in_b
