/* Closed loop of a controller around a physics step, at native speed.
 *
 * The physics engine is reached through the address of its step function and pointers to
 * its state arrays, so this file needs no header of the engine and survives its upgrades.
 * Each joint is a rotor hinge (its engine armature is the rotor inertia) in series with a
 * spring hinge (stiffness k, damping c) that carries the link; the torque from rotor to link is
 *     tau_s = -(k e + c e') + k gap(e) - hysteresis(e),  e = deflection of the spring hinge.
 */
#ifndef DASHPOT_RUNNER_H
#define DASHPOT_RUNNER_H

#include "dashpot_core.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { DP_MAX_DELAY = 64 };

/* Drive of one joint as simulated, with its state (set by dp_run where it starts at tick 0). What every physics step
 * touches comes first: between two of our turns the engine has emptied the first-level cache. */
typedef struct {
    double stiffness, damping;        /* transmission k [N m/rad], c [N m s/rad] */
    double half_gap;                  /* backlash: the spring is slack for |e| < half_gap [rad] */
    double hysteresis;                /* limit of the Maxwell-slip element across the spring [N m] */
    double coulomb;                   /* rotor friction limit, sliding [N m] */
    double stribeck, stribeck_rate;   /* breakaway above it [N m]; 1 / Stribeck velocity [s/rad] */
    double presliding_stiffness;      /* [N m/rad] */
    double presliding_damping;        /* [N m s/rad] */
    double stop_lower, stop_upper;    /* link angle at which the stops begin [rad] */
    double torque_limit;              /* of the drive [N m] */
    double actuator_gain;             /* 1 + relative error of the torque produced */
    double inner_gain;                /* inner torque loop: u + g (u - tau_s); 0 = none */
    double filter_a[2][2], filter_b[2]; /* sensor low-pass at the physics step, output state 0 */
    double motor_limit;               /* of command and gravity compensation together; infinite while healthy [N m] */
    int rotor_qpos, rotor_dof, spring_qpos, spring_dof;
    int control;                      /* index in the controller, or -1: the robot's own servo */
    int average, filtered, sensor_delay; /* sampling; delay in physics steps */
    /* state */
    double friction_z, tau, filter_x[2], sum, motor, measured_tau, friction, asked;
    double gravity;                   /* what the robot itself adds to the command over this period [N m] */

    double hysteresis_stiffness;      /* [N m/rad] */
    double stop_stiffness, stop_damping;
    double inner_pole;                /* per-step decay of its torque filter, 0 = no filter */
    double servo_kp, servo_kd, servo_ki, servo_limit;
    double sensor_gain, sensor_bias, sensor_noise, sensor_resolution;
    double position_resolution;       /* [rad], 0 = ideal */
    int inner_steps;                  /* physics steps per inner-loop period */
    int reserved;                     /* keeps the doubles below aligned */
    /* state */
    double hysteresis_z, integral, inner_torque, inner_correction, spare;
    double encoder;                   /* rotor angle at the last tick, quantised [rad] */
    double known;                     /* the same as the robot's gravity compensation knows it [rad] */
    double delay[DP_MAX_DELAY];
    unsigned long long rng;
} dp_drive;

enum { DP_EVENT_MODE, DP_EVENT_POSITION_LOOP, DP_EVENT_WARM_START };

typedef struct {
    int tick, joint, kind; /* joint is the controller's index */
    int value;
} dp_event;

/* What is recorded at each tick, each an array [ticks][drives]. */
enum {
    DP_REC_POSITION,      /* rotor position, as used by the position loop [rad] */
    DP_REC_VELOCITY,      /* rotor velocity [rad/s] */
    DP_REC_LINK_POSITION, /* [rad] */
    DP_REC_LINK_VELOCITY, /* [rad/s] */
    DP_REC_TORQUE,        /* transmitted torque, true [N m] */
    DP_REC_SAMPLE,        /* torque sample given to the controller, less the gravity that the robot carries [N m] */
    DP_REC_COMMAND,       /* torque command issued at this tick [N m] */
    DP_REC_IN_EFFECT,     /* torque asked of the drive over the coming period [N m]; a servo's: the last */
    DP_NREC
};

enum { DP_RUN_OK = 0, DP_RUN_DIVERGED = 1 };

struct dp_faults;     /* dashpot_faults.h */
struct dp_supervisor; /* what runs in the place of dp_step, if anything does */

