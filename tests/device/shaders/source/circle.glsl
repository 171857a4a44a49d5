#include "circle_back.glsl"
