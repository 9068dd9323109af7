#include <new>

#define DP_WIDTH 2
#define DP_LANES dp_lanes_2
#define DP_NAME "128 bit"
#include "width.inl"
