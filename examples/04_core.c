/* The controller core in plain C.
 *
 *   cc -std=c99 -Wall -Werror -I native examples/04_core.c native/dashpot_core.c -o core
 *   ./core
 */
#include <math.h>
#include <stdio.h>

#include "dashpot_core.h"

int main(void)
{
    /* A dashpot on the position loop's velocity input: u = -2 (velocity), limited to 5 N m. */
    dp_block block = {0};
    block.D[3] = -2.0;
    block.torque_limit = 5.0;
    block.rate_limit = INFINITY;
    dp_controller controller;
    if (dp_init(&controller, &block, 1) != 0)
        return 1;
    for (int tick = 0; tick < 4; tick++) {
        double in[DP_NIN] = {0}, out[1];
        in[DP_IN_VELOCITY] = 1.5 * tick;
        int status = dp_step(&controller, in, out);
        printf("velocity %.1f rad/s: torque %.1f N m%s\n", in[DP_IN_VELOCITY], out[0],
               status & DP_TORQUE_LIMITED ? " (limited)" : "");
    }
    return 0;
}
