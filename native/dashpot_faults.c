#include "dashpot_faults.h"

#include <math.h>
#include <string.h>

/* The brake sticks as the rotor's own friction does, half as stiff: both together stay stable in one step. */
static const double BRAKE_SOFTNESS = 0.5;

static int valid(const dp_fault *e, int drives)
{
    if (e->kind < 0 || e->kind >= DP_NFAULT || e->drive < 0 || e->drive >= drives)
        return 0;
    if (e->value - e->value != 0.0 || !(e->damping >= 0.0))
        return 0;
    if (e->kind == DP_FAULT_SAMPLES_LATE)
        return e->value >= 0.0 && e->value <= DP_MAX_LATE;
    return e->kind < DP_FAULT_SAMPLES_DROPPED || e->value >= 0.0;
}

int dp_faults_init(dp_faults *f, const dp_fault *fault, int faults, const dp_fault_drive *of, int drives,
                   double brake_delay)
{
    if (faults < 0 || faults > DP_MAX_FAULTS || drives < 1 || drives > DP_MAX_JOINTS || !(brake_delay >= 0.0))
        return -1;
    memset(f, 0, sizeof *f);
    for (int i = 0; i < faults; i++) {
        if (!valid(&fault[i], drives))
            return -1;
        f->fault[i] = fault[i];
    }
    for (int j = 0; j < drives; j++) {
        if (!(of[j].brake_torque >= 0.0) || !(of[j].short_corner > 0.0) || !(of[j].most_damping >= 0.0))
            return -1;
        f->state[j].of = of[j];
    }
    f->faults = faults;
    f->drives = drives;
    f->brake_delay = brake_delay;
    f->powered = 1;
    return 0;
}

int dp_faults_put(dp_faults *f, int i, const dp_fault *fault)
{
    if (i < 0 || i > f->faults || i >= DP_MAX_FAULTS || !valid(fault, f->drives))
        return -1;
    f->fault[i] = *fault;
    f->faults += i == f->faults;
    return 0;
}

void dp_faults_begin(dp_faults *f, const dp_drive *drive)
{
    f->stopped_at = -1;
    for (int j = 0; j < f->drives; j++) {
        const dp_fault_drive of = f->state[j].of;
        dp_fault_state *s = &f->state[j];
        memset(s, 0, sizeof *s);
        s->of = of;
        s->torque_limit = drive[j].torque_limit;
        s->servo_limit = drive[j].servo_limit;
        s->inner_gain = drive[j].inner_gain;
        s->sensor_gain = drive[j].sensor_gain;
        s->sensor_bias = drive[j].sensor_bias;
        s->sensor_noise = drive[j].sensor_noise;
    }
}

static void heal(const dp_faults *f, dp_fault_state *s, dp_drive *d)
{
    d->torque_limit = s->torque_limit;
    d->servo_limit = s->servo_limit;
    d->motor_limit = INFINITY;
    d->inner_gain = s->inner_gain;
    d->sensor_gain = s->sensor_gain;
    d->sensor_bias = s->sensor_bias;
    d->sensor_noise = s->sensor_noise;
    s->jump = s->short_damping = 0.0;
    s->frozen = s->lost = s->stuck = s->nan = s->dropped = s->late = s->off = 0;
    s->brake = f->apply_brake ? s->of.brake_torque : 0.0;
}

/* Puts up a wall at the link, in front of it as it moves (at rest: against positive motion). */
static void place_wall(dp_fault *e, const dp_run_args *a)
{
    const dp_drive *d = &a->drive[e->drive];
    e->anchor = a->qpos[d->rotor_qpos] + a->qpos[d->spring_qpos];
    e->side = a->qvel[d->rotor_dof] + a->qvel[d->spring_dof] < 0.0 ? -1.0 : 1.0;
}

