/* One cycle of the real-time loop: C99, no allocation, no library but memcpy, bounded time.
 *
 * dp_cycle_step is all that a robot's loop computes between reading and writing:
 *   1. ages of the samples, those that the robot's clock adds included,
 *   2. dp_supervise,
 *   3. where the run stands: it ends in SAFE with zero torque, however it ends,
 *   4. statistics of the deadlines, and one row into a ring that somebody else drains.
 *
 * Ring: one producer (this file) and one consumer, perhaps another process, without locks: rows are written before
 * `head` moves on. A slow consumer loses rows and knows how many; the producer never waits.
 */
#ifndef DASHPOT_CYCLE_H
#define DASHPOT_CYCLE_H

#include "dashpot_supervisor.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { DP_BINS = 4096 }; /* of 1 us; the last one holds all that is more */

/* Where a run stands; it only goes on. */
enum {
    DP_PHASE_RUN,   /* tracking */
    DP_PHASE_BRAKE, /* a stop is under way, by torque or by encoder brake */
    DP_PHASE_SAFE,  /* mechanical brakes closing, torque fading */
    DP_PHASE_OVER   /* no torque is left */
};

/* Columns of a row. */
enum {
    DP_ROW_TORQUE, DP_ROW_POSITION, DP_ROW_VELOCITY, DP_ROW_IN_EFFECT, DP_ROW_COMMAND, DP_ROW_REFERENCE,
    DP_ROW_MOTOR,  /* work of the motor since the first tick [J] */
    DP_ROW_PORT,   /* work done on the link, through the torque sensor [J] */
    DP_ROW_STATE,  /* of the block, DP_NX of them */
    DP_ROW_COLUMNS = DP_ROW_STATE + DP_NX
};

typedef struct {
    long long tick;  /* cycles before this one */
    long long clock; /* when it was, on the wall clock of the host [ns] */
    double time;     /* robot's clock [s] */
    double jitter;   /* time since the last cycle, less the period [s] */
    int state, phase, status;
    int lost;        /* ticks of the robot's clock that had no cycle, since the last one */
    double column[DP_ROW_COLUMNS][DP_MAX_JOINTS];
    int mode[DP_MAX_JOINTS], joint_status[DP_MAX_JOINTS];
} dp_row;

typedef struct {
    long long cycles;
    long long late;    /* cycles before which ticks of the robot's clock had been lost */
    long long lost;    /* these ticks */
    long long longest; /* most of them in a row */
    long long same;    /* cycles that found no new sample */
    long long jitter[DP_BINS]; /* of the time between two cycles less the period, its size [us] */
    double jitter_most;        /* [s] */
    double step_sum, step_most; /* time of dp_cycle_step, as its caller has measured it [s] */
} dp_cycle_statistics;

typedef struct {
    unsigned long long head;     /* rows written */
    unsigned long long read;     /* rows the consumer is done with */
    unsigned long long capacity; /* rows there are */
    long long decisions;         /* written to log[i % DP_LOG] */
    int closed, reserved;        /* the producer is done */
    dp_decision log[DP_LOG];
    dp_cycle_statistics statistics;
} dp_ring; /* followed by the rows */

/* What the robot says; n values each, in its own order. */
typedef struct {
    double time;
    const double *torque, *position, *velocity, *in_effect;
    const int *torque_age, *encoder_age;
} dp_cycle_sample;

typedef struct {
    dp_controller *controller;
    dp_supervisor *supervisor;
    dp_ring *ring;           /* or null */
    dp_cycle_statistics *statistics; /* those of the ring, or of the caller where there is none */
    const double *reference; /* [4][rows][n]: position, velocity, acceleration, torque; the last row stays */
    long long rows;
    long long until;         /* row at which a stop is asked for; negative: never */
    double period;           /* [s] */
    int order[DP_MAX_JOINTS]; /* place of the controller's joints in the sample */
    int late_cycles;         /* late cycles in a row that are too many; likewise more than a third of all */
    int longest_gap;         /* ticks lost at once that are too many */
    /* state */
    long long row;           /* of the reference */
    double start, last;      /* robot's clock at the first sample, at the last new one [s] */
    double velocity[DP_MAX_JOINTS], torque[DP_MAX_JOINTS], motor[DP_MAX_JOINTS], port[DP_MAX_JOINTS];
    int begun, same, late, phase, safe_ticks, reserved;
} dp_cycle;

/* Checks and clears. Returns 0, or -1 where the settings are out of range. */
int dp_cycle_init(dp_cycle *c);

/* One cycle. clock [ns]: wall clock of the host; jitter [s]: time since the last cycle less the period. out[i]
 * receives the torque of the robot's joint i. Returns the phase. */
int dp_cycle_step(dp_cycle *c, const dp_cycle_sample *s, long long clock, double jitter, double *out);

/* Bytes of a ring of so many rows; its memory is given, zeroed, by whoever shares it. */
unsigned long long dp_ring_size(unsigned long long rows);

/* Copies at most `most` rows from row *next on, and moves *next on; *missed grows by the rows that were overwritten
 * before they could be read. Tells the producer how far it has come. Returns the number of rows copied. */
int dp_ring_drain(dp_ring *r, dp_row *out, int most, unsigned long long *next, unsigned long long *missed);

#ifdef __cplusplus
}
#endif
#endif
