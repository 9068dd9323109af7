#define _GNU_SOURCE /* ppoll; POSIX clocks and sockets besides */
#include "dashpot_link.h"

#include <errno.h>
#include <poll.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>

static long long now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1000000000LL + t.tv_nsec;
}

static void sleep_until(long long when)
{
    const struct timespec t = {when / 1000000000LL, when % 1000000000LL};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, 0) == EINTR) {
    }
}

void dp_link_begin(dp_link *l)
{
    memset(l->torque, 0, sizeof l->torque);
    l->begun = l->silent_at = 0;
    l->tripped_at = -1;
    l->apply_brake = l->listening;
    l->state = l->status = l->end = l->started = l->stopped = l->gone = 0;
}

/* Takes one message, if there is one before a time (0: whenever it comes; negative: if it is there). */
static int receive(dp_link *l, dp_link_command *m, long long before)
{
    while (!l->gone) {
        if (before > 0) {
            const long long left = before - now();
            const struct timespec t = {0, left > 0 ? left : 0};
            struct pollfd p = {l->socket, POLLIN, 0};
            if (ppoll(&p, 1, &t, 0) <= 0)
                return 0;
        }
        const ssize_t size = recv(l->socket, m, sizeof *m, before == 0 ? 0 : MSG_DONTWAIT);
        if (size == (ssize_t)sizeof *m)
            return 1;
        if (size == 0 || (size < 0 && errno != EINTR && errno != EAGAIN))
            l->gone = 1; /* the other end is closed: silence from now on */
        else if (size < 0 && errno == EAGAIN)
            return 0;
    }
    return 0;
}

static void take(dp_link *l, const dp_link_command *m, int tick, int n)
{
    l->silent_at = tick;
    l->status = m->status;
    if (m->kind == DP_LINK_START)
        l->started = 1;
    if (m->kind == DP_LINK_STOP)
        l->stopped = 1;
    if (l->listening && (l->started || l->stopped))
        l->end = 1;
    if (l->listening)
        return;
    for (int j = 0; j < n; j++)
        l->torque[j] = m->torque[j];
    l->state = m->state;
    l->apply_brake |= m->brake;
}

static void converse(dp_link *l, const dp_link_sample *s, int n)
{
    dp_link_command m;
    const int tick = (int)s->tick;
    send(l->socket, s, sizeof *s, MSG_NOSIGNAL | (l->realtime ? MSG_DONTWAIT : 0));
    if (l->realtime && l->listening) {
        while (receive(l, &m, -1))
            take(l, &m, tick, n);
    } else {
        const long long answer = l->begun + (long long)((tick + l->answer) * l->period * 1e9);
        while (receive(l, &m, l->realtime ? answer : 0)) {
            take(l, &m, tick, n);
            if (l->listening || l->stopped || m.tick >= tick)
                break;
        }
    }
}

int dp_link_exchange(struct dp_supervisor *self, dp_controller *c, const double *in, const int *torque_age,
                     const int *encoder_age, double *out)
{
    dp_link *l = (dp_link *)self;
    const int n = c->n, tick = *l->tick;
    dp_link_sample s;
    memset(&s, 0, sizeof s);
    if (l->realtime && !l->stopped && tick >= l->quiet) {
        const long long due = (long long)(tick * l->period * 1e9);
        if (l->begun == 0)
            l->begun = now() - due;
        sleep_until(l->begun + due);
    }
    s.tick = tick;
    s.time = tick * l->period;
    s.listening = l->listening;
    s.tripped = l->tripped_at >= 0;
    for (int j = 0; j < n; j++) {
        s.torque[j] = in[DP_IN_TORQUE * n + j];
        s.position[j] = in[DP_IN_POSITION * n + j];
        s.velocity[j] = in[DP_IN_VELOCITY * n + j];
        s.in_effect[j] = c->state[j].in_effect;
        s.torque_age[j] = torque_age[j];
        s.encoder_age[j] = encoder_age[j];
    }
    if (!l->stopped && tick >= l->quiet)
        converse(l, &s, n);
    if (!l->listening && l->tripped_at < 0 && (l->stopped || tick - l->silent_at >= l->watchdog))
        l->tripped_at = tick;
    if (l->tripped_at >= 0) {
        memset(l->torque, 0, sizeof l->torque);
        l->apply_brake = 1;
        l->end |= tick - l->tripped_at >= l->after;
    }
    if (l->listening && l->gone)
        l->end = 1;
    if (l->listening) /* whatever holds the arm does so with the torque there was */
        for (int j = 0; j < n; j++)
            l->torque[j] = c->state[j].command;
    dp_issue(c, l->torque, out);
    return l->status;
}
