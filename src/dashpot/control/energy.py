"""Where a joint's energy is and where it goes, from what the joint senses.

Per joint, with rotor inertia m, stiffness k, motor torque u' in effect and sensed torque tau_s:

    motor       = integral of u' dq           kinetic   = 1/2 m q'^2
    port        = integral of tau_s dq        potential = 1/2 tau_s^2 / k
    dissipated  = motor - port - (kinetic - kinetic at the first sample)
    virtual     = 1/2 R m (q' + xc')^2 + 1/2 K xc^2

The rotor's equation ``u' = m q'' + v q' + f + tau_s`` makes ``dissipated`` the work done against v and f,
with everything that the model leaves out. ``virtual`` is the storage of Eqs. (20)-(21): along the law,
``d virtual = -u dq - R v q'^2 dt - D xc'^2 dt``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dashpot.arm.drive import Drive
from dashpot.control.controller import ControllerConfig
from dashpot.control.jointlaw import JointGains
from dashpot.control.sampled import NX, VirtualPassive
from dashpot.errors import InputError
from dashpot.support.arrays import Floats

QUANTITIES = ("motor", "port", "kinetic", "potential", "virtual", "dissipated")


class EnergyMeter:
    """Energies of an arm's joints, block of samples by block of samples.

    >>> meter = EnergyMeter(robot.drives, config)
    >>> columns = meter.update(torque, position, velocity, in_effect, x)     # for McapWriter.write

    Attributes:
        joints: Names, n of them, in the order of the drives.
    """

    def __init__(self, drives: Sequence[Drive], config: ControllerConfig | None = None) -> None:
        """Takes m and k from the drives, and the laws from the controller; joints without are not virtual."""
        self.joints = tuple(drive.name for drive in drives)
        self.m = np.array([drive.rotor_inertia for drive in drives])
        self.k = np.array([drive.stiffness for drive in drives])
        self._average = config is None or config.sampling == "average"
        self._laws: dict[int, tuple[VirtualPassive, Storage]] = {}
        for law in config.joints if config else ():
            if isinstance(law, JointGains) and config is not None:
                j = self.joints.index(law.name)
                virtual = VirtualPassive(law.R, law.D, law.K, *law.model(drives[j]))
                self._laws[j] = virtual, Storage(virtual, config)
        self._last: tuple[Floats, Floats] | None = None  # torque, position
        self._start = np.zeros(len(self.joints))
        self._motor, self._port = np.zeros((2, len(self.joints)))

    def update(
        self,
        torque: Floats,
        position: Floats,
        velocity: Floats,
        in_effect: Floats,
        x: Mapping[str, Floats] | None = None,
        acting: Floats | None = None,
    ) -> dict[str, Floats]:
        """Energies at the next t samples; work goes on from where the last call has left it.

        A period in which something is not a number adds no work.

        Args:
            torque: (t, n) sensed [N m].
            position: (t, n) rotor angle [rad].
            velocity: (t, n) [rad/s].
            in_effect: (t, n) torque over the period that ends at the sample [N m].
            x: Block states after the tick, "x0" to "x3", each (t, n); None: ``virtual`` is NaN.
            acting: (t, n), true where the law computes the torque; None: everywhere.

        Returns:
            "energy_motor" and so on, (t, n) [J]. ``virtual`` is NaN where another law, or none, acts.

        Raises:
            InputError: An array is not (t, n).
        """
        shape = (len(torque), len(self.joints))
        for name, values in (
            ("torque", torque),
            ("position", position),
            ("velocity", velocity),
            ("in_effect", in_effect),
        ):
            if np.shape(values) != shape:
                raise InputError(f"must have shape {shape}", quantity=f"{name}.shape", value=np.shape(values))
        kinetic = 0.5 * self.m * velocity**2
        first = self._last is None
        before_torque, before = (torque[:1], position[:1]) if self._last is None else self._last
        if first and len(torque):
            self._start = np.nan_to_num(kinetic[0])
        tau = torque
        if not self._average:  # point samples: the mean over a period is that of its ends
            tau = 0.5 * (torque + np.vstack([before_torque, torque[:-1]]))
        dq = np.diff(position, axis=0, prepend=before)
        motor = self._motor + np.cumsum(_work(in_effect, dq), axis=0)
        port = self._port + np.cumsum(_work(tau, dq), axis=0)
        virtual = np.full(shape, np.nan)
        for j, (law, storage) in self._laws.items():
            if x is None:
                break
            xc, rate = storage.update(np.stack([x[f"x{i}"][:, j] for i in range(NX)], axis=1))
            relative = velocity[:, j] + rate
            virtual[:, j] = 0.5 * law.R * law.m * relative**2 + 0.5 * law.K * xc**2
        if acting is not None:
            virtual[~acting.astype(bool)] = np.nan
        if len(torque):
            self._last = torque[-1:].copy(), position[-1:].copy()
            self._motor, self._port = motor[-1].copy(), port[-1].copy()
        return {
            "energy_motor": motor,
            "energy_port": port,
            "energy_kinetic": kinetic,
            "energy_potential": 0.5 * torque**2 / self.k,
            "energy_virtual": virtual,
            "energy_dissipated": motor - port - (kinetic - self._start),
        }


class Storage:
    """The law's displacement and rate, xc and xc', from the states of its sampled block.

    The explicit block's states after a tick are xc and xc' themselves. The implicit one keeps
    ``x+ = Phi xc + gamma e`` with the net torque e of the tick, so that ``xc = x + gamma e`` and
    ``x+ = Phi x + (Phi + 1) gamma e``: two successive states give e, and so xc.
    """

    def __init__(self, law: VirtualPassive, config: ControllerConfig) -> None:
        A, B, _ = law.continuous()
        self.n = len(B)
        self.explicit = config.form == "explicit"
        solve = np.linalg.inv(np.eye(self.n) - config.period / 2 * A)
        self.phi = solve @ (np.eye(self.n) + config.period / 2 * A)
        self.gamma = solve @ B * (config.period / 2)
        both = (self.phi + np.eye(self.n)) @ self.gamma
        self.pick = both / (both @ both)
        self._last: Floats | None = None

    def update(self, x: Floats) -> tuple[Floats, Floats]:
        """xc [rad] and xc' [rad/s], (t,), from the next (t, NX) states after the tick; xc is 0 for K = 0."""
        states = x[:, : self.n]
        if not self.explicit:
            before = np.vstack([states[:1] if self._last is None else self._last, states[:-1]])
            net = (states - before @ self.phi.T) @ self.pick
            if len(states):
                self._last = states[-1:].copy()
            states = before + np.outer(net, self.gamma)
        return (states[:, 0] if self.n > 1 else np.zeros(len(states))), states[:, -1]


def _work(torque: Floats, dq: Floats) -> Floats:
    work = torque * dq
    return np.where(np.isfinite(work), work, 0.0)
