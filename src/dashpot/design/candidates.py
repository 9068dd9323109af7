"""Sets of gains of one joint, and what each of them would do: the quantities a user can wish for.

With K = 0 the law is a first-order lag from sensed torque to motor torque (Eqs. (20)-(21) without u'),

    C(s) = C0 / (1 + s/w_c),    C0 = g/(1 + g),    g = R a/D,    w_c = (D + R a)/(R m),    a = R v + D.

Statically the joint looks 1 + g times as heavy and as rough, which is what load error, hold and creep show;
w_c is how fast. g and w_c cover all R and D, and the certificate's boundary is simple in them. K > 0 is
measured by the damping of the virtual oscillator, ``zeta = D / (2 sqrt(R m K))``; g and w_c then are those of
the same R and D.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from dashpot.arm.drive import Drive
from dashpot.certify.map import response
from dashpot.control.controller import ControllerConfig, JointGains
from dashpot.control.sampled import (
    BLOCK_DTYPE,
    Form,
    VirtualPassive,
    add_position_loop,
    virtual_passive_block,
)
from dashpot.design.motion import move
from dashpot.support.arrays import Floats

DIGITS = 4
ANGLES = np.concatenate([[0.0], np.geomspace(1e-5, 0.1, 40), np.linspace(0.12, np.pi, 70)])
STOP_HORIZON = 4.0  # [s]; a joint that has not stopped by then is said not to stop
WATCHED, CREEPING = 1.0, 4.0  # [s]
FIRST_HORIZON = 0.25  # [s], doubled while something moves


@dataclass(frozen=True)
class Gains:
    """k candidates for one joint.

    Attributes:
        R: (k,) [-].
        D: (k,) [N m s/rad].
        K: (k,) [N m/rad].
        kp: (k,) [N m/rad].
        kd: (k,) [N m s/rad].
    """

    R: Floats
    D: Floats
    K: Floats
    kp: Floats
    kd: Floats

    @classmethod
    def of(
        cls,
        drive: Drive,
        static: Floats,
        corner: Floats,
        zeta: Floats,
        kp: Floats | float,
        kd: Floats | float,
    ) -> Gains:
        """Gains from g [-], w_c [rad/s] and zeta (infinite: K = 0), arrays that broadcast to (k,)."""
        m, v = drive.rotor_inertia, drive.viscous_friction
        R = static * corner * m / ((1 + static) * v + corner * m)
        D = corner * R * m / (1 + static)
        K = D**2 / (4 * zeta**2 * R * m)
        parts = np.broadcast_arrays(R, D, K, kp, kd)
        return cls(*(_rounded(np.array(part, float).ravel()) for part in parts))

    @classmethod
    def from_joint(cls, gains: JointGains) -> Gains:
        """One candidate: gains of a controller file."""
        return cls(*(np.array([getattr(gains, f.name)], float) for f in fields(cls)))

    def __len__(self) -> int:
        return len(self.R)

    def __getitem__(self, chosen: NDArray[np.bool_] | NDArray[np.int64] | Sequence[int]) -> Gains:
        return Gains(*(getattr(self, f.name)[chosen] for f in fields(self)))

    def joint(self, name: str, i: int = 0) -> JointGains:
        """One of them as it stands in a controller file."""
        return JointGains(
            name, **{f.name: float(f"{getattr(self, f.name)[i]:.{DIGITS}g}") for f in fields(self)}
        )


def _rounded(values: Floats) -> Floats:
    """To `DIGITS`, as gains are written: what is searched is what will run."""
    with np.errstate(divide="ignore"):
        place = np.floor(np.log10(np.abs(values)))
    unit = 10.0 ** (np.where(np.isfinite(place), place, 0.0) - (DIGITS - 1))
    return np.asarray(np.round(values / unit) * unit)


_block = functools.lru_cache(1 << 15)(virtual_passive_block)


@dataclass(frozen=True)
class Duty:
    """What one joint has to do, and by which means.

    Attributes:
        drive: Its drive.
        period: [s].
        latency: [samples].
        latency_max: [samples].
        sampling: "average" or "point".
        form: "implicit" or "explicit".
        inertia: Link's own inertia about the axis, without payload [kg m^2].
        loaded: With the largest payload, at the worst pose [kg m^2].
        load: Largest torque the payload puts on the joint [N m].
        speed: From which it must stop [rad/s].
        residual: Share of it below which it counts as stopped [-].
        jump: Position error that must not saturate the motor [rad].
        torque_gain: Sensor times actuator scale over the assumed one [-].
    """

    drive: Drive
    period: float
    latency: int
    latency_max: int
    sampling: str
    form: Form
    inertia: float
    loaded: float
    load: float
    speed: float
    residual: float
    jump: float
    torque_gain: float = 1.0

    def config(self, joints: tuple[JointGains, ...]) -> ControllerConfig:
        """A controller with these means."""
        return ControllerConfig(
            joints,
            period=self.period,
            latency=self.latency,
            latency_max=None if self.latency_max == self.latency else self.latency_max,
            sampling=self.sampling,  # type: ignore[arg-type]
            form=self.form,
        )

    def blocks(self, gains: Gains, *, brake: bool = False) -> NDArray[np.void]:
        """Their controllers, (k,) records of `dashpot.control.sampled.BLOCK_DTYPE`; brakes have no position
        loop.
        """
        drive, found = self.drive, np.empty(len(gains), BLOCK_DTYPE)
        first, which = distinct_laws(gains)
        m, v = drive.rotor_inertia, drive.viscous_friction
        laws = np.empty(len(first), BLOCK_DTYPE)
        for i, j in enumerate(first):
            law = VirtualPassive(float(gains.R[j]), float(gains.D[j]), float(gains.K[j]), m, v)
            laws[i] = _block(law, self.period, self.form)
        found[:] = laws[which]
        if not brake:
            for i in range(len(gains)):
                found[i] = add_position_loop(found[i], gains.kp[i], gains.kd[i])
        found["torque_limit"], found["rate_limit"] = drive.torque_limit, drive.torque_rate_limit * self.period
        found["latency"] = self.latency
        return found


def static_gain(duty: Duty, gains: Gains) -> Floats:
    """By how much less a load moves the joint than the position loop alone, (k,) [-]: R a/D, or R if K > 0.

    With another scale of the torque channel it is ``C(0) / (1 - C(0))`` with C(0) scaled; infinite beyond 1.
    """
    a = gains.R * duty.drive.viscous_friction + gains.D
    exact = np.where(gains.K > 0, gains.R, gains.R * a / gains.D)
    rest = 1 + exact * (1 - duty.torque_gain)
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(rest > 0, exact * duty.torque_gain / np.maximum(rest, 0.0), np.inf))


def hold(duty: Duty, gains: Gains) -> Floats:
    """Largest load that the joint's friction holds as a brake, (k,) [N m]: (1 + g) tau_c."""
    return np.asarray((1 + static_gain(duty, gains)) * duty.drive.coulomb_friction)


