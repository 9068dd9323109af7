#include "dashpot_supervisor.h"

static const double DECAY = 0.9; /* a half-cycle smaller than this part of the one before last has decayed */
static const double FED = 0.5;   /* of the viscous heat: work of the motor that keeps an oscillation up */
static const double SLOW = 0.3;  /* part of its speed at which the encoder brake begins to hold a joint */
static const double KNOWN = 0.5; /* weight from which a direction's friction is known well enough for the bias */

static int finite(double x) { return x - x == 0.0; }

static double size(double x) { return x < 0.0 ? -x : x; }

static double clamp(double x, double limit)
{
    return x > limit ? limit : (x < -limit ? -limit : x);
}

static void count_up(int *ticks)
{
    if (*ticks < 1 << 30)
        ++*ticks;
}

static void follow(double *y, double x, double gain) { *y += gain * (x - *y); }

/* Bad ticks count two, good ones take one back: a signal that is bad more than a third of the time is lost,
 * one that is bad without a break after `debounce` ticks. */
static int tally(int *count, int bad, const dp_rules *r)
{
    const int most = 2 * r->debounce;
    *count = bad ? *count + 2 : (*count > 0 ? *count - 1 : 0);
    *count = *count < most ? *count : most;
    return *count == most;
}

int dp_next(int state, int events)
{
    const int blind = events & DP_EV_ENCODER_LOST, deaf = events & (DP_EV_TORQUE_LOST | DP_EV_LAW);
    if (state < DP_TRACK || state >= DP_SAFE || (blind && deaf))
        return DP_SAFE;
    if (state != DP_TRACK && (events & DP_EV_NOT_STOPPED))
        return DP_SAFE;
    if (state == DP_ENCODER_BRAKE) /* the law is off: if it still oscillates, damping is the cause */
        return blind || (events & DP_EV_LAW) ? DP_SAFE : DP_ENCODER_BRAKE;
    if (deaf)
        return DP_ENCODER_BRAKE;
    return blind || (events & DP_EV_STOP) ? DP_TORQUE_BRAKE : state;
}

int dp_supervisor_init(dp_supervisor *s, const dp_rules *rules, const dp_watch *watch, int n)
{
    const double *gain[] = {&rules->residual_gain, &rules->speed_gain, &rules->load_gain, &rules->bias_gain,
                            &rules->band_gain, &rules->release};
    if (n < 1 || n > DP_MAX_JOINTS)
        return -1;
    for (int i = 0; i < 6; i++)
        if (!(*gain[i] > 0.0 && *gain[i] <= 1.0))
            return -1;
    if (!(rules->period > 0.0) || !finite(rules->period) || !(rules->still_speed >= 0.0) || !(rules->drift >= 0.0))
        return -1;
    if (rules->torque_age < 0 || rules->encoder_age < 0 || rules->debounce < 1 || rules->stop_ticks < 1 ||
        rules->brake_ticks < 1 ||
        rules->still_ticks < 1 || rules->half_cycles < 2 || rules->window < 1)
        return -1;
    for (int j = 0; j < n; j++) {
        const dp_watch *w = &watch[j];
        /* what is compared or multiplied with signals: finite, so that no product is not a number */
        const double number[] = {w->inertia, w->viscous, w->inertia_error, w->viscous_error, w->torque_error,
                                 w->torque_lag, w->torque_mid, w->allowance, w->noise, w->noise_tick, w->torque_range, w->torque_rate,
                                 w->torque_jump, w->speed_limit, w->jump, w->stand, w->mismatch, w->bias_limit, w->moving,
                                 w->floor, w->damping, w->hold};
        for (unsigned i = 0; i < sizeof number / sizeof *number; i++)
            if (!(number[i] >= 0.0 && number[i] <= 1e12))
                return -1;
        for (int i = 0; i < DP_NX; i++)
            if (!finite(w->load[i]))
                return -1;
        if (!(w->inertia > 0.0) || !(w->lower < w->upper) || w->stuck < 0)
            return -1;
    }
    *s = (dp_supervisor){0};
    s->n = n;
    s->rules = *rules;
    for (int j = 0; j < n; j++)
        s->watch[j] = watch[j];
    return 0;
}

