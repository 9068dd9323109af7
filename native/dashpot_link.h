/* The robot's side of a link between a controller and a simulated arm in another process.
 *
 * dp_link_exchange takes the place of a controller in dp_run: it sends the samples of a tick, takes the torques, and
 * does what a drive does where none come: it holds the last torque, and after `watchdog` ticks of silence it takes
 * the torque away and closes the mechanical brakes, for good. The link is a socket that keeps messages apart.
 */
#ifndef DASHPOT_LINK_H
#define DASHPOT_LINK_H

#include "dashpot_supervisor.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What the arm says at a tick; n values each. */
typedef struct {
    long long tick;
    double time; /* [s] since the run began */
    double torque[DP_MAX_JOINTS], position[DP_MAX_JOINTS], velocity[DP_MAX_JOINTS], in_effect[DP_MAX_JOINTS];
    int torque_age[DP_MAX_JOINTS], encoder_age[DP_MAX_JOINTS];
    int listening; /* brakes closed, nobody has taken the arm over */
    int tripped;   /* the watchdog has ended the motion */
} dp_link_sample;

enum { DP_LINK_GO_ON, DP_LINK_START, DP_LINK_STOP };

/* What the controller answers. */
typedef struct {
    long long tick; /* of the sample that it answers */
    double torque[DP_MAX_JOINTS];
    int kind, brake, state, status;
} dp_link_command;

typedef struct {
    int socket;
    int realtime;      /* 1: a tick begins when its time has come; 0: when the answer to the last one is there */
    int listening;     /* brakes closed: answers are requests for the next sample, or DP_LINK_START */
    int quiet;         /* ticks that go by first without a word: until the brakes have closed and all is calm */
    int watchdog;      /* ticks of silence after which the arm stops by itself */
    int after;         /* ticks from there, or from a stop, until the run ends */
    double period;     /* [s] */
    double answer;     /* part of the period after which an answer is for the next tick */
    const int *tick;   /* that dp_run is at */
    /* state */
    long long begun;   /* when tick 0 was, on the monotonic clock [ns] */
    long long silent_at, tripped_at; /* tick of the last message; tick at which the watchdog tripped, or -1 */
    double torque[DP_MAX_JOINTS];
    int apply_brake, state, status, end, started, stopped, gone;
} dp_link;

void dp_link_begin(dp_link *l);

/* As dp_supervise; s is a dp_link. The controller is a delay line: its blocks have no states and no gains. */
int dp_link_exchange(struct dp_supervisor *s, dp_controller *c, const double *in, const int *torque_age,
                     const int *encoder_age, double *out);

#ifdef __cplusplus
}
#endif
#endif
