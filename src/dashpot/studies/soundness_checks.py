"""Second opinions for `dashpot.studies.soundness`: growth in many digits, damping at a single frequency."""

from __future__ import annotations

import math
from decimal import Decimal, localcontext

import numpy as np

from dashpot.certify.joint import SampledJoint
from dashpot.certify.port import lift

DIGITS, DOUBLINGS, TERMS = 60, 40, 50  # of that look: 2^40 periods, Taylor terms


def precise_radius(joint: SampledJoint, inertia: float, stiffness: float) -> float:
    """Spectral radius of a joint with a load, from its growth over 2^40 periods in 60 digits.

    Eigenvalues in double precision are worth no more than 1e-8 where two of them nearly coincide, as those
    of a heavy, freely turning link do. The joint's own coefficients are taken as exact.

    Args:
        joint: Its torque sampled as an average or behind a filter.
        inertia: [kg m^2].
        stiffness: [N m/rad].
    """
    assert not joint.speed_in_sample
    n, size = len(joint.flow), len(joint.jump)
    flow = np.zeros((n + 2, n + 2))
    flow[:n, :n], flow[:n, n] = joint.flow, joint.velocity_in
    flow[n, :n], flow[n, n], flow[n, n + 1] = joint.torque, joint.torque_w, -stiffness
    flow[n + 1, n] = 1.0
    units = np.append(joint.units, [1.0, joint.period])  # similarity: keeps the series short
    moving = np.r_[:n, size, size + 1]
    to_decimal = np.vectorize(Decimal, otypes=[object])
    with localcontext() as context:
        context.prec = DIGITS
        context.Emax, context.Emin = 10**15, -(10**15)
        exact = to_decimal(flow)
        exact[n] = exact[n] / Decimal(float(inertia))
        scale = to_decimal(units[moving])
        exact = exact * scale[None, :] / scale[:, None] * Decimal(joint.period)
        halvings = max(0, math.ceil(math.log2(float(np.abs(exact).astype(float).sum(1).max()) + 1e-300)) + 1)
        exact = exact / Decimal(2) ** halvings
        term = total = to_decimal(np.eye(n + 2))
        for i in range(1, TERMS):
            term = term @ exact / Decimal(i)
            total = total + term
        for _ in range(halvings):
            total = total @ total
        over, jump = to_decimal(np.eye(size + 2)), to_decimal(np.eye(size + 2))
        over[np.ix_(moving, moving)] = total
        scale = to_decimal(units)
        jump[:size, :size] = to_decimal(joint.jump)
        power = over @ (jump * scale[None, :] / scale[:, None])
        for _ in range(DOUBLINGS):
            power = power @ power
        return float((np.abs(power).max().ln() / Decimal(2) ** DOUBLINGS).exp())


def single_frequency(joint: SampledJoint, near: float, intervals: int = 32) -> float:
    """Least damping shown to a sinusoidal motion of the link, at any frequency [N m s/rad].

    The index is about motions that may also hold all aliases of a frequency, in any proportion; a load with
    one resonance cannot make such a motion.

    Args:
        joint: The joint.
        near: Where to look more closely, folded [Hz].
        intervals: The motion is a staircase of that many steps a period.
    """
    port = lift(joint, intervals)
    about = max(2 * np.pi * near * joint.period, 1e-5) * np.geomspace(0.8, 1.25, 41)
    angles = np.concatenate([np.geomspace(1e-5, 0.1, 80), np.linspace(0.105, np.pi, 160), about])
    form = port.response(np.minimum(angles, np.pi))
    form = (form + np.conj(np.swapaxes(form, -1, -2))) / 2
    # A frequency and its aliases: angles a, a +- 2 pi, ...; beyond half the steps they repeat.
    alias = 2 * np.pi * np.arange(-intervals // 2, intervals // 2)
    steps = np.arange(intervals) / intervals
    wave = np.exp(1j * (angles[:, None, None] + alias[:, None]) * steps) / np.sqrt(intervals)
    return float(np.einsum("tai,tij,taj->ta", wave.conj(), form, wave, optimize=True).real.min() * port.scale)