void dp_supervisor_reset(dp_supervisor *s, dp_controller *c)
{
    for (int j = 0; j < s->n; j++) {
        if (s->state != DP_TRACK) {
            dp_set_mode(c, j, s->joint[j].mode);
            dp_set_position_loop(c, j, s->joint[j].loop);
        }
        s->joint[j] = (dp_joint_watch){0};
    }
    if (s->state != DP_TRACK)
        dp_reset(c);
    s->state = s->apply_brake = s->events = s->request = s->since = s->still = s->stopped = s->park = 0;
}

void dp_supervisor_stop(dp_supervisor *s, int why)
{
    if (!s->request && (why == DP_WHY_OPERATOR || why == DP_WHY_HOST || why == DP_WHY_DONE))
        s->request = why;
}

void dp_supervisor_park(dp_supervisor *s) { s->park = 1; }

static void note(dp_supervisor *s, int joint, int why, double value, double threshold)
{
    dp_decision *d = &s->log[s->decisions++ % DP_LOG];
    *d = (dp_decision){s->tick, value, threshold, joint, s->state, s->state, why};
}

/* An event of the arm acts, and is noted, once. */
static void raise_event(dp_supervisor *s, int event, int joint, int why, double value, double threshold)
{
    if (!(s->events & event))
        note(s, joint, why, value, threshold);
    s->events |= event;
}

static void lose_encoder(dp_supervisor *s, int j, int why, double value, double threshold, int back)
{
    dp_joint_watch *o = &s->joint[j];
    o->encoder_lost = 1;
    o->back = back < 0 ? 0 : (back >= DP_HISTORY ? DP_HISTORY - 1 : back);
    s->events |= DP_EV_ENCODER_LOST;
    note(s, j, why, value, threshold);
}

static void lose_torque(dp_supervisor *s, int j, int why, double value, double threshold)
{
    s->joint[j].torque_lost = 1;
    s->events |= DP_EV_TORQUE_LOST;
    note(s, j, why, value, threshold);
}

/* Checks a torque sample and takes it over if it is plausible. */
static void check_torque(dp_supervisor *s, int j, double tau, int age)
{
    const dp_watch *w = &s->watch[j];
    const dp_rules *r = &s->rules;
    dp_joint_watch *o = &s->joint[j];
    int why = DP_WHY_NONE;
    double value = 0.0, threshold = 0.0;
    count_up(&o->torque_gap);
    const int gap = o->torque_gap;
    if (!finite(tau)) {
        why = DP_WHY_TORQUE_NOT_FINITE;
        value = tau;
    } else if (age < 0 || age > r->torque_age) {
        why = DP_WHY_TORQUE_STALE;
        value = age;
        threshold = r->torque_age;
    } else if (size(tau) > w->torque_range) {
        why = DP_WHY_TORQUE_RANGE;
        value = tau;
        threshold = w->torque_range;
    } else if (o->torque_seen && size(tau - o->torque) > w->torque_rate * gap + w->torque_jump) {
        why = DP_WHY_TORQUE_RATE;
        value = tau - o->torque;
        threshold = w->torque_rate * gap + w->torque_jump;
    }
    if (why == DP_WHY_NONE && age == 0) {
        if (!o->torque_seen || tau != o->raw_torque)
            o->same_torque = -1;
        count_up(&o->same_torque);
        o->raw_torque = tau;
        if (w->stuck > 0 && o->same_torque >= w->stuck && !o->torque_lost)
            lose_torque(s, j, DP_WHY_TORQUE_STUCK, o->same_torque, w->stuck);
    }
    if (tally(&o->torque_bad, why != DP_WHY_NONE, r) && !o->torque_lost)
        lose_torque(s, j, why ? why : DP_WHY_TORQUE_STALE, value, threshold);
    o->torque_usable = why == DP_WHY_NONE && !o->torque_lost;
    if (o->torque_usable) {
        o->torque = tau;
        o->torque_seen = 1;
        o->torque_gap = 0;
    }
}

