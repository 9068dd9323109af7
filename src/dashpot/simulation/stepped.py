"""The simulated arm one control tick at a time, its motor torques given from outside.

Where `dashpot.simulation.loop` closes the loop natively, this leaves it open: a controller in another
process, or a robot's interface around the arm, senses at a tick and then says what the motors do until the
next. The arm, its faults and its changes of payload are the same native code, with the same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

import dashpot._native as _native
from dashpot.arm.plant import Plant
from dashpot.errors import InputError
from dashpot.simulation.engine import engine
from dashpot.simulation.faults import Fault
from dashpot.simulation.loop import carry
from dashpot.simulation.prepare import loads
from dashpot.simulation.recording import CHANNELS, Recording
from dashpot.simulation.script import native_faults, sensor_streams
from dashpot.simulation.simulate import PayloadChange
from dashpot.support.arrays import Floats

DAY = 86_400.0  # [s]
ITERATIONS, TOLERANCE = 100, 1e-12  # of the rest position [rad]
LONGEST = 1_000_000  # ticks that are recorded, about 0.5 GB for seven joints


@dataclass(frozen=True)
class Ticks:
    """The clock of an arm that runs without end: faults and payloads happen within a day of its start."""

    period: float
    start: float = 0.0

    @property
    def ticks(self) -> int:
        """Of a day."""
        return round(DAY / self.period)


class SteppedArm:
    """An arm to be sensed and pushed in turns, from rest with its motors carrying the load.

    >>> arm.sense(torque, position, velocity)  # writes (n,) N m, rad, rad/s
    >>> arm.push(command)                      # (n,) N m until the next tick; False: it blew up

    Attributes:
        plant: The arm, at the time step it runs at.
        period: From one tick to the next [s].
        carried: Torque with which each motor holds the arm at rest at the start, (n,) [N m].
        torque_age: Ticks since each torque sensor's last fresh sample, (n,); written by `sense`.
        encoder_age: Of the encoders, (n,).
    """

    def __init__(
        self,
        plant: Plant,
        period: float,
        *,
        pose: Sequence[float] | Floats | None = None,
        faults: Sequence[Fault] = (),
        payload_changes: Sequence[PayloadChange] = (),
        seed: int = 0,
        average: bool = False,
        record: bool = False,
    ) -> None:
        """Puts the arm at rest.

        Args:
            plant: The arm with its payload, built for this period.
            period: Control period [s], a multiple of the plant's time step.
            pose: Motor angles to start at, (n,) [rad]; None: the robot's home.
            faults: What fails; times [s] from the first tick.
            payload_changes: Likewise.
            seed: Of sensor noise and dropped samples.
            average: Torque samples are means over the last period, not the latest value.
            record: Keep what `recording` returns.

        Raises:
            InputError: Period, pose, faults or payloads do not fit the arm.
        """
        clock = Ticks(period)
        self._models, self.plant = loads(plant, payload_changes, clock)
        self.period, n = period, len(plant.drives)
        steps = round(period / self.plant.timestep)
        if steps < 1 or abs(steps * self.plant.timestep - period) > 1e-9 * period:
            raise InputError(
                f"must be a multiple of the plant's time step, {self.plant.timestep:g} s",
                quantity="period [s]",
                value=period,
            )
        at = np.array(plant.robot.home if pose is None else pose, float)
        if at.shape != (n,) or not np.isfinite(at).all():
            raise InputError(f"must be {n} finite angles", quantity="pose [rad]", value=at.tolist())
        drives = self.plant.drives.copy()
        drives["control"], drives["average"] = np.arange(n), average
        drives["rng"] = sensor_streams(seed, n)
        self._model, self._data = self.plant.model, mujoco.MjData(self.plant.model)
        self.carried = self._rest(at)
        # Always with a script: brakes close through it.
        self._faults = native_faults(faults, self.plant, plant.robot.joints, clock, seed)
        self._arm = _native.Arm(
            drives.view(np.uint8), engine("mj_step"), self.plant.timestep, steps, self._faults
        )
        self._connect()
        self._spring, self._spring_dof = np.array(drives["spring_qpos"]), self.plant.spring_dof
        self.torque_age, self.encoder_age = self._arm.torque_age, self._arm.encoder_age
        self.sense = self._arm.sense
        self._row = self._arm.record
        self._rows: list[Floats] | None = [] if record else None
        self._settings: dict[str, object] = {
            "robot": plant.robot.name,
            "period": period,
            "timestep": self.plant.timestep,
            "seed": seed,
            "faults": [fault.table() for fault in faults],
            "payload_changes": [change.table() for change in payload_changes],
        }
        self.diverged = False

    def _rest(self, pose: Floats) -> Floats:
        """Deflects the springs until they carry the arm at these motor angles; returns their torque."""
        plant, data = self.plant, self._data
        torque = np.zeros(len(pose))
        data.qpos[plant.rotor_qpos] = pose
        for _ in range(ITERATIONS):
            deflection = -torque / plant.drives["stiffness"]
            data.qpos[plant.drives["spring_qpos"]] = deflection
            mujoco.mj_forward(plant.model, data)
            torque = np.array((data.qfrc_bias - data.qfrc_gravcomp)[plant.rotor_dof])
            if np.abs(torque / plant.drives["stiffness"] + deflection).max() < TOLERANCE:
                break
        return torque

    def _connect(self) -> None:
        data = self._data
        self._arm.engine(self._model._address, data._address, data.qpos, data.qvel, data.qfrc_applied)

    @property
    def tick(self) -> int:
        """The next one to be sensed, or the one that has been."""
        return self._arm.tick

    @property
    def apply_brake(self) -> bool:
        """Whether the mechanical brakes are told to close; set it to close or open them."""
        return self._faults.apply_brake

    @apply_brake.setter
    def apply_brake(self, closed: bool) -> None:
        self._faults.apply_brake = closed

    @property
    def truth(self) -> dict[str, Floats]:
        """What is true at the tick sensed last, as `CHANNELS` of a recording: views, each (n,)."""
        return dict(zip(CHANNELS, self._row, strict=True))

    @property
    def deflection(self) -> tuple[Floats, Floats]:
        """Link minus rotor angle (n,) [rad] and its rate (n,) [rad/s], true, now."""
        return self._data.qpos[self._spring], self._data.qvel[self._spring_dof]

    def push(self, torque: Floats) -> bool:
        """Holds motor torques (n,) [N m] until the next tick; False where the simulation has blown up."""
        if self._models and self._models[0][0] <= self._arm.tick:
            self._model = self._models.pop(0)[1]
            self._data = carry(self._model, self._data)
            self._connect()
        fine = self._arm.push(torque)
        if self._rows is not None and len(self._rows) < LONGEST:
            self._rows.append(self._row.copy())
        self.diverged |= not fine
        return fine

    def recording(self) -> Recording:
        """What has happened so far; the reference is not known, NaN.

        Raises:
            InputError: Nothing was recorded.
        """
        if not self._rows:
            raise InputError("nothing has been recorded", quantity="recording")
        record = np.stack(self._rows, axis=1)
        return Recording(
            self.plant.robot.joints,
            self.period * np.arange(record.shape[1], dtype=np.float64),
            np.full(record.shape[1:], np.nan),
            **dict(zip(CHANNELS, record, strict=True)),
            status=np.zeros(record.shape[1], np.int32),
            diverged_at=self.period * (record.shape[1] - 1) if self.diverged else None,
            settings=dict(self._settings),
        )
