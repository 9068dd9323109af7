#include <new>

#define DP_WIDTH 8
#define DP_LANES dp_lanes_8
#define DP_NAME "AVX-512"
#include "width.inl"
