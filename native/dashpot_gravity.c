#include "dashpot_gravity.h"

void dp_gravity_torque(void *of, const double *position, double *torque)
{
    dp_gravity *g = of;
    for (int j = 0; j < g->n; j++)
        g->qpos[g->qpos_index[j]] = position[j];
    g->kinematics(g->model, g->data);
    g->com(g->model, g->data);
    g->rne(g->model, g->data, 0, g->all);
    for (int j = 0; j < g->n; j++)
        torque[j] = g->all[g->dof_index[j]];
}
