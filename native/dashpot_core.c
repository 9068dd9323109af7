#include "dashpot_core.h"

/* True for finite x; unlike isfinite it needs no header and no library. */
static int finite(double x) { return x - x == 0.0; }

static double clamp(double x, double limit)
{
    return x > limit ? limit : (x < -limit ? -limit : x);
}

int dp_init(dp_controller *c, const dp_block *blocks, int n)
{
    if (n < 1 || n > DP_MAX_JOINTS)
        return -1;
    for (int j = 0; j < n; j++) {
        if (blocks[j].nx < 0 || blocks[j].nx > DP_NX)
            return -1;
        if (blocks[j].latency < 0 || blocks[j].latency > DP_MAX_LATENCY)
            return -1;
        /* written so that NaN fails: a limit that is not a number would be no limit */
        if (!(blocks[j].torque_limit >= 0.0) || !(blocks[j].rate_limit >= 0.0))
            return -1;
        if (!(blocks[j].blend >= 0.0 && blocks[j].blend < 1.0))
            return -1;
    }
    c->n = n;
    for (int j = 0; j < n; j++) {
        dp_block *b = &c->block[j];
        *b = blocks[j];
        for (int i = b->nx; i < DP_NX; i++) { /* dot_x reads all of x */
            b->C[i] = 0.0;
            for (int k = 0; k < DP_NX; k++)
                b->A[k][i] = 0.0;
        }
        c->state[j].mode = DP_MODE_ACTIVE;
        c->state[j].position_loop = 1;
    }
    dp_reset(c);
    return 0;
}

void dp_reset(dp_controller *c)
{
    for (int j = 0; j < c->n; j++) {
        dp_state *s = &c->state[j];
        int mode = s->mode, loop = s->position_loop;
        *s = (dp_state){0};
        s->mode = mode;
        s->position_loop = loop;
    }
}

/* Products of fixed length, summed as trees: no loop, half the latency of a running sum. Entries beyond
 * nx are zero (dp_init sees to it). */
static double dot_x(const double *a, const double *x)
{
    return (a[0] * x[0] + a[1] * x[1]) + (a[2] * x[2] + a[3] * x[3]);
}

static double dot_w(const double *a, const double *w)
{
    return ((a[0] * w[0] + a[1] * w[1]) + (a[2] * w[2] + a[3] * w[3])) +
           ((a[4] * w[4] + a[5] * w[5]) + (a[6] * w[6] + a[7] * w[7]));
}

/* Issues the torque u (known finite): fades out a change of mode, then applies the limits. */
static double issue(const dp_block *b, dp_state *s, double u)
{
    int status = DP_OK;
    if (s->changed && b->blend > 0.0)
        s->offset = s->command - u; /* the first tick continues the old torque exactly */
    else
        s->offset *= b->blend;
    s->changed = 0;
    if (s->offset != 0.0) {
        if (s->offset < 1e-9 && s->offset > -1e-9)
            s->offset = 0.0;
        else
            status |= DP_BLENDING;
        u += s->offset;
    }
    double limited = clamp(u, b->torque_limit);
    if (limited != u)
        status |= DP_TORQUE_LIMITED;
    double step = limited - s->command;
    double held = clamp(step, b->rate_limit);
    if (held != step) {
        status |= DP_RATE_LIMITED;
        limited = s->command + held;
    }
    s->status = status;
    return limited;
}

static int used(const dp_block *b, int mode, int input)
{
    if (mode != DP_MODE_ACTIVE)
        return mode == DP_MODE_BYPASS && b->bypass[input] != 0.0;
    int any = b->D[input] != 0.0;
    for (int i = 0; i < b->nx; i++)
        any |= b->B[i][input] != 0.0;
    return any;
}

static double output(const dp_block *b, const dp_state *s, const double *w)
{
    if (s->mode == DP_MODE_ACTIVE)
        return dot_x(b->C, s->x) + dot_w(b->D, w);
    return s->mode == DP_MODE_BYPASS ? dot_w(b->bypass, w) : 0.0;
}

