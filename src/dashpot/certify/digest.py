"""What a certificate is about, in 64 hex digits: coefficients, and the drives they were judged with."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dashpot.arm.drive import Drive
from dashpot.control.controller import ControllerConfig
from dashpot.control.sampled import BLOCK_DTYPE

JUDGED = (
    "rotor_inertia",
    "viscous_friction",
    "stiffness",
    "damping",
    "torque_gain_error",
    "torque_latency",
    "sensor_bandwidth",
    "sensor_order",
    "sensor_damping",
    "link_inertia",
    "link_friction",
)
"""Of a drive, with its uncertainty: all that the certificate depends on."""


def digest(drives: Sequence[Drive], blocks: NDArray[np.void], config: ControllerConfig) -> str:
    """SHA-256 of all that a certificate depends on.

    Args:
        drives: Of the controlled joints, base to tip.
        blocks: Their coefficients, (n,) records of `BLOCK_DTYPE`: those that run.
        config: Gives period, sampling and longest latency.
    """
    said: list[object] = [config.period, config.sampling, config.latency_max]
    for drive, block in zip(drives, blocks, strict=True):
        assert block.dtype.names is not None
        numbers = {key: np.asarray(block[key]).tolist() for key in BLOCK_DTYPE.names or ()}
        said += [drive.name, {key: getattr(drive, key) for key in JUDGED}, dict(drive.uncertainty), numbers]
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()
