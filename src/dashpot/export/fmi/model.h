/* The controller as both FMI versions see it: variables in groups of one value per joint, and ticks at
 * start + k * period. The model is plain data without pointers: its copy is the FMU's state. */
#ifndef DASHPOT_MODEL_H
#define DASHPOT_MODEL_H

#include <stdlib.h>
#include <string.h>

#include "config.h"

/* The inputs come first, in the order in which the controller wants them. */
enum {
    TORQUE, POSITION, VELOCITY, POSITION_REF, VELOCITY_REF, ACCELERATION_REF, TORQUE_REF, /* real inputs */
    MODE, POSITION_LOOP, WARM_START,  /* inputs without a supervisor */
    TORQUE_AGE, ENCODER_AGE, STOP,    /* inputs with one */
    COMMAND, STATUS,                  /* outputs */
    STATE, APPLY_BRAKE,               /* outputs with a supervisor */
    GROUPS
};

typedef enum { REAL, INTEGER, BOOLEAN } kind;

typedef struct {
    F(controller) controller;
#ifdef SUPERVISED
    F(supervisor) supervisor;
#endif
    double value[GROUPS][N]; /* integers and truth values too */
    double warm_before[N];
    double start, time; /* [s] */
    long long tick;     /* the next one */
} model;

static kind group_kind(int group)
{
    if (group <= TORQUE_REF || group == COMMAND)
        return REAL;
    return group == POSITION_LOOP || group == WARM_START || group == STOP || group == APPLY_BRAKE ? BOOLEAN : INTEGER;
}

static int group_size(int group)
{
    if (group < 0 || group >= GROUPS)
        return 0;
#ifdef SUPERVISED
    if (group >= MODE && group <= WARM_START)
        return 0;
#else
    if ((group >= TORQUE_AGE && group <= STOP) || group >= STATE)
        return 0;
#endif
    return group == STOP || group == STATE || group == APPLY_BRAKE ? 1 : N;
}

/* Where a variable lies, or nothing: it does not exist, is of another kind, or cannot be set. */
static double *variable(model *m, long group, int element, kind wanted, int set)
{
    if (group < 0 || group >= GROUPS || element < 0 || element >= group_size((int)group) ||
        group_kind((int)group) != wanted || (set && group >= COMMAND))
        return NULL;
    return &m->value[group][element];
}

/* Whether a number may be set; every real may, the controller copes with those that are none. */
static int allowed(long group, double value)
{
    return group == MODE ? value >= 0.0 && value <= 2.0 : group == TORQUE_AGE || group == ENCODER_AGE ? value >= 0.0 : 1;
}

static void model_reset(model *m)
{
    memset(m, 0, sizeof *m);
    F(init)(&m->controller);
#ifdef SUPERVISED
    F(supervisor_init)(&m->supervisor);
#endif
    for (int j = 0; j < N; j++) {
        m->value[MODE][j] = 2.0;
        m->value[POSITION_LOOP][j] = 1.0;
    }
}

static void model_tick(model *m)
{
    const double *in = &m->value[0][0];
    double *out = m->value[COMMAND];
#ifdef SUPERVISED
    int torque_age[N], encoder_age[N];
    for (int j = 0; j < N; j++) {
        torque_age[j] = (int)m->value[TORQUE_AGE][j];
        encoder_age[j] = (int)m->value[ENCODER_AGE][j];
    }
    if (m->value[STOP][0] != 0.0)
        F(supervisor_stop)(&m->supervisor, WHY_OPERATOR);
    F(supervise)(&m->supervisor, &m->controller, in, torque_age, encoder_age, out);
    m->value[STATE][0] = m->supervisor.state;
    m->value[APPLY_BRAKE][0] = m->supervisor.apply_brake;
#else
    for (int j = 0; j < N; j++) {
        const double warm = m->value[WARM_START][j];
        F(set_mode)(&m->controller, j, (int)m->value[MODE][j]);
        F(set_position_loop)(&m->controller, j, m->value[POSITION_LOOP][j] != 0.0);
        if (warm != 0.0 && m->warm_before[j] == 0.0)
            F(warm_start)(&m->controller, j, m->value[VELOCITY][j]);
        m->warm_before[j] = warm;
    }
    F(step)(&m->controller, in, out);
#endif
    for (int j = 0; j < N; j++)
        m->value[STATUS][j] = m->controller.state[j].status;
}

static void model_start(model *m, double start)
{
    m->start = m->time = start;
    m->tick = 0;
}

/* Runs the ticks within [time, time + step), whatever the step. Returns 0, or -1 where it is no step from here. */
static int model_advance(model *m, double from, double step)
{
    const double to = from + step, slack = 1e-6 * PERIOD;
    if (!(step > 0.0) || !(from - m->time <= slack && m->time - from <= slack) || to - to != 0.0)
        return -1;
    for (; m->start + (double)m->tick * PERIOD < to - slack; m->tick++)
        model_tick(m);
    m->time = to;
    return 0;
}

#endif
