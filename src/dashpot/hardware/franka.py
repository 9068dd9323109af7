"""Franka Research 3 through pylibfranka: `FrankaHardware`.

What the robot does by itself below its torque interface decides what is exchanged here. The motor gets
``u' = u + g(q) + friction compensation``; ``u`` is what `write` sends, and gravity g, that of the arm, of its
end effector and of the load that was declared, is added by the robot. Its sensor reads ``tau_J``, the torque
that passes to the link, positive as a motor torque: at rest ``tau_J = g(q)`` with nothing undeclared on the
hand. The drive's balance ``u' = m q'' + v q' + f + tau_J`` is therefore, for the torque that is commanded,

    u = m q'' + v q' + f + (tau_J - g(q)).

So samples are ``torque = tau_J - g(q)``, ``in_effect = tau_J_d``, both without gravity as the command is, and
``position = theta``, ``velocity = dtheta``, the motor's: it is the rotor's motion that is in the balance, and
that the certificate assumes.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import os
from contextlib import suppress
from types import ModuleType
from typing import Any

import numpy as np

from dashpot._native import bounded, take, take_difference
from dashpot.arm.payload import Payload
from dashpot.arm.robot import Robot
from dashpot.errors import DashpotError, InputError
from dashpot.hardware.interface import Sample
from dashpot.support.arrays import Floats
from dashpot.support.installing import install

JOINTS = 7
PERIOD = 1e-3  # [s]
TORQUE = np.array([87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0])
"""Largest torque a command may ask for, gravity not counted [N m]."""
STEP = 0.999  # [N m] from cycle to cycle; the robot stops at 1, and its state is in single precision
CONTACT = 100.0  # [N m, N] up to which a load is no collision: the law is there to carry loads
ENCODERS = (
    0.2  # [rad] by which motor and link may be apart: 2 kN m in the transmission; else theta is not sent
)


def pylibfranka() -> ModuleType:
    """Franka's own Python bindings.

    Raises:
        DashpotError: They are not installed, or do not run here.
    """
    try:
        return importlib.import_module("pylibfranka")
    except ImportError as error:
        try:
            found = importlib.metadata.version("pylibfranka")
        except importlib.metadata.PackageNotFoundError:
            raise DashpotError(
                f"pylibfranka is not installed: {install('franka')} (Linux on x86-64, Python 3.11 or 3.12)"
            ) from None
        raise DashpotError(f"pylibfranka {found} does not run here: {error}") from None


def connect(host: str) -> Any:
    """pylibfranka's robot at an address; this thread keeps the priority it has.

    libfranka gives whoever connects the highest real-time priority, 99, for good: what runs next in that
    process, a browser or a plot, would stop the machine.

    Raises:
        DashpotError: See `pylibfranka`.
        pylibfranka.FrankaException, RuntimeError: Nobody answers, or the versions do not fit.
    """
    franka = pylibfranka()
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        return franka.Robot(host, franka.RealtimeConfig.kIgnore)
    finally:
        with suppress(OSError):
            os.sched_setscheduler(0, policy, parameters)


class FrankaHardware:
    """A Franka Research 3, as `dashpot.hardware.interface.Hardware`.

    The robot's rules are kept whatever `write` is given: the first torque is zero (`start` sends it), every
    other within 0.999 N m of the torque that the robot says it has in effect (so that a packet that was lost
    does no harm), and all within 87 and 12 N m.

    Attributes:
        joints: Names in the robot file, base to tip.
        period: 1 ms.
        paced: True: `read` waits for the robot's next state.
        carries_weight: True: the robot adds gravity, see above.
        reason: Why the robot ended the motion; libfranka's words.
        host: Address of the robot.
    """

    period = PERIOD
    paced = True
    carries_weight = True

    def __init__(self, host: str, robot: Robot, *, load: Payload | None = None) -> None:
        """Connects; moves nothing.

        Args:
            host: Address of the robot, or of ``dashpot franka-server``.
            robot: Names the joints.
            load: On the flange; declared to the robot, which then carries it. None: as it is set in Desk.

        Raises:
            DashpotError: pylibfranka is missing, nobody answers, or the versions do not fit.
            InputError: The robot has not seven joints, or other torque limits than a Franka.
        """
        if len(robot.drives) != JOINTS:
            raise InputError(f"a Franka has {JOINTS} joints, this robot {len(robot.drives)}", file=robot.file)
        for drive, most in zip(robot.drives, TORQUE, strict=True):
            if drive.torque_limit > most:
                raise InputError(
                    f"a Franka takes at most {most:g} N m there",
                    file=robot.file,
                    joint=drive.name,
                    quantity="torque_limit [N m]",
                    value=drive.torque_limit,
                )
        self._franka = pylibfranka()
        # Most of its exceptions are none of its FrankaException but plain runtime errors.
        self._errors = (self._franka.FrankaException, RuntimeError)
        self.joints, self.host, self.reason = robot.joints, host, ""
        self._robot: Any = None
        self._control: Any = None
        self._in_effect = np.zeros(JOINTS)
        try:
            self._robot = connect(host)
            self._model = self._robot.load_model()
            self._gravity = self._model.gravity
            if load is not None:
                # A point, for all that gravity has to know.
                self._robot.set_load(load.mass, load.position.tolist(), [0.0] * 9)
            self._robot.set_collision_behavior(*([CONTACT] * n for n in (7, 7, 6, 6)))
        except self._errors as error:
            raise DashpotError(f"{host}: {self._advice(error)}") from None
        self._torques = self._franka.Torques

    def _advice(self, error: Exception) -> str:
        text = str(error).removeprefix("libfranka: ").strip()
        if "refused" in text:
            return (
                f"no Franka control interface there ({text}); is the address right, and FCI active in Desk? "
                "For a simulated one: dashpot franka-server"
            )
        if "ncompatible" in text:
            return f"{text}; the FR3 needs system 5.9 or later for this pylibfranka"
        return text

    def start(self) -> None:
        """Starts torque control with a cycle of zero torque.

        Raises:
            DashpotError: The robot is not ready, does not say its motor positions, or refuses.
        """
        franka = self._franka
        try:
            state = self._robot.read_once()
            if state.robot_mode != franka.RobotMode.Idle:
                why = f": {state.current_errors}" if state.current_errors else ""
                raise DashpotError(
                    f"{self.host}: the robot is not ready, mode {state.robot_mode.name}{why}; release the "
                    "stops and clear the errors in Desk (pylibfranka: automatic_error_recovery)"
                )
            apart = np.abs(np.subtract(state.theta, state.q))
            if not (apart < ENCODERS).all():
                joint = int(np.argmax(np.nan_to_num(apart, nan=np.inf)))
                raise DashpotError(
                    f"{self.host}: joint {self.joints[joint]!r}: motor position {state.theta[joint]:.4g} rad "
                    f"and link position {state.q[joint]:.4g} rad do not fit together; this system does not "
                    "send theta"
                )
            self._control = self._robot.start_torque_control()
            take(self._control.readOnce()[0].tau_J_d, self._in_effect)
            self._control.writeOnce(self._torques([0.0] * JOINTS))
        except self._errors as error:
            self._control = None
            raise DashpotError(f"{self.host}: {self._advice(error)}") from None

    def read(self, sample: Sample) -> bool:
        """Waits for the robot's next state; before `start` and after `apply_brake` it only looks."""
        try:
            state = self._robot.read_once() if self._control is None else self._control.readOnce()[0]
        except self._errors as error:
            self.reason, self._control = self._advice(error), None
            return False
        sample.time = state.time.to_sec()
        take_difference(state.tau_J, self._gravity(state), sample.torque)
        take(state.theta, sample.position)
        take(state.dtheta, sample.velocity)
        in_effect = state.tau_J_d
        take(in_effect, sample.in_effect)
        take(in_effect, self._in_effect)
        return True

    def write(self, torque: Floats) -> None:
        """Sends torques (7,) [N m], gravity not counted, within the robot's rules; nothing after a stop."""
        if self._control is None:
            return
        try:
            self._control.writeOnce(self._torques(bounded(torque, self._in_effect, TORQUE, STEP)))
        except self._errors as error:  # the robot's state says more, at the next read
            self.reason = self._advice(error)

    def apply_brake(self) -> None:
        """The robot's own stop: ends torque control; the robot holds, as it does when nobody commands it."""
        self._release()

    def stop(self) -> None:
        """Ends torque control."""
        self._release()

    def _release(self) -> None:
        control, self._control = self._control, None
        if control is None:
            return
        try:
            self._robot.stop()
        except self._errors as error:
            self.reason = self.reason or self._advice(error)
        del control  # libfranka waits for the motion's end there

    def close(self) -> None:
        """Ends torque control and hangs up, so that another program may have the robot."""
        self._release()
        self._robot = self._model = self._gravity = None
