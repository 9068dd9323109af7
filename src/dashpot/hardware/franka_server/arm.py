"""The robot behind the interface: the simulated arm with what a Franka adds below its torque interface.

Motor torque ``u = tau + g(q) + s (v dtheta + tau_c tanh(dtheta/w_0))``, tau the client's command: the robot
adds gravity, by its model of the arm and of the load that a client has declared (``set_load``), and a share s
of the drives' friction. What hangs on the flange undeclared is not compensated. Both read the robot's own
encoders.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from dashpot.arm.assembly import load_spec
from dashpot.arm.payload import Payload
from dashpot.arm.plant import build
from dashpot.arm.robot import Robot
from dashpot.errors import InputError
from dashpot.hardware.franka_server.limits import Limits
from dashpot.hardware.franka_server.messages import JOINTS, PERIOD, STATE
from dashpot.hardware.franka_server.urdf import urdf
from dashpot.simulation.faults import Fault
from dashpot.simulation.recording import Recording
from dashpot.simulation.simulate import PayloadChange
from dashpot.simulation.stepped import SteppedArm
from dashpot.support.arrays import Floats

RESERVE = 2.0  # motor torque over the limit of commands: gravity is added to them; assumed
CREEP = 0.05  # [rad/s] below which friction is compensated in part only
HOLD_STIFFNESS = np.array([600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0])  # [N m/rad] while nobody commands
HOLD_DAMPING = np.array([50.0, 50.0, 50.0, 50.0, 30.0, 25.0, 15.0])  # [N m s/rad]


class Gravity:
    """The robot's own model of its weight: the arm without payload, and a declared load.

    Attributes:
        mass: Of the declared load [kg].
        centre: Its centre in the flange frame, (3,) [m].
        pose: Of the flange in the base frame at the last angles, 4 x 4 by columns, (16,).
    """

    def __init__(self, robot: Robot) -> None:
        _, self._model = load_spec(robot)
        self._data = mujoco.MjData(self._model)
        self._qpos = [self._model.joint(name).qposadr[0] for name in robot.joints]
        self._dof = [self._model.joint(name).dofadr[0] for name in robot.joints]
        self._body = self._model.jnt_bodyid[self._model.joint(robot.joints[-1]).id]
        self._site = self._model.site(robot.flange).id if robot.flange else None
        self._force, self._jacobian = np.zeros(self._model.nv), np.zeros((3, self._model.nv))
        self.mass, self.centre, self.pose = 0.0, np.zeros(3), np.eye(4).ravel()
        self.acceleration = np.array(self._model.opt.gravity)

    def urdf(self, robot: Robot, limits: Limits) -> str:
        """The same model for a client."""
        return urdf(robot, self._model, limits)

    def torque(self, q: Floats) -> Floats:
        """Torque that holds the arm and the declared load at rest at joint angles (n,) [rad]: (n,) [N m]."""
        model, data = self._model, self._data
        data.qpos[self._qpos] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_rne(model, data, 0, self._force)
        torque = self._force[self._dof]
        place = data.xpos[self._body] if self._site is None else data.site_xpos[self._site]
        turn = data.xmat[self._body] if self._site is None else data.site_xmat[self._site]
        self.pose[[0, 1, 2, 4, 5, 6, 8, 9, 10]] = turn.reshape(3, 3).T.ravel()
        self.pose[12:15] = place
        if self.mass > 0:
            at = place + turn.reshape(3, 3) @ self.centre
            mujoco.mj_jac(model, data, self._jacobian, None, at, self._body)
            torque -= self.mass * (self.acceleration @ self._jacobian)[self._dof]
        return torque


class Arm:
    """The simulated robot: rests, moves under a client's torques, and holds itself when nobody commands.

    Attributes:
        state: What is published, a record of `STATE`; `sense` fills in what is measured.
        fine: False once the simulation has blown up.
        begun: Whether the clock of the script runs.
    """

    def __init__(
        self,
        robot: Robot,
        payload: Payload,
        *,
        faults: Sequence[Fault] = (),
        payload_changes: Sequence[PayloadChange] = (),
        seed: int = 0,
        friction: float = 0.2,
        record: bool = False,
    ) -> None:
        """Builds the arm at the robot's home.

        Args:
            robot: Seven joints.
            payload: On the flange, undeclared.
            faults: What fails; times count from the start of the first motion [s].
            payload_changes: Likewise.
            seed: Of the sensors' noise.
            friction: Share of the drives' friction that the robot compensates [-].
            record: Keep what `recording` returns.

        Raises:
            InputError: The robot has not seven joints, or faults and payloads do not fit.
        """
        if len(robot.drives) != JOINTS:
            raise InputError(f"a Franka has {JOINTS} joints, this robot {len(robot.drives)}", file=robot.file)
        if not 0 <= friction <= 1:
            raise InputError("must be 0 to 1", quantity="friction compensation [-]", value=friction)
        self.robot, self.gravity = robot, Gravity(robot)
        plant = build(robot, PERIOD, [payload] if payload.mass > 0 else [])
        drives = plant.drives.copy()
        drives["torque_limit"] *= RESERVE
        self._plant = replace(plant, drives=drives)
        self._script, self._record, self._seed = (tuple(faults), tuple(payload_changes)), record, seed
        self._viscous = friction * np.array([d.viscous_friction for d in robot.drives])
        self._coulomb = friction * np.array([d.coulomb_friction for d in robot.drives])
        self.state = np.zeros((), STATE)
        for name in ("O_T_EE_d", "O_T_EE_c", "F_T_EE", "EE_T_K", "F_T_NE", "NE_T_EE"):
            self.state[name] = np.eye(4).ravel()
        self.state["O_ddP_O"] = self.gravity.acceleration
        self._torque, self._theta, self._dtheta, self._q, self._dq = np.zeros((5, JOINTS))
        # What does not fit is refused now, not at the first motion.
        SteppedArm(self._plant, PERIOD, faults=faults, payload_changes=payload_changes, seed=seed)
        self._rest(SteppedArm(self._plant, PERIOD, seed=seed))
        self.begun = False

    def begin(self) -> None:
        """Starts the clock of the script and the recording, for the first motion; the arm still rests."""
        faults, changes = self._script
        self._rest(
            SteppedArm(
                self._plant,
                PERIOD,
                faults=faults,
                payload_changes=changes,
                seed=self._seed,
                record=self._record,
            )
        )
        self.begun = True

    def _rest(self, link: SteppedArm) -> None:
        self._link = link
        self.fine = True
        self._motor = self._link.carried.copy()
        self.engage(brakes=False)
        self.sense()

    @property
    def time(self) -> float:
        """On the arm's own clock [s]."""
        return self._link.tick * PERIOD

    def sense(self) -> None:
        """Samples the sensors into the state; once per tick."""
        before = self._torque.copy()
        self._link.sense(self._torque, self._theta, self._dtheta)
        (deflection, rate), state = self._link.deflection, self.state
        state["theta"], state["dtheta"] = self._theta, self._dtheta
        state["q"], state["dq"] = self._theta + deflection, self._dtheta + rate
        state["tau_J"], state["dtau_J"] = self._torque, (self._torque - before) / PERIOD
        lost = np.isnan(self._theta)
        self._q[~lost] = (self._theta + deflection)[~lost]  # the robot goes on with what it knew last
        self._dq[~lost] = self._dtheta[~lost]
        self._compensation = self.gravity.torque(self._q)
        self._compensation += self._viscous * self._dq + self._coulomb * np.tanh(self._dq / CREEP)
        state["O_T_EE"] = self.gravity.pose

    def engage(self, brakes: bool = True) -> None:
        """Nobody commands: the robot holds where it is, and closes its brakes."""
        self._reference: Floats | None = None
        self._link.apply_brake = brakes
        self.state["tau_J_d"] = 0.0

    def release(self) -> None:
        """Opens the brakes for a motion."""
        self._link.apply_brake = False

    def push(self, torque: Floats) -> None:
        """Follows a client's command (7,) [N m] for one period."""
        self.state["tau_J_d"] = torque
        self._motor = torque + self._compensation
        self.fine &= self._link.push(self._motor)

    def hold(self) -> None:
        """Holds itself for one period: position control around where it was told to."""
        if self._reference is None:
            self._reference, self._carried = self._q.copy(), self._motor.copy()
            self.state["q_d"] = self._reference
        error = self._reference - self._q
        self._motor = self._carried + HOLD_STIFFNESS * error - HOLD_DAMPING * self._dq
        self.fine &= self._link.push(self._motor)

    def recording(self) -> Recording:
        """What was true since the first motion started.

        Raises:
            InputError: Nothing was recorded.
        """
        return self._link.recording()