/* Checks an encoder sample. It is taken over in `fuse`, which still needs the one before. */
static void check_encoder(dp_supervisor *s, int j, double q, double v, int age)
{
    const dp_watch *w = &s->watch[j];
    const dp_rules *r = &s->rules;
    dp_joint_watch *o = &s->joint[j];
    int why = DP_WHY_NONE;
    double value = 0.0, threshold = 0.0;
    count_up(&o->encoder_gap);
    const double reach = w->speed_limit * r->period * o->encoder_gap + w->jump;
    if (!finite(q) || !finite(v)) {
        why = DP_WHY_ENCODER_NOT_FINITE;
        value = finite(q) ? v : q;
    } else if (age < 0 || age > r->encoder_age) {
        why = DP_WHY_ENCODER_STALE;
        value = age;
        threshold = r->encoder_age;
    } else if (q < w->lower || q > w->upper) {
        why = DP_WHY_ENCODER_RANGE;
        value = q;
        threshold = q < w->lower ? w->lower : w->upper;
    } else if (o->encoder_seen && size(q - o->position) > reach) {
        why = DP_WHY_ENCODER_RATE;
        value = (q - o->position) / (r->period * o->encoder_gap);
        threshold = reach / (r->period * o->encoder_gap);
    } else if (size(v) > w->speed_limit + w->jump / r->period) {
        why = DP_WHY_ENCODER_RATE;
        value = v;
        threshold = w->speed_limit + w->jump / r->period;
    }
    if (tally(&o->encoder_bad, why != DP_WHY_NONE, r) && !o->encoder_lost)
        lose_encoder(s, j, why ? why : DP_WHY_ENCODER_STALE, value, threshold, r->debounce + 1);
    o->encoder_usable = why == DP_WHY_NONE && !o->encoder_lost;
}

/* Which sensor lies, where the rotor's equation does not hold: the encoder if it stands although it moved
 * before; nobody can tell where it stood before; else the torque sensor, or a motor that does not obey. */
static void blame(dp_supervisor *s, int j, double threshold)
{
    dp_joint_watch *o = &s->joint[j];
    const int still = o->same_position;
    if (still < (s->rules.debounce > 1 ? s->rules.debounce - 1 : 1)) { /* the tick it froze at was the first */
        lose_torque(s, j, DP_WHY_TORQUE_RESIDUAL, o->residual, threshold);
        return;
    }
    const int back = still + 1 < DP_HISTORY ? still + 1 : DP_HISTORY - 1;
    const double before = o->history[(s->head - back + DP_HISTORY) % DP_HISTORY];
    if (size(before) * s->rules.period * still > s->watch[j].jump + 1e-12) {
        lose_encoder(s, j, DP_WHY_ENCODER_FROZEN, o->residual, threshold, back);
        return;
    }
    lose_encoder(s, j, DP_WHY_RESIDUAL_AT_REST, o->residual, threshold, 0);
    o->torque_lost = 1;
    s->events |= DP_EV_TORQUE_LOST;
}

/* Rotor balance m w' + v w + tau_s - u = bias - friction over the last period, and position against velocity.
 * Their bounds are low-passed like themselves, so that they hold for every motion. */
static void fuse(dp_supervisor *s, int j, double q, double v, double before_torque, double u)
{
    const dp_watch *w = &s->watch[j];
    const dp_rules *r = &s->rules;
    dp_joint_watch *o = &s->joint[j];
    const double dw = v - o->velocity, mean = 0.5 * (v + o->velocity);
    const double dtau = o->torque - before_torque, tau = o->torque - w->torque_mid * dtau;
    const double e = w->inertia * dw + w->viscous * mean + tau - u;
    const double bound = w->allowance + w->inertia_error * size(dw) + w->viscous_error * size(mean) +
                         w->torque_error * size(o->torque) + w->torque_lag * size(dtau);
    follow(&o->residual, e, r->residual_gain);
    follow(&o->bound, bound, r->residual_gain);
    follow(&o->mismatch, (q - o->position) / r->period - v, r->residual_gain);
    follow(&o->mismatch_bound, w->mismatch + size(dw), r->residual_gain);

    /* Real encoders at rest, and only they, repeat themselves for long. */
    if (q != o->position)
        o->same_position = -1;
    count_up(&o->same_position);
    if (o->same_position != 1) /* a halt that no torque explains is remembered while the encoder stands */
        o->halt = o->same_position ? o->halt : 0.0;
    else if (size(e) > bound + w->noise_tick) {
        o->halt = e;
        o->halt_bound = bound + w->noise_tick;
    }
    const double limit = o->bound + w->noise;
    o->residual_ticks = size(o->residual) > limit ? o->residual_ticks + 1 : 0;
    o->mismatch_ticks = size(o->mismatch) > o->mismatch_bound ? o->mismatch_ticks + 1 : 0;
    if (o->mismatch_ticks >= r->debounce && !o->encoder_lost)
        lose_encoder(s, j, DP_WHY_ENCODER_INCONSISTENT, o->mismatch, o->mismatch_bound, r->debounce + r->window);
    else if (o->halt != 0.0 && o->same_position >= r->debounce && !o->encoder_lost)
        lose_encoder(s, j, DP_WHY_ENCODER_FROZEN, o->halt, o->halt_bound, o->same_position + 1);
    else if (o->residual_ticks >= r->debounce)
        blame(s, j, limit);
    else if (size(o->speed) > w->moving && o->residual_ticks == 0) {
        const int up = o->speed > 0.0;
        follow(&o->sliding[up], e, r->bias_gain);
        follow(&o->weight[up], 1.0, r->bias_gain);
    }
}

