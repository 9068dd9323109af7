#include <new>

#define DP_WIDTH 4
#define DP_LANES dp_lanes_4
#define DP_NAME "AVX2"
#include "width.inl"