def creep(duty: Duty, gains: Gains) -> Floats:
    """Speed at which the load moves the brake in the long run, (k,) [rad/s].

    ``(tau_g/(1 + g) - tau_c)/v`` where positive; infinite without viscous friction.
    """
    drive = duty.drive
    excess = np.maximum(duty.load / (1 + static_gain(duty, gains)) - drive.coulomb_friction, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(excess > 0, excess / drive.viscous_friction, 0.0)


def load_error(duty: Duty, gains: Gains) -> Floats:
    """Largest error of the rotor's position at rest under the load, with position loop, (k,) [rad].

    ``(tau_g + (1 + g) tau_c)/(g kp)``: friction may hold the rotor on the wrong side.
    """
    g = static_gain(duty, gains)
    with np.errstate(divide="ignore", invalid="ignore"):
        friction = (1 + 1 / g) * duty.drive.coulomb_friction
        return np.asarray((duty.load / g + friction) / gains.kp)


def error_ratio(duty: Duty, gains: Gains) -> Floats:
    """How far a load moves the joint, over the same without torque feedback, (k,) [-]: 1/g."""
    return np.asarray(1 / static_gain(duty, gains))


def authority(duty: Duty, gains: Gains) -> Floats:
    """Share of the torque limit that is asked for, (k,) [-].

    The largest of: first torque of a stop, ``a speed``; answer to a position error, ``kp jump``; to a speed
    error, ``kd speed``; the load that is held.
    """
    a = gains.R * duty.drive.viscous_friction + gains.D
    asked = np.maximum.reduce(
        [a * duty.speed, gains.kp * duty.jump, gains.kd * duty.speed, np.full(len(gains), duty.load)]
    )
    return np.asarray(asked / duty.drive.torque_limit)


def noise(duty: Duty, gains: Gains) -> Floats:
    """RMS of the torque command from sensor noise over the torque limit, (k,) [-].

    White torque noise and the encoder's quantisation (variance q^2/12, velocity as difference quotient) pass
    through the controller; the joint's own answer to them is left out.
    """
    drive = duty.drive
    torque, position = noise_gains(duty, gains)
    power = torque**2 * drive.torque_noise**2 + position**2 * drive.position_resolution**2 / 12
    return np.asarray(np.sqrt(power) / drive.torque_limit)


def noise_gains(duty: Duty, gains: Gains) -> tuple[Floats, Floats]:
    """RMS of the command over that of white noise in torque [-] and position [N m/rad] samples, (k,) each."""
    first, which = distinct_laws(gains)
    s = (1 - np.exp(-1j * ANGLES)) / duty.period
    laws = duty.blocks(gains[first], brake=True)
    power = np.concatenate(
        [np.abs(response(some, ANGLES)) ** 2 for some in np.array_split(laws, max(1, len(laws) // 2000))]
    )
    width = np.gradient(ANGLES) / np.pi
    plain, mixed, fast = (power @ (width * weight) for weight in (1.0, 2 * s.real, np.abs(s) ** 2))
    kp, kd = gains.kp, gains.kd
    position = kp**2 * plain[which] + kp * kd * mixed[which] + kd**2 * fast[which]
    return np.sqrt(plain[which]), np.sqrt(np.maximum(position, 0.0))


def distinct_laws(gains: Gains) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Candidates with different R, D, K: where each is first, and which one every candidate has, (k,)."""
    laws = np.stack([gains.R, gains.D, gains.K], axis=1)
    _, first, which = np.unique(laws, axis=0, return_index=True, return_inverse=True)
    return first, which.ravel()


def damping_ratio(duty: Duty, gains: Gains) -> Floats:
    """Least damping ratio of the position loop with and without payload, (k,) [-]; rigid transmission.

    Of the slow modes, those below the virtual rotor's and the position loop's own: roots of
    ``(M s^2 + v s)(R m s^2 + (D + R a) s + (1 + R) K) + R (a s + K) (kd s + kp - J s^2) = 0``, M = m + J.
    """
    m, v = duty.drive.rotor_inertia, duty.drive.viscous_friction
    R, D, K, kp, kd = (getattr(gains, f.name) for f in fields(gains))
    a = R * v + D
    lowest = np.full(len(gains), np.inf)
    for J in {duty.inertia, duty.loaded}:
        M = m + J
        lag = (R * m, D + R * a, (1 + R) * K)
        coefficients = np.stack(
            [
                lag[0] * M,
                lag[1] * M + lag[0] * v - R * a * J,
                lag[2] * M + lag[1] * v + R * a * kd - R * K * J,
                lag[2] * v + R * a * kp + R * K * kd,
                R * K * kp,
            ],
            axis=1,
        )
        companion = np.zeros((len(gains), 4, 4))
        companion[:, 0] = -coefficients[:, 1:] / coefficients[:, :1]
        companion[:, [1, 2, 3], [0, 1, 2]] = 1.0
        roots = np.linalg.eigvals(companion)
        size = np.abs(roots)
        scale = size.max(1, keepdims=True)
        ringing = (np.abs(roots.imag) > 1e-9 * scale) & (size > 1e-9 * scale)
        zeta = np.where(ringing, -roots.real / np.where(ringing, size, 1.0), np.inf)
        lowest = np.minimum(lowest, zeta.min(1))
    return lowest


def stop_time(duty: Duty, gains: Gains, *, within: float = STOP_HORIZON) -> Floats:
    """Time from losing the encoder until the loaded link stays below the residual speed, (k,) [s].

    See `stopped`. The brake is warm started with the last speed. Not within ``within``: that. Friction
    counts, gravity does not.
    """
    blocks = duty.blocks(gains, brake=True)
    found = np.full(len(gains), within)
    open_, horizon = np.arange(len(gains)), min(FIRST_HORIZON, within)
    while len(open_):
        motion = move(
            duty.drive,
            blocks[open_],
            duty.sampling,
            duty.period,
            duty.loaded,
            speed=duty.speed,
            duration=horizon,
            torque_gain=duty.torque_gain,
        )
        times = stopped(motion.time, motion.speed, duty.residual * duty.speed)
        # What rings on comes back within a quarter of the horizon, or it does not come back.
        done = times < 0.75 * horizon
        if horizon >= within:
            done = times < within
        found[open_[done]] = times[done]
        open_ = open_[~done]
        if horizon >= within:
            break
        horizon = min(2 * horizon, within)
    return found


def travel(duty: Duty, gains: Gains) -> Floats:
    """How far the loaded link gets in 5 s after losing the encoder, the load pulling on, (k,) [rad].

    The path of the first second, forth and back, and four seconds of `creep`.
    """
    motion = move(
        duty.drive,
        duty.blocks(gains, brake=True),
        duty.sampling,
        duty.period,
        duty.loaded,
        speed=duty.speed,
        duration=WATCHED,
        load=duty.load,
        torque_gain=duty.torque_gain,
    )
    return np.asarray(duty.period * np.abs(motion.speed).sum(0) + CREEPING * creep(duty, gains))


def stopped(time: Floats, speed: Floats, level: float) -> Floats:
    """Time after which speeds (ticks, k) stay below a level, (k,) [s], interpolated; infinite: never."""
    size = np.abs(speed)
    coming = np.maximum.accumulate(size[::-1], axis=0)[::-1]  # largest speed from a tick on
    columns, step = np.arange(speed.shape[1]), float(time[1] - time[0])
    late = np.minimum((coming >= level).sum(0), len(time) - 1)  # first tick below for good
    early = np.maximum(late - 1, 0)
    before, after = size[early, columns], size[late, columns]
    with np.errstate(divide="ignore", invalid="ignore"):
        part = np.where(before > after, (before - level) / (before - after), 0.0)
    times = np.where(late == 0, 0.0, (early + np.clip(part, 0, 1)) * step)
    return np.where(coming[late, columns] < level, times, math.inf)