/* High-passed twice, by two low-passes of the oscillation monitor. */
static double band(double *low, double x, double gain)
{
    follow(&low[0], x, gain);
    x -= low[0];
    follow(&low[1], x, gain);
    return x - low[1];
}

/* Counts half-cycles of the torque that do not decay and whose energy comes from the motor. */
static void listen(dp_supervisor *s, int j, double u, double speed)
{
    const dp_watch *w = &s->watch[j];
    dp_joint_watch *o = &s->joint[j];
    const double gain = s->rules.band_gain;
    const double y = band(&o->band[0], o->torque - o->gravity, gain), motor = band(&o->band[2], u, gain);
    const double fast = band(&o->band[4], speed, gain);
    o->fed[o->up] += motor * fast;
    o->heat[o->up] += w->viscous * fast * fast;
    const double side = o->up ? y : -y;
    if (side > o->peak)
        o->peak = side;
    if (side > -0.25 * w->floor) /* the half-cycle goes on; noise around zero ends none */
        return;
    const double fed = o->fed[0] + o->fed[1], heat = o->heat[0] + o->heat[1];
    const int kept = o->peak >= w->floor && o->peak >= DECAY * o->peaks[o->up] && fed > FED * heat;
    o->cycles = kept ? o->cycles + 1 : 0;
    if (o->cycles == 1)
        o->first_peak = o->peak;
    if (o->cycles >= s->rules.half_cycles) {
        if (o->peak >= o->first_peak)
            raise_event(s, DP_EV_LAW, j, DP_WHY_OSCILLATION, o->peak, w->floor);
        o->cycles = 1; /* slowly decaying: watch from here */
        o->first_peak = o->peak;
    }
    o->peaks[o->up] = o->peak;
    o->up = !o->up;
    o->peak = -side;
    o->fed[o->up] = o->heat[o->up] = 0.0;
}

