"""Passive loads that can be hung on a joint, and the exact sampled loop they make with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from dashpot.certify.joint import SampledJoint
from dashpot.certify.threads import one_thread
from dashpot.support.arrays import Floats

GRAVITY = 9.81
GROWS = 1e-9  # modulus above 1 that counts as growing


@dataclass(frozen=True)
class Load:
    """A link that turns about the joint's axis: ``inertia q'' + stiffness q = tau_s``.

    Attributes:
        kind: "inertia", "inertia and spring" or "pendulum".
        inertia: [kg m^2].
        stiffness: Spring to the world, or M g l of a pendulum hanging down [N m/rad].
    """

    kind: str
    inertia: float
    stiffness: float = 0.0

    @classmethod
    def pendulum(cls, mass: float, length: float) -> Load:
        """A point mass [kg] hanging on a massless rod [m]."""
        return cls("pendulum", mass * length**2, mass * GRAVITY * length)

    @property
    def payload(self) -> tuple[float, float]:
        """Mass [kg] and length [m] of a pendulum."""
        length = GRAVITY * self.inertia / self.stiffness
        return self.inertia / length**2, length

    def __str__(self) -> str:
        if self.kind == "pendulum":
            mass, length = self.payload
            return f"pendulum of {mass:.3g} kg, {length:.3g} m"
        spring = f" on a spring of {self.stiffness:.3g} N m/rad" if self.stiffness else ""
        return f"inertia of {self.inertia:.3g} kg m^2{spring}"


@one_thread
def loops(joint: SampledJoint, inertia: Floats, stiffness: Floats, friction: float = 0.0) -> Floats:
    """Transition over one period of the joint with each of k loads: (k, size + 2, size + 2), scaled.

    The link's velocity and angle are the last two states; nothing is approximated.

    Args:
        joint: The sampled joint.
        inertia: (k,) [kg m^2].
        stiffness: (k,) [N m/rad].
        friction: Of the link [N m s/rad].
    """
    n, size = len(joint.flow), len(joint.jump)
    units = np.append(joint.units[:n], [1.0, joint.period])
    flow = np.zeros((len(inertia), n + 2, n + 2))
    flow[:, :n, :n], flow[:, :n, n] = joint.flow, joint.velocity_in
    flow[:, n, :n] = joint.torque / inertia[:, None]
    flow[:, n, n] = (joint.torque_w - friction) / inertia
    flow[:, n, n + 1] = -stiffness / inertia
    flow[:, n + 1, n] = 1.0
    exact = np.zeros((len(inertia), size + 2, size + 2))
    index = np.r_[:n, size, size + 1]
    exact[:, range(size), range(size)] = 1.0
    exact[np.ix_(range(len(inertia)), index, index)] = expm(flow * (units / units[:, None]) * joint.period)
    jump = np.eye(size + 2)
    jump[:size, :size] = joint.jump
    if joint.speed_in_sample:
        # The sample holds k (deflection) + c (rotor speed - link speed): its last part comes by the same way.
        alone = joint.jump[:, 0] - np.eye(size)[:, 0]
        jump[:size, size] = alone * joint.torque_w / joint.torque[0]
    units = np.append(joint.units, [1.0, joint.period])
    return np.asarray(exact @ (jump * units / units[:, None]))


@one_thread
def radii(joint: SampledJoint, inertia: Floats, stiffness: Floats, friction: float = 0.0) -> Floats:
    """Spectral radius of the loop with each load, (k,)."""
    return np.asarray(np.abs(np.linalg.eigvals(loops(joint, inertia, stiffness, friction))).max(-1))


@dataclass(frozen=True)
class Oscillation:
    """The fastest growing motion of a joint with a load.

    Attributes:
        frequency: [Hz].
        growth: Rate of the amplitude [1/s]; positive grows.
    """

    frequency: float
    growth: float


@one_thread
def oscillation(joint: SampledJoint, load: Load, friction: float = 0.0) -> Oscillation:
    """Fastest growing mode of the joint with one load, friction of the link [N m s/rad] included."""
    loop = loops(joint, np.array([load.inertia]), np.array([load.stiffness]), friction)[0]
    values: NDArray[np.complex128] = np.linalg.eigvals(loop).astype(complex)
    worst = values[np.abs(values).argmax()]
    return Oscillation(
        float(abs(np.angle(worst))) / (2 * np.pi * joint.period), float(np.log(abs(worst))) / joint.period
    )
