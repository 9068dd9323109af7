"""Random arms and scenarios, to hold the vectorised engine against others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from dashpot.arm.drive import Drive, InnerLoop, Servo
from dashpot.arm.payload import Payload
from dashpot.arm.plant import Plant, build, with_payload
from dashpot.arm.robot import Robot
from dashpot.control.controller import Controller, ControllerConfig, JointGains
from dashpot.errors import InputError
from dashpot.simulation.faults import NAMES, Fault
from dashpot.simulation.release import tracking_events
from dashpot.simulation.simulate import Event, PayloadChange, Scenario
from dashpot.simulation.trajectory import multisine
from dashpot.support.arrays import Floats

SECONDS = 0.3  # of a scenario
PERIOD = 1e-3  # [s]


def random_arm(rng: np.random.Generator, folder: Path) -> Robot:
    """An arm that nobody would build: branched, with slides and hinges, some of them without a motor.

    Args:
        rng: Decides everything.
        folder: Where its MJCF goes.
    """
    joints = int(rng.integers(1, 7))
    driven = {0, *(j for j in range(joints) if rng.random() < 0.8)}
    parents = [-1, *(int(rng.integers(max(-1, j - 2), j)) for j in range(1, joints))]
    order: list[int] = []

    def numbers(values: Floats) -> str:
        return " ".join(f"{value:.6g}" for value in values)

    def turn() -> str:
        """As often as not along the axes, as on most arms."""
        if rng.random() < 0.5:
            return numbers(rng.choice([-90.0, 0.0, 90.0, 180.0], 3))
        return numbers(rng.uniform(-180, 180, 3))

    def body(j: int) -> str:
        order.append(j)
        hinge = j in driven or rng.random() < 0.5
        axis = np.eye(3)[rng.integers(3)] if rng.random() < 0.5 else rng.normal(size=3)
        more = f'ref="{rng.uniform(-20, 20):.4g}"' if hinge and rng.random() < 0.3 else ""
        if j not in driven:
            more += f' damping="{rng.uniform(0.1, 1):.3g}" armature="{rng.uniform(0, 0.1):.3g}"'
            more += f' stiffness="{rng.uniform(5, 100):.3g}" springref="{rng.uniform(-5, 5):.3g}"'
        elif rng.random() < 0.4:
            more += ' limited="true" range="-25 25"'
        a, b, c = rng.uniform(2e-3, 2e-2, 3)
        inside = "".join(body(k) for k in range(joints) if parents[k] == j)
        fixed = f'<body pos="{numbers(rng.uniform(-0.1, 0.1, 3))}" euler="{turn()}">'
        fixed += f'<geom type="sphere" size="0.02" mass="{rng.uniform(0.1, 1):.3g}"/></body>'
        return (
            f'<body pos="{numbers(rng.uniform(-0.3, 0.3, 3))}" euler="{turn()}">'
            f'<joint name="j{j}" type="{"hinge" if hinge else "slide"}" axis="{numbers(axis)}" '
            f'pos="{numbers(rng.uniform(-0.05, 0.05, 3) * (rng.random() < 0.5))}" {more}/>'
            f'<inertial mass="{rng.uniform(0.5, 4):.4g}" pos="{numbers(rng.uniform(-0.1, 0.1, 3))}" '
            f'diaginertia="{numbers(np.array([b + c, a + c, a + b]))}" euler="{turn()}"/>'
            f"{fixed if rng.random() < 0.4 else ''}{inside}</body>"
        )

    roots = "".join(body(k) for k in range(joints) if parents[k] == -1)
    pull = numbers(np.array([*rng.uniform(-2, 2, 2), -9.81]))
    world = f'<worldbody><body euler="{turn()}">{roots}</body></worldbody>'
    text = f'<mujoco><option gravity="{pull}"/>{world}</mujoco>'
    path = folder / f"arm{rng.integers(10**9)}.xml"
    path.write_text(text)
    names = [j for j in order if j in driven]
    home = tuple(rng.uniform(-0.3, 0.3, len(names)))
    return Robot("random", tuple(random_drive(rng, f"j{j}") for j in names), path, home=home,
                 gravity_compensation=bool(rng.random() < 0.5))  # fmt: skip


def random_drive(rng: np.random.Generator, name: str) -> Drive:
    """A drive with some of the elements that a file can name."""

    def perhaps(value: Any, otherwise: Any, chance: float = 0.4) -> Any:
        return value if rng.random() < chance else otherwise

    friction = perhaps(float(rng.uniform(0.05, 1.5)), 0.0)
    return Drive(
        name,
        rotor_inertia=float(rng.uniform(0.05, 0.5)),
        viscous_friction=float(rng.uniform(0.1, 3)),
        coulomb_friction=friction,
        **perhaps({"stribeck_friction": 1.5 * friction + 0.1, "stribeck_velocity": 0.1}, {}),
        stiffness=float(rng.uniform(1e3, 1e4)),
        damping=float(rng.uniform(0.3, 4)),
        torque_limit=float(rng.uniform(40, 120)),
        torque_rate_limit=perhaps(2e3, float("inf")),
        torque_scale_error=perhaps(0.02, 0.0),
        torque_bias=perhaps(0.1, 0.0),
        torque_noise=perhaps(0.02, 0.0),
        torque_resolution=perhaps(0.01, 0.0),
        torque_latency=perhaps(float(rng.uniform(2e-4, 2e-3)), 0.0),
        sensor_bandwidth=perhaps(float(rng.uniform(80, 300)), None),
        sensor_order=int(rng.integers(1, 3)),
        position_resolution=perhaps(1e-5, 0.0),
        backlash=perhaps(1e-4, 0.0, 0.2),
        hysteresis=perhaps(0.3, 0.0, 0.2),
        inner_loop=perhaps(InnerLoop(gain=2.0, period=5e-4, bandwidth=400.0), None, 0.2),
        servo=Servo(kp=400.0, kd=20.0, ki=50.0),
    )


def random_config(rng: np.random.Generator, robot: Robot) -> ControllerConfig:
    """Virtual passive control of some of its joints, in one of its forms."""
    chosen = [drive for drive in robot.drives if rng.random() < 0.8] or [robot.drives[0]]
    laws = [
        JointGains(d.name, R=float(rng.uniform(0.5, 4)), D=float(rng.uniform(2, 20)), kp=200.0, kd=10.0)
        for d in chosen
    ]
    return ControllerConfig(
        joints=tuple(laws),
        period=PERIOD,
        latency=int(rng.integers(0, 2)),
        sampling="average" if rng.random() < 0.5 else "point",
        form="implicit" if rng.random() < 0.7 else "explicit",
    )


def random_scenario(
    rng: np.random.Generator, robot: Robot, config: ControllerConfig, plant: Plant | None = None
) -> Scenario:
    """A motion of an arm with payload, faults, events, knocks, a supervisor, or none of them.

    Args:
        rng: Decides everything.
        robot: The arm.
        config: Its controller.
        plant: The arm as it is built; None: with a random payload.
    """
    if plant is None:
        plant = with_payload(build(robot, config.period), random_payload(rng), config.period)
    amplitude = 0.02 + 0.3 * rng.random()
    path = multisine(robot.home, SECONDS, config.period, int(rng.integers(1000)), amplitude=amplitude,
                     ramp=0.2, lead_in=0.02)  # fmt: skip
    joints = [law.name for law in config.joints]
    events = tracking_events(config, path.start)
    if rng.random() < 0.4:
        mode = str(rng.choice(["off", "bypass", "active"]))
        events.append(Event(float(rng.uniform(0, SECONDS)), str(rng.choice(joints)), "mode", mode))
    if rng.random() < 0.4:
        events.append(Event(float(rng.uniform(0, SECONDS)), "all", "position_loop", False))
    external = None
    if rng.random() < 0.4:
        external = 5.0 * rng.normal(size=path.position.shape) * (rng.random(path.position.shape) < 0.1)
    changes = [PayloadChange(0.1, random_payload(rng))] if rng.random() < 0.3 else []
    return Scenario(
        plant,
        Controller.from_config(config, robot.drives),
        path,
        events,
        external,
        seed=int(rng.integers(10**6)),
        faults=[fault for _ in range(int(rng.integers(0, 4))) for fault in random_fault(rng, robot, joints)],
        payload_changes=changes,
        supervisor=replace(config.supervisor, friction_margin=0.2) if rng.random() < 0.4 else None,
        gravity_compensation=bool(rng.random() < 0.5),
    )


def random_payload(rng: np.random.Generator) -> Payload:
    """Up to 2 kg somewhere near the flange."""
    return Payload(float(rng.uniform(0, 2)) * (rng.random() < 0.8), tuple(rng.uniform(-0.1, 0.1, 3)))


def random_fault(rng: np.random.Generator, robot: Robot, controlled: list[str]) -> list[Fault]:
    """One fault of a random kind, or none where that kind does not fit the joint."""
    kind = NAMES[int(rng.integers(len(NAMES)))]
    start = float(rng.uniform(0, SECONDS - 0.01))
    end = start + float(rng.uniform(0.005, 0.2)) if rng.random() < 0.5 else float("inf")
    joint = "all" if kind == "brownout" or rng.random() < 0.3 else str(rng.choice(controlled))
    try:
        return [Fault(kind, start, end, joint)]
    except InputError:  # one that needs a value
        return [Fault(kind, start, end, joint, 0.5)]


def pinocchio_of(plant: Plant) -> Any:
    """The rigid links of a plant, without rotors, as a Pinocchio model, from MuJoCo's bodies and joints.

    Joints come in the order of `dashpot.lanes.Tree`; angles are 0 where MuJoCo's are at ``qpos0``.

    Raises:
        ImportError: Pinocchio is not installed.
    """
    import pinocchio as pin

    model, found = plant.model, pin.Model()
    found.gravity = pin.Motion(model.opt.gravity, np.zeros(3))
    springs = {int(model.dof_jntid[dof]) for dof in plant.spring_dof}
    frames = [(0, pin.SE3.Identity())]

    def pose(place: Floats, quat: Floats) -> Any:
        w, x, y, z = quat
        return pin.SE3(pin.Quaternion(w, x, y, z).matrix(), place)

    for body in range(1, model.nbody):
        joint, at = frames[model.body_parentid[body]]
        at = at * pose(model.body_pos[body], model.body_quat[body])
        for j in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            if j in springs:
                continue
            anchor = pin.SE3(np.eye(3), model.jnt_pos[j])
            hinge = model.jnt_type[j] == int(mujoco.mjtJoint.mjJNT_HINGE)
            kind = pin.JointModelRevoluteUnaligned if hinge else pin.JointModelPrismaticUnaligned
            joint = found.addJoint(joint, kind(model.jnt_axis[j]), at * anchor, model.joint(j).name)
            at = anchor.inverse()
        frames.append((joint, at))
        if joint and model.body_mass[body] > 0:
            own = pin.Inertia(model.body_mass[body], np.zeros(3), np.diag(model.body_inertia[body]))
            found.appendBodyToJoint(joint, own, at * pose(model.body_ipos[body], model.body_iquat[body]))
    return found
