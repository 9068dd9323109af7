/* Many brakes of one drive, each carrying the same rigid link: how every one of them stops it.
 *
 * Between ticks the joint is linear; its friction slips or sticks, which is asked once per sub-step. A state
 * X holds, besides the joint's own, the link's speed, the stretch of the friction's spring and the torque of
 * slipping friction; what each entry means is told by the indices below.
 */
#ifndef DASHPOT_STOPS_H
#define DASHPOT_STOPS_H

#include "dashpot_core.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { DP_STOP_STATES = 16, DP_STOP_LATE = 64 };

typedef struct {
    int states;            /* 1..DP_STOP_STATES */
    const double *slip;    /* transition over a sub-step while friction slips, (states, states) */
    const double *stick;   /* the same while it sticks */
    const double *start;   /* (states) */
    const double *sample;  /* torque sample = sample . X */
    int rotor, held, link, spring, slips; /* entries of X: rotor speed, torque in effect, ... */
    int mean;              /* torque average, cleared at every tick; -1: none */
    int substeps, ticks;
    int late;              /* whole samples still in the sensor, 0..DP_STOP_LATE */
    double coulomb, damper, torque_gain, speed;
    int window;            /* ticks over which a motion is looked at for an end */
    double still;          /* [rad/s] spread of the link's speed within it that counts as none */
} dp_stop_args;

/* speed and command receive (count, ticks) values: of the link [rad/s], and the torque issued [N m]. What has
 * not changed for a window is not followed further: it goes on as it was.
 * Returns 0, or -1 where a number or a block is out of range. */
int dp_stops(const dp_block *blocks, int count, const dp_stop_args *a, double *speed, double *command);

#ifdef __cplusplus
}
#endif
#endif
