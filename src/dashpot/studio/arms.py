"""The arms of the studio and their time: which robot runs under which controller, a rival beside it, in real
time on a thread or step by step.
"""

from __future__ import annotations

import math
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dashpot.arm.payload import Payload
from dashpot.arm.plant import Plant, build
from dashpot.arm.robot import Robot
from dashpot.control.controller import ControllerConfig, load_controller
from dashpot.control.supervisor import SupervisorSettings
from dashpot.errors import DashpotError, InputWarning
from dashpot.simulation.faults import Fault
from dashpot.studio.choices import carriable, poses, rival_of
from dashpot.studio.energy import Account, Energy
from dashpot.studio.live import LiveArm
from dashpot.studio.margins import Certifier
from dashpot.studio.references import Hold, Reference, go_to
from dashpot.studio.ring import Ring
from dashpot.studio.snapshot import News
from dashpot.support.workers import NATIVE_LOOP

WINDOW = 0.01  # [s] between two looks at what is asked for
LATEST = 0.25  # [s] by which the arm may fall behind before it gives the lost time up
REMEMBERED = 60.0  # [s]
ENERGIES = 6000  # windows whose energy is remembered


class Arms:
    """One arm and its time, and a rival beside it if one is chosen. Attributes: see `Session`."""

    def __init__(
        self,
        robot: str | Path | Robot,
        controller: str | Path | ControllerConfig,
        *,
        payload: Payload | None = None,
        supervise: bool = True,
        seed: int = 0,
        certify: bool = True,
    ) -> None:
        """Loads an arm at rest.

        Args:
            robot: File, bundled name, or the arm itself.
            controller: Alike.
            payload: On the flange.
            supervise: Whether a supervisor is in charge.
            seed: Of sensor noise and of motions.
            certify: Whether margins are kept; they need a process of their own.

        Raises:
            DashpotError: See `Robot.load`, `load_controller` and `dashpot.arm.plant.build`.
        """
        self._lock = threading.RLock()
        self._running, self._closed = False, threading.Event()
        self._thread: threading.Thread | None = None
        self.seed, self._certify = seed, certify
        self.supervised = self._supervise = supervise  # now, and what the user has chosen
        self.carried, self.generation, self.factor = True, 0, 1.0
        self.certifier: Certifier | None = None
        self.news: deque[News] = deque(maxlen=300)
        self.energies: deque[tuple[float, float, float, float, float]] = deque(maxlen=ENERGIES)
        self._agenda: list[tuple[float, Callable[[], None]]] = []
        self.load(robot, controller, payload)

    def load(
        self,
        robot: str | Path | Robot,
        controller: str | Path | ControllerConfig,
        payload: Payload | None = None,
        fixed: Sequence[Payload] = (),
        reference: Callable[[Robot], Reference] | None = None,
        seed: int | None = None,
        supervise: bool | None = None,
    ) -> None:
        """Takes another arm or another controller, at rest at home; all faults are gone, and so is the rival.

        Args:
            robot: File, bundled name, or the arm itself.
            controller: Alike.
            payload: On the flange; what `set_payload` changes.
            fixed: What else hangs there, always.
            reference: Makes the reference to start with; None: rest at home.
            seed: Of the sensor noise; None: the session's.
            supervise: Whether a supervisor is in charge until something else is loaded; None: as the user
                has chosen.

        Raises:
            DashpotError: They cannot be used; everything stays as it was.
        """
        if payload is not None:
            carriable(payload.mass, payload.offset)
        arm = robot if isinstance(robot, Robot) else Robot.load(robot)
        config = controller if isinstance(controller, ControllerConfig) else load_controller(controller)
        loads = [*fixed, *([payload] if payload is not None and payload.mass > 0 else [])]
        supervised = self._supervise if supervise is None else supervise
        with quiet():
            plant = build(arm, config.period, loads)
            first = reference(arm) if reference else Hold(np.array(arm.home))
            settings = SupervisorSettings() if supervised else None
            live = LiveArm(
                arm, config, plant, first, payloads=loads, supervisor=settings,
                seed=self.seed if seed is None else seed, carried=self.carried,
            )  # fmt: skip
            if live.diverged is not None:
                raise DashpotError("the arm cannot be simulated")
        with self._lock:
            same = self.certifier is not None and self.certifier.robot.drives == arm.drives
            if not same:
                if self.certifier is not None:
                    self.certifier.close()
                self.certifier = Certifier(arm) if self._certify else None
            self.robot, self.config, self.arm, self.supervised = arm, config, live, supervised
            self.payload, self._fixed = payload or Payload(0.0), tuple(fixed)
            self.rival: LiveArm | None = None
            self.rival_name = ""
            self.poses = poses(arm, plant)
            self.joint = config.joints[-1].name
            self.faults: dict[str, tuple[Fault, list[tuple[LiveArm, list[int]]]]] = {}
            self._agenda.clear()
            self._start, self.generation = 0.0, self.generation + 1
            self.ring = self.rival_ring = Ring(len(arm.drives), config.period, REMEMBERED)
            self.energies.clear()
            self.news.clear()
            self.account, self.energy = Account(live), Energy(live.energy()[0], 0.0, 0.0, 0.0)
            self._judge()

    def restart(self) -> None:
        """The same arm and controller again, at rest at home."""
        with self._lock:
            self.load(self.robot, self.config, self.payload, self._fixed)

    def set_rival(self, name: str, config: ControllerConfig | None = None) -> None:
        """Puts the same arm under another controller beside it, moving as it does now; "": none.

        Args:
            name: One of `dashpot.studio.choices.RIVALS`, or what to call `config`.
            config: The rival's controller; None: made from the present one.
        """
        with self._lock:
            self.rival, self.rival_name = None, ""
            if not name:
                return
            made = config or rival_of(name, self.config, self.robot)
            with quiet():
                self.rival = LiveArm(
                    self.robot, made, self.arm.plant, self.arm.reference,
                    payloads=self.arm.payloads, seed=self.arm.scenario.seed, carried=self.carried,
                    like=self.arm,
                )  # fmt: skip
            self.rival.follow(self.arm.reference)
            self.rival._since = self.rival.tick - (self.arm.tick - self.arm._since)
            self.rival_name = name
            self.rival_ring = Ring(len(self.robot.drives), self.config.period, REMEMBERED)
            for fault, reached in self.faults.values():
                reached.append((self.rival, self.rival.begin(fault)))
            self.generation += 1
            self._tell(f"beside it: {name}")

    @property
    def time(self) -> float:
        """On the session's clock [s]."""
        return self._start + self.arm.time

    def start(self) -> None:
        """Runs in real time, on a thread of its own."""
        with self._lock:
            self._running = self.arm.diverged is None
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name=NATIVE_LOOP, daemon=True)
                self._thread.start()

    def pause(self) -> None:
        """Stands still in time."""
        with self._lock:
            self._running = False

    @property
    def running(self) -> bool:
        """Whether it runs in real time."""
        return self._running

    def close(self) -> None:
        """Ends all threads and processes."""
        self._closed.set()
        self.pause()
        if self._thread is not None:
            self._thread.join(5)
        if self.certifier is not None:
            self.certifier.close()

    def step(self, seconds: float = WINDOW) -> None:
        """Runs some time by hand, in windows as in real time."""
        with self._lock:
            end = self.time + seconds - 1e-9
            while self.time < end and self.arm.diverged is None:
                self._step()

    def at(self, when: float, what: Callable[[], None]) -> None:
        """Does something at a time on the session's clock [s], with the accuracy of a window."""
        with self._lock:
            self._agenda.append((when, what))
            self._agenda.sort(key=lambda entry: entry[0])

    def _step(self) -> None:
        while self._agenda and self._agenda[0][0] <= self.time + 1e-9:
            self._agenda.pop(0)[1]()
        ticks = max(1, round(WINDOW / self.config.period))
        if self._agenda:  # what is due is done at its tick
            due = math.ceil((self._agenda[0][0] - self.time) / self.config.period - 1e-6)
            ticks = min(ticks, max(1, due))
        begun = self.time
        window = self.arm.go_on(ticks)
        self.ring.write(window, begun)
        if self.rival is not None:
            if self.arm.push is not None:  # the same force at the same place of the same link
                self.rival.push = self.arm.push.same(self.arm.push.force)
            else:
                self.rival.push = None
            if self.rival.diverged is None:
                self.rival_ring.write(self.rival.go_on(ticks), begun)
                if self.rival.diverged is not None:
                    self._tell(f"beside it, {self.rival_name}: unstable, stopped", "trouble")
        for decision in self.arm.news():
            said = replace(decision, time=self._start + decision.time)
            self._tell(str(said).partition(" s: ")[2], "supervisor", said.time)
        if self.arm.diverged is not None:
            self._running = False
            self._tell("the arm is unstable with these numbers, and was stopped; start again", "trouble")
            return
        self.energy = self.account.after(self.arm)
        self.energies.append((self.time, *self.energy.row()))

    def _run(self) -> None:
        due, told, simulated = time.perf_counter(), time.perf_counter(), self.time
        while not self._closed.is_set():
            now = time.perf_counter()
            if not self._running:
                due, told, simulated = now, now, self.time
                self._closed.wait(0.02)
                continue
            if now < due:
                time.sleep(min(due - now, 0.02))
                continue
            if now - due > LATEST:
                due = now
            with self._lock:
                begun = self.time
                self._step()
                passed = self.time - begun
            due += max(passed, 0.0)
            if now - told > 1.0:
                ahead = self.time - simulated
                if 0 <= ahead <= 10:  # else it was exchanged
                    self.factor = ahead / (now - told)
                told, simulated = now, self.time

    # What the rest is made of.

    def _tell(self, text: str, kind: str = "you", when: float | None = None) -> None:
        self.news.append(News(self.time if when is None else when, text, kind))

    def _arms(self) -> list[LiveArm]:
        return [self.arm] if self.rival is None else [self.arm, self.rival]

    def _exchange(self, config: ControllerConfig, plant: Plant, loads: Sequence[Payload]) -> None:
        """Another simulation goes on from the motion of this one."""
        start, old = self.arm.reference_now(), self.arm
        settings = SupervisorSettings() if self.supervised else None
        arm = LiveArm(
            self.robot, config, plant, Hold(start[0]), payloads=loads, supervisor=settings,
            seed=old.scenario.seed, carried=self.carried, like=old,
        )  # fmt: skip
        arm.follow(go_to(start, start[0] + 0.3 * start[1], config.period))
        self._start = self.time
        self.arm, self.rival, self.rival_name = arm, None, ""
        if config.period != self.config.period:
            self.ring = Ring(len(self.robot.drives), config.period, REMEMBERED)
        for name, (fault, _) in list(self.faults.items()):
            try:
                self.faults[name] = (fault, [(arm, arm.begin(fault))])
            except DashpotError:
                del self.faults[name]
        self.generation += 1

    def _judge(self) -> None:
        if self.certifier is not None:
            self.certifier.look_at(self.config, self.joint)


class quiet(warnings.catch_warnings):  # noqa: N801 - reads as a statement
    """Input warnings are for the terminal; here the fields and the margins show what they say."""

    def __enter__(self) -> None:
        super().__enter__()
        warnings.simplefilter("ignore", InputWarning)
