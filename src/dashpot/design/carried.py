"""What every joint of an arm carries: inertia and load torque, over the poses it can take."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dashpot.arm.robot import Robot
from dashpot.design.spec import Spec
from dashpot.errors import InputError
from dashpot.support.arrays import Floats
from dashpot.support.tables import as_float

POSES = 256  # of a low-discrepancy sequence over the joints' ranges
LEAST = 1e-6  # [kg m^2], link inertia where the model has none; [N m], what is a load at all


@dataclass(frozen=True)
class Carried:
    """What one joint carries.

    Attributes:
        inertia: Least of the link about the axis, others held, without payload [kg m^2].
        loaded: Largest with payload [kg m^2].
        load: Largest torque of the payload's weight, and the arm's where the robot does not carry it [N m].
    """

    inertia: float
    loaded: float
    load: float


def carried(robot: Robot, spec: Spec, period: float) -> dict[str, Carried]:
    """What every joint carries, from the model; or from the specification where it says.

    Raises:
        InputError: There is no model, and the specification does not say.
        ModelError: The model cannot be used.
    """
    stated = {
        name: {key: own[key] for key in ("inertia", "load") if key in own} for name, own in spec.own.items()
    }
    for name, values in stated.items():
        for key, value in values.items():
            if (
                isinstance(value, bool)
                or not isinstance(value, int | float)
                or not 0 <= as_float(value) < 1e6
            ):
                raise InputError(
                    "must be a number, at least 0 and below 1e6",
                    file=spec.file,
                    joint=name,
                    quantity=key,
                    value=value,
                )
    names = spec.joints or robot.joints
    if all("inertia" in stated.get(name, {}) for name in names):
        found = {name: Carried(LEAST, LEAST, 0.0) for name in names}
    elif robot.model is None:
        missing = [name for name in names if "inertia" not in stated.get(name, {})]
        raise InputError(
            f"the robot has no model to tell what {', '.join(missing)} carries: give `model` in the "
            "robot file, or `inertia` [kg m^2] and `load` [N m] in a [[joint]] table of the specification",
            file=robot.file,
        )
    else:
        found = _from_model(robot, spec, period)
    result = {}
    for name in names:
        own, base = stated.get(name, {}), found[name]
        loaded = max(as_float(own["inertia"]), LEAST) if "inertia" in own else base.loaded
        inertia = min(base.inertia, loaded) if "inertia" not in own or base.inertia > LEAST else loaded
        load = as_float(own.get("load", base.load))
        result[name] = Carried(inertia, loaded, load if load > LEAST else 0.0)
    return result


def _from_model(robot: Robot, spec: Spec, period: float) -> dict[str, Carried]:
    import mujoco

    from dashpot.arm.dynamics import full_mass
    from dashpot.arm.payload import Payload
    from dashpot.arm.plant import build

    weight = [Payload(spec.payload, spec.offset)] if spec.payload > 0 else []
    empty, full = build(robot, period), build(robot, period, weight)
    inertia: list[Floats] = []
    loaded: list[Floats] = []
    load: list[Floats] = []
    for q in poses(robot, spec, empty.drives["stop_lower"], empty.drives["stop_upper"]):
        for plant, into in ((empty, inertia), (full, loaded)):
            data = mujoco.MjData(plant.model)
            data.qpos[plant.rotor_qpos] = q
            into.append(np.diag(full_mass(plant.model, data))[plant.spring_dof])
        own = empty.load_torque(q) if spec.gravity_compensated else 0.0
        load.append(np.abs(full.load_torque(q) - own))
    least, most, torque = np.min(inertia, 0), np.max(loaded, 0), np.max(load, 0)
    return {
        name: Carried(max(float(least[i]), LEAST), max(float(most[i]), LEAST), float(torque[i]))
        for i, name in enumerate(robot.joints)
    }


def poses(robot: Robot, spec: Spec, lower: Floats, upper: Floats) -> Floats:
    """Poses at which an arm is looked at, (poses, n) [rad]: home, and all over the joints' ranges."""
    home = np.array([robot.home])
    if spec.pose == "home":
        return home
    # A joint without stops turns once around home.
    low = np.where(np.isfinite(lower), lower, home[0] - math.pi)
    high = np.where(np.isfinite(upper), upper, home[0] + math.pi)
    from scipy.stats import qmc  # takes as long to import as everything else together

    spread = qmc.Halton(len(robot.drives), scramble=False).random(POSES)
    return np.vstack([home, low + spread * (high - low)])
