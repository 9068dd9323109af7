// The widths that this machine's instruction set has.
#include "dashpot_lanes.h"

extern "C" const dp_lanes dp_lanes_2;
#ifdef DP_X86
extern "C" const dp_lanes dp_lanes_4, dp_lanes_8;
#endif

extern "C" const dp_lanes *dp_lanes_at(int i) {
    const dp_lanes *found[3] = {&dp_lanes_2};
    int n = 1;
#ifdef DP_X86
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx2")) found[n++] = &dp_lanes_4;
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq")) found[n++] = &dp_lanes_8;
#endif
    return i >= 0 && i < n ? found[i] : nullptr;
}
