"""Types of the native module (native/bindings.cpp)."""

from typing import overload

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

class Core:
    n: int
    inputs: NDArray[np.float64]
    def __init__(self, blocks: NDArray[np.uint8]) -> None: ...
    @overload
    def step(self, out: NDArray[np.float64]) -> int: ...
    @overload
    def step(self, inputs: NDArray[np.float64], out: NDArray[np.float64]) -> int: ...
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

WATCH_SIZE: int
RULES_SIZE: int
REASONS: int
LOG: int
HISTORY: int

def next_state(state: int, events: int) -> int: ...

class Guard:
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
