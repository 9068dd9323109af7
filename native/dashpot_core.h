/* dashpot controller core: C99, no allocation, no library (a compiler may call memcpy and memset for structs).
 *
 * A joint controller is a small linear block. At each tick k it maps
 *     w = [torque sample, torque in effect, position, velocity,
 *          position ref, velocity ref, acceleration ref, torque ref]
 * to a torque command
 *     u      = C x + D w
 *     x(k+1) = A x + B w + E (u_issued - u)
 * where u_issued is u after blending and the torque and rate limits: E feeds the
 * torque really issued back, so that no state winds up behind a limit.
 * "Torque in effect" is the torque the motor held over the period that ends at this
 * tick: the command of `latency` + 1 ticks ago, kept in a delay line here.
 */
#ifndef DASHPOT_CORE_H
#define DASHPOT_CORE_H

#ifdef __cplusplus
extern "C" {
#endif

enum { DP_MAX_JOINTS = 16, DP_NX = 4, DP_NW = 8, DP_MAX_LATENCY = 16 };

/* Inputs given by the caller; w adds the torque in effect, which the core knows itself. */
enum {
    DP_IN_TORQUE, DP_IN_POSITION, DP_IN_VELOCITY, DP_IN_POSITION_REF, DP_IN_VELOCITY_REF,
    DP_IN_ACCELERATION_REF, DP_IN_TORQUE_REF, DP_NIN
};

enum { DP_MODE_OFF = 0, DP_MODE_BYPASS = 1, DP_MODE_ACTIVE = 2 };

enum {
    DP_OK = 0,
    DP_TORQUE_LIMITED = 1, /* the torque limit was reached */
    DP_RATE_LIMITED = 2,   /* the torque rate limit was reached */
    DP_NOT_FINITE = 4,     /* an input or a result was not finite: last torque held, state kept */
    DP_BLENDING = 8        /* a change of mode is still being faded in */
};

/* Coefficients of one joint; all that certification and export need. */
typedef struct {
    double A[DP_NX][DP_NX], B[DP_NX][DP_NW], C[DP_NX], D[DP_NW], E[DP_NX];
    double bypass[DP_NW];  /* u = bypass . w in bypass mode */
    double warm[DP_NX];    /* x = warm * (joint velocity) at a warm start */
    double torque_limit;   /* [N m], >= 0, may be infinite */
    double rate_limit;     /* [N m per tick], >= 0, may be infinite */
    double blend;          /* per-tick decay of the step left by a change of mode, 0 <= blend < 1 */
    int nx;                /* states used, 0..DP_NX */
    int latency;           /* whole ticks from command to effect, 0..DP_MAX_LATENCY */
} dp_block;

/* State of one joint. */
typedef struct {
    double x[DP_NX];
    double command;   /* last issued torque [N m] */
    double in_effect; /* torque in effect over the current period [N m] */
    double offset;    /* what is left of the step at a change of mode [N m] */
    double line[DP_MAX_LATENCY];
    int head, mode, position_loop, status, changed;
} dp_state;

typedef struct {
    int n;
    dp_block block[DP_MAX_JOINTS];
    dp_state state[DP_MAX_JOINTS];
} dp_controller;

/* Copies n blocks and clears the state: all joints active, position loop on, zero torque.
 * Returns 0, or -1 when n, nx, latency, blend or a limit is out of range. */
int dp_init(dp_controller *c, const dp_block *blocks, int n);

/* Clears the state, keeps modes. */
void dp_reset(dp_controller *c);

/* One tick: in[i*n + j] is input i of joint j; out[j] receives the command to send now.
 * Returns the statuses of all joints, or-ed. Never writes a non-finite torque. */
int dp_step(dp_controller *c, const double *in, double *out);

/* One tick in which the caller decides: issues torque[j] through the limits and the delay line, as dp_step
 * does, and leaves the blocks' states alone. A torque that is not finite holds the last one. */
int dp_issue(dp_controller *c, const double *torque, double *out);

/* The calls below do nothing for a joint or a mode that does not exist.
 * Off, bypass or active from the next tick on; the change is bumpless when blend > 0. */
void dp_set_mode(dp_controller *c, int joint, int mode);

/* With the position loop off the block sees zeros for inputs position ... torque ref. */
void dp_set_position_loop(dp_controller *c, int joint, int on);

/* Starts a joint in equilibrium: block state x (nx values) and a torque that has been in effect for long.
 * Does nothing where a value is not finite or beyond the torque limit. */
void dp_preset(dp_controller *c, int joint, const double *x, double torque);

/* Sets the virtual velocity from the last trusted joint velocity [rad/s]; ends any blending. */
void dp_warm_start(dp_controller *c, int joint, double velocity);

#ifdef __cplusplus
}
#endif
#endif
