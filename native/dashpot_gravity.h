/* The robot's own gravity compensation: the torque that holds its bare links where its encoders say that they are.
 *
 * As on the robot, it is computed once per control tick from the encoders as they are, also where they have failed,
 * knows nothing of the payload or of the springs' deflections, and is added to every command below the interface.
 * The engine's inverse dynamics gives it, for a model of the same arm without a payload, at rest.
 */
#ifndef DASHPOT_GRAVITY_H
#define DASHPOT_GRAVITY_H

#include "dashpot_core.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct dp_gravity {
    void (*kinematics)(const void *model, void *data); /* mj_kinematics, mj_comPos, mj_rne */
    void (*com)(const void *model, void *data);
    void (*rne)(const void *model, void *data, int acceleration, double *result);
    const void *model;
    void *data;      /* at rest */
    double *qpos;    /* of data */
    double *all;     /* room for every degree of freedom of the model */
    int n;
    int qpos_index[DP_MAX_JOINTS], dof_index[DP_MAX_JOINTS]; /* of the rotors */
} dp_gravity;

/* torque[j] holds joint j at rest at the angles position [rad], both of n joints [N m]; g is a dp_gravity. */
void dp_gravity_torque(void *g, const double *position, double *torque);

#ifdef __cplusplus
}
#endif
#endif
