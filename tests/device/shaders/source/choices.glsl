always
#ifdef LEFT
left
#else
not_left
#endif
#ifndef RIGHT
not_right
#endif
#if COUNT > 3
many
#else
few
#endif
