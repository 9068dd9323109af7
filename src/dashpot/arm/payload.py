"""Weights on the flange."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from dashpot.arm.robot import Robot
from dashpot.errors import InputError, ModelError
from dashpot.support.arrays import Floats
from dashpot.support.tables import check_numbers, number

STEEL = 7850.0  # [kg/m^3], density of payload spheres


@dataclass(frozen=True)
class Payload:
    """A weight on the flange: a steel sphere at an offset, or a rod that reaches from it.

    Attributes:
        mass: [kg].
        offset: Centre of mass in the flange frame, (x, y, z) [m]; a number means along x.
        length: Length of a slender rod centred there, along the offset [m]; 0: a sphere.
    """

    mass: float = number("kg", 0, 1e4, typical=(0.01, 500), kw_only=False)
    offset: float | tuple[float, float, float] = 0.0
    length: float = number("m", 0, 10, default=0.0)

    def __post_init__(self) -> None:
        check_numbers(self)
        xyz = np.asarray(self.offset, float)
        if xyz.shape not in ((), (3,)) or not np.isfinite(xyz).all() or np.abs(xyz).max() > 10:
            raise InputError(
                "must be a number or (x, y, z) within 10 m", quantity="payload offset [m]", value=self.offset
            )

    @property
    def position(self) -> Floats:
        """Centre of mass in the flange frame, (3,) [m]."""
        xyz = np.asarray(self.offset, float)
        return np.array([float(xyz), 0.0, 0.0]) if xyz.ndim == 0 else xyz


def hang(spec: Any, rigid: Any, robot: Robot, payloads: Sequence[Payload]) -> None:
    """Attaches the payloads to the flange."""
    body, pos, quat = spec.joint(robot.joints[-1]).parent, np.zeros(3), np.array([1.0, 0, 0, 0])
    if robot.flange is not None:
        if spec.site(robot.flange) is None:
            known = ", ".join(s.name for s in spec.sites) or "none"
            raise ModelError(
                f"{robot.file}: flange = {robot.flange!r}: no such site in {robot.model}; sites: {known}"
            )
        site = rigid.site(robot.flange)
        body, pos, quat = spec.site(robot.flange).parent, site.pos, site.quat
    for i, load in enumerate(payloads):
        if load.mass == 0:
            continue
        child = body.add_body(name=f"payload{i}", pos=pos, quat=quat)
        centre = load.position
        radius = (3 * load.mass / (4 * math.pi * STEEL)) ** (1 / 3)
        inertia = np.full(3, 0.4 * load.mass * radius**2)
        child.mass, child.ipos, child.explicitinertial = load.mass, centre, True
        reach = np.linalg.norm(centre)
        if load.length > 0 and reach > 0:
            along = centre / reach
            tip = along * load.length / 2
            radius = max(math.sqrt(load.mass / (STEEL * math.pi * load.length)), 0.004)
            full = load.mass * load.length**2 / 12 * (np.eye(3) - np.outer(along, along))
            full += 0.5 * load.mass * radius**2 * np.outer(along, along)
            child.fullinertia = full[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
            child.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                size=[radius, 0, 0],
                fromto=[*(centre - tip), *(centre + tip)],
                rgba=[0.3, 0.3, 0.33, 1],
                mass=load.mass,  # counts where the file says inertiafromgeom="true"
                contype=0,
                conaffinity=0,
            )
        else:
            child.inertia = inertia
            child.add_geom(
                type=mujoco.mjtGeom.mjGEOM_SPHERE,
                size=[radius, 0, 0],
                pos=centre,
                rgba=[0.84, 0.37, 0.0, 1],
                mass=load.mass,
                contype=0,
                conaffinity=0,
            )
