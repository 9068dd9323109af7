"""``--via sim``: a simulated arm in a process of its own, linked as a robot is (native/dashpot_link.h).

The plant is that of `dashpot.simulation.simulate`: elastic joints, friction, payload, the true torque
sensor, scripted faults. In real time it is a robot with a clock of its own; without (``realtime=False``) it
waits for every answer, and the run has the same bits every time: those of `dashpot.simulation.simulate.run`
with a supervisor.
"""

from __future__ import annotations

import os
import pickle
import socket
import struct
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import dashpot._native as _native
from dashpot.control.supervisor import Supervisor
from dashpot.errors import DashpotError, InputError
from dashpot.hardware.interface import Sample
from dashpot.hardware.runtime import Start
from dashpot.simulation.prepare import equilibrium
from dashpot.simulation.simulate import Scenario
from dashpot.support.arrays import Floats

_N = _native.MAX_JOINTS
_FLOATS = ("torque", "position", "velocity", "in_effect")
_AGES = ("torque_age", "encoder_age")
SAMPLE_DTYPE = np.dtype(
    [
        ("tick", "i8"),
        ("time", "f8"),
        *((name, "f8", (_N,)) for name in _FLOATS),
        *((name, "i4", (_N,)) for name in _AGES),
        ("listening", "i4"),
        ("tripped", "i4"),
    ]
)
"""Layout of ``dp_link_sample``."""
COMMAND_DTYPE = np.dtype(
    [
        ("tick", "i8"),
        ("torque", "f8", (_N,)),
        *((name, "i4") for name in ("kind", "brake", "state", "status")),
    ]
)
"""Layout of ``dp_link_command``."""
GO_ON, START, STOP = range(3)
UP, SILENCE = 60.0, 1.0  # [s] that the arm's process may take to come up, and a sample in real time


@dataclass(frozen=True)
class LinkSettings:
    """The simulated robot's side of the link.

    Attributes:
        realtime: The arm has a clock; without, it waits for every answer.
        watchdog: Periods without a torque after which the arm takes its torque away and closes its brakes.
        answer: Part of the period after which a torque comes too late for it, and takes effect with the next.
        after: Time that is simulated after the motion has ended [s].
        record: File for the arm's own recording (.npz), written when it is at rest again; None: none.
    """

    realtime: bool = True
    watchdog: int = 20
    answer: float = 0.6
    after: float = 1.0
    record: Path | None = None