typedef struct {
    void (*step)(const void *model, void *data);
    const void *model;
    void *data;
    const double *qpos, *qvel;
    double *qfrc_applied;
    double dt;          /* physics step [s] */
    int steps_per_tick;
    int ticks;          /* rows of the tables below: of the whole run, or of a window of it */
    int origin;         /* tick of their first row; 0 unless the run goes on for as long as somebody watches */
    int first, last;    /* ticks to run now: first <= tick < last; a run may be cut anywhere */
    int drives;
    int events;
    dp_drive *drive;
    const dp_event *event;
    const double *reference; /* [4][ticks][drives]: position, velocity, acceleration, torque; or null */
    const double *external;  /* [ticks][drives]: torque on the links [N m]; or null */
    double *record;          /* [DP_NREC][ticks][drives]; or null */
    int *status;             /* [ticks]: or-ed statuses of the controller; or null */
    int diverged_tick;
    struct dp_faults *faults;          /* or null: nothing ever fails, at no cost */
    /* Called in the place of dp_step, or null. It also gets the ages of every joint's signals, in ticks since
     * the sample was taken (0: fresh). */
    int (*supervise)(struct dp_supervisor *s, dp_controller *c, const double *in, const int *torque_age,
                     const int *encoder_age, double *out);
    struct dp_supervisor *supervisor;
    const int *apply_brake;            /* the supervisor's flag, copied to faults after each call; or null */
    const int *state;                  /* its state, 0 while it tracks; or null */
    int tick;                          /* the one being run */
    const int *end;                    /* the run ends after the samples of a tick at which it is not 0; or null */
    double *supervisor_gravity;        /* where it reads what the robot adds itself, (controlled joints); or null */
    /* The robot's own gravity compensation, or null: torque that holds its bare links at the angles its encoders say,
     * [drives] both. It is added to every command, and taken off the torque samples. */
    void (*gravity)(void *of, const double *position, double *torque);
    void *gravity_of;
} dp_run_args;

/* Runs ticks a->first to a->last; returns DP_RUN_OK or DP_RUN_DIVERGED (a rotor or link faster than
 * 1e4 rad/s, or not finite; records stop there and diverged_tick is set). At tick 0 the engine's qpos and
 * qvel are the initial state, rng seeds in drive[].rng must be set, and the drives' states are cleared. A
 * later first goes on from the states that an earlier call has left, with the same bits as in one call; the
 * tables may hold a window of the run only (origin <= first, last <= origin + ticks). The
 * engine's model may be another one with the same degrees of freedom, the time step may not. */
int dp_run(dp_controller *c, dp_run_args *a);

/* A tick of dp_run in its parts, for whoever runs the physics otherwise. */
typedef struct {
    double in[DP_NIN * DP_MAX_JOINTS], out[DP_MAX_JOINTS]; /* of the controller, or its supervisor */
    double known[DP_MAX_JOINTS];  /* where the robot's gravity compensation believes the rotors to be [rad] */
    int torque_age[DP_MAX_JOINTS], encoder_age[DP_MAX_JOINTS], powered;
    int next;                     /* event to come */
} dp_tick;

/* State of the drives at the first tick: springs at rest, filters settled. */
void dp_begin(const dp_controller *c, dp_run_args *a);

/* Events, faults and sensors of a tick, in this order. */
void dp_tick_sense(dp_controller *c, dp_run_args *a, int tick, dp_tick *t);

/* Controller or supervisor; gravity [drives] is what the robot carries itself [N m], or null. */
void dp_tick_control(dp_controller *c, dp_run_args *a, int tick, const double *gravity, dp_tick *t);

/* The arm alone, one tick at a time, its motor torques given from outside: dp_sense at the tick, then dp_push with the
 * torque of every drive [N m] held until the next (0 where it is not finite, or the arm is without power). Every drive's
 * control must be >= 0, or its sensors do not fail; a->record, if any, has one row. As dp_run at tick 0 and after. */
void dp_sense(dp_run_args *a, int tick, double *torque, double *position, double *velocity);
int dp_push(dp_run_args *a, int tick, const double *torque);

/* Uniform in (0, 1). splitmix64: the state advances by a constant, so a stream depends on its seed only. */
double dp_uniform(unsigned long long *state);

#ifdef __cplusplus
}
#endif
#endif
