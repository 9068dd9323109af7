"""What Franka's control interface says on the wire: protocol version 10, little-endian, packed.

A client opens a TCP connection for commands (`HEADER`, then a payload; every command is answered under its
id) and names a UDP port. There it receives a `STATE` every millisecond and answers with a `COMMAND` that
repeats the state's ``message_id``. The layouts are facts of libfranka's ``research_interface`` headers
(frankarobotics/libfranka-common, Apache-2.0), checked against pylibfranka 0.21 in tests/test_franka.py.
"""

from __future__ import annotations

import enum
import struct

import numpy as np

PORT = 1337
"""TCP port of the command channel."""
VERSION = 10
"""Of the protocol: FR3 with system 5.9 or later, libfranka 0.18 or later."""
PERIOD = 1e-3
"""Of the interface [s]; ``message_id`` counts it."""
JOINTS = 7

HEADER = struct.Struct("<III")
"""Command, id chosen by the client, size of the whole message [bytes]."""


class Request(enum.IntEnum):
    """What a client asks for over TCP."""

    CONNECT = 0
    MOVE = 1
    STOP_MOVE = 2
    SET_COLLISION_BEHAVIOR = 3
    SET_JOINT_IMPEDANCE = 4
    SET_CARTESIAN_IMPEDANCE = 5
    SET_GUIDING_MODE = 6
    SET_EE_TO_K = 7
    SET_NE_TO_EE = 8
    SET_LOAD = 9
    AUTOMATIC_ERROR_RECOVERY = 10
    GET_ROBOT_MODEL = 11


PAYLOADS = {
    Request.CONNECT: struct.Struct("<HH"),  # version, UDP port
    Request.MOVE: struct.Struct("<II6d"),  # controller, motion generator, deviations of path and goal
    Request.STOP_MOVE: struct.Struct(""),
    Request.SET_COLLISION_BEHAVIOR: struct.Struct("<28d24d"),  # torque, force: lower, upper; moving, nominal
    Request.SET_JOINT_IMPEDANCE: struct.Struct("<7d"),
    Request.SET_CARTESIAN_IMPEDANCE: struct.Struct("<6d"),
    Request.SET_GUIDING_MODE: struct.Struct("<7?"),
    Request.SET_EE_TO_K: struct.Struct("<16d"),
    Request.SET_NE_TO_EE: struct.Struct("<16d"),
    Request.SET_LOAD: struct.Struct("<d3d9d"),  # mass, centre in the flange frame, inertia by columns
    Request.AUTOMATIC_ERROR_RECOVERY: struct.Struct(""),
    Request.GET_ROBOT_MODEL: struct.Struct(""),
}
"""Payload of each request. Newer libraries append: `Request.MOVE` has 57 bytes more in libfranka 0.21."""


class MoveStatus(enum.IntEnum):
    """Answers to `Request.MOVE`: one when the motion starts, one when it ends."""

    SUCCESS = 0
    STARTED = 1
    PREEMPTED = 2
    NOT_POSSIBLE = 5
    REFLEX_ABORTED = 8


class Controller(enum.IntEnum):
    """Who computes the torques: in `Request.MOVE` and in the state."""

    JOINT_IMPEDANCE = 0
    CARTESIAN_IMPEDANCE = 1
    EXTERNAL = 2
    OTHER = 3


class Generator(enum.IntEnum):
    """Who makes the motion, as the state says it; `Request.MOVE` says one less, and 4 for none."""

    IDLE = 0
    JOINT_POSITION = 1
    JOINT_VELOCITY = 2
    CARTESIAN_POSITION = 3
    CARTESIAN_VELOCITY = 4
    NONE = 5


class Mode(enum.IntEnum):
    """Of the robot."""

    OTHER = 0
    IDLE = 1
    MOVE = 2
    GUIDING = 3
    REFLEX = 4
    USER_STOPPED = 5
    RECOVERY = 6


class Reflex(enum.IntEnum):
    """Errors this server can raise: their places among the state's 41."""

    JOINT_POSITION_LIMITS_VIOLATION = 0
    JOINT_VELOCITY_VIOLATION = 3
    COMMUNICATION_CONSTRAINTS_VIOLATION = 25
    CONTROLLER_TORQUE_DISCONTINUITY = 32
    TAU_J_RANGE_VIOLATION = 34

    def __str__(self) -> str:
        """As libfranka names it."""
        return self.name.lower().replace("tau_j_", "tau_J_")


ERRORS = 41

STATE = np.dtype(
    [
        ("message_id", "<u8"),
        *((name, "<f4", 16) for name in ("O_T_EE", "O_T_EE_d", "F_T_EE", "EE_T_K", "F_T_NE", "NE_T_EE")),
        ("m_ee", "<f4"),
        ("I_ee", "<f4", 9),
        ("F_x_Cee", "<f4", 3),
        ("m_load", "<f4"),
        ("I_load", "<f4", 9),
        ("F_x_Cload", "<f4", 3),
        *((name, "<f4", 2) for name in ("elbow", "elbow_d")),
        *((name, "<f4", 7) for name in ("tau_J", "tau_J_d", "dtau_J", "q", "q_d", "dq", "dq_d", "ddq_d")),
        *((name, "<f4", size) for name, size in (("joint_contact", 7), ("cartesian_contact", 6))),
        *((name, "<f4", size) for name, size in (("joint_collision", 7), ("cartesian_collision", 6))),
        ("tau_ext_hat_filtered", "<f4", 7),
        *((name, "<f4", 6) for name in ("O_F_ext_hat_K", "K_F_ext_hat_K", "O_dP_EE_d")),
        ("O_ddP_O", "<f4", 3),
        *((name, "<f4", 2) for name in ("elbow_c", "delbow_c", "ddelbow_c")),
        ("O_T_EE_c", "<f4", 16),
        *((name, "<f4", 6) for name in ("O_dP_EE_c", "O_ddP_EE_c")),
        *((name, "<f4", 7) for name in ("theta", "dtheta")),
        *((name, "<f4", 18) for name in ("accelerometer_top", "accelerometer_bottom")),
        *((name, "u1") for name in ("motion_generator_mode", "controller_mode")),
        *((name, "u1", ERRORS) for name in ("errors", "reflex_reason")),
        ("robot_mode", "u1"),
        ("control_command_success_rate", "<f4"),
    ]
)
"""A datagram to the client; SI units, matrices by columns, single precision as on the robot."""

COMMAND = np.dtype(
    [
        ("message_id", "<u8"),
        *((name, "<f8", size) for name, size in (("q_c", 7), ("dq_c", 7), ("O_T_EE_c", 16))),
        *((name, "<f8", size) for name, size in (("O_dP_EE_c", 6), ("elbow_c", 2))),
        *((name, "u1") for name in ("valid_elbow", "motion_generation_finished")),
        ("tau_J_d", "<f8", 7),
        ("torque_command_finished", "u1"),
    ]
)
"""A datagram from the client."""
