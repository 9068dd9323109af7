/* Scripted faults of drives, sensors and links, and the mechanical brake, inside the closed loop.
 *
 * What happens to a signal, in this order: plant; sensor (scale, bias, drift and noise are its parameters, so a
 * fault of 1 N m bias is the drive with 1 N m bias); encoder jump, then frozen; torque stuck; lost or NaN;
 * dropped and late. Faults of one kind on one drive compose: scales and saturations multiply, jumps, biases and
 * drifts add, noises add in squares, dropped samples are dropped independently, of delays, shorts and brakes the
 * largest counts, and every contact is a wall of its own. Without faults the runner never calls this file.
 */
#ifndef DASHPOT_FAULTS_H
#define DASHPOT_FAULTS_H

#include "dashpot_runner.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { DP_MAX_FAULTS = 256, DP_MAX_LATE = 64 };

/* In the order of FaultKind in faults.py; the value's unit in brackets. */
enum {
    DP_FAULT_ENCODER_FROZEN,   /* position held, velocity zero */
    DP_FAULT_ENCODER_JUMP,     /* [rad] */
    DP_FAULT_ENCODER_LOST,     /* NaN, and the age grows */
    DP_FAULT_TORQUE_BIAS,      /* [N m] */
    DP_FAULT_TORQUE_DRIFT,     /* [N m/s] */
    DP_FAULT_TORQUE_SCALE,     /* factor of the sensor's gain [-] */
    DP_FAULT_TORQUE_STUCK,
    DP_FAULT_TORQUE_NOISE,     /* standard deviation of a sample [N m] */
    DP_FAULT_TORQUE_NAN,
    DP_FAULT_SAMPLES_DROPPED,  /* probability per tick [-] */
    DP_FAULT_SAMPLES_LATE,     /* [ticks] */
    DP_FAULT_SATURATION,       /* factor of the torque limit [-] */
    DP_FAULT_BROWNOUT,         /* no controller, all motors off */
    DP_FAULT_CONTACT,          /* stiffness [N m/rad] */
    DP_FAULT_SHORTED_WINDINGS, /* damping b [N m s/rad]; motor off */
    DP_FAULT_MECHANICAL_BRAKE, /* friction of the rotor [N m]; motor off once closed */
    DP_NFAULT
};

typedef struct {
    int kind, drive;
    int first, last;        /* acts at ticks first <= tick < last */
    double value;
    double damping;         /* of a contact [N m s/rad] */
    unsigned long long rng; /* of dropped samples */
    /* state */
    double anchor, side;    /* link angle at which a wall stands [rad]; +1: it blocks positive motion */
    int acts, reserved;
} dp_fault;

/* What the drive's faults need to know of it. */
typedef struct {
    double brake_torque;    /* of its mechanical brake, where the fault does not say [N m] */
    double short_corner;    /* w_c: speed of the largest short-circuit torque, b w/(1 + (w/w_c)^2) [rad/s] */
    double most_damping;    /* that the physics step can carry [N m s/rad] */
} dp_fault_drive;

typedef struct {
    double torque, position, velocity;
    double gravity; /* that the robot carries */
    int encoder;    /* 0: lost */
} dp_packet;

/* What acts on one drive, and what its faults remember. */
typedef struct {
    dp_fault_drive of;
    double torque_limit, servo_limit, inner_gain, sensor_gain, sensor_bias, sensor_noise; /* healthy */
    double jump, short_damping, brake; /* at this tick */
    int frozen, lost, stuck, nan, dropped, late, off;
    int started, was_frozen, was_off;
    double jump_before, position, torque; /* as seen at the last tick, before loss */
    double closing, brake_z;           /* time since the brake was told to close [s]; its friction [N m] */
    int source, encoder_source;        /* ticks at which what the controller sees was sampled */
    dp_packet seen, sent[DP_MAX_LATE + 1];
} dp_fault_state;

typedef struct dp_faults {
    int faults, drives;
    int powered;       /* 0: brownout */
    int acting;        /* whether forces must be added at every physics step */
    int apply_brake;   /* set by a supervisor: the mechanical brakes of all drives close */
    int stopped_at;    /* tick at which a supervisor left tracking, or -1: servos stay where they were told to be */
    int torque_age[DP_MAX_JOINTS], encoder_age[DP_MAX_JOINTS]; /* by drive [ticks] */
    double brake_delay; /* from telling to fully closed; nothing in the first half, then a ramp [s] */
    dp_fault fault[DP_MAX_FAULTS];
    dp_fault_state state[DP_MAX_JOINTS];
} dp_faults;

/* Copies the script. Returns 0, or -1 where a count, a kind, a drive or a value is out of range. */
int dp_faults_init(dp_faults *f, const dp_fault *fault, int faults, const dp_fault_drive *of, int drives,
                   double brake_delay);

/* Puts a fault into a place of the script of a run that goes on, a new one (i = f->faults) or one there is: what it
 * remembers begins afresh. Returns 0, or -1 where the place or the fault is not valid. */
int dp_faults_put(dp_faults *f, int i, const dp_fault *fault);

/* Called by dp_run before its first tick: forgets, and takes the drives as healthy. */
void dp_faults_begin(dp_faults *f, const dp_drive *drive);

/* Before the samples of a tick are taken: starts and ends faults, and sets the drives' parameters. */
void dp_faults_tick(dp_faults *f, const dp_run_args *a, int tick);

/* Turns the sample of drive j into what its controller sees; sets the ages. */
void dp_faults_sample(dp_faults *f, int j, int tick, double period, double *torque, double *position,
                      double *velocity);

/* Where the encoder of drive j, as it is at this tick, says that its rotor is; left as it was while it is lost. */
void dp_faults_angle(const dp_faults *f, int j, double *position);

/* Of the gravity torque that the robot carries at this tick: what its controller is told, with the sample it gets. */
double dp_faults_gravity(dp_faults *f, int j, int tick, double gravity);

/* Adds contact, short circuit and brake to the forces of the coming physics step; needed while f->acting. */
void dp_faults_forces(dp_faults *f, const dp_run_args *a);

#ifdef __cplusplus
}
#endif
#endif
