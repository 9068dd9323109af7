#include <new>

#define DP_WIDTH 1
#define DP_LANES dp_lanes_1
#define DP_NAME "scalar"
#include "width.inl"
