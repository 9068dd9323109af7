// A group of as many scenarios as there are lanes. Compiled once per instruction set, with DP_WIDTH and DP_LANES defined.
#include "drives.h"
#include "tree.h"

namespace {

struct Group {
    const dp_tree &t;
    dp_lane *lane;
    int count, ticks, drives, steps;
    double dt;
    V brake_delay = {};
    bool live[W] = {}, carries = false, contacts = false;
    int of[DP_MAX_JOINTS] = {};  // link that a drive moves
    int next_load[W] = {};
    V angle[DP_MAX_LINKS] = {}, rate[DP_MAX_LINKS] = {};  // of the links' joints
    V theta[DP_MAX_JOINTS] = {}, e[DP_MAX_JOINTS] = {}, w[DP_MAX_JOINTS] = {}, de[DP_MAX_JOINTS] = {};
    // The rotors are eliminated: 1 / (m + h v + h c), h c, h c / (m + h v + h c), viscous friction, and what that adds to
    // the links' inertias.
    V rotor[DP_MAX_JOINTS] = {}, coupling[DP_MAX_JOINTS] = {}, share[DP_MAX_JOINTS] = {}, viscous[DP_MAX_JOINTS] = {};
    V added[DP_MAX_LINKS] = {};
    Drive drive[DP_MAX_JOINTS] = {};
    Body body[DP_MAX_LINKS] = {}, bare[DP_MAX_LINKS] = {};

