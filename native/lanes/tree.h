// Rigid-body dynamics of a tree of links, all lanes at once: composite rigid bodies and the bias force, about the base's
// origin, and the factorisation of the mass matrix that keeps its zeros (Featherstone, Rigid Body Dynamics Algorithms,
// 2008, sections 5.3, 6.2 and 6.5).
#include "dashpot_lanes.h"

namespace {

struct Body {
    V mass, centre[3], inertia[6];
};

// A link's own numbers at one pose.
struct Placed {
    V R[9], p[3];                 // of its frame
    V z[3], s[3];                 // its joint's axis: turning part and linear part at the origin
    V w[3], v[3], A[3], a[3];     // velocity; acceleration without its joints' own
    V I[6], h[3], m;              // inertia about the origin, first moment, mass: of the link, then of all beyond it
    V N[3], F[3];                 // moment and force
};

DP_INLINE void cross(const V *a, const V *b, V *c) {
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

DP_INLINE V dot(const V *a, const V *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

DP_INLINE void rotate(const V *R, const V *x, V *y) {
    for (int r = 0; r < 3; r++) y[r] = R[3 * r] * x[0] + R[3 * r + 1] * x[1] + R[3 * r + 2] * x[2];
}

DP_INLINE void symmetric(const V *I, const V *x, V *y) {  // xx yy zz xy xz yz
    y[0] = I[0] * x[0] + I[3] * x[1] + I[4] * x[2];
    y[1] = I[3] * x[0] + I[1] * x[1] + I[5] * x[2];
    y[2] = I[4] * x[0] + I[5] * x[1] + I[2] * x[2];
}

// Moment and force (or momenta) of a body at the motion (w, v): [I w + h x v, m v - h x w].
DP_INLINE void times(const Placed &b, const V *w, const V *v, V *N, V *F) {
    V hv[3], hw[3];
    symmetric(b.I, w, N);
    cross(b.h, v, hv);
    cross(b.h, w, hw);
    for (int k = 0; k < 3; k++) {
        N[k] += hv[k];
        F[k] = b.m * v[k] - hw[k];
    }
}

// Frame and axis of link i where its joint is at q.
DP_INLINE void place(const dp_tree &t, int i, V q, Placed *P) {
    Placed &b = P[i];
    const int up = t.parent[i];
    const double *T = t.turn[i], *x = t.place[i];
    V R[9];
    if (up < 0) {
        for (int k = 0; k < 9; k++) R[k] = all(T[k]);
        for (int k = 0; k < 3; k++) b.p[k] = all(x[k]);
    } else {
        const V *U = P[up].R;
        const int *along = t.along[i];
        for (int r = 0; r < 3; r++) b.p[r] = P[up].p[r] + (U[3 * r] * x[0] + U[3 * r + 1] * x[1] + U[3 * r + 2] * x[2]);
        if (along[0] >= 0) {
            for (int r = 0; r < 3; r++)
                for (int k = 0; k < 3; k++) R[3 * r + k] = U[3 * r + along[k]] * t.sense[i][k];
        } else {
            for (int r = 0; r < 3; r++)
                for (int k = 0; k < 3; k++) R[3 * r + k] = U[3 * r] * T[k] + U[3 * r + 1] * T[3 + k] + U[3 * r + 2] * T[6 + k];
        }
    }
    for (int r = 0; r < 3; r++) b.z[r] = R[3 * r + 2];
    if (t.slides[i]) {
        for (int k = 0; k < 9; k++) b.R[k] = R[k];
        for (int r = 0; r < 3; r++) b.p[r] += b.z[r] * q;
        return;
    }
    V sine, cosine;
    sincos(q, sine, cosine);
    for (int r = 0; r < 3; r++) {
        b.R[3 * r] = R[3 * r] * cosine + R[3 * r + 1] * sine;
        b.R[3 * r + 1] = R[3 * r + 1] * cosine - R[3 * r] * sine;
        b.R[3 * r + 2] = b.z[r];
    }
    cross(b.p, b.z, b.s);
}

// First moment about the origin; returns the centre of mass.
DP_INLINE void weigh(const Body &body, Placed &b, V *c) {
    rotate(b.R, body.centre, c);
    b.m = body.mass;
    for (int k = 0; k < 3; k++) {
        c[k] += b.p[k];
        b.h[k] = body.mass * c[k];
    }
}

// Inertia about the origin.
DP_INLINE void inertia(const Body &body, const V *c, Placed &b) {
    const V *R = b.R, *J = body.inertia;
    V RJ[9];
    for (int r = 0; r < 3; r++) symmetric(J, R + 3 * r, RJ + 3 * r);
    const V hx = b.h[0] * c[0], hy = b.h[1] * c[1], hz = b.h[2] * c[2];
    b.I[0] = dot(RJ, R) + (hy + hz);
    b.I[1] = dot(RJ + 3, R + 3) + (hx + hz);
    b.I[2] = dot(RJ + 6, R + 6) + (hx + hy);
    b.I[3] = dot(RJ, R + 3) - b.h[0] * c[1];
    b.I[4] = dot(RJ, R + 6) - b.h[0] * c[2];
    b.I[5] = dot(RJ + 3, R + 6) - b.h[1] * c[2];
}

// Velocity, and the acceleration and force that it and gravity make.
DP_INLINE void move(const dp_tree &t, int i, V qd, Placed *P) {
    Placed &b = P[i];
    const int up = t.parent[i];
    V zero[3] = {V{}, V{}, V{}}, rest[3];
    for (int k = 0; k < 3; k++) rest[k] = all(-t.gravity[k]);
    const V *w = up < 0 ? zero : P[up].w, *v = up < 0 ? zero : P[up].v;
    const V *A = up < 0 ? zero : P[up].A, *a = up < 0 ? rest : P[up].a;
    V wz[3];
    cross(w, b.z, wz);
    if (t.slides[i]) {
        for (int k = 0; k < 3; k++) {
            b.w[k] = w[k];
            b.v[k] = v[k] + b.z[k] * qd;
            b.A[k] = A[k];
            b.a[k] = a[k] + wz[k] * qd;
        }
    } else {
        V ws[3], vz[3];
        cross(w, b.s, ws);
        cross(v, b.z, vz);
        for (int k = 0; k < 3; k++) {
            b.w[k] = w[k] + b.z[k] * qd;
            b.v[k] = v[k] + b.s[k] * qd;
            b.A[k] = A[k] + wz[k] * qd;
            b.a[k] = a[k] + (ws[k] + vz[k]) * qd;
        }
    }
    V L[3], p[3], wL[3], vp[3], wp[3];
    times(b, b.A, b.a, b.N, b.F);
    times(b, b.w, b.v, L, p);
    cross(b.w, L, wL);
    cross(b.v, p, vp);
    cross(b.w, p, wp);
    for (int k = 0; k < 3; k++) {
        b.N[k] += wL[k] + vp[k];
        b.F[k] += wp[k];
    }
}

DP_INLINE V along(const dp_tree &t, int i, const Placed &b, const V *N, const V *F) {
    return t.slides[i] ? dot(b.z, F) : dot(b.z, N) + dot(b.s, F);
}

// Mass matrix (lower part, where not zero) and bias torque; q and qd of every link.
static inline void dynamics(const dp_tree &t, const Body *body, const V *q, const V *qd, V (*H)[DP_MAX_LINKS], V *bias) {
    Placed P[DP_MAX_LINKS];
    const int n = t.links;
    for (int i = 0; i < n; i++) {
        V c[3];
        place(t, i, q[i], P);
        weigh(body[i], P[i], c);
        inertia(body[i], c, P[i]);
        move(t, i, qd[i], P);
    }
    for (int i = n - 1; i >= 0; i--) {
        Placed &b = P[i];
        const int up = t.parent[i];
        bias[i] = along(t, i, b, b.N, b.F);
        V N[3], F[3];
        if (t.slides[i]) {
            cross(b.h, b.z, N);
            for (int k = 0; k < 3; k++) F[k] = b.m * b.z[k];
        } else {
            times(b, b.z, b.s, N, F);
        }
        for (int j = i; j >= 0; j = t.parent[j]) H[i][j] = along(t, j, P[j], N, F);
        if (up < 0) continue;
        Placed &u = P[up];
        for (int k = 0; k < 6; k++) u.I[k] += b.I[k];
        for (int k = 0; k < 3; k++) {
            u.h[k] += b.h[k];
            u.N[k] += b.N[k];
            u.F[k] += b.F[k];
        }
        u.m += b.m;
    }
}

// Torque that holds the links at rest.
static inline void weight(const dp_tree &t, const Body *body, const V *q, V *torque) {
    Placed P[DP_MAX_LINKS];
    V up_g[3];
    for (int k = 0; k < 3; k++) up_g[k] = all(-t.gravity[k]);
    for (int i = 0; i < t.links; i++) {
        V c[3];
        place(t, i, q[i], P);
        weigh(body[i], P[i], c);
    }
    for (int i = t.links - 1; i >= 0; i--) {
        Placed &b = P[i];
        V N[3], F[3];
        cross(b.h, up_g, N);
        for (int k = 0; k < 3; k++) F[k] = b.m * up_g[k];
        torque[i] = along(t, i, b, N, F);
        if (t.parent[i] < 0) continue;
        Placed &u = P[t.parent[i]];
        for (int k = 0; k < 3; k++) u.h[k] += b.h[k];
        u.m += b.m;
    }
}

// Solves H x = x in place by H = L' D L; H is destroyed.
static inline void solve(const dp_tree &t, V (*H)[DP_MAX_LINKS], V *x) {
    const int n = t.links;
    for (int k = n - 1; k >= 0; k--) {
        const V inverse = 1.0 / H[k][k];
        for (int i = t.parent[k]; i >= 0; i = t.parent[i]) {
            const V a = H[k][i] * inverse;
            for (int j = i; j >= 0; j = t.parent[j]) H[i][j] -= a * H[k][j];
            H[k][i] = a;
            x[i] -= a * x[k];
        }
        x[k] *= inverse;
    }
    for (int k = 0; k < n; k++)
        for (int i = t.parent[k]; i >= 0; i = t.parent[i]) x[k] -= H[k][i] * x[i];
}

}  // namespace
