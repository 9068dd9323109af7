"""The studio without its page: an arm that runs in real time, what it is told, and what it shows.

All calls may come from any thread, also while the arm runs; between two windows of about 10 ms each takes
effect at once. `step` runs a window by hand, for tests and for recordings that must be repeatable.
"""

from __future__ import annotations

import math
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.commands import NATIVE_LOOP
from dashpot.controller import ControllerConfig, Mode, load_controller
from dashpot.errors import DashpotError, InputError, InputWarning
from dashpot.faults import Fault, FaultKind
from dashpot.payload import Payload
from dashpot.plant import Plant, build
from dashpot.release import release_events
from dashpot.robot import Robot
from dashpot.sampled import Floats
from dashpot.studio.choices import poses, rival_of
from dashpot.studio.energy import Account, Energy
from dashpot.studio.live import LiveArm
from dashpot.studio.margins import Certifier
from dashpot.studio.push import Push
from dashpot.studio.references import Hold, Reference, go_to, wander
from dashpot.studio.ring import Past, Ring
from dashpot.supervisor import SupervisorSettings
from dashpot.tables import as_float

WINDOW = 0.01  # [s] between two looks at what is asked for
LATEST = 0.25  # [s] by which the arm may fall behind before it gives the lost time up
REMEMBERED = 60.0  # [s]
ENERGIES = 6000  # windows whose energy is remembered
HEAVIEST = 20.0  # [kg] on the flange
POUND = 0.45359237  # [kg]


@dataclass(frozen=True)
class News:
    """Something that happened.

    Attributes:
        time: On the session's clock [s].
        text: In one line.
        kind: "you": somebody did it here; "supervisor": it decided; "scene": told by one; "trouble".
    """

    time: float
    text: str
    kind: str = "you"


@dataclass(frozen=True)
class Snapshot:
    """The arm at one time; arrays (n,), base to tip.

    Attributes:
        time: On the session's clock [s].
        factor: Simulated time over time that has passed, over the last seconds [-].
        running: Whether it runs.
        state: The supervisor's.
        brake_closed: Whether the mechanical brakes are closed by the supervisor.
        position: Link angles [rad].
        velocity: Of the links [rad/s].
        reference: [rad].
        torque: Sensed [N m].
        command: [N m].
        energy: Of the arm.
        payload: On the flange [kg].
        faults: Names of what fails.
        push: Force of the hand [N], (3,), and where it acts [m], (3,); None: there is none.
        diverged: Whether the simulation blew up.
    """

    time: float
    factor: float
    running: bool
    state: str
    brake_closed: bool
    position: Floats
    velocity: Floats
    reference: Floats
    torque: Floats
    command: Floats
    energy: Energy
    payload: float
    faults: tuple[str, ...]
    push: tuple[Floats, Floats] | None
    diverged: bool


