#include "dashpot_runner.h"

#include "dashpot_faults.h"

#include <math.h>
#include <string.h>

static const double MAX_SPEED = 1e4; /* [rad/s]; no joint moves so fast: the simulation has diverged */

static double clamp(double x, double limit)
{
    return x > limit ? limit : (x < -limit ? -limit : x);
}

double dp_uniform(unsigned long long *state)
{
    unsigned long long z = (*state += 0x9E3779B97F4A7C15ULL);
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ULL;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBULL;
    z ^= z >> 31;
    return ((double)(z >> 11) + 0.5) * 0x1p-53;
}

/* Box-Muller gives two values at a time; the second waits in *spare (NaN: none). */
static double gaussian(unsigned long long *state, double *spare)
{
    if (*spare == *spare) {
        double value = *spare;
        *spare = NAN;
        return value;
    }
    double radius = sqrt(-2.0 * log(dp_uniform(state)));
    double angle = 6.283185307179586 * dp_uniform(state);
    *spare = radius * sin(angle);
    return radius * cos(angle);
}

/* Torque z of an elastic - perfectly plastic element: sticks exactly, dissipates on slip, never drifts. */
static double slip(double *z, double delta, double stiffness, double limit)
{
    return *z = clamp(*z + stiffness * delta, limit);
}

/* Reads the engine's new state: element forces, transmitted torque, sensor. */
static void observe(dp_drive *d, const double *qpos, const double *qvel, double dt, long step)
{
    const double e = qpos[d->spring_qpos], de = qvel[d->spring_dof], w = qvel[d->rotor_dof];
    double tau = -(d->stiffness * e + d->damping * de);
    if (d->half_gap > 0.0)
        tau += d->stiffness * clamp(e, d->half_gap);
    if (d->hysteresis > 0.0)
        tau -= slip(&d->hysteresis_z, de * dt, d->hysteresis_stiffness, d->hysteresis);
    if (d->coulomb > 0.0 || d->stribeck > 0.0) {
        double level = d->coulomb;
        if (d->stribeck > 0.0) {
            double ratio = w * d->stribeck_rate;
            level += d->stribeck * exp(-ratio * ratio);
        }
        double elastic = slip(&d->friction_z, w * dt, d->presliding_stiffness, level);
        d->friction = clamp(elastic + d->presliding_damping * w, level);
    }
    double seen = tau;
    if (d->sensor_delay > 0) {
        double *slot = &d->delay[step % d->sensor_delay];
        seen = *slot;
        *slot = tau;
    }
    if (d->filtered) {
        double x0 = d->filter_x[0], x1 = d->filter_x[1];
        d->filter_x[0] = d->filter_a[0][0] * x0 + d->filter_a[0][1] * x1 + d->filter_b[0] * seen;
        d->filter_x[1] = d->filter_a[1][0] * x0 + d->filter_a[1][1] * x1 + d->filter_b[1] * seen;
        seen = d->filter_x[0];
    }
    d->sum += 0.5 * (d->measured_tau + seen);
    d->measured_tau = seen;
    d->tau = tau;
}

