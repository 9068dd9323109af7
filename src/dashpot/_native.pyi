"""Types of the native module (native/bindings.cpp)."""

from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

BLOCK_SIZE: int
DRIVE_SIZE: int
EVENT_SIZE: int
MAX_JOINTS: int
MAX_LATENCY: int
MAX_DELAY: int
FAULT_SIZE: int
MAX_FAULTS: int
MAX_LATE: int
TREE_SIZE: int
MAX_LINKS: int
LANES: dict[int, str]
MEASURES: int
SOURCES: dict[str, str]

class Core:
    n: int
    inputs: NDArray[np.float64]
    def __init__(self, blocks: NDArray[np.uint8]) -> None: ...
    @overload
    def step(self, out: NDArray[np.float64]) -> int: ...
    @overload
    def step(self, inputs: NDArray[np.float64], out: NDArray[np.float64]) -> int: ...
    def issue(self, torque: NDArray[np.float64], out: NDArray[np.float64]) -> int: ...
    def reset(self) -> None: ...
    def set_mode(self, joint: int, mode: int) -> None: ...
    def set_position_loop(self, joint: int, on: bool) -> None: ...
    def warm_start(self, joint: int, velocity: float) -> None: ...
    def preset(self, joint: int, x: NDArray[np.float64], torque: float) -> None: ...
    def joint_state(self, joint: int) -> tuple[int, bool, float, float, int, tuple[float, ...]]: ...

class Faults:
    apply_brake: bool
    stopped_at: int
    ages: list[tuple[int, int]]
    def __init__(
        self, script: NDArray[np.uint8], drives: NDArray[np.float64], brake_delay: float
    ) -> None: ...
    def put(self, place: int, fault: NDArray[np.uint8]) -> None: ...

def take(list: list[float], to: NDArray[np.float64]) -> None: ...
def take_difference(list: list[float], less: list[float], to: NDArray[np.float64]) -> None: ...
def bounded(
    torque: NDArray[np.float64], around: NDArray[np.float64], limit: NDArray[np.float64], step: float
) -> list[float]: ...

class Arm:
    tick: int
    record: NDArray[np.float64]
    torque_age: NDArray[np.int32]
    encoder_age: NDArray[np.int32]
    def __init__(
        self, drives: NDArray[np.uint8], step: int, dt: float, steps_per_tick: int, faults: Faults | None
    ) -> None: ...
    def engine(
        self,
        model: int,
        data: int,
        qpos: NDArray[np.float64],
        qvel: NDArray[np.float64],
        qfrc_applied: NDArray[np.float64],
    ) -> None: ...
    def sense(
        self,
        torque: NDArray[np.float64],
        position: NDArray[np.float64],
        velocity: NDArray[np.float64],
    ) -> None: ...
    def push(self, torque: NDArray[np.float64]) -> bool: ...

WATCH_SIZE: int
RULES_SIZE: int
REASONS: int
LOG: int
HISTORY: int

def next_state(state: int, events: int) -> int: ...

class Gravity:
    def __init__(
        self,
        kinematics: int,
        com: int,
        rne: int,
        model: int,
        data: int,
        qpos: NDArray[np.float64],
        rotor_qpos: NDArray[np.int32],
        rotor_dof: NDArray[np.int32],
        dof: int,
    ) -> None: ...
    def torque(self, position: NDArray[np.float64], out: NDArray[np.float64]) -> None: ...

class Guard:
    gravity: NDArray[np.float64]
    torque_age: NDArray[np.int32]
    encoder_age: NDArray[np.int32]
    state: int
    apply_brake: bool
    stopped: bool
    tick: int
    decisions: int
    def __init__(self, core: Core, rules: NDArray[np.uint8], watch: NDArray[np.uint8]) -> None: ...
    def step(self, out: NDArray[np.float64]) -> int: ...
    def stop(self, why: int) -> None: ...
    def park(self) -> None: ...
    def reset(self) -> None: ...
    def log(self) -> list[tuple[int, int, int, int, int, float, float]]: ...
    def joint_state(self, joint: int) -> tuple[float, float, float, float, bool, bool, int]: ...
    def step_many(self, count: int) -> None: ...