    Group(const dp_tree &tree, dp_lane *lanes, int n);
    void hang(int l, const double *numbers, Body *to);
    void sense(int tick);
    void control(int tick, const V *gravity);
    void step(int tick, int k);
    void touch(V *on_link);
    void run();
};

void Group::hang(int l, const double *numbers, Body *to) {
    for (int i = 0; i < t.links; i++, numbers += DP_NBODY) {
        to[i].mass[l] = numbers[DP_MASS];
        for (int k = 0; k < 3; k++) to[i].centre[k][l] = numbers[DP_CENTRE + k];
        for (int k = 0; k < 6; k++) to[i].inertia[k][l] = numbers[DP_INERTIA + k];
    }
}

Group::Group(const dp_tree &tree, dp_lane *lanes, int n)
    : t(tree), lane(lanes), count(n), ticks(0), drives(lanes->a.drives), steps(lanes->a.steps_per_tick), dt(lanes->a.dt) {
    for (int i = 0; i < t.links; i++) {
        if (t.drive[i] >= 0) of[t.drive[i]] = i;
        else added[i] = all(t.armature[i] + dt * t.damping[i]);
    }
    for (int l = 0; l < W; l++) {
        dp_lane &s = lane[l < n ? l : 0];  // lanes that are left over repeat the first scenario's physics
        live[l] = l < n;
        if (live[l]) {
            dp_begin(s.c, &s.a);
            s.a.diverged_tick = -1;
            std::memset(&s.tick, 0, sizeof s.tick);
            ticks = s.a.ticks > ticks ? s.a.ticks : ticks;
        }
        hang(l, s.load, body);
        if (s.bare) hang(l, s.bare, bare);
        carries |= s.bare != nullptr;
        for (int j = 0; j < drives; j++) {
            const dp_drive &d = s.a.drive[j];
            const double m = s.rotor[2 * j], v = s.rotor[2 * j + 1], hc = dt * d.damping, own = m + dt * v + hc;
            theta[j][l] = s.qpos[d.rotor_qpos], e[j][l] = s.qpos[d.spring_qpos];
            w[j][l] = s.qvel[d.rotor_dof], de[j][l] = s.qvel[d.spring_dof];
            rotor[j][l] = 1.0 / own, coupling[j][l] = hc, share[j][l] = hc / own, viscous[j][l] = v;
            added[of[j]][l] = hc * ((m + dt * v) / own);
            load(drive[j], l, d, s.a.reference != nullptr);
            take(drive[j], l, d);
            drive[j].asked[l] = d.asked;
        }
        for (int i = 0; i < t.links; i++)
            if (t.drive[i] < 0) angle[i][l] = s.qpos[t.qpos[i]] - t.zero[i], rate[i][l] = s.qvel[t.dof[i]];
    }
}

// Events, faults and sensors of a tick.
void Group::sense(int tick) {
    for (int l = 0; l < count; l++) {
        dp_lane &s = lane[l];
        live[l] = live[l] && tick < s.a.ticks;
        if (!live[l]) continue;
        while (next_load[l] + 1 < s.loads && s.load_tick[next_load[l] + 1] <= tick)
            hang(l, s.load + static_cast<size_t>(++next_load[l]) * t.links * DP_NBODY, body);
        for (int j = 0; j < drives; j++) {
            dp_drive &d = s.a.drive[j];
            s.qpos[d.rotor_qpos] = theta[j][l], s.qpos[d.spring_qpos] = e[j][l];
            s.qvel[d.rotor_dof] = w[j][l], s.qvel[d.spring_dof] = de[j][l];
            give(drive[j], l, d);
            if (s.a.faults) {
                s.a.faults->state[j].closing = drive[j].closing[l];
                s.a.faults->state[j].brake_z = drive[j].brake_z[l];
            }
        }
        dp_tick_sense(s.c, &s.a, tick, &s.tick);
    }
}

// Controllers, and what the physics needs to know of the coming period.
void Group::control(int tick, const V *gravity) {
    contacts = false;
    for (int j = 0; j < drives; j++) drive[j].has_short = drive[j].has_brake = false;
    for (int l = 0; l < count; l++) {
        if (!live[l]) continue;
        dp_lane &s = lane[l];
        double own[DP_MAX_JOINTS];
        for (int j = 0; s.bare && j < drives; j++) own[j] = gravity[of[j]][l];
        dp_tick_control(s.c, &s.a, tick, s.bare ? own : nullptr, &s.tick);
        const dp_faults *f = s.a.faults;
        const bool held = f && f->stopped_at >= 0;
        const long at = static_cast<long>(tick) * drives, when = held ? static_cast<long>(f->stopped_at) * drives : at;
        const double *q = s.a.reference, *qd = q ? q + static_cast<long>(s.a.ticks) * drives : nullptr;
        for (int j = 0; j < drives; j++) {
            Drive &d = drive[j];
            take(d, l, s.a.drive[j]);
            d.external[l] = s.a.external ? s.a.external[at + j] : 0.0;
            d.reference[l] = q ? q[when + j] : 0.0;
            d.reference_rate[l] = qd && !held ? qd[at + j] : 0.0;
            const bool acts = f && f->acting;
            d.short_damping[l] = acts ? f->state[j].short_damping : 0.0;
            d.brake[l] = acts ? f->state[j].brake : 0.0;
            if (!f) continue;
            d.short_corner[l] = f->state[j].of.short_corner, d.most_damping[l] = f->state[j].of.most_damping;
            d.closing[l] = f->state[j].closing, d.brake_z[l] = f->state[j].brake_z;
            d.has_short |= d.short_damping[l] > 0.0, d.has_brake |= d.brake[l] > 0.0;
        }
        if (f) brake_delay[l] = f->brake_delay;
        for (int i = 0; f && f->acting && i < f->faults; i++)
            contacts |= f->fault[i].acts && f->fault[i].kind == DP_FAULT_CONTACT;
    }
}

// Walls that a fault has put up: few, and one by one.
void Group::touch(V *on_link) {
    for (int l = 0; l < count; l++) {
        const dp_faults *f = lane[l].a.faults;
        if (!live[l] || !f || !f->acting) continue;
        for (int i = 0; i < f->faults; i++) {
            const dp_fault &wall = f->fault[i];
            if (!wall.acts || wall.kind != DP_FAULT_CONTACT) continue;
            const int j = wall.drive;
            const double depth = wall.side * ((theta[j][l] + e[j][l]) - wall.anchor);
            const double push = wall.value * depth + wall.damping * (wall.side * (w[j][l] + de[j][l]));
            if (depth > 0.0 && push > 0.0) on_link[j][l] -= wall.side * push;
        }
    }
}

void Group::step(int tick, int k) {
    V H[DP_MAX_LINKS][DP_MAX_LINKS], bias[DP_MAX_LINKS], x[DP_MAX_LINKS], on_rotor[DP_MAX_JOINTS], on_link[DP_MAX_JOINTS];
    const long at = static_cast<long>(tick) * steps + k;
    for (int j = 0; j < drives; j++) {
        Drive &d = drive[j];
        actuate(d, theta[j], e[j], w[j], de[j], k * dt, dt, at, on_rotor[j], on_link[j]);
        if (d.has_brake) on_rotor[j] -= braked(d, w[j], brake_delay, dt);
        angle[of[j]] = (theta[j] + e[j]) - t.zero[of[j]];
        rate[of[j]] = w[j] + de[j];
    }
    if (contacts) touch(on_link);
    dynamics(t, body, angle, rate, H, bias);
    for (int j = 0; j < drives; j++) {
        Drive &d = drive[j];
        const V spring = d.stiffness * e[j] + d.damping * de[j];
        on_rotor[j] += spring - viscous[j] * w[j];
        x[of[j]] = on_link[j] - spring - bias[of[j]] + share[j] * on_rotor[j];
    }
    for (int i = 0; i < t.links; i++)
        if (t.drive[i] < 0) x[i] = t.stiffness[i] * (t.rest[i] - angle[i]) - t.damping[i] * rate[i] - bias[i];
    for (int i = 0; i < t.links; i++) H[i][i] += added[i];
    solve(t, H, x);
    V fastest = V{};
    Mask wild = fastest > 1.0;
    for (int j = 0; j < drives; j++) {
        const V link = x[of[j]], own = (on_rotor[j] + coupling[j] * link) * rotor[j];
        w[j] += dt * own;
        de[j] += dt * (link - own);
        theta[j] += dt * w[j];
        e[j] += dt * de[j];
        observe(drive[j], e[j], de[j], w[j], dt, at, lane, j, count);
        wild |= ~(absolute(w[j]) + absolute(de[j]) < 1e4);  // as dp_run; also where it is no number
    }
    for (int i = 0; i < t.links; i++)
        if (t.drive[i] < 0) {
            rate[i] += dt * x[i];
            angle[i] += dt * rate[i];
        }
    if (!any(wild)) return;
    for (int l = 0; l < count; l++)
        if (live[l] && wild[l]) {
            live[l] = false;
            lane[l].a.diverged_tick = tick;
        }
}

void Group::run() {
    for (int tick = 0; tick < ticks; tick++) {
        sense(tick);
        V gravity[DP_MAX_LINKS], known[DP_MAX_LINKS];
        if (carries) {
            for (int i = 0; i < t.links; i++) known[i] = all(0.0);
            for (int j = 0; j < drives; j++)
                for (int l = 0; l < W; l++) known[of[j]][l] = lane[l < count ? l : 0].tick.known[j] - t.zero[of[j]];
            weight(t, bare, known, gravity);
        }
        control(tick, gravity);
        bool left = false;
        for (int l = 0; l < count; l++) left |= live[l];
        if (!left) break;
        for (int k = 0; k < steps; k++) step(tick, k);
    }
    for (int l = 0; l < count; l++)
        for (int j = 0; j < drives; j++) {
            const dp_drive &d = lane[l].a.drive[j];
            lane[l].qpos[d.rotor_qpos] = theta[j][l], lane[l].qpos[d.spring_qpos] = e[j][l];
            lane[l].qvel[d.rotor_dof] = w[j][l], lane[l].qvel[d.spring_dof] = de[j][l];
        }
    for (int l = 0; l < count; l++)
        for (int i = 0; i < t.links; i++)
            if (t.drive[i] < 0) lane[l].qpos[t.qpos[i]] = angle[i][l] + t.zero[i], lane[l].qvel[t.dof[i]] = rate[i][l];
}

static void run(const dp_tree *tree, dp_lane *lane, int count) {
    Group *group = new (std::align_val_t(64)) Group(*tree, lane, count);
    group->run();
    group->~Group();
    ::operator delete(group, std::align_val_t(64));
}

static void forward(const dp_tree *tree, const double *body, const double *q, const double *qd, const double *torque,
                    double *qdd, double *mass, double *bias_out, int count) {
    const dp_tree &t = *tree;
    const int n = t.links;
    for (size_t i = 0; mass && i < static_cast<size_t>(count) * n * n; i++) mass[i] = 0.0;  // links that no path joins
    for (int first = 0; first < count; first += W) {
        Body b[DP_MAX_LINKS];
        V at[DP_MAX_LINKS], rate[DP_MAX_LINKS], x[DP_MAX_LINKS], H[DP_MAX_LINKS][DP_MAX_LINKS], bias[DP_MAX_LINKS];
        auto row = [&](int l) { return static_cast<size_t>(first + l < count ? first + l : first); };
        for (int i = 0; i < n; i++)
            for (int l = 0; l < W; l++) {
                const double *from = body + (row(l) * n + i) * DP_NBODY;
                b[i].mass[l] = from[DP_MASS];
                for (int k = 0; k < 3; k++) b[i].centre[k][l] = from[DP_CENTRE + k];
                for (int k = 0; k < 6; k++) b[i].inertia[k][l] = from[DP_INERTIA + k];
                at[i][l] = q[row(l) * n + i], rate[i][l] = qd[row(l) * n + i];
            }
        dynamics(t, b, at, rate, H, bias);
        for (int i = 0; i < n; i++)
            for (int l = 0; l < W; l++) {
                x[i][l] = torque[row(l) * n + i] - bias[i][l];
                if (bias_out) bias_out[row(l) * n + i] = bias[i][l];
                for (int j = i; mass && j >= 0; j = t.parent[j])
                    mass[(row(l) * n + i) * n + j] = mass[(row(l) * n + j) * n + i] = H[i][j][l];
            }
        solve(t, H, x);
        for (int i = 0; i < n; i++)
            for (int l = 0; l < W; l++) qdd[row(l) * n + i] = x[i][l];
    }
}

static void functions(const double *x, double *sine, double *cosine, double *fall, int count) {
    for (int first = 0; first < count; first += W) {
        V in, s, c;
        for (int l = 0; l < W; l++) in[l] = x[first + l < count ? first + l : first];
        sincos(in, s, c);
        const V f = decay(absolute(in));
        for (int l = 0; l < W && first + l < count; l++) sine[first + l] = s[l], cosine[first + l] = c[l], fall[first + l] = f[l];
    }
}

}  // namespace

extern "C" const dp_lanes DP_LANES;
const dp_lanes DP_LANES = {W, DP_NAME, run, forward, functions};