/* Writes the forces of the coming step. */
static void actuate(dp_drive *d, const dp_run_args *a, const double *reference, double ahead, double external,
                    long step)
{
    const double e = a->qpos[d->spring_qpos];
    const double q = a->qpos[d->rotor_qpos], w = a->qvel[d->rotor_dof];
    double torque = d->motor;
    if (d->control < 0 && reference) {
        double error = reference[0] + ahead * reference[1] - q;
        double u = d->servo_kp * error + d->servo_kd * (reference[1] - w) + d->integral;
        torque = clamp(u, d->servo_limit);
        if (torque == u) /* integrate only while not saturated */
            d->integral += d->servo_ki * error * a->dt;
    }
    torque = clamp(torque, d->torque_limit);
    d->asked = torque;
    torque = clamp(torque + d->gravity, d->motor_limit);
    if (d->inner_gain > 0.0) {
        d->inner_torque = d->tau + d->inner_pole * (d->inner_torque - d->tau);
        if (step % d->inner_steps == 0)
            d->inner_correction = d->inner_gain * (torque - d->inner_torque); /* correction held for a period */
        torque += d->inner_correction;
    }
    /* The engine's own spring carries k e + c e'; only what differs from it is applied here. */
    double spring = d->half_gap > 0.0 ? d->stiffness * clamp(e, d->half_gap) : 0.0;
    if (d->hysteresis > 0.0)
        spring -= d->hysteresis_z;
    double link = external, angle = q + e;
    if (angle > d->stop_upper || angle < d->stop_lower) {
        double depth = angle > d->stop_upper ? angle - d->stop_upper : angle - d->stop_lower;
        double push = d->stop_stiffness * depth + d->stop_damping * (w + a->qvel[d->spring_dof]);
        if (push * depth > 0.0) /* a stop pushes, it never pulls */
            link -= push;
    }
    a->qfrc_applied[d->rotor_dof] = d->actuator_gain * torque - d->friction + link;
    a->qfrc_applied[d->spring_dof] = spring + link;
}

static double sample(dp_drive *d, int steps)
{
    double tau = d->average && steps > 0 ? d->sum / steps : d->measured_tau;
    d->sum = 0.0;
    tau = d->sensor_gain * tau + d->sensor_bias;
    if (d->sensor_noise > 0.0)
        tau += d->sensor_noise * gaussian(&d->rng, &d->spare);
    if (d->sensor_resolution > 0.0)
        tau = d->sensor_resolution * floor(tau / d->sensor_resolution + 0.5);
    return tau;
}

static void record(const dp_run_args *a, int tick, int j, int field, double value)
{
    a->record[((long)field * a->ticks + tick - a->origin) * a->drives + j] = value;
}

static const double *row(const double *table, const dp_run_args *a, int field, int tick, int j)
{
    return &table[((long)field * a->ticks + tick - a->origin) * a->drives + j];
}

/* What is sensed of drive j at a tick, faults included; recorded in row `at`. */
static void sense(const dp_run_args *a, int tick, int at, int j, double *torque, double *position, double *velocity)
{
    const double period = a->dt * a->steps_per_tick;
    dp_drive *d = &a->drive[j];
    double q = a->qpos[d->rotor_qpos], w = a->qvel[d->rotor_dof];
    if (d->position_resolution > 0.0) {
        q = d->position_resolution * floor(q / d->position_resolution + 0.5);
        w = tick > 0 ? (q - d->encoder) / period : w;
    }
    d->encoder = q;
    double tau = sample(d, tick > 0 ? a->steps_per_tick : 0);
    if (a->faults && d->control >= 0)
        dp_faults_sample(a->faults, j, tick, period, &tau, &q, &w);
    if (a->record) {
        record(a, at, j, DP_REC_POSITION, q);
        record(a, at, j, DP_REC_VELOCITY, w);
        record(a, at, j, DP_REC_LINK_POSITION, a->qpos[d->rotor_qpos] + a->qpos[d->spring_qpos]);
        record(a, at, j, DP_REC_LINK_VELOCITY, a->qvel[d->rotor_dof] + a->qvel[d->spring_dof]);
        record(a, at, j, DP_REC_TORQUE, d->tau);
        record(a, at, j, DP_REC_SAMPLE, tau);
    }
    *torque = tau;
    *position = q;
    *velocity = w;
}

static int apply_events(dp_controller *c, const dp_run_args *a, int tick, int next)
{
    for (; next < a->events && a->event[next].tick <= tick; next++) {
        const dp_event *e = &a->event[next];
        if (e->kind == DP_EVENT_MODE)
            dp_set_mode(c, e->joint, e->value);
        else if (e->kind == DP_EVENT_POSITION_LOOP)
            dp_set_position_loop(c, e->joint, e->value);
        else
            for (int j = 0; j < a->drives; j++)
                if (a->drive[j].control == e->joint)
                    dp_warm_start(c, e->joint, a->qvel[a->drive[j].rotor_dof]);
    }
    return next;
}

