"""Random drives on a bench with a weight, moved under feedback in the simulator, and the logs they leave."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from dashpot.arm.drive import Drive
from dashpot.arm.plant import Plant, build
from dashpot.arm.robot import Robot
from dashpot.control.controller import Controller, ControllerConfig, JointGains, Sampling
from dashpot.control.sampled import pd_block
from dashpot.logs.log import Log, Segment
from dashpot.simulation.recording import Recording
from dashpot.simulation.simulate import Scenario, run
from dashpot.simulation.trajectory import Trajectory, multisine
from dashpot.support.arrays import Floats

STEP = 5e-5  # [s], longest physics step: far below what the drives do
DURATION = 24.0  # [s] of motion
JOINT = "joint1"
ATTEMPTS = 30  # draws of gains and motion until the arm neither oscillates nor sticks
BENCH = """<mujoco><compiler angle="radian"/><option gravity="0 0 -9.81"/><worldbody><body name="load">
<joint name="joint1" type="hinge" axis="0 1 0"/>
<inertial pos="0 0 {reach!r}" mass="{mass!r}" diaginertia="{own!r} {own!r} {own!r}"/>
</body></worldbody></mujoco>"""


@dataclass(frozen=True)
class Bench:
    """One drive with a weight on it.

    Attributes:
        drive: What is simulated; the values to be found.
        inertia: Of the link about the axis [kg m^2].
        weight: Largest gravity torque of the link [N m].
        period: Of control and log [s].
        sampling: Of the torque.
        latency: Of the command [samples].
    """

    drive: Drive
    inertia: float
    weight: float
    period: float
    sampling: Sampling
    latency: int

    def robot(self, folder: Path) -> Robot:
        """Writes the model and returns the robot."""
        mass = max(self.weight, 1e-3 * self.inertia) ** 2 / (9.81**2 * 0.8 * self.inertia)
        reach = self.weight / (9.81 * mass)
        own = self.inertia - mass * reach**2
        path = folder / "bench.xml"
        path.write_text(BENCH.format(reach=-reach, mass=mass, own=own), encoding="utf-8")
        return Robot("bench", (self.drive,), path)

    def plant(self) -> Plant:
        """The bench in the simulator."""
        with TemporaryDirectory() as folder:
            return build(self.robot(Path(folder)), self.period / math.ceil(self.period / STEP))


def random_bench(seed: int, number: int) -> Bench:
    """A drive from (seed, number) alone: what industrial and collaborative arms have, and somewhat beyond."""
    rng = np.random.default_rng([seed, number])

    def log(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    m = log(0.02, 4.0)
    inertia = min(m * log(1.0, 20.0), 8.0)
    weight = inertia * 9.81 / rng.uniform(0.25, 0.8) * rng.uniform(0.3, 0.9)
    torque = weight + 5.0 * (m + inertia)  # about the largest in the motion below
    mode = 2 * math.pi * log(15.0, 60.0)
    k = mode**2 / (1 / m + 1 / inertia)
    fast = bool(rng.random() < 0.5)
    coulomb = rng.uniform(0.02, 0.2) * torque
    stribeck = bool(rng.random() < 0.25)
    drive = Drive(
        JOINT,
        rotor_inertia=m,
        viscous_friction=m * log(0.7, 15.0),
        coulomb_friction=coulomb,
        stribeck_friction=coulomb * rng.uniform(1.2, 2.0) if stribeck else 0.0,
        stribeck_velocity=log(0.03, 0.15) if stribeck else 0.0,
        stiffness=k,
        damping=2 * log(0.01, 0.1) * k / mode,
        torque_limit=10 * torque,
        torque_scale_error=rng.uniform(-0.05, 0.05),
        torque_bias=rng.uniform(-0.1, 0.1) * torque,
        torque_noise=rng.uniform(0.02, 0.1),
        torque_resolution=0.002,
        position_resolution=log(1e-6, 1e-4),
        hysteresis=rng.uniform(0.005, 0.05) * torque,
    )
    if fast:
        drive = replace(
            drive,
            sensor_bandwidth=log(80.0, 400.0),
            sensor_order=int(rng.integers(1, 3)),
            sensor_damping=rng.uniform(0.6, 1.0),
            torque_latency=float(rng.uniform(0.0, 2e-3)),
        )
    return Bench(
        drive,
        inertia,
        weight,
        1e-3 if fast else 5e-3,
        "point" if fast else "average",
        int(rng.integers(0, 4)),
    )


def controller(bench: Bench, rng: np.random.Generator, gentle: float) -> Controller:
    """A position loop, alone or with virtual passive control, slow enough for its delay."""
    drive, h = bench.drive, bench.period
    m, total = drive.rotor_inertia, drive.rotor_inertia + bench.inertia
    omega = 2 * math.pi * rng.uniform(1.0, 2.5)
    delay = (bench.latency + 1) * h + 2e-3
    kd = gentle * min(1.6 * total * omega, 0.4 * m / delay)
    kp = min(total * omega**2, 0.5 * kd * omega)
    names = (drive.name,)
    if rng.random() < 0.5:
        block = pd_block(kp, kd)
        block["torque_limit"], block["latency"] = drive.torque_limit, bench.latency
        return Controller(np.array([block]), names, h, bench.sampling)
    R = rng.uniform(0.5, 3.0)
    gains = JointGains(drive.name, R=R, D=R * m * 2 * math.pi * rng.uniform(1, 4), kp=kp / R, kd=kd / R)
    config = ControllerConfig((gains,), period=h, latency=bench.latency, sampling=bench.sampling)
    return Controller.from_config(config, (drive,))


def motion(bench: Bench, rng: np.random.Generator, size: float) -> Trajectory:
    """A sum of sine waves, about 1.5 rad/s fast times the size."""
    return multisine(
        [rng.uniform(-0.8, 0.8)],
        DURATION,
        bench.period,
        int(rng.integers(2**31)),
        amplitude=size * rng.uniform(0.5, 0.9),
        tones=4,
        band=(0.2, 2.0),
    )


def simulate(bench: Bench, seed: int, number: int) -> Recording:
    """A closed-loop run; gains are drawn again where they make the bench oscillate."""
    rng = np.random.default_rng([seed, number, 1])
    plant = bench.plant()
    for attempt in range(ATTEMPTS):
        path = motion(bench, rng, 1.25 ** (attempt // 5))  # larger where friction holds the arm
        source = controller(bench, rng, 0.8 ** (attempt % 5))
        recording = run(Scenario(plant, source, path, seed=number))
        if recording.diverged_at is None and calm(recording, bench):
            return recording
    raise RuntimeError(f"no stable loop for seed {seed}, number {number}")


def calm(recording: Recording, bench: Bench) -> bool:
    """Whether the arm moves about as much as it was asked to."""
    asked = float(np.std(np.gradient(recording.reference[:, 0], bench.period)))
    return 0.3 * asked < float(np.std(recording.link_velocity)) < 3 * asked


def to_log(bench: Bench, recording: Recording, *, link: bool = True) -> Log:
    """The log a robot would write: command, torque sample, encoder angles; no true value."""
    step = bench.drive.position_resolution
    links: Floats = recording.link_position
    if step:
        links = step * np.floor(links / step + 0.5)
    segment = Segment(
        recording.time,
        recording.command,
        recording.sample,
        recording.position,
        None,
        links if link else None,
    )
    return Log(recording.joints, bench.period, (segment,), bench.sampling, None, "")


def known(bench: Bench, plant_step: float) -> Drive:
    """What the robot file says before identification: the sensor and the limits are right, the drive is not.

    The simulated low-pass holds its input over a physics step, which takes half a step off its delay.
    """
    drive = bench.drive
    half = plant_step / 2 if drive.sensor_bandwidth is not None else 0.0
    steps = round(drive.torque_latency / plant_step)
    return replace(
        drive,
        rotor_inertia=1.0,
        viscous_friction=1.0,
        coulomb_friction=0.0,
        stribeck_friction=0.0,
        stribeck_velocity=0.0,
        stiffness=1e4,
        damping=0.0,
        hysteresis=0.0,
        torque_scale_error=0.0,
        torque_bias=0.0,
        torque_latency=max(steps * plant_step - half, 0.0),
    )


def truth(bench: Bench, plant_step: float) -> dict[str, float]:
    """The values to be found.

    The simulator's step shifts two of them: a torque held from t on acts from half a step before t on, and
    viscous friction, of the speed half a step ahead, weighs v dt/2 like inertia.
    """
    drive = bench.drive
    found = {
        name: getattr(drive, name)
        for name in (
            "rotor_inertia",
            "viscous_friction",
            "coulomb_friction",
            "stribeck_friction",
            "stribeck_velocity",
            "torque_bias",
            "torque_scale_error",
            "stiffness",
            "damping",
        )
    }
    found["rotor_inertia"] += found["viscous_friction"] * plant_step / 2
    return {**found, "latency": bench.latency * bench.period - plant_step / 2}
