"""``dashpot run``: the controller on a robot, or on a simulated one behind the same interface."""

from __future__ import annotations

import signal
import sys
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from dashpot.certify.certificate import certify_arm
from dashpot.commands.run_job import Job, check_options, prepare
from dashpot.commands.run_link import connected
from dashpot.commands.run_view import show_checks, show_outcome
from dashpot.commands.shared import progress
from dashpot.control.rivals.tracking import PDGravity
from dashpot.errors import DashpotError, InputError
from dashpot.hardware.checks import Verdicts, at_rest, before_link, listen
from dashpot.hardware.interface import Hardware, carries_weight
from dashpot.hardware.realtime import undisturbed
from dashpot.hardware.ring import Ring
from dashpot.hardware.runtime import LoopSettings, Outcome, Start, control, joint_order
from dashpot.hardware.scribe import Notes, scribe
from dashpot.simulation.engine import quiet_engine
from dashpot.support.arrays import Floats
from dashpot.support.waiting import waiting

if TYPE_CHECKING:
    from dashpot.arm.plant import Plant
    from dashpot.cli.deploy import Run


def run(options: Run) -> int:
    """``dashpot run``; returns the exit status."""
    check_options(options)
    quiet_engine()
    with waiting("preparing"):
        job = prepare(options)
    verdicts = None if options.uncertified else _verdicts(options, job)
    settings = job.supervisor.settings
    checks = before_link(
        job.drives, job.config, job.controller, verdicts, settings, path=job.motion, ranges=job.ranges
    )
    failed = any(check.passed is False for check in checks)
    if failed and not options.check:
        show_checks(checks, options)
        return 1
    with connected(options, job) as (hardware, start):
        joint_order(hardware, job.controller)
        _refuse_gravity_twice(hardware, job)
        # Without a clock a sample more is another run: what the sensors say is looked at with --check only.
        if options.check or not options.lock_step:
            quiet = undisturbed(0 if options.lock_step else options.priority, options.cpu)
            with waiting("listening to the arm at rest", still=True), quiet:
                heard = listen(hardware, job.controller, options.samples)
            load = None
            if job.plant is not None:
                where = np.array(job.robot.home)
                where[job.columns] = heard.position.mean(0)
                load = _load(job, job.plant, hardware, where) if np.isfinite(where).all() else None
            # A simulated arm rests where its motion begins, sag included.
            path = None if options.via == "sim" else job.motion
            about: dict[str, Any] = {"path": path, "ranges": job.ranges, "load": load}
            about["realtime"] = not options.lock_step
            checks += at_rest(heard, job.drives, job.controller, settings, **about)
        show_checks(checks, options)
        failed = any(check.passed is False for check in checks)
        if options.check or failed:
            return 1 if failed else 0
        outcome = _run(options, job, hardware, start)
    show_outcome(outcome, job.controller, options)
    if outcome.end == "stopped":
        return 128 + (outcome.signal or signal.SIGINT)
    return 0 if outcome.end == "done" and not outcome.problems else 1


def _load(job: Job, plant: Plant, hardware: Hardware, where: Floats) -> Floats:
    """Torque of gravity that the sensors show at a pose (n,) [rad], per controlled joint [N m]."""
    from dashpot.arm.plant import build

    load = plant.load_torque(where)
    if carries_weight(hardware):
        load -= build(job.robot, job.config.period).load_torque(where)
    return np.asarray(load[job.columns])


def _refuse_gravity_twice(hardware: Hardware, job: Job) -> None:
    """Checks that no law adds the weight of an arm that carries it itself."""
    if not carries_weight(hardware) or job.robot.gravity_compensation:  # known: the law leaves it out
        return
    for law in job.config.joints:
        if isinstance(law, PDGravity):
            raise InputError(
                f"adds gravity, which this robot does itself; say gravity_compensation = true in "
                f"{job.robot.file}",
                file=job.config.file,
                joint=law.name,
                quantity="law",
            )


def _run(options: Run, job: Job, hardware: Hardware, start: Start | None) -> Outcome:
    terminal = sys.stderr.isatty()
    limits = tuple(float(drive.torque_limit) for drive in job.drives)
    about = (
        ("robot", job.robot.name),
        ("controller", str(options.controller)),
        ("sampling", job.controller.sampling),
    )
    log = "" if options.log is None else str(options.log.resolve())
    names = job.controller.joints
    notes = Notes(
        names,
        job.controller.period,
        limits,
        log,
        terminal and not options.lock_step,
        not options.lock_step,
        about,
    )
    ring = Ring() if log or notes.live else None
    settings = LoopSettings(
        priority=0 if options.lock_step else options.priority, cpu=options.cpu, flow=options.lock_step
    )
    duration = options.duration
    if duration is not None and job.path is not None:
        duration = None  # the path has been cut to it
    motion = job.motion
    means: dict[str, Any] = {"duration": duration, "start": start, "settings": settings}
    if ring is None:
        with waiting("running in lock step" if options.lock_step else "running", still=not options.lock_step):
            return control(hardware, job.supervisor, motion, **means)
    outcome: Outcome | None = None
    try:
        with ExitStack() as stack:
            with waiting("starting the log"):
                stack.enter_context(scribe(ring, notes))
            if options.lock_step:
                stack.enter_context(waiting("running in lock step"))
            outcome = control(hardware, job.supervisor, motion, **means, ring=ring.memory)
    except DashpotError as error:  # of the log; how the run ended is worth more
        if outcome is None:
            raise
        outcome = replace(outcome, problems=(*outcome.problems, str(error)))
    return outcome


def _verdicts(options: Run, job: Job) -> Verdicts:
    if options.certificate is not None:
        return Verdicts.load(options.certificate)
    with progress("certifying", len(job.config.joints)) as advance:
        return Verdicts.of(certify_arm(job.robot, job.config, advance).table())
