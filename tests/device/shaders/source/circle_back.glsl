// and around
#include "circle.glsl"
