#include "dashpot_stops.h"

#include <math.h>
#include <string.h>

static double clamp(double x, double limit)
{
    return x > limit ? limit : (x < -limit ? -limit : x);
}

static double dot(const double *a, const double *x, int n)
{
    double sum = 0.0;
    for (int i = 0; i < n; i++)
        sum += a[i] * x[i];
    return sum;
}

static void advance(const double *transition, double *x, int n)
{
    double next[DP_STOP_STATES];
    for (int i = 0; i < n; i++)
        next[i] = dot(transition + i * n, x, n);
    memcpy(x, next, (size_t)n * sizeof(double));
}

/* Over one period: friction slips at its full torque, or its spring is stretched no further than that. */
static void period(const dp_stop_args *a, double *x)
{
    for (int i = 0; i < a->substeps; i++) {
        double torque = x[a->spring] + a->damper * x[a->rotor];
        int sticks = fabs(torque) < a->coulomb;
        x[a->slips] = copysign(a->coulomb, torque);
        advance(sticks ? a->stick : a->slip, x, a->states);
        x[a->spring] = clamp(x[a->spring], a->coulomb);
    }
}

static int out_of_range(const dp_stop_args *a)
{
    const int entries[] = {a->rotor, a->held, a->link, a->spring, a->slips};
    if (a->states < 1 || a->states > DP_STOP_STATES || a->mean >= a->states || a->late < 0 ||
        a->late > DP_STOP_LATE || a->substeps < 1 || a->ticks < 1 || a->window < 1)
        return 1;
    for (int i = 0; i < 5; i++)
        if (entries[i] < 0 || entries[i] >= a->states)
            return 1;
    return 0;
}

static void stop(dp_controller *c, const dp_stop_args *a, double *speed, double *command)
{
    double x[DP_STOP_STATES], sensed[DP_STOP_LATE + 1], in[DP_NIN] = {0.0};
    memcpy(x, a->start, (size_t)a->states * sizeof(double));
    for (int i = 0; i < a->late; i++)
        sensed[i] = a->torque_gain * dot(a->sample, a->start, a->states);
    int slot = 0;
    for (int tick = 0; tick < a->ticks; tick++) {
        sensed[(slot + a->late) % (a->late + 1)] = a->torque_gain * dot(a->sample, x, a->states);
        in[DP_IN_TORQUE] = sensed[slot];
        slot = (slot + 1) % (a->late + 1);
        dp_step(c, in, &command[tick]);
        x[a->held] = c->state[0].in_effect;
        speed[tick] = x[a->link];
        if (a->mean >= 0)
            x[a->mean] = 0.0;
        period(a, x);
        if (tick % a->window != a->window - 1)
            continue;
        double low = speed[tick], high = low, sum = 0.0;
        for (int i = tick + 1 - a->window; i <= tick; i++) {
            low = fmin(low, speed[i]);
            high = fmax(high, speed[i]);
            sum += speed[i];
        }
        if (high - low < a->still) {
            for (int i = tick + 1; i < a->ticks; i++) {
                speed[i] = sum / a->window;
                command[i] = command[tick];
            }
            return;
        }
    }
}

int dp_stops(const dp_block *blocks, int count, const dp_stop_args *a, double *speed, double *command)
{
    if (out_of_range(a))
        return -1;
    for (int k = 0; k < count; k++) {
        dp_controller c;
        double warm[DP_NX];
        if (dp_init(&c, &blocks[k], 1) != 0)
            return -1;
        for (int i = 0; i < DP_NX; i++)
            warm[i] = blocks[k].warm[i] * a->speed;
        dp_preset(&c, 0, warm, clamp(a->start[a->held], blocks[k].torque_limit));
        dp_set_position_loop(&c, 0, 0);
        stop(&c, a, speed + (size_t)k * a->ticks, command + (size_t)k * a->ticks);
    }
    return 0;
}
