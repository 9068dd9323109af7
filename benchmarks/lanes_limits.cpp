// What forward dynamics of one state takes in operations, and how many of them this core does at best.
#include <chrono>

#ifdef DP_TYPES
#include "dashpot_lanes.h"
#include "vector.h"

#include "tree.h"

extern "C" void count(const dp_tree *tree, const double *numbers, const double *q, long *found) {
    static Body body[DP_MAX_LINKS];
    static V at[DP_MAX_LINKS], rate[DP_MAX_LINKS], bias[DP_MAX_LINKS], H[DP_MAX_LINKS][DP_MAX_LINKS];
    for (int i = 0; i < tree->links; i++, numbers += DP_NBODY) {
        body[i].mass = numbers[DP_MASS];
        for (int k = 0; k < 3; k++) body[i].centre[k] = numbers[DP_CENTRE + k];
        for (int k = 0; k < 6; k++) body[i].inertia[k] = numbers[DP_INERTIA + k];
        at[i] = q[i], rate[i] = 0.1;
    }
    counts = Counts();
    dynamics(*tree, body, at, rate, H, bias);
    solve(*tree, H, bias);
    found[0] = counts.multiplied, found[1] = counts.added, found[2] = counts.divided, found[3] = counts.picked;
}
#else
typedef double V __attribute__((vector_size(8 * DP_WIDTH)));

// Vector additions and multiplications per second, none waiting for another nor for memory.
extern "C" double peak(double factor) {
    V a0 = V{} + factor, a1 = a0, a2 = a0, a3 = a0, a4 = a0, a5 = a0, m0 = a0, m1 = a0, m2 = a0, m3 = a0, m4 = a0, m5 = a0;
    const V one = V{} + factor, small = V{} + 1e-9 * factor;
    const long rounds = 400000;
    double best = 0.0;
    for (int repeat = 0; repeat < 20; repeat++) {
        auto begin = std::chrono::steady_clock::now();
        for (long i = 0; i < rounds; i++) {
            a0 += small, a1 += small, a2 += small, a3 += small, a4 += small, a5 += small;
            m0 *= one, m1 *= one, m2 *= one, m3 *= one, m4 *= one, m5 *= one;
            asm volatile("" : "+x"(a0), "+x"(a1), "+x"(a2), "+x"(a3), "+x"(a4), "+x"(a5), "+x"(m0), "+x"(m1), "+x"(m2),
                              "+x"(m3), "+x"(m4), "+x"(m5));
        }
        const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
        best = 12.0 * rounds / seconds > best ? 12.0 * rounds / seconds : best;
    }
    return best;
}
#endif