static void apply(dp_faults *f, dp_fault *e, const dp_run_args *a, int tick)
{
    dp_fault_state *s = &f->state[e->drive];
    dp_drive *d = &a->drive[e->drive];
    const double v = e->value;
    switch (e->kind) {
    case DP_FAULT_ENCODER_FROZEN: s->frozen = 1; break;
    case DP_FAULT_ENCODER_JUMP: s->jump += v; break;
    case DP_FAULT_ENCODER_LOST: s->lost = 1; break;
    case DP_FAULT_TORQUE_BIAS: d->sensor_bias += v; break;
    case DP_FAULT_TORQUE_DRIFT: d->sensor_bias += v * ((tick - e->first) * (a->dt * a->steps_per_tick)); break;
    case DP_FAULT_TORQUE_SCALE: d->sensor_gain *= v; break;
    case DP_FAULT_TORQUE_STUCK: s->stuck = 1; break;
    case DP_FAULT_TORQUE_NOISE: d->sensor_noise = sqrt(d->sensor_noise * d->sensor_noise + v * v); break;
    case DP_FAULT_TORQUE_NAN: s->nan = 1; break;
    case DP_FAULT_SAMPLES_DROPPED: s->dropped |= dp_uniform(&e->rng) < v; break;
    case DP_FAULT_SAMPLES_LATE: s->late = v > s->late ? (int)v : s->late; break;
    case DP_FAULT_SATURATION: /* 0 times an infinite limit must be 0 */
        d->torque_limit = v > 0.0 ? v * d->torque_limit : 0.0;
        d->servo_limit = v > 0.0 ? v * d->servo_limit : 0.0;
        d->motor_limit = d->torque_limit; /* a weak motor carries no more weight than this either */
        break;
    case DP_FAULT_BROWNOUT: f->powered = 0; break;
    case DP_FAULT_CONTACT:
        if (tick == e->first)
            place_wall(e, a);
        f->acting = 1;
        break;
    case DP_FAULT_SHORTED_WINDINGS:
        s->short_damping = v > s->short_damping ? v : s->short_damping;
        s->off = 1;
        break;
    case DP_FAULT_MECHANICAL_BRAKE: s->brake = v > s->brake ? v : s->brake; break;
    }
}

void dp_faults_tick(dp_faults *f, const dp_run_args *a, int tick)
{
    f->powered = 1;
    f->acting = 0;
    for (int j = 0; j < f->drives; j++)
        heal(f, &f->state[j], &a->drive[j]);
    for (int i = 0; i < f->faults; i++) {
        dp_fault *e = &f->fault[i];
        e->acts = tick >= e->first && tick < e->last;
        if (e->acts)
            apply(f, e, a, tick);
    }
    for (int j = 0; j < f->drives; j++) {
        dp_fault_state *s = &f->state[j];
        dp_drive *d = &a->drive[j];
        if (s->brake > 0.0)
            s->off |= s->closing >= f->brake_delay;
        else
            s->closing = s->brake_z = 0.0;
        s->off |= !f->powered;
        f->acting |= s->brake > 0.0 || s->short_damping > 0.0;
        if (s->off) {
            d->torque_limit = d->servo_limit = d->motor_limit = d->inner_gain = 0.0;
        } else if (s->was_off) { /* the inner loop starts afresh */
            d->inner_torque = d->tau;
            d->inner_correction = 0.0;
        }
        s->was_off = s->off;
    }
}