/* Where the encoders say that the rotors are; where one is lost, it goes on as it was. */
static void know(dp_run_args *a, double *known)
{
    for (int j = 0; j < a->drives; j++) {
        dp_drive *d = &a->drive[j];
        if (!(a->faults && d->control >= 0))
            d->known = d->encoder;
        else
            dp_faults_angle(a->faults, j, &d->known);
        known[j] = d->known;
    }
}

/* The robot carries its own weight; its controller is told so in the packet of the torque sample. */
static void carry(dp_run_args *a, int tick, int n, const double *gravity, double *in)
{
    for (int j = 0; j < a->drives; j++) {
        const int i = a->drive[j].control;
        const double told = a->faults && i >= 0 ? dp_faults_gravity(a->faults, j, tick, gravity[j]) : gravity[j];
        a->drive[j].gravity = gravity[j];
        if (a->record)
            a->record[((long)DP_REC_SAMPLE * a->ticks + tick - a->origin) * a->drives + j] -= told;
        if (i >= 0 && a->supervisor_gravity) /* it checks the sensor as it is, and takes the rest off itself */
            a->supervisor_gravity[i] = told;
        else if (i >= 0)
            in[DP_IN_TORQUE * n + i] -= told;
    }
}

void dp_tick_sense(dp_controller *c, dp_run_args *a, int tick, dp_tick *t)
{
    const int n = c ? c->n : 0;
    dp_faults *f = a->faults;
    a->tick = tick;
    t->powered = 1;
    if (c)
        t->next = apply_events(c, a, tick, t->next);
    if (f) {
        dp_faults_tick(f, a, tick);
        t->powered = f->powered;
    }
    for (int j = 0; j < a->drives; j++) {
        double tau, q, w;
        sense(a, tick, tick, j, &tau, &q, &w);
        const int i = a->drive[j].control;
        if (i < 0)
            continue;
        t->torque_age[i] = f ? f->torque_age[j] : 0;
        t->encoder_age[i] = f ? f->encoder_age[j] : 0;
        t->in[DP_IN_TORQUE * n + i] = tau;
        t->in[DP_IN_POSITION * n + i] = q;
        t->in[DP_IN_VELOCITY * n + i] = w;
        for (int k = 0; k < 4; k++)
            t->in[(DP_IN_POSITION_REF + k) * n + i] = a->reference ? *row(a->reference, a, k, tick, j) : 0.0;
    }
    know(a, t->known);
}

void dp_tick_control(dp_controller *c, dp_run_args *a, int tick, const double *gravity, dp_tick *t)
{
    dp_faults *f = a->faults;
    if (gravity)
        carry(a, tick, c ? c->n : 0, gravity, t->in);
    if (c && t->powered) {
        int status = a->supervise ? a->supervise(a->supervisor, c, t->in, t->torque_age, t->encoder_age, t->out)
                                  : dp_step(c, t->in, t->out);
        if (a->status)
            a->status[tick - a->origin] = status;
        if (f && a->apply_brake)
            f->apply_brake = *a->apply_brake;
        if (f && a->state && *a->state != 0 && f->stopped_at < 0)
            f->stopped_at = tick;
    }
    for (int j = 0; j < a->drives; j++) {
        dp_drive *d = &a->drive[j];
        if (d->control >= 0)
            d->motor = c->state[d->control].in_effect;
        if (a->record) {
            double asked = f ? clamp(d->motor, d->torque_limit) : d->motor;
            double issued = t->powered ? t->out[d->control >= 0 ? d->control : 0] : 0.0;
            record(a, tick, j, DP_REC_COMMAND, d->control >= 0 ? issued : d->asked);
            record(a, tick, j, DP_REC_IN_EFFECT, d->control >= 0 ? asked : d->asked);
        }
    }
}

