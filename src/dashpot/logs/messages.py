"""ROS 2 messages of dashpot's MCAP logs: types, topics, and which column fills which field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

_HEADER = f"""{"=" * 80}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""
_TIME = f"""{"=" * 80}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


@dataclass(frozen=True)
class Field:
    """One field of a message after its header: an array with a value per joint, or a single value.

    Attributes:
        name: In the message.
        kind: "f8": float64, "u1": uint8.
        column: What a `McapWriter` is given to fill it; an array without is left empty.
        scalar: One value for the arm.
    """

    name: str
    kind: str
    column: str
    scalar: bool = False


@dataclass(frozen=True)
class Topic:
    """A topic, its message type and fields; the names of the joints come before the first array."""

    name: str
    type: str
    definition: str
    fields: tuple[Field, ...]

    @property
    def columns(self) -> tuple[str, ...]:
        """What it is filled from."""
        return tuple(field.column for field in self.fields)


JOINT_STATE = "sensor_msgs/msg/JointState"
JOINT_STATE_DEFINITION = f"""std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{_HEADER}{_TIME}"""

CONTROLLER_STATE = "dashpot_msgs/msg/ControllerState"
CONTROLLER_STATE_DEFINITION = f"""# Blocks u = C x + D w, x+ = A x + B w + E (u_issued - u), after a tick.
uint8 TRACK=0
uint8 TORQUE_BRAKE=1
uint8 ENCODER_BRAKE=2
uint8 SAFE=3
uint8 OFF=0
uint8 BYPASS=1
uint8 ACTIVE=2
uint8 TORQUE_LIMITED=1
uint8 RATE_LIMITED=2
uint8 NOT_FINITE=4
uint8 BLENDING=8
std_msgs/Header header
uint8 supervisor    # TRACK to SAFE; TRACK where there is no supervisor
string[] name
uint8[] mode        # OFF, BYPASS, ACTIVE
uint8[] status      # bits, TORQUE_LIMITED to BLENDING
float64[] x0        # states of the block, 0 where it has fewer
float64[] x1
float64[] x2
float64[] x3
{_HEADER}{_TIME}"""

JOINT_ENERGY = "dashpot_msgs/msg/JointEnergy"
JOINT_ENERGY_DEFINITION = f"""# Energy of each joint [J], from what is sensed; work since the first sample.
std_msgs/Header header
string[] name
float64[] motor       # work of the motor on the rotor
float64[] port        # work of the rotor on the link, through the torque sensor
float64[] kinetic     # of the rotor
float64[] potential   # of the transmission's spring
float64[] virtual     # stored by the control law
float64[] dissipated  # by the rotor's friction: motor - port - change of kinetic
{_HEADER}{_TIME}"""

LOG = "rcl_interfaces/msg/Log"
LOG_DEFINITION = f"""byte DEBUG=10
byte INFO=20
byte WARN=30
byte ERROR=40
byte FATAL=50
builtin_interfaces/Time stamp
uint8 level
string name
string msg
string file
string function
uint32 line
{_TIME}"""
Level = Literal["info", "warning", "error"]
LEVELS: dict[Level, int] = {"info": 20, "warning": 30, "error": 40}
ROSOUT = "/rosout"
METADATA = "dashpot"  # name of the record that says how the log was made
START = "start"  # key in it: the time [s] that is stamped 0


def _joint_state(name: str, position: str, velocity: str, effort: str) -> Topic:
    fields = (
        Field("position", "f8", position),
        Field("velocity", "f8", velocity),
        Field("effort", "f8", effort),
    )
    return Topic(name, JOINT_STATE, JOINT_STATE_DEFINITION, fields)


TOPICS = (
    _joint_state("/joint_states", "position", "velocity", "torque"),
    _joint_state("/joint_command", "reference", "reference_velocity", "command"),
    _joint_state("/dashpot/in_effect", "", "", "in_effect"),
    _joint_state("/link_states", "link_position", "link_velocity", "link_torque"),
    Topic(
        "/dashpot/controller",
        CONTROLLER_STATE,
        CONTROLLER_STATE_DEFINITION,
        (
            Field("supervisor", "u1", "supervisor", scalar=True),
            Field("mode", "u1", "mode"),
            Field("status", "u1", "status"),
            *(Field(x, "f8", x) for x in ("x0", "x1", "x2", "x3")),
        ),
    ),
    Topic(
        "/dashpot/energy",
        JOINT_ENERGY,
        JOINT_ENERGY_DEFINITION,
        tuple(
            Field(name, "f8", f"energy_{name}")
            for name in ("motor", "port", "kinetic", "potential", "virtual", "dissipated")
        ),
    ),
)
"""Everything a log may hold, in the order in which it is written. Units: docs/logs.md."""

COLUMNS = tuple(column for topic in TOPICS for column in topic.columns if column)
SCALARS = tuple(field.column for topic in TOPICS for field in topic.fields if field.scalar)
