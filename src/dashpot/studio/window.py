"""What a live arm did in the last ticks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dashpot.simulation.recording import CHANNELS
from dashpot.support.arrays import Floats


@dataclass(frozen=True)
class Window:
    """What happened at some ticks.

    Attributes:
        tick: The first one.
        record: `dashpot.simulation.recording.CHANNELS` x ticks x joints.
        reference: Position reference, (ticks, n) [rad].
        external: Torque on the links, (ticks, n) [N m].
        status: Or-ed controller statuses, (ticks,).
        work: Done by the external torque [J].
    """

    tick: int
    record: Floats
    reference: Floats
    external: Floats
    status: NDArray[np.int32]
    work: float

    def last(self, channel: str) -> Floats:
        """The newest row of a channel, (n,)."""
        return np.asarray(self.record[CHANNELS.index(channel), -1])
