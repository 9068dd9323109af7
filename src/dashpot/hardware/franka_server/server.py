"""Serves a `dashpot.hardware.franka_server.arm.Arm` to one libfranka client at a time.

One thread: TCP and UDP are looked after between ticks. *Free-running*, a tick comes every millisecond of wall
clock, as on the robot. In *lock-step* it comes when the client has answered the last one, and only then: the
same client then sees the same robot, bit for bit, however busy the machine is. The arm's clock, on which
faults and payloads are scripted, starts with the first motion; before, it rests.
"""

from __future__ import annotations

import errno
import select
import socket
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from dashpot.errors import DashpotError, InputError
from dashpot.hardware.franka_server.arm import Arm
from dashpot.hardware.franka_server.limits import Limits
from dashpot.hardware.franka_server.messages import (
    COMMAND,
    HEADER,
    PAYLOADS,
    PERIOD,
    PORT,
    VERSION,
    Controller,
    Generator,
    Mode,
    MoveStatus,
    Reflex,
    Request,
)
from dashpot.hardware.franka_server.rules import Rules

PATIENCE = 0.5  # [s] for which lock-step waits for an answer; libfranka itself gives up after 1 s
REPEAT = (0.02, 0.4)
# [s] after which lock-step shows the state again to a client that has not begun to command: libfranka takes
# the first one as the news that the motion has started, and waits for the next
ANSWER = 0.8e-3  # [s] that a client has at least to answer a state; 1 ms if the server is punctual
SETTLING = 1000  # ticks for which lock-step lets the arm go on when a motion has ended; then it stands still
LARGEST = 4096  # [bytes] of a message that a client may send


@dataclass
class Tally:
    """What has happened to a server so far.

    Attributes:
        cycles: Ticks at which a client was in control.
        lost: Of these, without an answer in time.
        longest: Most lost in a row.
        late: Ticks for which the server itself was late by a fifth of a period; the next one comes later.
        motions: Started.
        reflexes: With which they ended, as ``"name at 1.234 s"``.
        before: Cycles and lost packets of the motions before this one.
    """

    cycles: int = 0
    lost: int = 0
    longest: int = 0
    late: int = 0
    motions: int = 0
    reflexes: list[str] = field(default_factory=list)
    before: tuple[int, int] = (0, 0)

    def since(self) -> str:
        """What has come to pass since the last call, in words."""
        cycles, lost = self.cycles - self.before[0], self.lost - self.before[1]
        self.before = self.cycles, self.lost
        return f"{cycles} cycles, {lost} packets lost"


class _GoneError(Exception):
    """The client has hung up."""