class Session:
    """One arm in the studio, and a rival beside it if one is chosen.

    Attributes:
        robot: The arm.
        config: The controller as it is edited.
        arm: What runs.
        rival: The same arm under another controller, or None.
        rival_name: Its name, "" where there is none.
        certifier: Keeps margins and maps.
        ring, rival_ring: The last minute.
        energies: Time and energies of every window, oldest first.
        news: What happened, oldest first.
        joint: Name of the joint on show.
        generation: Counts how often the arm was exchanged: what is drawn of it must be drawn anew.
    """

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
            DashpotError: See `Robot.load`, `load_controller` and `dashpot.plant.build`.
        """
        self._lock = threading.RLock()
        self._running, self._closed = False, threading.Event()
        self._thread: threading.Thread | None = None
        self.seed, self._certify = seed, certify
        self.supervised, self.generation, self.factor = supervise, 0, 1.0
        self.certifier: Certifier | None = None
        self.news: deque[News] = deque(maxlen=300)
        self.energies: deque[tuple[float, float, float, float, float]] = deque(maxlen=ENERGIES)
        self._agenda: list[tuple[float, Callable[[], None]]] = []
        self.load(robot, controller, payload)

    # Arms.

    def load(
        self,
        robot: str | Path | Robot,
        controller: str | Path | ControllerConfig,
        payload: Payload | None = None,
        fixed: Sequence[Payload] = (),
        reference: Callable[[Robot], Reference] | None = None,
        seed: int | None = None,
    ) -> None:
        """Takes another arm or another controller, at rest at home; all faults are gone, and so is the rival.

        Args:
            robot: File, bundled name, or the arm itself.
            controller: Alike.
            payload: On the flange; what `set_payload` changes.
            fixed: What else hangs there, always.
            reference: Makes the reference to start with; None: rest at home.
            seed: Of the sensor noise; None: the session's.

        Raises:
            DashpotError: They cannot be used; everything stays as it was.
        """
        arm = robot if isinstance(robot, Robot) else Robot.load(robot)
        config = controller if isinstance(controller, ControllerConfig) else load_controller(controller)
        loads = [*fixed, *([payload] if payload is not None and payload.mass > 0 else [])]
        with quiet():
            plant = build(arm, config.period, loads)
            first = reference(arm) if reference else Hold(np.array(arm.home))
            settings = SupervisorSettings() if self.supervised else None
            live = LiveArm(
                arm, config, plant, first, payloads=loads, supervisor=settings,
                seed=self.seed if seed is None else seed,
            )  # fmt: skip
            if live.diverged is not None:
                raise DashpotError("the arm cannot be simulated")
        with self._lock:
            same = self.certifier is not None and self.certifier.robot.drives == arm.drives
            if not same:
                if self.certifier is not None:
                    self.certifier.close()
                self.certifier = Certifier(arm) if self._certify else None
            self.robot, self.config, self.arm = arm, config, live
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
                    payloads=self.arm.payloads, seed=self.arm.scenario.seed, like=self.arm,
                )  # fmt: skip
            self.rival.follow(self.arm.reference)
            self.rival._since = self.rival.tick - (self.arm.tick - self.arm._since)
            self.rival_name = name
            self.rival_ring = Ring(len(self.robot.drives), self.config.period, REMEMBERED)
            for fault, reached in self.faults.values():
                reached.append((self.rival, self.rival.begin(fault)))
            self.generation += 1
            self._tell(f"beside it: {name}")

    def _arms(self) -> list[LiveArm]:
        return [self.arm] if self.rival is None else [self.arm, self.rival]

    # Time.

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

    # What it is told.

    def go(self, pose: str | Floats) -> None:
        """Moves to a pose, by name or (n,) [rad], and rests there.

        Raises:
            InputError: There is no such pose, or it is outside a joint's range.
        """
        with self._lock:
            target = self._pose(pose)
            start = self.arm.reference_now()
            self._follow(go_to(start, target, self.config.period))
            self._tell("goes to " + (pose if isinstance(pose, str) else "a pose"))

    def move(self, amplitude: float = 0.3, pose: str | Floats = "home") -> None:
        """Moves about a pose for ever, every joint by up to an amplitude [rad].

        Raises:
            InputError: The amplitude is not between 0 and 1 rad.
        """
        if not 0 < amplitude <= 1:
            raise InputError("must be above 0 and at most 1 rad", quantity="amplitude [rad]", value=amplitude)
        with self._lock:
            target = self._pose(pose)
            drives = self.arm.plant.drives
            room = np.minimum(drives["stop_upper"] - target, target - drives["stop_lower"])
            sizes = np.minimum(amplitude, np.maximum(0.9 * room, 0.0))
            start = self.arm.reference_now()
            self._follow(wander(start, target, sizes, self.config.period, self.seed))
            self._tell(
                f"moves about {pose if isinstance(pose, str) else 'a pose'} by up to {amplitude:g} rad"
            )

    def hold(self) -> None:
        """Comes to rest."""
        with self._lock:
            start = self.arm.reference_now()
            self._follow(go_to(start, start[0] + 0.3 * start[1], self.config.period))
            self._tell("holds")

    def follow(self, reference: Reference) -> None:
        """Follows any reference from now on."""
        with self._lock:
            self._follow(reference)

    def set_payload(self, mass: float, offset: float | tuple[float, float, float] | None = None) -> None:
        """Hangs a mass [kg] on the flange at an offset [m], instead of the present one.

        Raises:
            InputError: It cannot be carried or simulated.
        """
        if not 0 <= mass <= HEAVIEST:
            raise InputError(f"must be 0 to {HEAVIEST:g} kg", quantity="payload [kg]", value=mass)
        load = Payload(mass, self.payload.offset if offset is None else offset)
        loads = [*self._fixed, *([load] if mass > 0 else [])]
        with quiet():
            plant = build(self.robot, self.config.period, loads)
        with self._lock:
            held = self.arm.energy()
            for arm in self._arms():
                if not arm.carry(plant, loads):
                    self._exchange(self.config, plant, loads)
                    break
            self.payload = load
            self.account.restate(held, self.arm.energy())
            self.generation += 1
            self._tell(f"payload {mass:.2f} kg ({mass / POUND:.1f} lb)")

    def tap(self, joint: str, torque: float) -> None:
        """Knocks a link for 0.1 s [N m].

        Raises:
            InputError: There is no such joint.
        """
        with self._lock:
            for arm in self._arms():
                arm.tap(self.robot.index(joint), torque, 0.1)
            self._tell(f"{joint} tapped with {torque:g} N m")

    def grasp(self, body: int, point: Floats) -> None:
        """Takes hold of a body of the model at a point of the world (3,) [m]."""
        with self._lock:
            if not 0 < body < self.arm.model.nbody:
                raise InputError("no such body", quantity="body", value=body)
            self.arm.push = Push.at(self.arm.data, body, point)

    def pull(self, target: Floats) -> None:
        """Pulls what was taken hold of towards a point of the world (3,) [m]."""
        with self._lock:
            if self.arm.push is not None and np.isfinite(target).all():
                self.arm.push.target = np.array(target, float)

    def let_go(self) -> None:
        """Lets go."""
        with self._lock:
            self.arm.push = None

    # The controller.

    def edit(self, joint: str, **numbers: float) -> None:
        """Changes numbers of a joint's law, or of all joints' ("all"), e.g. ``R=10.0``.

        Raises:
            InputError: A number is out of its range, the joint's law has no such number, or the supervisor
            has stopped the arm; everything stays as it was.
        """
        with self._lock:
            chosen = [law for law in self.config.joints if joint in ("all", law.name)]
            if not chosen:
                self.arm.controller.index(joint)
            laws = list(self.config.joints)
            for i, law in enumerate(laws):
                if law not in chosen:
                    continue
                known = {f.name for f in fields(law)}
                unknown = [key for key in numbers if key not in known]
                if unknown:
                    raise InputError(
                        f'law "{law.law}" has no such number', joint=law.name, quantity=unknown[0]
                    )
                values: dict[str, Any] = {key: as_float(value) for key, value in numbers.items()}
                laws[i] = replace(law, **values)
            self._retune(replace(self.config, joints=tuple(laws)))

    def configure(self, **settings: Any) -> None:
        """Changes period, latency, latency_max, sampling or form of the controller.

        Raises:
            InputError: See `ControllerConfig`.
        """
        with self._lock:
            self._retune(replace(self.config, **settings))

    def use(self, config: ControllerConfig) -> None:
        """Takes another controller while the arm moves on.

        Raises:
            InputError: It does not fit the arm.
        """
        with self._lock:
            self._retune(config)

    def set_mode(self, joint: str, mode: Mode) -> None:
        """Law of a joint on ("active"), bypassed (position loop alone), or its motor off.

        Raises:
            InputError: The supervisor has stopped the arm, or there is no such joint.
        """
        with self._lock:
            self.arm.set_mode(joint, mode, self.arm.mode(joint)[1])
            words = {"active": "law on", "bypass": "law bypassed, position loop alone", "off": "motor off"}
            self._tell(f"{joint}: {words[mode]}")

    def set_position_loop(self, joint: str, on: bool) -> None:
        """Connects or removes the position loop of a joint, or of all; laws that brake without it engage.

        Raises:
            InputError: The supervisor has stopped the arm, or there is no such joint.
        """
        with self._lock:
            chosen = self.arm.controller.joints if joint == "all" else (joint,)
            for name in chosen:
                self.arm.set_mode(name, self.arm.mode(name)[0], on)
            for arm in self._arms():
                if not on:
                    for event in release_events(arm.config, 0.0):
                        if event.joint in chosen:
                            _do(arm, event)
                elif arm is not self.arm:
                    for name in chosen:
                        arm.set_mode(name, arm.mode(name)[0], True)
            self._tell(f"{joint}: position loop {'connected' if on else 'removed'}")

    # Faults and supervisor.

    def fail(self, kind: FaultKind, joint: str = "all", value: float | None = None) -> str:
        """Lets something fail until `heal`; returns its name.

        Raises:
            InputError: The fault does not fit the arm.
        """
        with self._lock:
            fault = Fault(kind, 0.0, joint=joint, value=value)
            name = str(fault).partition("@")[0]
            self.heal(name)
            reached = []
            for arm in self._arms():
                reached.append((arm, arm.begin(fault)))
            self.faults[name] = (fault, reached)
            self._tell(f"fails: {_words(fault)}")
            return name

    def heal(self, name: str | None = None) -> None:
        """Ends a fault by its name, or all of them."""
        with self._lock:
            for each in [name] if name is not None else list(self.faults):
                fault, reached = self.faults.pop(each, (None, []))
                for arm, places in reached:
                    if arm in self._arms():
                        arm.end(places)
                if fault is not None:
                    self._tell(f"healed: {_words(fault)}")

    def supervise(self, on: bool) -> None:
        """Puts the supervisor in charge, or nobody."""
        with self._lock:
            self.supervised = on
            self.arm.supervise(SupervisorSettings() if on else None)
            self._tell("supervisor " + ("on" if on else "off"))

    def stop(self) -> None:
        """Asks for a stop, as an operator does; without a supervisor the position loops are removed."""
        with self._lock:
            if self.supervised:
                self.arm.stop()
                self._tell("stop asked for")
            else:
                self.set_position_loop("all", False)

    def resume(self) -> None:
        """Tracks again where the arm is; faults that act go on acting."""
        with self._lock:
            self.arm.resume()
            if self.rival is not None:
                self.rival.follow(self.arm.reference)
            self._tell("tracks again from here")

    # What it shows.

    def snapshot(self) -> Snapshot:
        """The arm now."""
        with self._lock:
            arm, window = self.arm, self.arm.window
            push = None if arm.push is None else (arm.push.force.copy(), arm.push.point(arm.data))
            return Snapshot(
                self.time,
                self.factor,
                self._running,
                arm.state,
                arm.brake_closed,
                window.last("link_position"),
                window.last("link_velocity"),
                np.array(window.reference[-1]),
                window.last("sample"),
                window.last("command"),
                self.energy,
                self.payload.mass,
                tuple(self.faults),
                push,
                arm.diverged is not None,
            )

    def bodies(self) -> list[tuple[Floats, Floats]]:
        """Positions (nbody, 3) [m] and quaternions wxyz (nbody, 4) of the arm, and of the rival."""
        with self._lock:
            return [(np.array(arm.data.xpos), np.array(arm.data.xquat)) for arm in self._arms()]

    def latest(self, since: float = -math.inf) -> list[News]:
        """What happened since a time on the session's clock [s], oldest first."""
        with self._lock:
            return [news for news in self.news if news.time >= since]

    def energy_since(self, when: float) -> Floats:
        """Time and energies of every window since a time [s], (k, 5)."""
        with self._lock:
            rows = [row for row in self.energies if row[0] >= when]
        return np.array(rows).reshape(-1, 5)

    def past(self, seconds: float | None = None, rival: bool = False) -> Past:
        """The last seconds [s] of the arm or of its rival, at every tick."""
        with self._lock:
            return (self.rival_ring if rival else self.ring).past(seconds)

    def tell(self, text: str, kind: str = "you") -> None:
        """Adds to the news."""
        with self._lock:
            self._tell(text, kind)

    # Inside.

    def _tell(self, text: str, kind: str = "you", when: float | None = None) -> None:
        self.news.append(News(self.time if when is None else when, text, kind))

    def _follow(self, reference: Reference) -> None:
        for arm in self._arms():
            arm.follow(reference)

    def _pose(self, pose: str | Floats) -> Floats:
        if isinstance(pose, str):
            if pose not in self.poses:
                raise InputError(f"there are {', '.join(self.poses)}", quantity="pose", value=pose)
            return self.poses[pose]
        drives, angles = self.arm.plant.drives, np.asarray(pose, float)
        for name, q, drive in zip(self.robot.joints, angles, drives, strict=True):
            low, high = float(drive["stop_lower"]), float(drive["stop_upper"])
            if not low <= q <= high:
                raise InputError(
                    f"must be {low:.3g} to {high:.3g} rad", joint=name, quantity="angle [rad]", value=float(q)
                )
        return angles

    def _retune(self, config: ControllerConfig) -> None:
        with quiet():
            joints = [law.name for law in config.joints] == list(self.arm.controller.joints)
            if config.period == self.config.period and joints:
                self.arm.retune(config)
            else:
                self._exchange(config, build(self.robot, config.period, self.arm.payloads), self.arm.payloads)
        self.config = config
        self._judge()

    def _exchange(self, config: ControllerConfig, plant: Plant, loads: Sequence[Payload]) -> None:
        """Another simulation goes on from the motion of this one."""
        start, old = self.arm.reference_now(), self.arm
        settings = SupervisorSettings() if self.supervised else None
        arm = LiveArm(
            self.robot, config, plant, Hold(start[0]), payloads=loads, supervisor=settings,
            seed=old.scenario.seed, like=old,
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

    def show(self, joint: str) -> None:
        """Chooses the joint on show.

        Raises:
            InputError: It is not controlled.
        """
        with self._lock:
            self.arm.controller.index(joint)
            self.joint = joint
            self._judge()


def _do(arm: LiveArm, event: Any) -> None:
    mode, loop = arm.mode(event.joint)
    if event.kind == "mode":
        arm.set_mode(event.joint, event.value, loop)
    elif event.kind == "position_loop":
        arm.set_mode(event.joint, mode, bool(event.value))
    else:
        arm.warm_start(event.joint)


def _words(fault: Fault) -> str:
    where = "" if fault.joint == "all" else f" of {fault.joint}"
    size = "" if fault.value is None else f" {fault.value:g}"
    return f"{fault.kind.replace('_', ' ')}{where}{size}"


class quiet(warnings.catch_warnings):  # noqa: N801 - reads as a statement
    """Input warnings are for the terminal; here the margins show what they say."""

    def __enter__(self) -> None:
        super().__enter__()
        warnings.simplefilter("ignore", InputWarning)


__all__ = ["News", "Session", "Snapshot"]
