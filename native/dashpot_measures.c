#include "dashpot_measures.h"

#include <math.h>

static double size(double x) { return x < 0.0 ? -x : x; }

/* Not a number stays. */
static void raise(double *most, double x)
{
    if (!(x <= *most) && *most == *most)
        *most = x;
}

/* Errors of joint j from `first` to `last`, which is more. */
static void errors(const dp_measured *m, int j, int first, int last, double *out)
{
    const int n = m->joints, count = last - first;
    double sum = 0.0, squares = 0.0, most = 0.0, spread = 0.0;
    for (int k = first; k < last; k++) {
        const double e = m->reference[(long)k * n + j] - m->angle[(long)k * n + j];
        sum += e;
        squares += e * e;
        raise(&most, size(e));
    }
    const double mean = sum / count;
    for (int k = first; k < last; k++) {
        const double e = m->reference[(long)k * n + j] - m->angle[(long)k * n + j] - mean;
        spread += e * e;
    }
    out[DP_MEASURE_ERROR_RMS * n + j] = sqrt(squares / count);
    out[DP_MEASURE_ERROR_MAX * n + j] = most;
    out[DP_MEASURE_ERROR_MEAN * n + j] = mean;
    out[DP_MEASURE_ERROR_STD * n + j] = sqrt(spread / count);
}

/* How joint j stops: it has at the first tick on after which it stays slow for so many, the last ones too. */
static void stops(const dp_measured *m, int j, double *out)
{
    const int n = m->joints, count = m->ticks - m->event, stays = m->stays < count ? m->stays : count;
    const double *q = &m->angle[(long)m->event * n + j], *w = &m->speed[(long)m->event * n + j];
    const double share = m->slowed * size(w[0]), slow = share > m->at_rest ? share : m->at_rest;
    double error = 0.0, way = 0.0, stopped = INFINITY, angle = 0.0, at[2] = {0.0, 0.0};
    int run = 0;
    for (int k = 0; k < count; k++) {
        const long at_k = (long)k * n;
        raise(&error, size(m->reference[(long)(m->event + k) * n + j] - q[at_k]));
        raise(&way, size(q[at_k] - q[0]));
        if (!(size(w[at_k]) < slow)) {
            run = 0;
            continue;
        }
        if (run++ == 0)
            at[1] = way;
        if (run == stays && stopped == INFINITY) {
            stopped = (k + 1 - stays) * m->period;
            at[0] = at[1];
        }
    }
    angle = stopped == INFINITY ? way : at[0];
    const int last = m->last < count - 1 ? m->last : count - 1;
    const double *end = &q[(long)(count - 1) * n];
    out[DP_MEASURE_ERROR_AFTER * n + j] = error;
    out[DP_MEASURE_STOP_TIME * n + j] = stopped;
    out[DP_MEASURE_STOP_ANGLE * n + j] = angle;
    out[DP_MEASURE_TRAVEL * n + j] = way;
    out[DP_MEASURE_DRIFT_SPEED * n + j] = last > 0 ? size(end[0] - end[-(long)last * n]) / (last * m->period)
                                                   : size(w[(long)(count - 1) * n]);
}

/* Largest speed, torque, and change of the command over the whole run. */
static void peaks(const dp_measured *m, int j, double *out)
{
    const int n = m->joints;
    double speed = 0.0, torque = 0.0, step = 0.0, before = NAN;
    for (int k = 0; k < m->ticks; k++) {
        const long at = (long)k * n + j;
        raise(&speed, size(m->speed[at]));
        raise(&torque, size(m->in_effect[at]));
        if (m->powered && !m->powered[k])
            continue;
        if (before == before)
            raise(&step, size(m->command[at] - before));
        before = m->command[at];
    }
    out[DP_MEASURE_SPEED_PEAK * n + j] = speed;
    out[DP_MEASURE_TORQUE_PEAK * n + j] = torque;
    out[DP_MEASURE_TORQUE_STEP * n + j] = step;
}

/* Sum of squares of what a high-pass leaves of a signal, over its last ticks and over as many before them. It starts
 * at rest at the first value, which it takes away. */
static void loudness(const double *signal, int n, int count, const dp_highpass *filter, int window, double *sums)
{
    const double (*s)[5] = filter->section, first = signal[0];
    double a0 = 0.0, a1 = 0.0, b0 = 0.0, b1 = 0.0;
    sums[0] = sums[1] = 0.0;
    for (int k = 0; k < count; k++) {
        const double x = signal[(long)k * n] - first;
        const double y = s[0][0] * x + a0;
        a0 = s[0][1] * x - s[0][3] * y + a1;
        a1 = s[0][2] * x - s[0][4] * y;
        const double z = s[1][0] * y + b0;
        b0 = s[1][1] * y - s[1][3] * z + b1;
        b1 = s[1][2] * y - s[1][4] * z;
        if (k >= count - window)
            sums[0] += z * z;
        else if (k >= count - 2 * window)
            sums[1] += z * z;
    }
}

/* Whether a signal can be filtered: numbers, from `begin` on, in all joints. */
static int numbers(const dp_measured *m, const double *signal)
{
    double check = 0.0;
    for (long i = (long)m->begin * m->joints; i < (long)m->ticks * m->joints; i++)
        check += signal[i] - signal[i];
    return check == 0.0;
}

void dp_measure(const dp_measured *m, double *out)
{
    const int n = m->joints, count = m->ticks - m->begin, until = m->event;
    const long from = (long)m->begin * n;
    const int noisy = m->noise && count > 0 && numbers(m, m->command);
    const int swings = m->vibration && m->window > 0 && numbers(m, m->sample);
    double sums[2];
    for (int i = 0; i < DP_NMEASURE * n; i++)
        out[i] = NAN;
    for (int j = 0; j < n; j++) {
        if (until > m->begin)
            errors(m, j, m->begin, until, out);
        if (m->event < m->ticks)
            stops(m, j, out);
        peaks(m, j, out);
        if (noisy) {
            loudness(&m->command[from + j], n, count, m->noise, count, sums);
            out[DP_MEASURE_TORQUE_NOISE * n + j] = sqrt(sums[0] / count);
        }
        if (swings) {
            loudness(&m->sample[from + j], n, count, m->vibration, m->window, sums);
            out[DP_MEASURE_VIBRATION * n + j] = sqrt(sums[0] / m->window);
            out[DP_MEASURE_EARLIER * n + j] = sqrt(sums[1] / m->window);
        }
    }
}