class Server:
    """The control interface of a simulated robot.

    Attributes:
        address: Host and port it listens at.
        tally: Counts.
    """

    def __init__(
        self,
        arm: Arm,
        limits: Limits,
        *,
        host: str = "127.0.0.1",
        port: int = PORT,
        lock_step: bool = False,
        enforce: bool = True,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Opens the port.

        Args:
            arm: What is controlled.
            limits: Of the robot, enforced.
            host: Address to listen at; 127.0.0.2 and so on let several robots share a machine.
            port: libfranka knows no other than 1337.
            lock_step: A tick comes when the client has answered, not every millisecond.
            enforce: Lost packets stop the robot, as they do the real one.
            say: Receives one line per event.

        Raises:
            InputError: The port is in use, or the host is not one of this machine.
        """
        self.arm, self.limits, self.say, self.tally = arm, limits, say, Tally()
        self._lock_step, self._enforce = lock_step, enforce
        self._stop = False
        self._model = arm.gravity.urdf(arm.robot, limits).encode()
        try:
            self._listener = socket.create_server((host, port), backlog=1)
        except OSError as error:
            reason = {
                errno.EADDRINUSE: "is in use: another server runs there; stop it or choose another --host",
                errno.EADDRNOTAVAIL: "is no address of this machine; 127.0.0.1 always is",
                errno.EACCES: "must not be opened by this user",
            }.get(error.errno or 0, str(error))
            raise InputError(reason, quantity="address", value=f"{host}:{port}") from None
        self._listener.settimeout(0.1)
        self.address = self._listener.getsockname()[:2]

    def stop(self) -> None:
        """Ends `serve` within a tenth of a second; a signal handler may call it."""
        self._stop = True

    def serve(self) -> None:
        """Serves one client after the other until `stop`.

        Raises:
            DashpotError: The simulated arm blew up.
        """
        with self._listener:
            while not self._stop:
                try:
                    client, peer = self._listener.accept()
                except TimeoutError:
                    continue
                with client:
                    self.say(f"client {peer[0]} connected")
                    _Session(self, client, peer[0]).run()
                    self.say("client gone")


class _Session:
    """One connection."""

    def __init__(self, server: Server, client: socket.socket, peer: str) -> None:
        self._server, self._arm, self._state = server, server.arm, server.arm.state
        self._tcp, self._udp = client, socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._peer = peer
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._inbox = bytearray()
        self._connected = False
        self._move = 0  # id of the client's Move that has not been answered for good
        self._rules: Rules | None = None
        self._shown = 0  # states in this motion
        self._begun = False  # the client has commanded something in this motion
        self._answered = False  # the last state published
        self._settling = 0
        self._datagram = np.zeros((), COMMAND)
        self._inbound = self._datagram.reshape(1).view(np.uint8).data
        self._outbound = self._state.reshape(1).view(np.uint8).data
        self._mode(Mode.IDLE)
        self._state["errors"] = self._state["reflex_reason"] = 0
        self._state["message_id"] = 0

    def run(self) -> None:
        """Until the client hangs up, or the server is told to stop."""
        try:
            while not self._connected and not self._server._stop:
                self._wait(0.05)
            step = self._lock_step if self._server._lock_step else self._free_running
            self._due = time.perf_counter()
            while not self._server._stop:
                step()
                if not self._arm.fine:
                    raise DashpotError("the simulated arm has blown up: velocities beyond 1e4 rad/s")
        except (_GoneError, ConnectionError):
            pass
        finally:
            if self._rules is not None:
                self._end(Mode.IDLE, "the client left")
            self._settle(SETTLING)
            self._udp.close()

    # --- ticks --------------------------------------------------------------------------------------------

    def _free_running(self) -> None:
        """One millisecond: publish, move on as soon as that is answered, listen until the next one is due."""
        self._publish()
        self._due += PERIOD
        soonest = time.perf_counter() + ANSWER
        if self._due < soonest:  # this process was late, which must not cost the client its time to answer
            self._server.tally.late += 1
            self._due = soonest
        moved = False
        while (left := self._due - time.perf_counter()) > 0:
            if not moved and (self._answered or self._rules is None):
                moved = self._move_on()
            else:
                self._wait(left)
        if not moved:
            self._wait(0.0)  # an answer that is there counts, even if this process has slept over it
            self._move_on()

    def _move_on(self) -> bool:
        """Lets a millisecond pass for the arm."""
        if self._rules is None:
            self._arm.hold()
            self._arm.sense()
        else:
            self._advance(self._rules)
        return True

    def _lock_step(self) -> None:
        """One answer of the client, or some time in which it has not begun to command."""
        self._publish()
        if self._rules is None:
            self._wait(PERIOD)
            self._settle(1)
            return
        patience = time.perf_counter() + (PATIENCE if self._begun else REPEAT[min(self._shown, 1)])
        self._shown += 1
        while not self._answered and self._rules is not None:
            left = patience - time.perf_counter()
            if left <= 0 or self._server._stop:
                break
            self._wait(left)
        if self._rules is not None and self._begun:
            self._advance(self._rules)

    def _settle(self, ticks: int) -> None:
        """In lock-step: so many of the ticks for which the arm goes on after a motion, if any are left."""
        for _ in range(min(ticks, self._settling)):
            self._settling -= 1
            self._arm.hold()
            self._arm.sense()

    def _advance(self, rules: Rules) -> None:
        tally = self._server.tally
        if self._begun:  # the robot waits for the first command; packets are lost after it
            tally.cycles += 1
            tally.lost += not self._answered
            reflex = rules.cycle(self._answered)
            tally.longest = max(tally.longest, rules.lost)
            if reflex is not None:
                self._abort(reflex)
                return
        self._state["control_command_success_rate"] = rules.success_rate
        self._arm.push(rules.torque)
        self._arm.sense()
        reflex = rules.motion(self._state["q"], self._state["dq"])
        if reflex is not None:
            self._abort(reflex)

    def _publish(self) -> None:
        self._state["message_id"] += 1
        self._answered = False
        try:
            self._udp.send(self._outbound)
        except ConnectionRefusedError:
            raise _GoneError from None

    # --- what the client says -----------------------------------------------------------------------------

    def _wait(self, timeout: float) -> None:
        """Looks after both sockets for at most so long [s]; returns after whatever came first."""
        listener = self._server._listener
        ready, _, _ = select.select([self._tcp, self._udp, listener], [], [], timeout)
        if self._udp in ready:
            self._receive()
            if self._server._lock_step:  # its tick comes before what the client said after it
                return
        if self._tcp in ready:
            data = self._tcp.recv(LARGEST)
            if not data:
                raise _GoneError
            self._inbox += data
            while len(self._inbox) >= HEADER.size:
                request, number, size = HEADER.unpack_from(self._inbox)
                if not HEADER.size <= size <= LARGEST:
                    raise _GoneError
                if len(self._inbox) < size:
                    break
                payload = bytes(self._inbox[HEADER.size : size])
                del self._inbox[:size]
                self._obey(request, number, payload)
        if listener in ready:  # the robot, too, has one client at a time
            other, peer = listener.accept()
            other.close()
            self._server.say(f"refused {peer[0]}: the robot is taken")

    def _receive(self) -> None:
        """Takes one command; it counts if it answers the state published last."""
        try:
            size = self._udp.recv_into(self._inbound)
        except ConnectionRefusedError:
            raise _GoneError from None
        rules, command = self._rules, self._datagram
        if rules is None or size != COMMAND.itemsize or self._answered:
            return
        if command["message_id"] != self._state["message_id"]:
            return
        if command["torque_command_finished"]:
            self._reply(Request.MOVE, self._move, MoveStatus.SUCCESS)
            self._end(Mode.IDLE, "finished by the client")
            return
        reflex = rules.command(command["tau_J_d"])
        if reflex is not None:
            self._abort(reflex)
            return
        self._begun = self._answered = True

    def _obey(self, request: int, number: int, payload: bytes) -> None:
        try:
            kind = Request(request)
            values = PAYLOADS[kind].unpack_from(payload)
        except (ValueError, struct.error) as error:
            self._server.say(f"client asked for {request} with {len(payload)} bytes: not understood, {error}")
            raise _GoneError from None
        if kind is Request.CONNECT:
            version, port = values
            fits = version == VERSION
            self._answer(kind, number, bytes([not fits]) + VERSION.to_bytes(2, "little"))
            if not fits:
                self._server.say(
                    f"client speaks version {version} of the protocol, this is version {VERSION}"
                )
                raise _GoneError
            self._udp.bind((self._server.address[0], 0))
            self._udp.connect((self._peer, port))
            self._connected = True
        elif kind is Request.MOVE:
            self._start(number, values[0], values[1])
        elif kind is Request.STOP_MOVE:
            self._reply(kind, number)
            if self._rules is not None:
                self._reply(Request.MOVE, self._move, MoveStatus.PREEMPTED)
                self._end(Mode.IDLE, "stopped by the client")
        elif kind is Request.GET_ROBOT_MODEL:
            self._answer(kind, number, b"\0" + self._server._model)
        else:
            self._set(kind, values)
            self._reply(kind, number)

    def _set(self, kind: Request, values: Sequence[float]) -> None:
        if kind is Request.SET_LOAD:
            mass, centre, inertia = values[0], values[1:4], values[4:]
            self._arm.gravity.mass, self._arm.gravity.centre[:] = mass, centre
            self._state["m_load"], self._state["F_x_Cload"], self._state["I_load"] = mass, centre, inertia
            self._server.say(f"declared load: {mass:g} kg")
        elif kind is Request.SET_EE_TO_K:
            self._state["EE_T_K"] = values
        elif kind is Request.SET_NE_TO_EE:
            self._state["NE_T_EE"] = self._state["F_T_EE"] = values
        elif kind is Request.AUTOMATIC_ERROR_RECOVERY and self._state["robot_mode"] == Mode.REFLEX:
            self._state["errors"] = 0
            self._mode(Mode.IDLE)

    def _reply(self, request: Request, number: int, status: int = 0) -> None:
        self._answer(request, number, bytes([status]))

    def _answer(self, request: Request, number: int, payload: bytes) -> None:
        self._tcp.sendall(HEADER.pack(request, number, HEADER.size + len(payload)) + payload)

    # --- motions ------------------------------------------------------------------------------------------

    def _mode(self, mode: Mode) -> None:
        moving = mode is Mode.MOVE
        self._state["robot_mode"] = mode
        self._state["controller_mode"] = Controller.EXTERNAL if moving else Controller.OTHER
        self._state["motion_generator_mode"] = Generator.NONE if moving else Generator.IDLE
        self._state["control_command_success_rate"] = 0.0

    def _start(self, number: int, controller: int, generator: int) -> None:
        if self._rules is not None or self._state["robot_mode"] == Mode.REFLEX:
            self._reply(Request.MOVE, number, MoveStatus.NOT_POSSIBLE)
            return
        if controller != Controller.EXTERNAL or generator + 1 != Generator.NONE:
            self._server.say("refused: this robot takes torques only (start_torque_control)")
            self._reply(Request.MOVE, number, MoveStatus.NOT_POSSIBLE)
            return
        tally = self._server.tally
        self._settle(SETTLING)
        if not self._arm.begun:
            self._arm.begin()
        tally.motions += 1
        self._rules, self._begun, self._move = (
            Rules(self._server.limits, self._server._enforce),
            False,
            number,
        )
        self._shown = 0
        self._arm.release()
        self._mode(Mode.MOVE)
        self._state["reflex_reason"] = 0
        self._reply(Request.MOVE, number, MoveStatus.STARTED)
        self._server.say(f"{self._arm.time:.3f} s: torque control")

    def _abort(self, reflex: Reflex) -> None:
        """Stops as the robot does: the state says why before the answer to Move does."""
        self._server.tally.reflexes.append(f"{reflex} at {self._arm.time:.3f} s")
        self._state["errors"][reflex] = self._state["reflex_reason"][reflex] = 1
        self._end(Mode.REFLEX, f"reflex {reflex}")
        self._publish()
        self._reply(Request.MOVE, self._move, MoveStatus.REFLEX_ABORTED)

    def _end(self, mode: Mode, why: str) -> None:
        self._server.say(f"{self._arm.time:.3f} s: {why}; {self._server.tally.since()}")
        self._rules = None
        self._mode(mode)
        self._arm.engage()
        self._settling = SETTLING if self._server._lock_step else 0  # nobody answers any more