/* All that is known of one joint at this tick; writes the inputs the controller may see. */
static void watch_joint(dp_supervisor *s, const dp_controller *c, int j, const double *in, int torque_age,
                        int encoder_age, double *clean)
{
    const int n = s->n;
    const dp_watch *w = &s->watch[j];
    const dp_rules *r = &s->rules;
    dp_joint_watch *o = &s->joint[j];
    const dp_state *state = &c->state[j];
    const double q = in[DP_IN_POSITION * n + j], v = in[DP_IN_VELOCITY * n + j];
    const double u = state->in_effect, before_torque = o->torque, carried = o->gravity;
    const int first_torque = !o->torque_seen, first_encoder = !o->encoder_seen;
    if (finite(s->gravity[j]))
        o->gravity = s->gravity[j];
    check_torque(s, j, in[DP_IN_TORQUE * n + j], torque_age);
    check_encoder(s, j, q, v, encoder_age);

    /* A frozen encoder under a smooth motion is hidden by friction in the rotor balance. It does not follow. */
    const double reference = in[DP_IN_POSITION_REF * n + j];
    if (s->state != DP_TRACK || !state->position_loop || first_encoder || (o->encoder_usable && q != o->position))
        o->reference = reference;
    else if (!o->encoder_lost && size(reference - o->reference) > w->stand)
        lose_encoder(s, j, DP_WHY_ENCODER_STANDS, reference - o->reference, w->stand, o->same_position + 1);

    const int fresh = o->torque_usable && o->encoder_usable && torque_age == 0 && encoder_age == 0;
    if (fresh && o->fresh && s->state != DP_SAFE) /* the mechanical brake is in no rotor balance */
        fuse(s, j, q, v, before_torque, u + carried);
    o->fresh = fresh;
    if (o->encoder_usable) {
        const double seen = 0.5 * (v + o->velocity);
        if (first_encoder)
            o->speed = v;
        else
            follow(&o->speed, seen, r->speed_gain);
        o->position = q;
        o->velocity = o->observed = v;
        o->encoder_seen = 1;
        o->encoder_gap = 0;
    } else {
        o->observed += (u + carried - o->torque - w->viscous * o->observed) / w->inertia;
    }
    o->history[s->head] = o->speed;

    follow(&o->drive, u, s->tick == 0 ? 1.0 : r->load_gain);
    o->drives[s->head] = o->drive;
    if (o->torque_usable) {
        const double net = o->torque - o->gravity;
        if (first_torque) {
            o->load = net;
            o->band[0] = net;
            o->band[2] = u;
        }
        follow(&o->load, net, r->speed_gain);
        if (s->state != DP_SAFE) /* where the motor feeds nothing, and a closed brake makes the link ring */
            listen(s, j, u, o->encoder_usable ? o->velocity : o->observed);
    }
    const int failed = state->status & DP_NOT_FINITE && s->state <= DP_TORQUE_BRAKE && s->tick > 0;
    if (tally(&o->law_bad, failed && o->torque_usable && (o->encoder_usable || s->state != DP_TRACK), r))
        raise_event(s, DP_EV_LAW, j, DP_WHY_LAW_NOT_FINITE, state->command, 0.0);
    int bad_reference = 0;
    for (int i = DP_IN_POSITION_REF; i < DP_NIN; i++) {
        clean[i * n + j] = in[i * n + j];
        bad_reference |= !finite(in[i * n + j]);
    }
    if (tally(&o->reference_bad, bad_reference, r))
        raise_event(s, DP_EV_STOP, j, DP_WHY_REFERENCE, in[DP_IN_POSITION_REF * n + j], 0.0);

    /* A suspected sample is bridged: torque by the last good one, position by going on at the last good speed. */
    clean[DP_IN_TORQUE * n + j] = o->torque - o->gravity - (s->state == DP_TORQUE_BRAKE ? o->bias : 0.0);
    if (o->encoder_seen) {
        clean[DP_IN_POSITION * n + j] = o->position + o->speed * r->period * o->encoder_gap;
        clean[DP_IN_VELOCITY * n + j] = o->encoder_usable ? o->velocity : o->speed;
    } else { /* never heard: no error, so that the position loop asks for nothing */
        clean[DP_IN_POSITION * n + j] = in[DP_IN_POSITION_REF * n + j];
        clean[DP_IN_VELOCITY * n + j] = in[DP_IN_VELOCITY_REF * n + j];
    }
}

/* Has the brake stopped the arm, and does it stay where it stopped? */
static void check_stop(dp_supervisor *s)
{
    const dp_rules *r = &s->rules;
    double fastest = 0.0;
    int joint = 0;
    count_up(&s->since);
    for (int j = 0; j < s->n; j++) {
        dp_joint_watch *o = &s->joint[j];
        if (size(o->speed) > fastest) {
            fastest = size(o->speed);
            joint = j;
        }
        if (!s->stopped && s->since == r->brake_ticks)
            o->rest = o->position;
        /* Farther than at the speed it had is no braking at all. */
        const double way = size(o->position - o->begin), free = size(o->pace) * r->period * s->since + r->drift;
        if (!s->stopped && s->since <= r->brake_ticks && !o->encoder_lost && way > free)
            raise_event(s, DP_EV_NOT_STOPPED, j, DP_WHY_SAG, way, free);
        /* A load that the brake cannot hold must not have until stop_ticks to fall; and where another joint's
         * encoder is lost, nothing else looks at this one. */
        if ((s->stopped || s->since > r->brake_ticks) && !o->encoder_lost && size(o->position - o->rest) > r->drift)
            raise_event(s, DP_EV_NOT_STOPPED, j, s->stopped ? DP_WHY_DRIFT : DP_WHY_SAG, o->position - o->rest,
                        r->drift);
    }
    if (s->events & DP_EV_ENCODER_LOST) {
        if (s->since >= r->stop_ticks)
            raise_event(s, DP_EV_NOT_STOPPED, -1, DP_WHY_BLIND, s->since * r->period, r->stop_ticks * r->period);
        return;
    }
    if (!(fastest < r->still_speed))
        s->still = -1;
    count_up(&s->still);
    if (!s->stopped && s->still >= r->still_ticks) {
        s->stopped = 1;
        for (int j = 0; j < s->n; j++)
            s->joint[j].rest = s->joint[j].position;
    }
    if (!s->stopped && s->since >= r->stop_ticks)
        raise_event(s, DP_EV_NOT_STOPPED, joint, DP_WHY_STOP_LATE, fastest, r->still_speed);
    if (s->stopped && s->park)
        raise_event(s, DP_EV_NOT_STOPPED, -1, DP_WHY_PARKED, fastest, r->still_speed);
}