static double joint_step(const dp_block *b, dp_state *s, double *w)
{
    double u = output(b, s, w);
    if (!finite(u)) { /* rare: a broken input that this block does not use is no reason to stop */
        for (int i = 0; i < DP_NW; i++)
            if (!finite(w[i]) && !used(b, s->mode, i))
                w[i] = 0.0;
        u = output(b, s, w);
    }
    if (!finite(u)) {
        s->status = DP_NOT_FINITE;
        return s->command;
    }

    const int nx = s->mode == DP_MODE_ACTIVE ? b->nx : 0;
    const double offset = s->offset;
    const int changed = s->changed;
    double issued = issue(b, s, u); /* may overflow where there is no torque limit */
    double next[DP_NX], check = issued - issued;
    for (int i = 0; i < nx; i++) {
        next[i] = dot_x(b->A[i], s->x) + dot_w(b->B[i], w) + b->E[i] * (issued - u);
        check += next[i] - next[i];
    }
    if (check != 0.0) { /* also true for NaN */
        s->offset = offset;
        s->changed = changed;
        s->status = DP_NOT_FINITE;
        return s->command;
    }
    for (int i = 0; i < nx; i++)
        s->x[i] = next[i];
    return issued;
}

/* Passes the issued torque to the motor, through the delay line. */
static void send(const dp_block *b, dp_state *s, double u)
{
    s->command = u;
    if (b->latency == 0) {
        s->in_effect = u;
    } else {
        s->in_effect = s->line[s->head];
        s->line[s->head] = u;
        s->head = s->head + 1 == b->latency ? 0 : s->head + 1;
    }
}

int dp_step(dp_controller *c, const double *in, double *out)
{
    const int n = c->n;
    int status = DP_OK;
    for (int j = 0; j < n; j++) {
        const dp_block *b = &c->block[j];
        dp_state *s = &c->state[j];
        double w[DP_NW] = {in[DP_IN_TORQUE * n + j], s->in_effect};
        if (s->position_loop)
            for (int i = DP_IN_POSITION; i < DP_NIN; i++)
                w[i + 1] = in[i * n + j];
        double u = joint_step(b, s, w);
        send(b, s, u);
        out[j] = u;
        status |= s->status;
    }
    return status;
}

int dp_issue(dp_controller *c, const double *torque, double *out)
{
    int status = DP_OK;
    for (int j = 0; j < c->n; j++) {
        const dp_block *b = &c->block[j];
        dp_state *s = &c->state[j];
        double u = s->command;
        s->offset = 0.0;
        s->changed = 0;
        if (finite(torque[j]))
            u = issue(b, s, torque[j]);
        else
            s->status = DP_NOT_FINITE;
        send(b, s, u);
        out[j] = u;
        status |= s->status;
    }
    return status;
}

static dp_state *state_of(dp_controller *c, int joint)
{
    return joint >= 0 && joint < c->n ? &c->state[joint] : 0;
}

void dp_set_mode(dp_controller *c, int joint, int mode)
{
    dp_state *s = state_of(c, joint);
    if (!s || mode < DP_MODE_OFF || mode > DP_MODE_ACTIVE || s->mode == mode)
        return;
    s->mode = mode;
    s->changed = 1;
    for (int i = 0; i < DP_NX; i++)
        s->x[i] = 0.0;
}

void dp_set_position_loop(dp_controller *c, int joint, int on)
{
    dp_state *s = state_of(c, joint);
    if (s)
        s->position_loop = on != 0;
}

void dp_preset(dp_controller *c, int joint, const double *x, double torque)
{
    dp_state *s = state_of(c, joint);
    if (!s)
        return;
    const dp_block *b = &c->block[joint];
    int ok = finite(torque) && torque <= b->torque_limit && torque >= -b->torque_limit;
    for (int i = 0; i < b->nx; i++)
        ok &= finite(x[i]);
    if (!ok)
        return;
    for (int i = 0; i < b->nx; i++)
        s->x[i] = x[i];
    s->command = s->in_effect = torque;
    for (int i = 0; i < DP_MAX_LATENCY; i++)
        s->line[i] = torque;
}

void dp_warm_start(dp_controller *c, int joint, double velocity)
{
    dp_state *s = state_of(c, joint);
    if (!s || !finite(velocity))
        return;
    const dp_block *b = &c->block[joint];
    for (int i = 0; i < b->nx; i++)
        s->x[i] = b->warm[i] * velocity;
    /* The brake must bite at once: fading its torque in while the state settles would drive the joint. */
    s->offset = 0.0;
    s->changed = 0;
}