class SimHardware:
    """A simulated arm as `Hardware`. Before `start` its brakes hold it in equilibrium at the first reference.

    Attributes:
        scenario: What is simulated; its supervisor is not used, and of its controller only how the arm
            starts.
        process: Of the arm. It outlives this one: killed, its watchdog stops the arm.
        carries_weight: Whether the arm's own gravity compensation is on, as the scenario says.
    """

    def __init__(
        self,
        scenario: Scenario,
        settings: LinkSettings | None = None,
        *,
        paced: bool = True,
        supervisor: Supervisor | None = None,
    ) -> None:
        """Starts the arm's process.

        Args:
            scenario: With a controller.
            settings: None: the defaults.
            paced: `read` waits for the arm's next sample; else it takes the newest one.
            supervisor: Whose state the joints under a servo of their own are told: they stop when it does.

        Raises:
            InputError: The scenario has no controller, or its parts do not fit together.
        """
        if scenario.controller is None:
            raise InputError("needs a controller", quantity="scenario")
        self.scenario, self.settings = scenario, settings or LinkSettings()
        self.joints = scenario.controller.joints
        self.period, self.reason = scenario.controller.period, ""
        self.paced, self.carries_weight = paced, scenario.carried
        self._guard = None if supervisor is None else supervisor.guard
        n = len(self.joints)
        self._in, self._out = np.zeros(1, SAMPLE_DTYPE), np.zeros(1, COMMAND_DTYPE)
        if (SAMPLE_DTYPE.itemsize, COMMAND_DTYPE.itemsize) != (
            _native.LINK_SAMPLE_SIZE,
            _native.LINK_COMMAND_SIZE,
        ):
            raise RuntimeError("the native library was built from another version; reinstall dashpot")
        self._buffer = memoryview(self._in.view(np.uint8))  # type: ignore[arg-type]
        self._values = tuple(self._in[name][0, :n] for name in _FLOATS)
        self._ages = tuple(self._in[name][0, :n] for name in _AGES)
        self._torque = self._out["torque"][0, :n]
        self._started = self._stopped = False
        self._heard = 0.0
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.process = _spawn(theirs, scenario, self.settings)
        theirs.close()
        self._patience(UP)

    def equilibrium(self) -> Start | None:
        """Where the controller begins so that nothing moves, as in `simulate`; None: nothing holds it."""
        found = equilibrium(self.scenario)
        if found is None:
            return None
        robot = self.scenario.plant.robot
        return Start(found.states, found.torque[[robot.index(name) for name in self.joints]])

    def start(self) -> None:
        """Opens the brakes.

        Raises:
            DashpotError: The arm's process has ended.
        """
        self._out["kind"] = START
        self._send()
        if self.reason:
            raise DashpotError(self.reason)
        self._out["kind"] = GO_ON
        self._started, self._heard = True, 0.0
        self._patience(UP)

    def read(self, sample: Sample) -> bool:
        """The arm's newest sample; False where its process is gone or silent, or its watchdog tripped."""
        if self._stopped:
            return False
        if not self._started and not self.settings.realtime:
            self._send()  # asks for the next
        if not self._receive():
            return False
        message = self._in[0]
        if message["tripped"]:
            self.reason = "the arm's watchdog has closed its brakes: no torque came for too long"
            return False
        sample.time = float(message["time"])
        torque, position, velocity, in_effect = self._values
        sample.torque[:], sample.position[:] = torque, position
        sample.velocity[:], sample.in_effect[:] = velocity, in_effect
        sample.torque_age[:], sample.encoder_age[:] = self._ages
        return True

    def write(self, torque: Floats) -> None:
        """Sends the torques [N m]."""
        self._torque[:] = torque
        self._out["tick"] = self._in["tick"]
        if self._guard is not None:
            self._out["state"], self._out["brake"] = self._guard.state, self._guard.apply_brake
        self._send()

    def apply_brake(self) -> None:
        """Closes the mechanical brakes of the arm."""
        self._out["brake"] = 1
        self._send()

    def stop(self) -> None:
        """Motors off; returns when the arm's process has ended and written its recording.

        Raises:
            DashpotError: It could not be written.
        """
        if self._stopped:
            return
        self._stopped = True
        self._out["kind"] = STOP
        self._send()
        try:
            self.process.wait(30)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._socket.close()
        if self.process.returncode > 0:  # it has said why
            raise DashpotError("the arm's process has failed; its recording is lost")

    def _send(self) -> None:
        try:
            self._socket.send(self._out.tobytes(), socket.MSG_DONTWAIT if self.settings.realtime else 0)
        except OSError as error:  # `read` says what is wrong with the link
            self.reason = self.reason or f"the link to the arm is lost: {error.strerror}"

    def _patience(self, seconds: float) -> None:
        """How long a message is waited for."""
        whole = int(seconds)
        timeval = struct.pack("ll", whole, int(1e6 * (seconds - whole)))
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, timeval)

    def _receive(self) -> bool:
        """Takes the next sample, in real time the newest one; what is left from listening does not count."""
        fresh, got = False, 0
        if self.settings.realtime:
            while (got := self._take(socket.MSG_DONTWAIT)) > 0:
                fresh = not (self._started and self._in["listening"][0])
        while not fresh and got >= 0 and (self.paced or self._heard == 0.0):
            got = self._take(0)
            if got == 0:
                self.reason = "the arm has said nothing for too long"
            if got <= 0:
                return False
            fresh = not (self._started and self._in["listening"][0])
        now = time.monotonic()
        if fresh:
            if self._heard == 0.0:
                self._patience(SILENCE if self.settings.realtime else UP)
            self._heard = now
            return True
        if got == 0 and now - self._heard > SILENCE:
            self.reason = "the arm has said nothing for too long"
            return False
        return got == 0

    def _take(self, flags: int) -> int:
        """1: a message; 0: none; -1: the link is lost, and `reason` says so."""
        try:
            size = self._socket.recv_into(self._buffer, 0, flags)
        except BlockingIOError:
            return 0
        except OSError as error:
            self.reason = f"the link to the arm is lost: {error.strerror}"
            return -1
        if size == 0:
            self.reason = "the link to the arm is lost: its process has ended"
            return -1
        return 1


def _spawn(link: socket.socket, scenario: Scenario, settings: LinkSettings) -> subprocess.Popen[bytes]:
    """The arm's process, in a session of its own: Ctrl-C in a terminal is for the controller."""
    command = [sys.executable, "-m", "dashpot.hardware.arm", str(link.fileno())]
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        pass_fds=(link.fileno(),),
        start_new_session=True,
        env=dict(os.environ),
    )
    assert process.stdin is not None
    pickle.dump((scenario, settings), process.stdin)
    process.stdin.close()
    return process


__all__ = ["LinkSettings", "SimHardware"]
