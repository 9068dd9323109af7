"""Other joint controllers in the shape of the sampled law, to be certified and simulated by the same code.

Each is a record of `dashpot.sampled.BLOCK_DTYPE` without limits. Signs are those of the drive: the rotor
obeys ``m th'' + v th' = u - tau_s`` with tau_s the torque the transmission carries to the link.
"""

from __future__ import annotations

import math
import numbers

import numpy as np
from numpy.typing import NDArray

from dashpot.errors import InputError
from dashpot.sampled import IN_EFFECT, TORQUE, empty_block, pd_block
from dashpot.tables import as_float


def static_feedback_block(gain: float) -> NDArray[np.void]:
    """Static positive torque feedback ``u = K_tau tau_s``, no state.

    It leaves ``m th'' + v th' = -(1 - K_tau) tau_s``: to the load, rotor inertia and friction look
    ``1/(1 - K_tau)`` times what they are. Source: Aldridge & Juang, (A8), which needs K_tau < 1; 0 is off.

    Args:
        gain: K_tau [-], at least 0 and below 1.

    Returns:
        A record of `BLOCK_DTYPE`.

    Raises:
        InputError: An argument is out of range.
    """
    gain = _number("gain [-]", gain)
    if not 0 <= gain < 1:
        raise InputError("must be at least 0 and below 1", quantity="gain [-]", value=gain)
    block = empty_block()
    block["D"][TORQUE] = gain
    return block


def rotor_observer_block(inertia: float, friction: float, damping: float, period: float) -> NDArray[np.void]:
    """Brake on the rotor speed that a model of the rotor predicts, without correction by the encoder.

    ``m w' = u - tau_s - v w``, ``u = -b w``: exact for inputs held over the past period, that is for the
    interval average of tau_s and for u the torque in effect over it. The output uses the state at the tick,
    as in the explicit form of `dashpot.sampled.virtual_passive_block`. Only friction pulls the prediction
    back to the rotor: with v = 0 an error of it stays, and no passivity index covers the joint.

    Args:
        inertia: m assumed [kg m^2].
        friction: v assumed [N m s/rad].
        damping: b [N m s/rad].
        period: Sample period [s].

    Returns:
        A record of `BLOCK_DTYPE`; `warm` sets w to the joint velocity.

    Raises:
        InputError: An argument is out of range.
    """
    inertia = _number("inertia [kg m^2]", inertia, positive=True)
    friction = _number("friction [N m s/rad]", friction)
    damping = _number("damping [N m s/rad]", damping)
    period = _number("period [s]", period, positive=True)
    decay = friction / inertia * period
    phi = math.exp(-decay)
    gamma = period / inertia * (-math.expm1(-decay) / decay if decay > 0 else 1.0)
    block = empty_block()
    block["nx"] = 1
    block["A"][0, 0] = phi
    block["B"][0, TORQUE], block["B"][0, IN_EFFECT] = -gamma, gamma
    block["C"][0] = -damping * phi
    block["D"][TORQUE], block["D"][IN_EFFECT] = damping * gamma, -damping * gamma
    block["warm"][0] = 1.0
    return block


def inertia_shaping_block(ratio: float, kp: float, kd: float) -> NDArray[np.void]:
    """Inertia shaping by torque feedback, around a PD controller; no state.

    ``u = (B/B_d) w + (1 - B/B_d) tau_s`` with ``w = kp (q_d - q) + kd (q_d' - q') + torque_ref`` turns the
    rotor of inertia B into ``B_d th'' + (B_d/B) v th' = w - tau_s``. Source: Ott, Albu-Schaeffer, Kugi and
    Hirzinger, On the passivity-based impedance control of flexible joint robots, IEEE Trans. Robotics 24(2),
    2008. There ``B/B_d > 1`` makes the rotor look lighter; below 1 it looks heavier, and `ratio` 1 is the PD
    controller alone.

    Args:
        ratio: B/B_d [-], positive.
        kp: [N m/rad].
        kd: [N m s/rad].

    Returns:
        A record of `BLOCK_DTYPE`; its bypass is the PD controller alone.

    Raises:
        InputError: An argument is out of range.
    """
    ratio = _number("ratio [-]", ratio, positive=True)
    block = pd_block(_number("kp [N m/rad]", kp), _number("kd [N m s/rad]", kd))
    block["D"] *= ratio
    block["D"][TORQUE] = 1 - ratio
    return block


def _number(quantity: str, value: object, *, positive: bool = False) -> float:
    """The argument as a float, finite and not negative, or positive."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise InputError("must be a number", quantity=quantity, value=value)
    number = as_float(value)
    if not math.isfinite(number) or number < 0 or (positive and number == 0):
        rule = "positive" if positive else "not negative"
        raise InputError(f"must be finite and {rule}", quantity=quantity, value=value)
    return number