void dp_faults_sample(dp_faults *f, int j, int tick, double period, double *torque, double *position,
                      double *velocity)
{
    dp_fault_state *s = &f->state[j];
    double q = *position, w = *velocity, tau = *torque;
    if (!s->started)
        s->jump_before = s->jump;
    if (s->jump != 0.0)
        q += s->jump;
    if (s->jump != s->jump_before) /* rates are difference quotients: a jump is a spike */
        w += (s->jump - s->jump_before) / period;
    if (s->frozen) {
        q = s->started ? s->position : q;
        w = 0.0;
    } else if (s->was_frozen) {
        w = (q - s->position) / period;
    }
    if (s->stuck && s->started)
        tau = s->torque;
    s->jump_before = s->jump;
    s->was_frozen = s->frozen;
    s->position = q;
    s->torque = tau;

    dp_packet *sent = &s->sent[tick % (DP_MAX_LATE + 1)];
    const dp_packet now = {s->nan ? NAN : tau, s->lost ? NAN : q, s->lost ? NAN : w, sent->gravity, !s->lost};
    *sent = now;
    if (!s->started) {
        s->source = tick;
        s->encoder_source = tick - 1;
        s->seen = now;
    } else if (!s->dropped && tick - s->late > s->source) { /* a delay that grows repeats, it never goes back */
        s->source = tick - s->late;
        s->seen = s->late ? s->sent[s->source % (DP_MAX_LATE + 1)] : now; /* what was just stored is slow to read */
    }
    if (s->seen.encoder)
        s->encoder_source = s->source;
    s->started = 1;
    *torque = s->seen.torque;
    *position = s->seen.position;
    *velocity = s->seen.velocity;
    f->torque_age[j] = tick - s->source;
    f->encoder_age[j] = tick - s->encoder_source;
}

void dp_faults_angle(const dp_faults *f, int j, double *position)
{
    if (!f->state[j].lost)
        *position = f->state[j].position;
}

double dp_faults_gravity(dp_faults *f, int j, int tick, double gravity)
{
    dp_fault_state *s = &f->state[j];
    s->sent[tick % (DP_MAX_LATE + 1)].gravity = gravity;
    if (tick - s->source <= DP_MAX_LATE) /* older ones are no longer there, and were told before */
        s->seen.gravity = s->sent[s->source % (DP_MAX_LATE + 1)].gravity;
    return s->seen.gravity;
}

static double within(double x, double limit)
{
    return x > limit ? limit : (x < -limit ? -limit : x);
}

/* Coulomb friction of a closing brake on the rotor. */
static double brake(dp_faults *f, dp_fault_state *s, const dp_drive *d, double w, double dt)
{
    const double dead = 0.5 * f->brake_delay;
    double share = s->closing < f->brake_delay ? (s->closing - dead) / dead : 1.0;
    s->closing += dt;
    if (!(share > 0.0))
        return 0.0;
    const double level = share * s->brake;
    s->brake_z = within(s->brake_z + BRAKE_SOFTNESS * d->presliding_stiffness * (w * dt), level);
    return within(s->brake_z + BRAKE_SOFTNESS * d->presliding_damping * w, level);
}

void dp_faults_forces(dp_faults *f, const dp_run_args *a)
{
    for (int j = 0; j < f->drives; j++) {
        dp_fault_state *s = &f->state[j];
        const dp_drive *d = &a->drive[j];
        const double w = a->qvel[d->rotor_dof];
        if (s->short_damping > 0.0) {
            const double ratio = w / s->of.short_corner;
            const double b = s->short_damping / (1.0 + ratio * ratio);
            a->qfrc_applied[d->rotor_dof] -= (b < s->of.most_damping ? b : s->of.most_damping) * w;
        }
        if (s->brake > 0.0)
            a->qfrc_applied[d->rotor_dof] -= brake(f, s, d, w, a->dt);
    }
    for (int i = 0; i < f->faults; i++) {
        const dp_fault *e = &f->fault[i];
        if (!e->acts || e->kind != DP_FAULT_CONTACT)
            continue;
        const dp_drive *d = &a->drive[e->drive];
        const double angle = a->qpos[d->rotor_qpos] + a->qpos[d->spring_qpos];
        const double rate = a->qvel[d->rotor_dof] + a->qvel[d->spring_dof];
        const double depth = e->side * (angle - e->anchor);
        const double push = e->value * depth + e->damping * (e->side * rate);
        if (depth > 0.0 && push > 0.0) { /* a wall pushes, it never pulls */
            a->qfrc_applied[d->rotor_dof] -= e->side * push;
            a->qfrc_applied[d->spring_dof] -= e->side * push;
        }
    }
}
