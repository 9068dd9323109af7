"""The link of ``dashpot run``: a simulated arm, or the adapter of a robot."""

from __future__ import annotations

import importlib
import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from dashpot.commands.payload import payload_of
from dashpot.commands.run_job import Job
from dashpot.control.controller import Controller
from dashpot.errors import DashpotError, InputError
from dashpot.hardware.interface import Hardware
from dashpot.hardware.runtime import Start, said
from dashpot.simulation.release import tracking_events
from dashpot.simulation.simulate import Scenario
from dashpot.simulation.trajectory import Trajectory
from dashpot.support.installing import install
from dashpot.support.waiting import waiting

if TYPE_CHECKING:
    from dashpot.cli.deploy import Run

SPARE = 1.0  # [s] that a simulated arm can go on for, besides a stop


@contextmanager
def connected(options: Run, job: Job) -> Iterator[tuple[Hardware, Start | None]]:
    """The robot, and where the controller starts if that is known without asking it."""
    with waiting("starting the simulated arm" if options.via == "sim" else "connecting"):
        if options.via == "sim":
            hardware, start = _simulated(options, job)
        else:
            hardware, start = _robot(options, job), None
    try:
        yield hardware, start
    finally:
        hardware.stop()


def _simulated(options: Run, job: Job) -> tuple[Hardware, Start | None]:
    from dashpot.commands.simulate_faults import of_faults, read_changes, read_faults
    from dashpot.hardware.sim import LinkSettings, SimHardware
    from dashpot.simulation.prepare import check

    path, plant = job.path, job.plant
    assert path is not None
    assert plant is not None
    stop = job.supervisor.settings
    after = stop.stop_time + stop.release_time + SPARE
    link = LinkSettings(realtime=not options.lock_step, record=options.record)
    scenario = Scenario(
        plant,
        Controller.from_config(job.config, job.robot.drives),
        path,
        tracking_events(job.config, path.start),
        seed=options.seed,
        faults=read_faults(options.fault, job.robot),
        payload_changes=read_changes(options.payload_at, payload_of(options.payload, options.offset)),
        gravity_compensation=True,
    )
    with of_faults():
        check(scenario)  # what fails does so while the motion lasts
    longer = replace(scenario, trajectory=standing(path, after + link.after))
    hardware = SimHardware(longer, link, supervisor=job.supervisor)
    return hardware, hardware.equilibrium()


def standing(path: Trajectory, time: float) -> Trajectory:
    """A motion that stands at its end for some more time [s]."""
    ticks = math.ceil(time / path.period)

    def longer(array: Any, still: bool) -> Any:
        last = np.zeros_like(array[-1:]) if still else array[-1:]
        return np.vstack([array, last.repeat(ticks, 0)])

    return replace(
        path,
        position=longer(path.position, False),
        velocity=longer(path.velocity, True),
        acceleration=longer(path.acceleration, True),
        torque=None if path.torque is None else longer(path.torque, False),
    )


def _robot(options: Run, job: Job) -> Hardware:
    """The adapter of ``--via``: pylibfranka's, or ``module:Class`` called with host and robot."""
    if options.via == "franka":
        if not options.host:
            raise InputError("is needed: the robot's address, e.g. --host 172.16.0.2", quantity="--host")
        module, name = "dashpot.hardware.franka", "FrankaHardware"
    else:
        module, _, name = options.via.partition(":")
    if not module or not name:
        raise InputError(
            "must be sim, franka, or module:Class, the adapter of your robot",
            quantity="--via",
            value=options.via,
        )
    sys.path.insert(0, "")  # a module in the current folder, as `python -m` finds it
    try:
        made = getattr(importlib.import_module(module), name)(options.host, job.robot)
    except DashpotError:
        raise
    except ModuleNotFoundError as error:
        raise InputError(
            f"cannot be imported: {error}" + (f"; {install('franka')}" if options.via == "franka" else ""),
            quantity="--via",
            value=options.via,
        ) from None
    except Exception as error:
        raise InputError(f"cannot be made: {said(error)}", quantity="--via", value=options.via) from None
    finally:
        sys.path.remove("")
    if not isinstance(made, Hardware):
        wanted = "joints, period, paced, reason, start, read, write, apply_brake and stop"
        raise InputError(f"lacks something; an adapter has {wanted}", quantity="--via", value=options.via)
    return made
