// Numbers that count what is done with them.
#include <cstddef>

namespace {

enum { W = 1 };

struct Counts {
    long multiplied, added, divided, picked;
} counts;

struct Mask {
    bool on;
};
typedef long long Bits;

struct V {
    double x;
    V() : x(0.0) {}
    V(double value) : x(value) {}
    double &operator[](int) { return x; }
};

static inline V operator-(V a) { return counts.added++, V(-a.x); }
static inline V operator+(V a, V b) { return counts.added++, V(a.x + b.x); }
static inline V operator-(V a, V b) { return counts.added++, V(a.x - b.x); }
static inline V operator*(V a, V b) { return counts.multiplied++, V(a.x * b.x); }
static inline V operator/(V a, V b) { return counts.divided++, V(a.x / b.x); }
static inline V &operator+=(V &a, V b) { return a = a + b; }
static inline V &operator-=(V &a, V b) { return a = a - b; }
static inline V &operator*=(V &a, V b) { return a = a * b; }
static inline Mask operator>(V a, V b) { return Mask{a.x > b.x}; }
static inline Mask operator<(V a, V b) { return Mask{a.x < b.x}; }
static inline Mask operator==(V a, V b) { return Mask{a.x == b.x}; }
static inline Mask operator|(Mask a, Mask b) { return Mask{a.on || b.on}; }
static inline V pick(Mask m, V a, V b) { return counts.picked++, m.on ? a : b; }
static inline V all(double x) { return V(x); }

}  // namespace
