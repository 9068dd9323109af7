"""A check an exported controller carries along: does this build compute what dashpot computed, bit for bit?

Contraction into fused multiply-adds, wider registers or "fast" mathematics change results, and no compiler
tells. The exported file therefore can run a fixed sequence and compare a hash of all torques with the one
computed here by the native controller: `CONTROLLER` and `SUPERVISOR` are that sequence in C,
`controller_hash` and `supervisor_hash` the same in Python.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

import dashpot._native as _native
from dashpot.support.arrays import Floats

TICKS = 96
SCALES = (4.0, 2.0**-6, 2.0**-2, 2.0**-6, 2.0**-2, 1.0, 1.0)  # of the inputs, in their units
QUIET = 2.0**-10  # of the first half, for the supervisor: signals it has no reason to doubt

STIMULUS = """
/* The sequence of the checks: inputs of one tick from a linear congruence, exact in any arithmetic. */
static void stimulus(uint32_t *random, double scale, double *in)
{
    static const double scales[DP_NIN] = {4.0, 0.015625, 0.25, 0.015625, 0.25, 1.0, 1.0};
    for (int i = 0; i < DP_NIN * DP_JOINTS; i++) {
        *random = *random * 1664525u + 1013904223u;
        in[i] = scale * scales[i / DP_JOINTS] * ((double)(*random >> 8) / 8388608.0 - 1.0);
    }
}

static uint32_t hashed(uint32_t hash, const double *out, int status)
{
    for (int j = 0; j < DP_JOINTS; j++) {
        union { double number; uint64_t bits; } torque;
        torque.number = out[j];
        hash = (hash ^ (uint32_t)(torque.bits & 0xffffffffu)) * 16777619u;
        hash = (hash ^ (uint32_t)(torque.bits >> 32)) * 16777619u;
    }
    return (hash ^ (uint32_t)status) * 16777619u;
}
"""

CONTROLLER = """
int dp_check(dp_controller *c)
{
    double in[DP_NIN * DP_JOINTS], out[DP_JOINTS];
    uint32_t random = 1u, hash = 2166136261u;
    dp_init(c);
    for (int tick = 0; tick < @TICKS@; tick++) {
        for (int j = 0; j < DP_JOINTS; j++) {
            if (tick % 16 == 8)
                dp_set_mode(c, j, (tick / 16 + j) % 3);
            if (tick % 16 == 12)
                dp_set_position_loop(c, j, (tick / 16 + j) % 2);
            if (tick % 32 == 20)
                dp_warm_start(c, j, 0.25);
        }
        stimulus(&random, 1.0, in);
        const int status = dp_step(c, in, out);
        hash = hashed(hash, out, status);
    }
    dp_init(c);
    return hash == @HASH@u ? 0 : -1;
}
"""

SUPERVISOR = """
int dp_supervisor_check(dp_supervisor *s, dp_controller *c)
{
    double in[DP_NIN * DP_JOINTS], out[DP_JOINTS];
    const int age[DP_JOINTS] = {0};
    uint32_t random = 1u, hash = 2166136261u;
    dp_init(c);
    dp_supervisor_init(s);
    for (int tick = 0; tick < @TICKS@; tick++) {
        stimulus(&random, tick < @TICKS@ / 2 ? 0.0009765625 : 1.0, in);
        const int status = dp_supervise(s, c, in, age, age, out);
        hash = hashed(hash, out, status + 256 * s->state);
    }
    dp_init(c);
    dp_supervisor_init(s);
    return hash == @HASH@u ? 0 : -1;
}
"""


def controller_hash(blocks: NDArray[np.void]) -> int:
    """What ``dp_check`` must arrive at with these blocks."""
    core = _native.Core(blocks.view(np.uint8))
    n, random, hash_ = core.n, 1, 2166136261
    out = np.zeros(n)
    for tick in range(TICKS):
        for j in range(n):
            if tick % 16 == 8:
                core.set_mode(j, (tick // 16 + j) % 3)
            if tick % 16 == 12:
                core.set_position_loop(j, bool((tick // 16 + j) % 2))
            if tick % 32 == 20:
                core.warm_start(j, 0.25)
        random, inputs = _stimulus(random, 1.0, n)
        hash_ = _hashed(hash_, out, core.step(inputs, out))
    return hash_


def supervisor_hash(blocks: NDArray[np.void], rules: NDArray[np.void], watch: NDArray[np.void]) -> int:
    """What ``dp_supervisor_check`` must arrive at."""
    core = _native.Core(blocks.view(np.uint8))
    guard = _native.Guard(core, rules.reshape(1).view(np.uint8), watch.view(np.uint8))
    random, hash_ = 1, 2166136261
    out = np.zeros(core.n)
    for tick in range(TICKS):
        random, core.inputs[:] = _stimulus(random, QUIET if tick < TICKS // 2 else 1.0, core.n)
        status = guard.step(out)
        hash_ = _hashed(hash_, out, status + 256 * guard.state)
    return hash_


def _stimulus(random: int, scale: float, n: int) -> tuple[int, Floats]:
    inputs = np.zeros((len(SCALES), n))
    for i in range(inputs.size):
        random = (random * 1664525 + 1013904223) & 0xFFFFFFFF
        inputs.flat[i] = scale * SCALES[i // n] * ((random >> 8) / 8388608.0 - 1.0)
    return random, inputs


def _hashed(hash_: int, out: Floats, status: int) -> int:
    for word in (*struct.unpack(f"<{2 * len(out)}I", out.astype("<f8").tobytes()), status):
        hash_ = ((hash_ ^ word) * 16777619) & 0xFFFFFFFF
    return hash_
