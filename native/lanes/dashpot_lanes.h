/* Many scenarios of one arm at a time: rigid links, elastic drives and all, a scenario per lane of a vector register.
 *
 * What happens at a control tick is dp_run's own code (dp_tick_sense, dp_tick_control), once per scenario; between two
 * ticks the physics of all lanes advances together. Written once for any number of lanes, and compiled for each
 * instruction set without fused operations, so that a scenario's bits depend neither on its lane nor on the machine.
 */
#ifndef DASHPOT_LANES_H
#define DASHPOT_LANES_H

#include "dashpot_runner.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { DP_MAX_LINKS = 24, DP_MAX_LANES = 8 };

/* How the links hang together; base to tip. Joint i turns its link about the z axis of its own frame, or slides it along
 * that; the frame lies at a place and with a turn in that of its parent's (or the world's), where the joint is at 0. */
typedef struct {
    int links;
    int parent[DP_MAX_LINKS]; /* -1: the base; always less than i */
    int slides[DP_MAX_LINKS];
    int drive[DP_MAX_LINKS];  /* that moves it, or -1: a joint without a motor */
    int qpos[DP_MAX_LINKS], dof[DP_MAX_LINKS]; /* of a joint without a motor */
    double zero[DP_MAX_LINKS];                 /* what qpos says where the joint is at 0, rotor plus spring [rad, m] */
    double place[DP_MAX_LINKS][3], turn[DP_MAX_LINKS][9]; /* row by row */
    int along[DP_MAX_LINKS][3]; /* where a turn only renames axes, as most do: the parent's axis that each of ours lies */
    double sense[DP_MAX_LINKS][3]; /* along, and which way, +1 or -1; along[0] = -1 elsewhere */
    double gravity[3];                         /* [m/s^2] */
    /* Joints without a motor; the spring is at rest where the joint is at `rest`. */
    double armature[DP_MAX_LINKS], damping[DP_MAX_LINKS], stiffness[DP_MAX_LINKS], rest[DP_MAX_LINKS];
} dp_tree;

enum { DP_MASS, DP_CENTRE, DP_INERTIA = 4, DP_NBODY = 10 };
/* Mass [kg], centre of mass (3) [m] and inertia about it (xx yy zz xy xz yz) [kg m^2] in the joint's frame. */

typedef struct {
    dp_controller *c;    /* or null */
    dp_run_args a;       /* as for dp_run, but for step, model and data, gravity, first = 0 and last */
    const double *rotor; /* [drives][2]: rotor inertia [kg m^2], viscous friction [N m s/rad] */
    int loads;           /* >= 1 */
    const int *load_tick; /* [loads]: when it is taken, ascending; the first at 0 */
    const double *load;  /* [loads][links][DP_NBODY] */
    const double *bare;  /* [links][DP_NBODY] that the robot itself carries, or null */
    double *qpos, *qvel; /* those of a, to be written */
    dp_tick tick;
} dp_lane;

typedef struct {
    int width;
    const char *name;
    /* Runs up to width scenarios of one time step and one number of steps per tick, each to its end. */
    void (*run)(const dp_tree *tree, dp_lane *lane, int count);
    /* Accelerations [links] of the rigid tree, drives' joints without rotors: qdd = H^-1 (torque - bias). Also gives H
     * [links][links] and the bias, where they are not null. All of count rows; body is [count][links][DP_NBODY]. */
    void (*forward)(const dp_tree *tree, const double *body, const double *q, const double *qd, const double *torque,
                    double *qdd, double *H, double *bias, int count);
    /* sin, cos and exp(-x) of count numbers, for tests. */
    void (*functions)(const double *x, double *sine, double *cosine, double *decay, int count);
} dp_lanes;

/* The widths this machine can run, narrowest first; null beyond the last. */
const dp_lanes *dp_lanes_at(int i);

#ifdef __cplusplus
}
#endif
#endif
