"""The equations of the rivals: blocks in the shape of the sampled law, certified and run by the same code.

Each is a record of `dashpot.control.sampled.BLOCK_DTYPE` without limits. Signs are those of the drive: the
rotor obeys ``m th'' + v th' = u - tau_s`` with tau_s the torque the transmission carries to the link. The
position loop is ``pd = kp (q_d - q) + kd (q_d' - q') + torque_ref``.
"""

from __future__ import annotations

import math
import numbers

import numpy as np
from numpy.typing import NDArray

from dashpot.control.sampled import (
    ACCELERATION_REF,
    IN_EFFECT,
    POSITION,
    POSITION_REF,
    TORQUE,
    VELOCITY,
    VELOCITY_REF,
    empty_block,
    pd_block,
)
from dashpot.errors import InputError
from dashpot.support.tables import as_float


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
    as in the explicit form of `dashpot.control.sampled.virtual_passive_block`. Only friction pulls the
    prediction back to the rotor: with v = 0 an error of it stays, and no passivity index covers the joint.

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


def encoder_damping_block(damping: float) -> NDArray[np.void]:
    """Damping by the encoder, ``u = -b q'``: what a brake could do if the encoder were not lost.

    Args:
        damping: b [N m s/rad].

    Returns:
        A record of `BLOCK_DTYPE`.

    Raises:
        InputError: An argument is out of range.
    """
    block = empty_block()
    block["D"][VELOCITY] = -_number("damping [N m s/rad]", damping)
    return block


def latched_torque_block(latency: int, blend: float) -> NDArray[np.void]:
    """The torque at the moment of engaging stays: ``u = u_last``.

    Without latency the torque in effect is the last one commanded, and ``u = u'``. With latency it is older
    than the last, which is still known where a change of mode is faded in: the first tick continues it as an
    offset to u = 0 that decays by `blend`. A state that gains ``1 - blend`` of it at every tick,
    ``x+ = x + (1 - blend)(u_issued - u)`` and ``u = x``, replaces exactly what is lost. A warm start ends the
    fading, so this form must not be given one.

    Args:
        latency: Ticks from command to effect.
        blend: Decay of a change of mode per tick, as in the block [-].

    Returns:
        A record of `BLOCK_DTYPE`.

    Raises:
        InputError: There is a latency and no fading.
    """
    block = empty_block()
    if latency == 0:
        block["D"][IN_EFFECT] = 1.0
        return block
    if not blend > 0:
        raise InputError(
            "must be above 0 where there is a latency: the last torque is known only while it is faded out",
            quantity="blend [s]",
            value=0.0,
        )
    block["nx"] = 1
    block["A"][0, 0] = block["C"][0] = 1.0
    block["E"][0] = 1 - blend
    return block


def pid_block(kp: float, ki: float, kd: float, period: float) -> NDArray[np.void]:
    """PD with the integral of the position error: ``u = pd + ki integral(q_d - q)``.

    The integral is the trapezoidal rule: exact for an error that is a polygon between ticks. Anti-windup by
    back-calculation (Astrom and Haegglund, PID Controllers, 1995, section 3.5) with the tracking time kp/ki:
    what the limits took from the torque is taken from the integral.

    Args:
        kp: [N m/rad].
        ki: [N m/(rad s)]; 0: the PD controller, bit for bit.
        kd: [N m s/rad].
        period: Sample period [s].

    Returns:
        A record of `BLOCK_DTYPE`; its state is the integral's torque [N m], its bypass the PD controller.

    Raises:
        InputError: An argument is out of range.
    """
    kp, ki = _number("kp [N m/rad]", kp), _number("ki [N m/(rad s)]", ki)
    period = _number("period [s]", period, positive=True)
    block = pd_block(kp, _number("kd [N m s/rad]", kd))
    if ki == 0:
        return block
    block["nx"] = 1
    block["A"][0, 0] = block["C"][0] = 1.0
    block["B"][0, [POSITION_REF, POSITION]] = ki * period, -ki * period
    block["D"][[POSITION_REF, POSITION]] += ki * period / 2, -ki * period / 2
    block["E"][0] = min(1.0, ki * period / kp) if kp > 0 else 1.0
    return block


