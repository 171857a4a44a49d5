first
#include "not_there.glsl"
