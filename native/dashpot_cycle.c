#include "dashpot_cycle.h"

#include <string.h>

static const int MOST_AGE = 1 << 20; /* [ticks]; older is no older */

static int finite(double x) { return x - x == 0.0; }

static dp_row *rows_of(dp_ring *r) { return (dp_row *)(r + 1); }

unsigned long long dp_ring_size(unsigned long long rows) { return sizeof(dp_ring) + rows * sizeof(dp_row); }

int dp_cycle_init(dp_cycle *c)
{
    const int n = c->supervisor->n;
    if (n != c->controller->n || c->rows < 1 || !(c->period > 0.0) || !finite(c->period) || c->late_cycles < 1 ||
        c->longest_gap < 1)
        return -1;
    for (int j = 0; j < n; j++)
        if (c->order[j] < 0 || c->order[j] >= n)
            return -1;
    *c->statistics = (dp_cycle_statistics){0};
    c->row = 0;
    c->begun = c->same = c->late = c->phase = c->safe_ticks = 0;
    for (int j = 0; j < n; j++)
        c->velocity[j] = c->torque[j] = c->motor[j] = c->port[j] = 0.0;
    return 0;
}

/* Ticks lost before a sample; counts how long there has been no new one. A clock that stands, runs backwards or is
 * not a number gives no new sample. */
static int advance(dp_cycle *c, double time)
{
    const double ticks = (time - c->last) / c->period;
    if (!c->begun && finite(time)) {
        c->begun = 1;
        c->start = c->last = time;
        c->same = 0;
        return 0;
    }
    if (!c->begun || !(ticks > 0.5)) {
        c->same += c->same < MOST_AGE;
        return 0;
    }
    const double since = (time - c->start) / c->period + 0.5;
    c->row = since < 1e15 ? (long long)since : (long long)1e15;
    c->last = time;
    c->same = 0;
    return ticks < MOST_AGE ? (int)(ticks - 0.5) : MOST_AGE;
}

/* Late cycles count two, good ones take one back, and so do ticks that come twice: where two clocks beat, a tick that
 * is lost follows on one that came twice. */
static void judge(dp_cycle *c, int lost)
{
    dp_cycle_statistics *t = c->statistics;
    t->late += lost > 0;
    t->lost += lost;
    t->same += c->same > 0;
    t->longest = lost > t->longest ? lost : t->longest;
    c->late += lost > 0 ? 2 : c->same > 0 ? -2 : -1;
    c->late = c->late > 0 ? c->late : 0;
    if (c->late >= 2 * c->late_cycles || lost >= c->longest_gap)
        dp_supervisor_stop(c->supervisor, DP_WHY_HOST);
}

static void count(dp_cycle_statistics *t, double jitter)
{
    const double size = jitter < 0.0 ? -jitter : jitter;
    if (t->cycles++ == 0) /* nothing was before it */
        return;
    t->jitter_most = size > t->jitter_most ? size : t->jitter_most;
    t->jitter[size < 1e-6 * (DP_BINS - 1) ? (int)(size * 1e6) : DP_BINS - 1]++;
}

static void publish(dp_cycle *c, const dp_cycle_sample *s, long long clock, double jitter, int status, int lost,
                    const double *u, const double *reference)
{
    dp_ring *r = c->ring;
    dp_row *row = &rows_of(r)[r->head % r->capacity];
    row->tick = c->statistics->cycles - 1;
    row->clock = clock;
    row->time = s->time;
    row->jitter = jitter;
    row->state = c->supervisor->state;
    row->phase = c->phase;
    row->status = status;
    row->lost = lost;
    for (int j = 0; j < c->supervisor->n; j++) {
        const int i = c->order[j];
        const dp_state *x = &c->controller->state[j];
        row->column[DP_ROW_TORQUE][j] = s->torque[i];
        row->column[DP_ROW_POSITION][j] = s->position[i];
        row->column[DP_ROW_VELOCITY][j] = s->velocity[i];
        row->column[DP_ROW_IN_EFFECT][j] = finite(s->in_effect[i]) ? s->in_effect[i] : u[j];
        row->column[DP_ROW_COMMAND][j] = x->command;
        row->column[DP_ROW_REFERENCE][j] = reference[j];
        row->column[DP_ROW_MOTOR][j] = c->motor[j];
        row->column[DP_ROW_PORT][j] = c->port[j];
        row->mode[j] = x->mode;
        row->joint_status[j] = x->status;
        for (int k = 0; k < DP_NX; k++)
            row->column[DP_ROW_STATE + k][j] = x->x[k];
    }
    const dp_supervisor *v = c->supervisor;
    if (r->decisions != v->decisions) {
        memcpy(r->log, v->log, sizeof r->log);
        __atomic_store_n(&r->decisions, v->decisions, __ATOMIC_RELEASE);
    }
    __atomic_store_n(&r->head, r->head + 1, __ATOMIC_RELEASE);
}