def run(
    core: Core | None,
    drives: NDArray[np.uint8],
    events: NDArray[np.uint8],
    step: int,
    model: int,
    data: int,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    qfrc_applied: NDArray[np.float64],
    dt: float,
    steps_per_tick: int,
    ticks: int,
    reference: NDArray[np.float64] | None,
    external: NDArray[np.float64] | None,
    record: NDArray[np.float64] | None,
    status: NDArray[np.int32] | None,
    faults: Faults | None = None,
    first: int = 0,
    last: int = -1,
    guard: Guard | None = None,
    link: Link | None = None,
    gravity: Gravity | None = None,
    origin: int = 0,
) -> tuple[int, int]: ...
def stops(
    blocks: NDArray[np.uint8],
    slip: NDArray[np.float64],
    stick: NDArray[np.float64],
    start: NDArray[np.float64],
    sample: NDArray[np.float64],
    rotor: int,
    held: int,
    link: int,
    spring: int,
    slips: int,
    mean: int,
    substeps: int,
    late: int,
    coulomb: float,
    damper: float,
    torque_gain: float,
    speed: float,
    window: int,
    still: float,
    speeds: NDArray[np.float64],
    commands: NDArray[np.float64],
) -> None: ...
def step_many(core: Core, count: int) -> None: ...

ROW_SIZE: int
ROW_COLUMNS: int
RING_SIZE: int
LINK_SAMPLE_SIZE: int
LINK_COMMAND_SIZE: int

class Cycle:
    out: NDArray[np.float64]
    statistics: dict[str, Any]
    behind: int
    def __init__(
        self,
        guard: Guard,
        sample: tuple[NDArray[Any], ...],
        order: NDArray[np.int32],
        reference: NDArray[np.float64],
        until: int,
        period: float,
        late_cycles: int,
        longest_gap: int,
        ring: NDArray[np.uint8] | None,
    ) -> None: ...
    def step(self, time: float) -> int: ...
    def wait(self) -> None: ...
    def close(self) -> None: ...
    def step_many(self, count: int) -> None: ...

def sleep_until(nanoseconds: int) -> None: ...
def ring_drain(ring: NDArray[np.uint8], out: NDArray[np.uint8], next: int) -> tuple[int, int, int]: ...
def ring_state(
    ring: NDArray[np.uint8],
) -> tuple[bool, int, list[tuple[int, int, int, int, int, float, float]], dict[str, Any]]: ...

class Link:
    started: bool
    stopped: bool
    gone: bool
    tripped_at: int
    end: bool
    def __init__(
        self,
        socket: int,
        realtime: bool,
        listening: bool,
        period: float,
        answer: float,
        watchdog: int,
        after: int,
        quiet: int,
    ) -> None: ...

class Lane:
    diverged_tick: int
    def __init__(
        self,
        core: Core | None,
        drives: NDArray[np.uint8],
        events: NDArray[np.uint8],
        qpos: NDArray[np.float64],
        qvel: NDArray[np.float64],
        dt: float,
        steps_per_tick: int,
        ticks: int,
        reference: NDArray[np.float64] | None,
        external: NDArray[np.float64] | None,
        record: NDArray[np.float64] | None,
        status: NDArray[np.int32] | None,
        faults: Faults | None,
        guard: Guard | None,
        rotors: NDArray[np.float64],
        load_ticks: NDArray[np.int32],
        loads: NDArray[np.float64],
        bare: NDArray[np.float64] | None,
    ) -> None: ...

def measure(
    tables: tuple[NDArray[np.float64], ...],
    powered: NDArray[np.uint8] | None,
    begin: int,
    event: int,
    period: float,
    slowed: float,
    at_rest: float,
    stays: int,
    last: int,
    noise: NDArray[np.float64] | None,
    vibration: NDArray[np.float64] | None,
    window: int,
    out: NDArray[np.float64],
) -> None: ...
def run_lanes(tree: NDArray[np.uint8], scenarios: list[Lane], width: int) -> None: ...
def forward_dynamics(
    tree: NDArray[np.uint8],
    body: NDArray[np.float64],
    q: NDArray[np.float64],
    qd: NDArray[np.float64],
    torque: NDArray[np.float64],
    qdd: NDArray[np.float64],
    mass: NDArray[np.float64] | None,
    bias: NDArray[np.float64] | None,
    width: int,
) -> None: ...
def lane_functions(
    x: NDArray[np.float64],
    sine: NDArray[np.float64],
    cosine: NDArray[np.float64],
    decay: NDArray[np.float64],
    width: int,
) -> None: ...