static void enter(dp_supervisor *s, dp_controller *c, int state)
{
    for (int j = 0; j < s->n; j++) {
        dp_joint_watch *o = &s->joint[j];
        const dp_watch *w = &s->watch[j];
        dp_state *x = &c->state[j];
        if (s->state == DP_TRACK) {
            o->begin = o->position;
            o->pace = o->speed;
            o->mode = x->mode;
            o->loop = x->position_loop;
        }
        o->cycles = 0;
        if (state == DP_TORQUE_BRAKE) {
            const double trusted = o->encoder_lost ? o->history[(s->head - o->back + DP_HISTORY) % DP_HISTORY]
                                                   : o->speed;
            if (o->weight[0] > KNOWN && o->weight[1] > KNOWN)
                o->bias = clamp(0.5 * (o->sliding[0] / o->weight[0] + o->sliding[1] / o->weight[1]), w->bias_limit);
            dp_set_mode(c, j, DP_MODE_ACTIVE);
            dp_set_position_loop(c, j, 0);
            dp_warm_start(c, j, trusted);
            for (int i = 0; i < c->block[j].nx; i++) /* and goes on carrying the load */
                x->x[i] += w->load[i] * (o->load - o->bias);
        } else if (state == DP_ENCODER_BRAKE) {
            const int back = s->rules.window + s->rules.debounce; /* what the sensor did since is in doubt */
            const int then = (s->head + DP_HISTORY - (back < DP_HISTORY ? back : DP_HISTORY - 1)) % DP_HISTORY;
            o->held = s->rules.keep_load ? o->drives[then] : 0.0;
            o->entry = o->speed;
            o->anchored = 0;
        } else {
            o->held = x->command;
        }
    }
    s->events &= ~DP_EV_LAW; /* seen to; if the next state oscillates too, that is news */
    s->state = state;
    s->apply_brake = state == DP_SAFE;
}

/* Torque of ENCODER_BRAKE: damping until most of the speed is gone, from there on a spring as well. Both are
 * passive, and so is a constant load. */
static double brake(dp_joint_watch *o, const dp_watch *w, double still, double position, double velocity)
{
    if (!o->anchored && (size(o->speed) < still || o->speed * o->entry <= SLOW * o->entry * o->entry)) {
        o->anchored = 1;
        o->anchor = position;
    }
    return o->held - w->damping * velocity - (o->anchored ? w->hold * (position - o->anchor) : 0.0);
}

int dp_supervise(dp_supervisor *s, dp_controller *c, const double *in, const int *torque_age,
                 const int *encoder_age, double *out)
{
    const int n = s->n;
    const long long decided = s->decisions;
    double clean[DP_NIN * DP_MAX_JOINTS], u[DP_MAX_JOINTS];
    s->head = s->head + 1 == DP_HISTORY ? 0 : s->head + 1;
    for (int j = 0; j < n; j++)
        watch_joint(s, c, j, in, torque_age[j], encoder_age[j], clean);
    if (s->request)
        raise_event(s, DP_EV_STOP, -1, s->request, 0.0, 0.0);
    if (s->state == DP_TORQUE_BRAKE || s->state == DP_ENCODER_BRAKE)
        check_stop(s);

    const int next = dp_next(s->state, s->events);
    for (long long i = decided; i < s->decisions; i++)
        s->log[i % DP_LOG].to = next;
    if (next != s->state) {
        enter(s, c, next);
        for (int j = 0; j < n; j++) /* the bias just latched */
            clean[DP_IN_TORQUE * n + j] = s->joint[j].torque - s->joint[j].gravity - s->joint[j].bias;
    }
    s->tick++;
    if (s->state <= DP_TORQUE_BRAKE)
        return dp_step(c, clean, out);
    for (int j = 0; j < n; j++) {
        dp_joint_watch *o = &s->joint[j];
        const double command = c->state[j].command;
        if (s->state == DP_SAFE)
            u[j] = command - clamp(command, s->rules.release * size(o->held));
        else
            u[j] = brake(o, &s->watch[j], s->rules.still_speed, clean[DP_IN_POSITION * n + j],
                         clean[DP_IN_VELOCITY * n + j]);
    }
    return dp_issue(c, u, out);
}
