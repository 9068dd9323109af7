"""The real-time loop: samples in, one native call, torques out, and an end that is always the safe state."""

from __future__ import annotations

from dashpot.hardware.interface import Hardware
from dashpot.supervisor import Supervisor
from dashpot.trajectory import Trajectory


def control(
    hardware: Hardware,
    supervisor: Supervisor,
    trajectory: Trajectory | None = None,
    *,
    duration: float | None = None,
) -> object:
    """Controls a robot until the motion is over, somebody stops it, or something fails.

    Args:
        hardware: The robot; its joints are the controller's, in any order.
        supervisor: With its controller.
        trajectory: References of all joints in the order of ``controller.joints``; None: holds where the arm is.
        duration: Ends the run after it [s]; None: with the trajectory, or never.
    """
    raise NotImplementedError
