"""What the studio's arm is told: where it goes, what it carries, its controller, and what fails."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np

from dashpot.arm.plant import build
from dashpot.control.controller import ControllerConfig, Mode
from dashpot.control.supervisor import SupervisorSettings
from dashpot.errors import InputError
from dashpot.simulation.faults import Fault, FaultKind
from dashpot.simulation.release import release_events
from dashpot.studio.arms import Arms, quiet
from dashpot.studio.choices import POUND, carriable
from dashpot.studio.live import LiveArm
from dashpot.studio.push import Push
from dashpot.studio.references import Reference, go_to, wander
from dashpot.support.arrays import Floats
from dashpot.support.tables import as_float

MOST_AMPLITUDE = 1.0  # [rad] of a motion about a pose


class Told(Arms):
    """Commands to the arms; every one takes effect between two windows, or changes nothing."""

    # Motion, load and hand.

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
            InputError: The amplitude is not in its range.
        """
        if not 0 < amplitude <= MOST_AMPLITUDE:
            rule = f"must be above 0 and at most {MOST_AMPLITUDE:g} rad"
            raise InputError(rule, quantity="amplitude [rad]", value=amplitude)
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
        with quiet():
            load = carriable(mass, self.payload.offset if offset is None else offset)
            loads = [*self._fixed, *([load] if mass > 0 else [])]
            plant = build(self.robot, self.config.period, loads)
        with self._lock:
            held = self.arm.energy()
            for arm in self._arms():
                arm.carry(plant, loads)
            self.payload = load
            self.account.restate(held, self.arm.energy())
            self.generation += 1
            self._tell(f"payload {mass:.2f} kg ({mass / POUND:.1f} lb)")

    def compensate(self, on: bool) -> None:
        """Has robots that can do so carry their own weight, or leave it to the controller.

        Raises:
            InputError: The robot cannot, or the supervisor has stopped the arm.
        """
        with self._lock:
            for arm in self._arms():
                arm.compensate(on)
            self.carried = on
            self._tell("the robot carries its own weight" if on else "the controller carries the robot")

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
                with quiet():
                    laws[i] = replace(law, **values)
            self._retune(replace(self.config, joints=tuple(laws)))

    def configure(self, **settings: Any) -> None:
        """Changes period, latency, latency_max, sampling or form of the controller.

        Raises:
            InputError: See `ControllerConfig`.
        """
        with self._lock:
            with quiet():
                config = replace(self.config, **settings)
            self._retune(config)

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
            self.supervised = self._supervise = on
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

    # What the rest is made of.

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
