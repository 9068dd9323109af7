/* A controller and its supervisor as C99 in a program of its own: an encoder falls silent, and the arm is braked.
 *
 *   dashpot export fr3 fr3 --to c --supervised
 *   cc -std=c99 -Wall -Werror -I out/export examples/09_exported.c out/export/fr3.c -o exported
 *   ./exported
 */
#include <stdio.h>

#include "fr3.h"

int main(void)
{
    static const double home[FR3_JOINTS] = {0.0, -0.8, 0.0, -2.4, 0.0, 1.6, 0.8}; /* rad */
    static fr3_controller c; /* all the memory there is */
    static fr3_supervisor s;
    if (fr3_check(&c) != 0 || fr3_supervisor_check(&s, &c) != 0)
        return 1; /* this build does not compute what was certified */
    for (int tick = 0; tick < 7; tick++) { /* on a robot: every FR3_PERIOD seconds */
        double in[FR3_NIN * FR3_JOINTS] = {0}, out[FR3_JOINTS];
        int torque_age[FR3_JOINTS] = {0}, encoder_age[FR3_JOINTS] = {0};
        for (int j = 0; j < FR3_JOINTS; j++) { /* here: read the robot */
            in[FR3_IN_TORQUE * FR3_JOINTS + j] = 0.1 + 0.01 * tick;
            in[FR3_IN_POSITION * FR3_JOINTS + j] = home[j];
            in[FR3_IN_POSITION_REF * FR3_JOINTS + j] = home[j] + 0.001;
            encoder_age[j] = j == 3 ? tick : 0; /* ticks since joint 4's encoder was heard */
        }
        int status = fr3_supervise(&s, &c, in, torque_age, encoder_age, out);
        printf("tick %d: joint 1 %.6f N m, status %d, state %d\n", tick, out[0], status, s.state);
        if (s.apply_brake)
            puts("close the brake"); /* here: do so; and then send `out` to the robot, whatever it is */
    }
    return 0;
}