def disturbance_observer_block(
    inertia: float, friction: float, cutoff: float, kp: float, kd: float, period: float
) -> NDArray[np.void]:
    """PD that cancels an estimated disturbance: ``u = pd - d``, ``d = Q (m w' + v w - u')``.

    Source: Ohnishi, Shibata and Murakami, Motion control for advanced mechatronics, IEEE/ASME Trans.
    Mechatronics 1(1), 1996. Q is a first-order low-pass. Exact for a disturbance and a torque u' held over
    the past period: two speeds give the net torque n between them,
    ``m w[k] = m exp(-v h/m) w[k-1] + n integral exp(-v t/m) dt``; the disturbance is ``n - u'``, its low-pass
    a geometric mean with ``exp(-2 pi cutoff h)``. u' is the torque in effect, so that nothing winds up behind
    a limit. In continuous time and with the true m and v it is, for constant references, a PID controller
    with gains ``kp + (kd + v) c``, ``kp c`` and ``kd + m c``, c the cutoff in rad/s.

    Args:
        inertia: m assumed [kg m^2].
        friction: v assumed [N m s/rad].
        cutoff: Of Q [Hz].
        kp: [N m/rad].
        kd: [N m s/rad].
        period: Sample period [s].

    Returns:
        A record of `BLOCK_DTYPE`; states: the last speed [rad/s] and d [N m]. `warm` sets the speed, its
        bypass is the PD controller.

    Raises:
        InputError: An argument is out of range.
    """
    inertia = _number("inertia [kg m^2]", inertia, positive=True)
    friction = _number("friction [N m s/rad]", friction)
    cutoff = _number("cutoff [Hz]", cutoff, positive=True)
    period = _number("period [s]", period, positive=True)
    decay = friction / inertia * period
    span = period * (-math.expm1(-decay) / decay if decay > 0 else 1.0)
    new = -math.expm1(-2 * math.pi * cutoff * period)  # share of the newest disturbance
    block = pd_block(_number("kp [N m/rad]", kp), _number("kd [N m s/rad]", kd))
    block["nx"] = 2
    block["B"][0, VELOCITY] = 1.0
    block["A"][1, :2] = -new * inertia * math.exp(-decay) / span, 1 - new
    block["B"][1, [VELOCITY, IN_EFFECT]] = new * inertia / span, -new
    block["C"] = -block["A"][1]
    block["D"] -= block["B"][1]
    block["warm"][0] = 1.0
    return block


def torque_feedback_block(
    inertia: float, friction: float, kp: float, kd: float, gain: float = 1.0
) -> NDArray[np.void]:
    """Joint torque feedback: cancel load and friction, then prescribe the rotor's motion.

    ``u = K tau_s + v q' + m q_d'' + pd`` with K = 1 in the source: Kosuge, Takeuchi and Furuta, Motion
    control of a robot arm using joint torque sensors, IEEE Trans. Robotics and Automation 6(2), 1990, whose
    gains are ``kp/m`` and ``kd/m``. Its term f, the rotor's coupling to the link before it, is left out as
    everywhere here. Sampled as it stands: u at a tick takes the torque sample (mean over the last period, or
    point) and the position and velocity of that tick; no state.

    Args:
        inertia: m assumed [kg m^2].
        friction: v assumed [N m s/rad].
        kp: [N m/rad].
        kd: [N m s/rad].
        gain: K [-], at most 1.

    Returns:
        A record of `BLOCK_DTYPE`; its bypass is the PD controller.

    Raises:
        InputError: An argument is out of range.
    """
    gain = _number("gain [-]", gain)
    if gain > 1:
        raise InputError("must be at most 1", quantity="gain [-]", value=gain)
    block = pd_block(_number("kp [N m/rad]", kp), _number("kd [N m s/rad]", kd))
    block["D"][TORQUE] = gain
    block["D"][VELOCITY] += _number("friction [N m s/rad]", friction)
    block["D"][ACCELERATION_REF] = _number("inertia [kg m^2]", inertia, positive=True)
    return block


def scaled_pd_block(scale: float, kp: float, kd: float) -> NDArray[np.void]:
    """PD with its gains multiplied: ``u = scale (kp (q_d - q) + kd (q_d' - q')) + torque_ref``.

    With scale R it has the static load error of the virtual passive law with R, K > 0 and the same kp.

    Args:
        scale: [-], positive.
        kp: [N m/rad].
        kd: [N m s/rad].

    Returns:
        A record of `BLOCK_DTYPE`; its bypass is the PD controller with the gains as they are.

    Raises:
        InputError: An argument is out of range.
    """
    scale = _number("scale [-]", scale, positive=True)
    block = pd_block(_number("kp [N m/rad]", kp), _number("kd [N m s/rad]", kd))
    block["D"][[POSITION, VELOCITY, POSITION_REF, VELOCITY_REF]] *= scale
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
