// Numbers of all lanes: a vector of DP_WIDTH doubles, and the functions the physics needs of it.
//
// Only +, -, *, / and square roots are used, in one order: IEEE arithmetic gives every lane the same bits on any machine.
#include <cmath>
#include <cstring>

#define DP_INLINE static inline __attribute__((always_inline))

#ifdef DP_TYPES  // others in the place of these, to count operations: benchmarks/lanes_limits.cpp
#include DP_TYPES
#else

namespace {

enum { W = DP_WIDTH };

typedef double V __attribute__((vector_size(8 * DP_WIDTH)));
typedef decltype(V{} < V{}) Mask;  // all bits of a lane, or none
typedef long long Bits __attribute__((vector_size(8 * DP_WIDTH)));

DP_INLINE V all(double x) { return V{} + x; }
DP_INLINE V pick(Mask m, V a, V b) { return m ? a : b; }

DP_INLINE bool any(Mask m) {
#if defined(__AVX__) && DP_WIDTH == 4
    return __builtin_ia32_movmskpd256(reinterpret_cast<V>(m)) != 0;
#else
    long long found = 0;
    for (int l = 0; l < W; l++) found |= m[l];
    return found != 0;
#endif
}

}  // namespace

#endif

namespace {

DP_INLINE V clamp(V x, V limit) { return pick(x > limit, limit, pick(x < -limit, -limit, x)); }
DP_INLINE V absolute(V x) { return pick(x < 0.0, -x, x); }

const double SHIFT = 6755399441055744.0;  // 1.5 * 2^52: adding and subtracting it rounds to the nearest integer

// Sine and cosine, |x| < 1e5, to 1 unit in the last place: reduced by multiples of pi/2 in three parts (33 + 33 + 53 bits),
// then the polynomials of Moshier and of Ng (fdlibm's k_sin.c and k_cos.c) on [-pi/4, pi/4].
DP_INLINE void sincos(V x, V &sine, V &cosine) {
    const V n = (x * 6.36619772367581382433e-01 + SHIFT) - SHIFT;
    const V y = ((x - n * 1.57079632673412561417e+00) - n * 6.07710050630396597660e-11) - n * 2.02226624879595063154e-21;
    const V z = y * y;
    const V s = y + y * z *
                        (-1.66666666666666324348e-01 +
                         z * (8.33333333332248946124e-03 +
                              z * (-1.98412698298579493134e-04 +
                                   z * (2.75573137070700676789e-06 +
                                        z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
    const V c = (1.0 - 0.5 * z) +
                z * z *
                    (4.16666666666666019037e-02 +
                     z * (-1.38888888888741095749e-03 +
                          z * (2.48015872894767294178e-05 +
                               z * (-2.75573143513906633035e-07 +
                                    z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)))));
    const V quarter = n - 4.0 * ((0.25 * n + SHIFT) - SHIFT);  // -2, -1, 0, 1 or 2
    const Mask odd = (quarter == 1.0) | (quarter == -1.0);
    const Mask turned = (quarter == 2.0) | (quarter == -2.0);
    const V a = pick(odd, c, s), b = pick(odd, s, c);
    sine = pick(turned | (quarter == -1.0), -a, a);
    cosine = pick(turned | (quarter == 1.0), -b, b);
}

// exp(-x) for x >= 0, to 1 unit in the last place; 0 beyond 700.
DP_INLINE V decay(V x) {
    const V n = (x * -1.44269504088896338700e+00 + SHIFT) - SHIFT;
    const V r = (-x - n * 6.93147180369123816490e-01) - n * 1.90821492927058770002e-10;
    V p = all(1.0 / 6227020800.0);
    const double inverse[] = {1.0 / 479001600, 1.0 / 39916800, 1.0 / 3628800, 1.0 / 362880, 1.0 / 40320, 1.0 / 5040,
                              1.0 / 720,       1.0 / 120,      1.0 / 24,      1.0 / 6,      0.5,         1.0,
                              1.0};
    for (double c : inverse) p = p * r + c;
    const V shifted = n + SHIFT;
    Bits bits;
    std::memcpy(&bits, &shifted, sizeof bits);
    bits = (bits + 1023) << 52;  // 2^n; SHIFT's own bits are shifted out
    V power;
    std::memcpy(&power, &bits, sizeof power);
    return pick(x > 700.0, all(0.0), p * power);
}

}  // namespace
