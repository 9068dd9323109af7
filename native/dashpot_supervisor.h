/* Runtime supervisor of a dashpot controller: C99, no allocation, no library, bounded time per tick.
 *
 * Deployed with dashpot_core.c alone. Once per tick, in place of dp_step, dp_supervise
 *   1. checks every signal of every joint (each reason below, with its value and threshold),
 *   2. decides: states only ever get worse, until dp_supervisor_reset,
 *   3. issues a torque that is finite and within the torque and rate limits of the blocks.
 *
 *   TRACK          position loop and law
 *   TORQUE_BRAKE   no encoder is read: the law alone, warm-started from the last trusted velocity
 *   ENCODER_BRAKE  no torque sensor is read: u = load - damping * velocity, and a spring once it stands
 *   SAFE           torque faded to zero, mechanical brake closed (apply_brake)
 *
 * Where a number below is "per tick" or "a gain", it has the period in it. A gain g is that of the
 * first-order low-pass y += g (x - y), g = 1 - exp(-period / time constant).
 */
#ifndef DASHPOT_SUPERVISOR_H
#define DASHPOT_SUPERVISOR_H

#include "dashpot_core.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { DP_TRACK, DP_TORQUE_BRAKE, DP_ENCODER_BRAKE, DP_SAFE, DP_NSTATES };

/* What dp_next decides from; the first two are latched until a reset. */
enum {
    DP_EV_ENCODER_LOST = 1, /* an encoder is not trusted */
    DP_EV_TORQUE_LOST = 2,  /* a torque sensor is not trusted */
    DP_EV_STOP = 4,         /* a stop is asked for, or there is no usable reference */
    DP_EV_LAW = 8,          /* the controller itself oscillates or fails */
    DP_EV_NOT_STOPPED = 16, /* the brake is late, drifts, nobody can see that it stopped, or it has done its work */
    DP_NEVENTS = 32
};

enum {
    DP_WHY_NONE, DP_WHY_OPERATOR, DP_WHY_HOST, DP_WHY_REFERENCE,
    DP_WHY_ENCODER_NOT_FINITE, DP_WHY_ENCODER_STALE, DP_WHY_ENCODER_RANGE, DP_WHY_ENCODER_RATE,
    DP_WHY_ENCODER_INCONSISTENT, DP_WHY_ENCODER_FROZEN,
    DP_WHY_TORQUE_NOT_FINITE, DP_WHY_TORQUE_STALE, DP_WHY_TORQUE_RANGE, DP_WHY_TORQUE_RATE,
    DP_WHY_TORQUE_STUCK, DP_WHY_TORQUE_RESIDUAL, DP_WHY_RESIDUAL_AT_REST,
    DP_WHY_LAW_NOT_FINITE, DP_WHY_OSCILLATION, DP_WHY_STOP_LATE, DP_WHY_BLIND, DP_WHY_DRIFT, DP_WHY_SAG,
    DP_WHY_ENCODER_STANDS, DP_WHY_DONE, DP_WHY_PARKED,
    DP_NWHY
};

/* DP_LOG holds every decision between two resets: each signal is lost once, each other reason acts once. */
enum { DP_HISTORY = 32, DP_LOG = 64 };

/* What is known of one joint; docs/supervisor.md has the formula of every threshold. */
typedef struct {
    double inertia, viscous;      /* m / period, v: of the rotor balance */
    double inertia_error;         /* bound on the error of the first */
    double viscous_error;         /* of the second */
    double torque_error;          /* relative, of sensor x actuator */
    double torque_mid;            /* 0: the sample is the mean over a period; 0.5: of its end */
    double torque_lag;            /* by how many ticks a torque sample may be off in time */
    double allowance;             /* friction and sensor bias, largest [N m] */
    double noise;                 /* what noise and quantisation alone put into the residual [N m] */
    double noise_tick;            /* and into the balance of one period [N m] */
    double torque_range;          /* of the sensor [N m] */
    double torque_rate, torque_jump; /* per tick, and at once [N m] */
    double lower, upper;          /* joint range [rad] */
    double speed_limit;           /* [rad/s] */
    double jump;                  /* position step that is not motion [rad] */
    double stand;                 /* by which a reference may move while the encoder does not [rad] */
    double mismatch;              /* of velocity and differenced position, at rest [rad/s] */
    double bias_limit;            /* largest bias that is taken off [N m] */
    double moving;                /* speed from which friction has its full size [rad/s] */
    double floor;                 /* smallest torque amplitude that counts as oscillation [N m] */
    double damping;               /* of ENCODER_BRAKE [N m s/rad] */
    double hold;                  /* its stiffness once a joint has come to rest [N m/rad] */
    double load[DP_NX];           /* block state per N m of a constant load */
    int stuck;                    /* identical torque samples that are too many; 0: not checked */
    int reserved;
} dp_watch;

