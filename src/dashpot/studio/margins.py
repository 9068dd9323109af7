"""The certificate beside the sliders: a guess at once, the proof from a process of its own as soon as it is
there.

Only joints whose numbers have changed are looked at. The newest numbers win: what has been overtaken is not
proven.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from dashpot.arm.drive import Drive
from dashpot.arm.robot import Robot
from dashpot.certify.box import Box
from dashpot.certify.certificate import JointCertificate, block_of, certify_joint
from dashpot.certify.index import passivity_index
from dashpot.certify.joint import Scales
from dashpot.certify.map import IndexMap
from dashpot.control.controller import ControllerConfig, JointGains, Law
from dashpot.control.sampled import empty_block
from dashpot.errors import DashpotError
from dashpot.studio.quick import quick_worst
from dashpot.support.arrays import Floats
from dashpot.support.workers import deaf_to_interrupts, pool_of

Verdict = Literal["certified", "checking", "not certified"]
POINTS, TRIED = 36, 18  # of R and of D in a map, and of them with loads tried
OFF_CENTRE = 0.9  # decades by which a point may leave the middle of its map
NICE = 10  # a proof must not slow the arm down
LOADS = np.geomspace(1e-2, 1e3, 80)  # inertias of the window, relative to the rotor's


@dataclass(frozen=True)
class Margin:
    """What is known of one joint's certificate.

    Attributes:
        joint: Its name.
        verdict: "checking": the quick test finds nothing against it, and the proof is under way.
        index: The least damping its port shows, worst of the drive's uncertainty once proven [N m s/rad].
        share: The same over what the drive shows without a controller [-].
        words: In one line.
    """

    joint: str
    verdict: Verdict
    index: float
    share: float
    words: str


@dataclass(frozen=True)
class Plane:
    """The map of a joint, and its window of load inertias.

    Attributes:
        found: The map around some gains, or None: it is being computed, or the law has no R and D.
        R: Where the controller is now [-].
        D: [N m s/rad].
        inertia: (k,) [kg m^2].
        damping: Damping ratio of the least damped oscillation with each, (k,) [-]; NaN: none.
        frequency: Its frequency, (k,) [Hz].
    """

    found: IndexMap | None
    R: float
    D: float
    inertia: Floats
    damping: Floats
    frequency: Floats


class _Closed(BaseException):
    """Ends the pool at once."""


def _prove(drive: Drive, law: Law, config: ControllerConfig) -> JointCertificate:
    be_nice()
    return certify_joint(drive, law, config)


def _map(drive: Drive, law: JointGains, config: ControllerConfig) -> IndexMap:
    from dashpot.certify.plots import gain_map

    be_nice()
    return gain_map(drive, law, config, POINTS, tried=TRIED)


def be_nice() -> None:
    """Gives way to the arm, which must keep real time."""
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, NICE)


class Certifier:
    """Keeps margins and maps of one arm up to date.

    Attributes:
        changed: Called from the certifier's thread when a proof or a map has arrived.
    """

    def __init__(self, robot: Robot, changed: Callable[[], None] = lambda: None) -> None:
        self.robot, self.changed = robot, changed
        self._drives = {drive.name: drive for drive in robot.drives}
        self._bare: dict[tuple[str, float, str], float] = {}
        self._wanted: dict[str, tuple[Any, ...]] = {}
        self._proofs: dict[str, tuple[tuple[Any, ...], JointCertificate]] = {}
        self._guesses: dict[str, tuple[tuple[Any, ...], float]] = {}
        self._maps: dict[str, tuple[tuple[Any, ...], JointGains, IndexMap]] = {}
        self._map_of: str | None = None
        self._work = threading.Condition()
        self._open = True
        self._thread: threading.Thread | None = None

    def close(self) -> None:
        """Ends the process at once."""
        with self._work:
            self._open = False
            self._work.notify_all()
        if self._thread is not None:
            self._thread.join(10)

    def look_at(self, config: ControllerConfig, mapped: str | None = None) -> None:
        """Judges a controller's changed joints at once and has them proven; `mapped` is the joint on show."""
        with self._work:
            self._wanted = {law.name: _key(law, config) for law in config.joints}
            for law in config.joints:
                key = self._wanted[law.name]
                if self._guesses.get(law.name, (None,))[0] != key:
                    self._guesses[law.name] = (key, self._guess(law, config))
            self._map_of = mapped if mapped in self._wanted else None
            self._work.notify_all()
            if self._thread is None:
                self._thread = threading.Thread(target=self._prove_all, name="dashpot certifier", daemon=True)
                self._thread.start()

    def margins(self) -> list[Margin]:
        """Of all joints of the controller, base to tip."""
        with self._work:
            return [self._margin(name, key) for name, key in self._wanted.items()]

    def proven(self, joint: str) -> JointCertificate | None:
        """The certificate of a joint's present numbers; None: not there yet."""
        with self._work:
            key, found = self._proofs.get(joint, (None, None))
            return found if key == self._wanted.get(joint) else None

    @property
    def busy(self) -> bool:
        """Whether proofs or maps are outstanding."""
        with self._work:
            return self._next() is not None

    def plane(self, law: Law, config: ControllerConfig) -> Plane:
        """Map and window of a joint; the window is computed here, in milliseconds."""
        from dashpot.certify.plots import damping_ratio

        drive = self._drives[law.name]
        inertia = np.maximum(LOADS * drive.rotor_inertia, drive.link_inertia)
        try:
            damping, frequency = damping_ratio(drive, block_of(drive, law, config), config, inertia, Scales())
        except (DashpotError, np.linalg.LinAlgError, ValueError):
            damping = frequency = np.full(len(inertia), np.nan)
        R, D = (law.R, law.D) if isinstance(law, JointGains) else (np.nan, np.nan)
        with self._work:
            known = self._maps.get(law.name)
            found = known[2] if known is not None and known[0] == _map_key(law, config) else None
        return Plane(found, R, D, inertia, damping, frequency)

    def _guess(self, law: Law, config: ControllerConfig) -> float:
        drive = self._drives[law.name]
        known = self._proofs.get(law.name)
        point = dict(known[1].box.point) if known is not None else None
        if point is not None:  # a worst point of another controller: only what is of the drive is kept
            box = Box.of(drive, block_of(drive, law, config), config.latency_max)
            point = {name: min(max(point[name], low), high) for name, (low, high) in box.ranges.items()}
        try:
            return quick_worst(drive, law, config, point)
        except DashpotError:
            return -np.inf

    def _margin(self, name: str, key: tuple[Any, ...]) -> Margin:
        bare = self._bare_of(name, key[1])
        stamp, proof = self._proofs.get(name, (None, None))
        if proof is not None and stamp == key:
            index = proof.box.worst.value if proof.nominal.passive else proof.nominal.value
            if not proof.certified:
                load = proof.counterexample
                words = f"counterexample, a load of any kind: {load}" if load is not None else proof.reason
                return Margin(name, "not certified", index, _share(index, bare), words)
            words = f"certified: at least {index:.3g} N m s/rad over the drive's whole uncertainty"
            return Margin(name, "certified", index, _share(index, bare), words)
        guess = self._guesses[name][1]
        if guess <= 0:
            said = "gives out energy" if np.isfinite(guess) else "unstable, or cannot be judged"
            return Margin(name, "not certified", guess, _share(guess, bare), f"{said} (quick test)")
        return Margin(
            name, "checking", guess, _share(guess, bare), f"about {guess:.3g} N m s/rad; being proven"
        )

    def _bare_of(self, name: str, config: ControllerConfig) -> float:
        key = name, config.period, config.sampling
        if key not in self._bare:
            drive = self._drives[name]
            self._bare[key] = passivity_index(drive, empty_block(), config.sampling, config.period).value
        return self._bare[key]

    def _next(self) -> tuple[str, str] | None:
        """Kind and joint of what is to be done first."""
        for name, key in self._wanted.items():
            if self._proofs.get(name, (None,))[0] != key and self._guesses[name][1] > 0:
                return "proof", name
        name = self._map_of or ""
        shown = self._wanted.get(name)
        if shown is not None and isinstance(shown[0], JointGains):
            law, config = shown[0], shown[1]
            known = self._maps.get(name)
            if known is None or known[0] != _map_key(law, config) or _off_centre(known[1], law):
                return "map", name
        for name, key in self._wanted.items():  # what the quick test refuses: the load that shows it
            if self._proofs.get(name, (None,))[0] != key:
                return "proof", name
        return None

    def _prove_all(self) -> None:
        with suppress(_Closed, BrokenProcessPool), pool_of(1) as pool:
            while True:
                with self._work:
                    while self._open and self._next() is None:
                        self._work.wait()
                    if not self._open:
                        raise _Closed
                    found = self._next()
                    assert found is not None
                    kind, name = found
                    key = self._wanted[name]
                law, config = key[0], key[1]
                with deaf_to_interrupts():
                    work: Callable[..., Any] = _prove if kind == "proof" else _map
                    job = pool.submit(work, self._drives[name], law, config)
                done: Any = None
                while not job.done():
                    with self._work:
                        if not self._open:
                            raise _Closed
                    with suppress(TimeoutError):
                        job.result(0.05)
                done = job.result()
                with self._work:
                    if kind == "proof":
                        self._proofs[name] = (key, done)
                    else:
                        self._maps[name] = (_map_key(law, config), law, done)
                self.changed()


def _key(law: Law, config: ControllerConfig) -> tuple[Any, ...]:
    """All that a joint's certificate depends on."""
    return law, replace(config, joints=(law,), file=None, blend=0.0)


def _map_key(law: Law, config: ControllerConfig) -> tuple[Any, ...]:
    same = replace(law, R=1.0, D=1.0) if isinstance(law, JointGains) else law
    return same, replace(config, joints=(same,), file=None, blend=0.0)


def _off_centre(centre: JointGains, now: JointGains) -> bool:
    return bool(max(abs(np.log10(now.R / centre.R)), abs(np.log10(now.D / centre.D))) > OFF_CENTRE)


def _share(index: float, bare: float) -> float:
    return index / bare if bare > 0 else -np.inf


__all__ = ["Certifier", "Margin", "Plane"]
