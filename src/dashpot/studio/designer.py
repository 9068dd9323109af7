"""The designer beside the arm: one design at a time, in a process that gives way to it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import replace

from dashpot.arm.payload import Payload
from dashpot.arm.robot import Robot
from dashpot.control.controller import ControllerConfig
from dashpot.design.design import Design, design_arm
from dashpot.design.spec import Spec
from dashpot.design.words import conflict_lines
from dashpot.errors import DashpotError
from dashpot.studio.margins import be_nice
from dashpot.support.workers import deaf_to_interrupts, pool_of

PRESETS = ("track", "gentle")  # "brake" leaves the position loop out, by which the studio's arm moves


class _Ended(BaseException):
    """Ends the process at once."""


def specification(
    config: ControllerConfig, joints: tuple[str, ...], payload: Payload, preset: str, **limits: float
) -> Spec:
    """What `dashpot design` would be asked: these joints, in the controller's loop, with the payload.

    Args:
        config: Its period, latency, sampling and form are kept.
        joints: Names.
        payload: The largest.
        preset: One of `PRESETS`.
        limits: Changes of the preset's, e.g. ``stop_time=0.3``; 0 leaves the preset's.

    Raises:
        InputError: A limit is not valid.
    """
    x, y, z = payload.position
    return Spec(
        preset,
        {name: value for name, value in limits.items() if value != 0},
        joints,
        payload=payload.mass,
        offset=(float(x), float(y), float(z)),
        period=config.period,
        latency=config.latency,
        latency_max=config.latency_max,
        sampling=config.sampling,
        form=config.form,
    )


def taken_over(config: ControllerConfig, design: Design) -> ControllerConfig:
    """The controller with the gains of a design.

    Raises:
        DashpotError: Wishes of a joint conflict: with the reasons.
    """
    gains = {}
    for joint in design.joints:
        if joint.found is None:
            raise DashpotError(f"{joint.name}: " + "; ".join(conflict_lines(joint)))
        gains[joint.name] = joint.found.gains.joint(joint.name)
    return replace(config, joints=tuple(gains.get(law.name, law) for law in config.joints))


def _design(robot: Robot, spec: Spec) -> Design:
    be_nice()
    return design_arm(robot, spec)


class Designer:
    """Runs the designer."""

    def __init__(self) -> None:
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()

    @property
    def busy(self) -> bool:
        """Whether a design is under way."""
        return self._thread is not None and self._thread.is_alive()

    def begin(self, robot: Robot, spec: Spec, done: Callable[[Design | None, str], None]) -> None:
        """Begins; `done` is called from a thread with the design, or with None and why there is
        none, "" if it was ended.

        Raises:
            DashpotError: A design is under way.
        """
        if self.busy:
            raise DashpotError("a design is under way")
        self._stop = threading.Event()
        self._thread = threading.Thread(
            target=self._run, args=(self._stop, robot, spec, done), name="dashpot designer", daemon=True
        )
        self._thread.start()

    def end(self) -> None:
        """Ends what is under way at once."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(10)

    @staticmethod
    def _run(
        stop: threading.Event, robot: Robot, spec: Spec, done: Callable[[Design | None, str], None]
    ) -> None:
        found, why = None, ""
        try:
            with pool_of(1) as pool:
                with deaf_to_interrupts():
                    job = pool.submit(_design, robot, spec)
                while not job.done():
                    if stop.is_set():
                        raise _Ended
                    with suppress(TimeoutError):
                        job.result(0.1)
                found = job.result()
        except _Ended:
            pass
        except BrokenProcessPool:
            why = "the designer's process was ended from outside"
        except DashpotError as error:
            why = str(error)
        done(found, why)