/* Work over the last period, by the trapezoid rule; samples that are not numbers are left out. */
static void work(dp_cycle *c, int j, double torque, double velocity, double motor, int lost)
{
    const double time = c->period * (1 + lost);
    if (!finite(velocity) || !finite(torque))
        return;
    c->motor[j] += motor * 0.5 * (velocity + c->velocity[j]) * time;
    c->port[j] += 0.5 * (torque * velocity + c->torque[j] * c->velocity[j]) * time;
    c->velocity[j] = velocity;
    c->torque[j] = torque;
}

/* The run is over once SAFE has let go of every torque, on its way to the motors too, and the brakes had their time. */
static int phase_of(dp_cycle *c)
{
    const dp_supervisor *s = c->supervisor;
    if (s->state == DP_TRACK)
        return DP_PHASE_RUN;
    if (s->state != DP_SAFE)
        return DP_PHASE_BRAKE;
    c->safe_ticks++;
    for (int j = 0; j < s->n; j++)
        if (c->controller->state[j].command != 0.0 || c->controller->state[j].in_effect != 0.0)
            return DP_PHASE_SAFE;
    return c->safe_ticks * s->rules.release > 1.0 ? DP_PHASE_OVER : DP_PHASE_SAFE;
}

int dp_cycle_step(dp_cycle *c, const dp_cycle_sample *s, long long clock, double jitter, double *out)
{
    const int n = c->supervisor->n, lost = advance(c, s->time);
    double in[DP_NIN * DP_MAX_JOINTS], u[DP_MAX_JOINTS], held[DP_MAX_JOINTS];
    int torque_age[DP_MAX_JOINTS], encoder_age[DP_MAX_JOINTS];
    count(c->statistics, jitter);
    judge(c, lost);
    if (c->until >= 0 && c->row >= c->until)
        dp_supervisor_stop(c->supervisor, DP_WHY_DONE);
    if (c->phase != DP_PHASE_RUN)
        dp_supervisor_park(c->supervisor);

    const long long row = c->row < c->rows ? c->row : c->rows - 1;
    const int more = lost + c->same;
    for (int j = 0; j < n; j++) {
        const int i = c->order[j], ta = s->torque_age[i], ea = s->encoder_age[i];
        in[DP_IN_TORQUE * n + j] = s->torque[i];
        in[DP_IN_POSITION * n + j] = s->position[i];
        in[DP_IN_VELOCITY * n + j] = s->velocity[i];
        for (int k = 0; k < 4; k++) /* beyond its end a motion stands */
            in[(DP_IN_POSITION_REF + k) * n + j] =
                c->row >= c->rows && (k == 1 || k == 2) ? 0.0 : c->reference[(k * c->rows + row) * n + j];
        torque_age[j] = ta < 0 || ta > MOST_AGE ? MOST_AGE : ta + more;
        encoder_age[j] = ea < 0 || ea > MOST_AGE ? MOST_AGE : ea + more;
        held[j] = c->controller->state[j].in_effect;
        work(c, j, s->torque[i], s->velocity[i], held[j], lost);
    }
    const int status = dp_supervise(c->supervisor, c->controller, in, torque_age, encoder_age, u);
    for (int j = 0; j < n; j++)
        out[c->order[j]] = u[j];
    c->phase = phase_of(c);
    if (c->ring)
        publish(c, s, clock, jitter, status, lost, held, &in[DP_IN_POSITION_REF * n]);
    return c->phase;
}

int dp_ring_drain(dp_ring *r, dp_row *out, int most, unsigned long long *next, unsigned long long *missed)
{
    const dp_row *rows = (const dp_row *)(r + 1);
    const unsigned long long head = __atomic_load_n(&r->head, __ATOMIC_ACQUIRE);
    if (head - *next > r->capacity) {
        *missed += head - r->capacity - *next;
        *next = head - r->capacity;
    }
    int count = 0;
    while (count < most && *next + count < head) {
        out[count] = rows[(*next + count) % r->capacity];
        count++;
    }
    /* What the producer may have been writing while it was read is thrown away. */
    const unsigned long long after = __atomic_load_n(&r->head, __ATOMIC_ACQUIRE);
    const unsigned long long oldest = after + 1 > r->capacity ? after + 1 - r->capacity : 0;
    if (oldest > *next) {
        const unsigned long long spoilt = oldest - *next < (unsigned long long)count ? oldest - *next : (unsigned long long)count;
        memmove(out, out + spoilt, (size_t)(count - (int)spoilt) * sizeof *out);
        *missed += spoilt;
        *next += spoilt;
        count -= (int)spoilt;
    }
    *next += (unsigned long long)count;
    __atomic_store_n(&r->read, *next, __ATOMIC_RELEASE);
    return count;
}