typedef struct {
    double period;                /* [s] */
    double residual_gain, speed_gain, load_gain, bias_gain;
    double band_gain;             /* of the high-pass of the oscillation monitor */
    double still_speed;           /* [rad/s] */
    double drift;                 /* from where it came to rest, or from where it should have slowed down [rad] */
    double release;               /* period / time over which SAFE takes the torque away */
    int torque_age, encoder_age;  /* oldest sample that is used [ticks] */
    int brake_ticks;              /* after which a braked joint may move on by `drift` and no more */
    int debounce;                 /* ticks of bad samples until trust is lost */
    int stop_ticks, still_ticks;  /* a brake's time to stop; time at rest that counts as stopped */
    int half_cycles;              /* of an oscillation that is fed and does not decay */
    int window;                   /* ticks that the residual remembers */
    int keep_load;                /* ENCODER_BRAKE holds the load that was there */
} dp_rules;

typedef struct {
    long long tick;
    double value, threshold;
    int joint; /* -1: the arm */
    int from, to, why;
} dp_decision;

/* State of one joint. */
typedef struct {
    double position, velocity, torque;   /* last accepted samples */
    double raw_torque;
    double gravity;                      /* what the robot adds by itself over the coming period [N m] */
    double speed;                        /* low-passed velocity */
    double load;                         /* low-passed torque sample */
    double drive;                        /* low-passed motor torque, slower */
    double residual, bound;              /* of the rotor balance, low-passed [N m] */
    double halt, halt_bound;             /* of the period in which the encoder came to a halt, or 0 [N m] */
    double mismatch, mismatch_bound;     /* [rad/s] */
    double sliding[2], weight[2], bias;  /* residual while moving down, up; latched bias [N m] */
    double band[6];                      /* low-passes of the oscillation monitor */
    double observed;                     /* velocity from the rotor balance alone */
    double peak, peaks[2], first_peak;   /* of the half-cycle so far, of the last two, of the first counted */
    double fed[2], heat[2];              /* motor's work and viscous heat of the last two half-cycles [J/period] */
    double held;                         /* torque kept by ENCODER_BRAKE */
    double rest;                         /* where it was when the arm came to rest, or brake_ticks on [rad] */
    double begin, pace;                  /* where it was, and how fast, when the brake began [rad], [rad/s] */
    double reference;                    /* at the last change of position [rad] */
    double entry, anchor;                /* speed when ENCODER_BRAKE began; where it holds the joint */
    double history[DP_HISTORY];          /* of speed */
    double drives[DP_HISTORY];           /* of drive */
    int encoder_lost, torque_lost, encoder_bad, torque_bad, encoder_gap, torque_gap;
    int encoder_seen, torque_seen, fresh, encoder_usable, torque_usable;
    int same_position, same_torque, residual_ticks, mismatch_ticks, reference_bad, law_bad;
    int up, cycles, mode, loop, back, anchored, reserved;
} dp_joint_watch;

typedef struct dp_supervisor {
    int n, state;
    int apply_brake;                     /* 1 once the mechanical brake must close */
    int events;                          /* DP_EV_*, latched */
    int request;                         /* reason of a stop asked for, or 0 */
    int since, still, stopped;           /* ticks since TRACK was left; at rest; came to rest */
    int head, park;                      /* park: SAFE follows once the arm has come to rest */
    long long tick;
    long long decisions;                 /* made since dp_supervisor_init; log[i % DP_LOG] */
    double gravity[DP_MAX_JOINTS];       /* input, see dp_supervise; zero from the start */
    dp_rules rules;
    dp_watch watch[DP_MAX_JOINTS];
    dp_joint_watch joint[DP_MAX_JOINTS];
    dp_decision log[DP_LOG];
} dp_supervisor;

/* Copies the settings. Returns 0, or -1 where one is not a number or out of range. */
int dp_supervisor_init(dp_supervisor *s, const dp_rules *rules, const dp_watch *watch, int n);

/* Back to TRACK with every signal trusted; gives the controller its modes and position loops back, cleared.
 * To be called at rest, by whoever has found the cause. The log stays. */
void dp_supervisor_reset(dp_supervisor *s, dp_controller *c);

/* Asks for a stop from the next tick on; why is DP_WHY_OPERATOR, DP_WHY_HOST or DP_WHY_DONE. */
void dp_supervisor_stop(dp_supervisor *s, int why);

/* From now on a brake that has brought the arm to rest hands it to the mechanical brakes: SAFE, and so an end. */
void dp_supervisor_park(dp_supervisor *s);

/* One tick. in and out as for dp_step; ages in ticks since the last fresh sample, 0: fresh. Of a robot that adds the
 * torque against gravity to every command, s->gravity holds what it adds from this tick on: torque samples are given as
 * they are and checked so; balance and law get them without it. Where it is not finite the last one is used.
 * Returns the statuses of all joints, or-ed. s and c must be for the same number of joints. */
int dp_supervise(dp_supervisor *s, dp_controller *c, const double *in, const int *torque_age,
                 const int *encoder_age, double *out);

/* The whole decision: the state that follows on a state and or-ed events. */
int dp_next(int state, int events);

#ifdef __cplusplus
}
#endif
#endif