void dp_begin(const dp_controller *c, dp_run_args *a)
{
    for (int j = 0; j < a->drives; j++) {
        dp_drive *d = &a->drive[j];
        double tau = -(d->stiffness * a->qpos[d->spring_qpos] + d->damping * a->qvel[d->spring_dof]);
        d->filter_x[0] = d->measured_tau = d->inner_torque = d->tau = tau;
        d->filter_x[1] = d->friction_z = d->hysteresis_z = d->sum = d->integral = d->encoder = 0.0;
        d->spare = NAN;
        d->friction = d->inner_correction = d->gravity = 0.0;
        d->known = a->qpos[d->rotor_qpos];
        d->motor = d->asked = c && d->control >= 0 ? c->state[d->control].in_effect : 0.0;
        for (int i = 0; i < DP_MAX_DELAY; i++)
            d->delay[i] = tau;
    }
    if (a->faults)
        dp_faults_begin(a->faults, a->drive);
}

/* The physics steps of one tick, with the motor torques as they are set. */
static int advance(const dp_run_args *a, int tick)
{
    long step = (long)tick * a->steps_per_tick;
    for (int k = 0; k < a->steps_per_tick; k++, step++) {
        for (int j = 0; j < a->drives; j++) {
            double reference[2] = {0.0, 0.0};
            if (a->drive[j].control < 0 && a->reference) {
                const int held = a->faults && a->faults->stopped_at >= 0;
                /* Where the tables do not reach back to it, their first row repeats it. */
                const int when = held && a->faults->stopped_at < a->origin ? a->origin
                                 : held                                    ? a->faults->stopped_at
                                                                           : tick;
                reference[0] = *row(a->reference, a, 0, when, j);
                reference[1] = held ? 0.0 : *row(a->reference, a, 1, tick, j);
            }
            actuate(&a->drive[j], a, a->reference ? reference : 0, k * a->dt,
                    a->external ? *row(a->external, a, 0, tick, j) : 0.0, step);
        }
        if (a->faults && a->faults->acting)
            dp_faults_forces(a->faults, a);
        a->step(a->model, a->data);
        double fastest = 0.0;
        for (int j = 0; j < a->drives; j++) {
            dp_drive *d = &a->drive[j];
            observe(d, a->qpos, a->qvel, a->dt, step);
            double w = fabs(a->qvel[d->rotor_dof]) + fabs(a->qvel[d->spring_dof]);
            fastest = w > fastest || w != w ? w : fastest;
        }
        if (!(fastest < MAX_SPEED))
            return DP_RUN_DIVERGED;
    }
    return DP_RUN_OK;
}

int dp_run(dp_controller *c, dp_run_args *a)
{
    dp_tick t = {0};
    double gravity[DP_MAX_JOINTS] = {0};
    if (a->first == 0)
        dp_begin(c, a);
    while (t.next < a->events && a->event[t.next].tick < a->first)
        t.next++;
    a->diverged_tick = -1;
    for (int tick = a->first; tick < a->last; tick++) {
        dp_tick_sense(c, a, tick, &t);
        if (a->gravity)
            a->gravity(a->gravity_of, t.known, gravity);
        dp_tick_control(c, a, tick, a->gravity ? gravity : 0, &t);
        if (a->end && *a->end)
            return DP_RUN_OK;
        if (advance(a, tick) != DP_RUN_OK) {
            a->diverged_tick = tick;
            return DP_RUN_DIVERGED;
        }
    }
    return DP_RUN_OK;
}

void dp_sense(dp_run_args *a, int tick, double *torque, double *position, double *velocity)
{
    if (tick == 0)
        dp_begin(0, a);
    if (a->faults)
        dp_faults_tick(a->faults, a, tick);
    for (int j = 0; j < a->drives; j++)
        sense(a, tick, 0, j, &torque[j], &position[j], &velocity[j]);
}

int dp_push(dp_run_args *a, int tick, const double *torque)
{
    const int powered = !a->faults || a->faults->powered;
    for (int j = 0; j < a->drives; j++) {
        dp_drive *d = &a->drive[j];
        d->motor = powered && torque[j] - torque[j] == 0.0 ? torque[j] : 0.0;
        if (a->record) {
            record(a, 0, j, DP_REC_COMMAND, torque[j]);
            record(a, 0, j, DP_REC_IN_EFFECT, clamp(d->motor, d->torque_limit));
        }
    }
    return advance(a, tick);
}
