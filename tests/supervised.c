/* A joint in plain C under a supervisor: prints the ages it is given, and how the joint ends (test_faults.py). */
#include <stdio.h>

#include "dashpot_faults.h"

struct dp_supervisor { int calls, brake; };

static double q[2], v[2], force[2];

/* Rotor 0.05 and link 0.2 kg m^2, transmission 6e3 N m/rad, 9 N m s/rad */
static void step(const void *model, void *data)
{
    (void)model, (void)data;
    const double spring = 6e3 * q[1] + 9.0 * v[1], rotor = (force[0] - force[1] + spring) / 0.05;
    v[0] += 1e-4 * rotor;
    v[1] += 1e-4 * ((force[1] - spring) / 0.2 - rotor);
    q[0] += 1e-4 * v[0];
    q[1] += 1e-4 * v[1];
}

static int supervise(struct dp_supervisor *s, dp_controller *c, const double *in, const int *torque_age,
                     const int *encoder_age, double *out)
{
    printf("%d %d\n", torque_age[0], encoder_age[0]);
    s->brake = ++s->calls > 60;
    return dp_step(c, in, out);
}

int main(void)
{
    static dp_faults f;
    dp_block block = {.torque_limit = 10.0, .rate_limit = 1e9, .D = {[4] = 1.0}}; /* torque: position reference */
    dp_drive d = {.stiffness = 6e3, .damping = 9.0, .torque_limit = 10.0, .actuator_gain = 1.0, .sensor_gain = 1.0,
                  .stop_lower = -1e9, .stop_upper = 1e9, .presliding_stiffness = 1e4, .presliding_damping = 20.0,
                  .spring_qpos = 1, .spring_dof = 1, .inner_steps = 1, .average = 1};
    dp_fault fault[] = {{.kind = DP_FAULT_SAMPLES_DROPPED, .first = 10, .last = 20, .value = 1.0},
                        {.kind = DP_FAULT_ENCODER_LOST, .first = 30, .last = 35},
                        {.kind = DP_FAULT_SAMPLES_LATE, .first = 40, .last = 50, .value = 3.0},
                        {.kind = DP_FAULT_BROWNOUT, .first = 55, .last = 57}};
    const dp_fault_drive of = {8.0, 1.0, 100.0};
    double reference[4 * 200] = {0}, record[DP_NREC * 200];
    struct dp_supervisor s = {0, 0};
    dp_controller c;
    dp_run_args a = {.step = step, .qpos = q, .qvel = v, .qfrc_applied = force, .dt = 1e-4, .steps_per_tick = 10,
                     .ticks = 200, .last = 200, .drives = 1, .drive = &d, .reference = reference, .record = record,
                     .faults = &f, .supervise = supervise, .supervisor = &s, .apply_brake = &s.brake};
    for (int k = 0; k < 200; k++)
        reference[k] = 1.0;
    if (dp_init(&c, &block, 1) || dp_faults_init(&f, fault, 4, &of, 1, 0.02) || dp_run(&c, &a))
        return 1;
    printf("%d %.9g %.9g %.9g\n", s.calls, record[200 + 60], record[200 + 199], record[7 * 200 + 199]);
    return 0;
}
